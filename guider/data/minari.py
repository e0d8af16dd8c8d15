"""Minari 0.5 datasets, as they lie on this machine; nothing is downloaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from guider.data.safety import MAIN_FILE, METADATA_FILE, check_minari
from guider.data.store import Recording
from guider.episodes import check_goal_indices
from guider.errors import GuiderError


def dataset_directory(path: Path) -> Path | None:
    """The directory of a Minari dataset's data (it holds main_data.hdf5), given the dataset's directory, that
    directory itself or that file; None if there is no such dataset at `path`.
    """
    if path.name == MAIN_FILE:
        path = path.parent
    for directory in (path / "data", path):
        if (directory / MAIN_FILE).is_file() and (directory / METADATA_FILE).is_file():
            return directory
    return None


def read_minari(source: str, location: str | Path, goal_indices: tuple[int, ...]) -> Recording:
    """Read the dataset with the id `location`, or in the directory `location`.

    An episode of T actions has T + 1 states. Of observations that are dicts, the state is `observation`, and
    `achieved_goal` is put in front of it where it is not among its entries (as in AntMaze, whose
    `observation` leaves out x and y), so that a goal space can always be named by state entries.
    `desired_goal` is the recorded goal where `achieved_goal` is the goal space asked for. Goals that are
    dicts are left out. What is put in front and what is kept is decided by the first episode.

    Raises GuiderError for a dataset that is not on this machine, is damaged, or whose states or actions are not
    vectors.
    """
    directory = _installed(source, location) if isinstance(location, str) else location
    check_minari(source, directory)
    from minari import MinariDataset  # takes a while, and other sources do without

    try:
        return _gather(MinariDataset(directory), source, goal_indices)
    except GuiderError:
        raise
    except Exception as error:  # whatever Minari raises on what others wrote
        reason = " ".join(repr(error).split())[:200]
        raise GuiderError(f"{source}: the Minari dataset is damaged or cut off ({reason})") from error


def _installed(source: str, dataset_id: str) -> Path:
    from minari.storage.datasets_root_dir import get_dataset_path

    directory = get_dataset_path(dataset_id) / "data"
    if dataset_directory(directory) is None:
        raise GuiderError(
            f"{source}: no such Minari dataset on this machine; fetch it with: guider data fetch minari:{dataset_id}"
        )
    return directory


def _gather(dataset: Any, source: str, goal_indices: tuple[int, ...]) -> Recording:
    episode_count = len(dataset)
    if episode_count == 0:
        raise GuiderError(f"{source}: the Minari dataset holds no episodes")
    rows = int(dataset.total_steps) + episode_count
    observations = actions = goals = None
    prepend = keep_goals = False
    lengths, row = np.zeros(episode_count, np.int64), 0

    for index, episode in enumerate(dataset.iterate_episodes()):
        recorded = episode.observations
        parts = recorded if isinstance(recorded, dict) else {"observation": recorded}
        if "observation" not in parts:
            raise GuiderError(f"{source}: observations hold {', '.join(parts)}, but no 'observation'")
        state, action = parts["observation"], episode.actions
        achieved, desired = _vectors(parts.get("achieved_goal")), _vectors(parts.get("desired_goal"))
        for name, array in (("observations", state), ("actions", action)):
            if not isinstance(array, np.ndarray) or array.ndim != 2:
                raise GuiderError(f"{source}: {name} must be vectors (a 1-D Box); these are not")
        if len(state) != len(action) + 1:
            raise GuiderError(
                f"{source}: episode {episode.id} has {len(state)} states and {len(action)} actions; "
                "there must be one state more"
            )
        if observations is None or actions is None:
            prepend = achieved is not None and not contains(state, achieved)
            width = state.shape[1] + (achieved.shape[1] if prepend and achieved is not None else 0)
            goal_indices = check_goal_indices(goal_indices, width, source)
            observations = np.zeros((rows, width), np.float32)
            actions = np.zeros((rows, action.shape[1]), np.float32)
        end = row + len(state)
        if prepend and achieved is not None:
            state = np.concatenate([achieved, state], axis=1)
        observations[row:end], actions[row : end - 1] = state, action
        if index == 0 and achieved is not None and desired is not None and desired.shape == achieved.shape:
            asked_for = observations[row:end, list(goal_indices)]
            keep_goals = asked_for.shape == achieved.shape and np.allclose(asked_for, achieved, atol=1e-5)
            goals = np.zeros((rows, desired.shape[1]), np.float32) if keep_goals else None
        if goals is not None:
            goals[row:end] = desired
        lengths[index], row = len(state), end

    assert observations is not None and actions is not None
    space = dataset.action_space
    if not hasattr(space, "low"):
        raise GuiderError(f"{source}: actions must be continuous (a Box), not {space}")
    finite = bool(np.isfinite(space.low).all() and np.isfinite(space.high).all())
    bounds = (space.low, space.high) if finite else (None, None)
    return Recording(observations, actions, lengths, goals, *bounds)


def _vectors(array: Any) -> np.ndarray | None:
    return array if isinstance(array, np.ndarray) and array.ndim == 2 else None


def contains(state: np.ndarray, achieved: np.ndarray) -> bool:
    """Whether every entry of `achieved` equals some entry of `state` throughout. [rows, S], [rows, G]."""
    return all(np.isclose(state, column[:, None], atol=1e-5).all(axis=0).any() for column in achieved.T)
