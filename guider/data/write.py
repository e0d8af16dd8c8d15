"""Writing recorded trajectories to files that others read too."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from guider.data.store import Recording
from guider.goals import Parts, largest_distance

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer


def write_d4rl(
    path: Path, recording: Recording, goal_indices: tuple[int, ...], radius: float, goal_parts: Parts = ()
) -> None:
    """Write HDF5 laid out as D4RL's; the file appears only when it is complete.

    observations, actions and, where goals are recorded, infos/goal are float32; rewards are 1 where the step comes
    within `radius` of its goal, else 0, and 0 throughout without goals; terminals are all False; timeouts are True in
    the last row of each episode.
    """
    rows = len(recording.observations)
    timeouts = np.zeros(rows, bool)
    timeouts[np.cumsum(recording.lengths) - 1] = True
    arrays = {"observations": recording.observations, "actions": recording.actions}
    if recording.goals is not None:
        arrays["infos/goal"] = recording.goals
    arrays["rewards"] = np.where(timeouts, np.float32(0), _rewards(recording, goal_indices, radius, goal_parts))
    arrays |= {"terminals": np.zeros(rows, bool), "timeouts": timeouts}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial(path)
    try:
        with h5py.File(partial, "w") as file:
            for key, array in arrays.items():
                file.create_dataset(key, data=array)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_minari(
    directory: Path,
    recording: Recording,
    goal_indices: tuple[int, ...],
    radius: float,
    goal_parts: Parts = (),
    *,
    dataset_id: str,
    recipe: str,
    description: str,
    seed: int,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write a Minari dataset, which appears only when it is complete; `directory` must be new or empty.

    Observations are those recorded, or where goals are recorded dicts of observation, achieved_goal and desired_goal.
    Rewards are write_d4rl's. No step terminates; the last of each episode is a truncation. Episodes of a single state
    hold no transition and are left out.

    dataset_id:  NAMESPACE/NAME-vN; as this folder below Minari's own, Minari finds the dataset by that name
    recipe:      in a few words, who acted (Minari's algorithm_name)
    description: what was recorded, and how
    report:      called with (episodes done, episodes in all): Minari takes about 2 ms for each
    """
    import minari
    from gymnasium.spaces import Box, Dict
    from minari.dataset.minari_storage import MinariStorage

    def vectors(width: int) -> Box:
        return Box(-np.inf, np.inf, (width,), np.float32)

    observation_space = vectors(recording.observations.shape[1])
    if recording.goals is not None:
        goal_space = vectors(len(goal_indices))
        observation_space = Dict(observation=observation_space, achieved_goal=goal_space, desired_goal=goal_space)
    action_space = vectors(recording.actions.shape[1])
    if recording.action_low is not None and recording.action_high is not None:
        low, high = (np.asarray(bound, np.float32) for bound in (recording.action_low, recording.action_high))
        action_space = Box(low, high, action_space.shape, np.float32)

    partial = _partial(directory)
    partial.mkdir(parents=True)
    try:
        storage = MinariStorage.new(partial / "data", observation_space, action_space)
        storage.update_metadata(
            {
                "dataset_id": dataset_id,
                "minari_version": minari.__version__,
                "algorithm_name": recipe,
                "description": description,
                "seed": seed,
            }
        )
        rewards = _rewards(recording, goal_indices, radius, goal_parts)
        storage.update_episodes(_episode_buffers(recording, goal_indices, rewards, report))
        os.replace(partial, directory)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _episode_buffers(
    recording: Recording, goal_indices: tuple[int, ...], rewards: np.ndarray, report: Callable[[int, int], None]
) -> Iterator[EpisodeBuffer]:
    from minari.data_collector import EpisodeBuffer

    total = len(recording.lengths)
    ends = np.cumsum(recording.lengths)
    for done, (start, end) in enumerate(zip(ends - recording.lengths, ends, strict=True), start=1):
        if end - start > 1:
            states, steps = slice(start, end), slice(start, end - 1)
            observations = recording.observations[states]
            if recording.goals is not None:
                observations = {
                    "observation": observations,
                    "achieved_goal": observations[:, list(goal_indices)],
                    "desired_goal": recording.goals[states],
                }
            yield EpisodeBuffer(
                observations=observations,  # pyright: ignore[reportArgumentType]
                actions=recording.actions[steps],  # pyright: ignore[reportArgumentType]
                rewards=rewards[steps],  # pyright: ignore[reportArgumentType]
                terminations=np.zeros(end - start - 1, bool),  # pyright: ignore[reportArgumentType]
                truncations=np.arange(start + 2, end + 1) == end,  # pyright: ignore[reportArgumentType]
            )
        report(done, total)


def _rewards(recording: Recording, goal_indices: tuple[int, ...], radius: float, goal_parts: Parts) -> np.ndarray:
    """[rows] float32: 1 where the step from a row comes within `radius` of the row's goal; last rows mean nothing."""
    rewards = np.zeros(len(recording.observations), np.float32)
    if recording.goals is not None:
        achieved = recording.observations[1:, list(goal_indices)]
        rewards[:-1] = largest_distance(achieved, recording.goals[:-1], goal_parts) <= radius
    return rewards


def _partial(path: Path) -> Path:
    """Where `path` is written before it is renamed: beside it, so that renaming is one step."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")
