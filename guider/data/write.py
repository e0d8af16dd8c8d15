"""Writing recorded trajectories to files that others read too."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import h5py
import numpy as np

from guider.data.store import Recording
from guider.errors import GuiderError
from guider.goals import Parts, largest_distance
from guider.support.files import clear_leftovers, shortened, temporary

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

MINARI_BYTES_PER_EPISODE = 30_000
"""More than Minari writes for an episode besides its arrays: 21,000 to 26,000, or 15,000 to 20,000 without goals."""
FLAG_BYTES_PER_ROW = 6
"""Of reward, termination and truncation."""


def check_destination(out: Path, size: int) -> Literal["d4rl", "ogbench", "minari"]:
    """What is to be written to `out`: D4RL's file if its name ends in .hdf5 or .h5, OGBench's two files if in .npz, a
    Minari directory if in nothing.

    size: bytes it will take, or somewhat fewer. Missing folders above it are made. Raises GuiderError for any other
    ending, where something is there already, and where there is no room or it cannot be written.
    """
    ending = out.suffix.lower()
    if ending not in ("", ".hdf5", ".h5", ".npz"):
        raise GuiderError(
            f"{out}: recordings are not written as {ending}; end the name in .hdf5 or .h5 for D4RL's layout, in .npz "
            "for OGBench's, or in nothing for a Minari directory"
        )
    for path in (out, validation_file(out)) if ending == ".npz" else (out,):
        if os.path.lexists(path):
            raise GuiderError(f"{path} exists already and is never overwritten; choose another --out")
    with in_new_place(out, size):
        return "ogbench" if ending == ".npz" else "d4rl" if ending else "minari"


def validation_file(path: Path) -> Path:
    """Where OGBench looks for the validation set of the one in `path`."""
    return path.with_name(f"{path.stem}-val{path.suffix}")


def write_ogbench(path: Path, recording: Recording) -> None:
    """Write an npz laid out as OGBench's; the file appears only when it is complete.

    observations and actions are float32; terminals are True in the last row of each episode, whose action nothing
    reads; goals, qpos, qvel and button_states are there where they were recorded, OGBench's loader passes over goals.
    """
    arrays = {"observations": recording.observations, "actions": recording.actions}
    arrays["terminals"] = _last_rows(recording)
    goals = {} if recording.goals is None else {"goals": recording.goals}
    write_npz(path, arrays | goals | dict(recording.simulation))


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """The file appears only when it is complete."""
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # pyright: ignore[reportArgumentType]
    _write(path, content)


def _write(path: Path, content: BytesIO) -> None:
    with in_new_place(path, len(content.getbuffer())) as partial:
        partial.write_bytes(content.getbuffer())
        os.replace(partial, path)


def _last_rows(recording: Recording) -> np.ndarray:
    """[rows] bool: True in the last row of each episode."""
    last = np.zeros(len(recording.observations), bool)
    last[np.cumsum(recording.lengths) - 1] = True
    return last


def write_d4rl(
    path: Path, recording: Recording, goal_indices: tuple[int, ...], radius: float, goal_parts: Parts = ()
) -> None:
    """Write HDF5 laid out as D4RL's; the file appears only when it is complete.

    observations, actions and, where goals are recorded, infos/goal are float32; rewards are 1 where the step comes
    within `radius` of its goal, else 0, and 0 throughout without goals; terminals are all False; timeouts are True in
    the last row of each episode. What puts a simulator where it was is there as infos/qpos and so on.
    """
    rows = len(recording.observations)
    timeouts = _last_rows(recording)
    arrays = {"observations": recording.observations, "actions": recording.actions}
    if recording.goals is not None:
        arrays["infos/goal"] = recording.goals
    arrays["rewards"] = np.where(timeouts, np.float32(0), _rewards(recording, goal_indices, radius, goal_parts))
    arrays |= {"terminals": np.zeros(rows, bool), "timeouts": timeouts}
    arrays |= {f"infos/{name}": array for name, array in recording.simulation.items()}
    content = BytesIO()  # HDF5 crashes on a full disk
    with h5py.File(content, "w") as file:
        for key, array in arrays.items():
            file.create_dataset(key, data=array)
    _write(path, content)


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

    arrays = recording.observations, recording.actions, *2 * [recording.goals]
    size = sum(array.nbytes for array in arrays if array is not None)
    size += FLAG_BYTES_PER_ROW * len(recording.observations) + MINARI_BYTES_PER_EPISODE * len(recording.lengths)
    with in_new_place(directory, size) as partial:
        partial.mkdir()
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


@contextmanager
def in_new_place(path: Path, size: int) -> Iterator[Path]:
    """Where to write what is then renamed to `path`: within a folder beside it that lasts as long as this context.

    Raises GuiderError where there is no room for `size` bytes, and for any OSError in the context.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_leftovers(path.parent, re.escape(shortened(path.name)))
        folder = temporary(path.absolute())
        folder.mkdir()
        try:
            partial = folder / path.name
            _check_room(partial, size)
            yield partial
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        raise GuiderError(f"{path} cannot be written: {error.strerror or error}") from error


def _check_room(path: Path, size: int) -> None:
    """Raise OSError unless a file of `size` bytes can be made at `path`; it is gone again afterwards."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, max(1, size))  # minds quotas and limits, too
        elif shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    path.unlink()
