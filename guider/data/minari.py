"""Minari 0.5 datasets, as they lie on this machine; nothing is downloaded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.episodes import EndSign, check_goal_indices
from guider.data.safety import MAIN_FILE, METADATA_FILE, check_minari
from guider.data.store import Recording
from guider.errors import GuiderError
from guider.goals import goal_entries
from guider.support.files import user_path


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


def read_minari(source: str, location: str | Path, goal_indices: tuple[int, ...] | None) -> Recording:
    """Read the dataset with the id `location`, or in the directory `location`.

    An episode of T actions has T + 1 states. Of observations that are dicts, the state is `observation`, and
    `achieved_goal` is put in front of it where it is not among its entries (as in AntMaze, whose
    `observation` leaves out x and y), so that a goal space can always be named by state entries.
    `desired_goal` is the recorded goal where `achieved_goal` is the goal space asked for, or none is asked for: then it
    is the dataset's own. Goals that are dicts are left out.

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
    if "MINARI_DATASETS_PATH" not in os.environ:
        user_path("~")  # without a home, Minari would make a folder called ~ here
    from minari.storage.datasets_root_dir import get_dataset_path

    directory = get_dataset_path(dataset_id) / "data"
    if dataset_directory(directory) is None:
        raise GuiderError(
            f"{source}: no such Minari dataset on this machine; fetch it with: guider data fetch minari:{dataset_id}"
        )
    return directory


def _gather(dataset: Any, source: str, goal_indices: tuple[int, ...] | None) -> Recording:
    episode_count = len(dataset)
    if episode_count == 0:
        raise GuiderError(f"{source}: the Minari dataset holds no episodes")
    rows = int(dataset.total_steps) + episode_count
    arrays: dict[str, np.ndarray] = {}
    lengths, row = np.zeros(episode_count, np.int64), 0

    for index, episode in enumerate(dataset.iterate_episodes()):
        recorded = episode.observations
        parts = recorded if isinstance(recorded, dict) else {"observation": recorded}
        if "observation" not in parts:
            raise GuiderError(f"{source}: observations hold {', '.join(parts)}, but no 'observation'")
        state, action = parts["observation"], episode.actions
        for name, array in (("observations", state), ("actions", action)):
            if not isinstance(array, np.ndarray) or array.ndim != 2:
                raise GuiderError(f"{source}: {name} must be vectors (a 1-D Box); these are not")
        if len(state) != len(action) + 1:
            raise GuiderError(
                f"{source}: episode {episode.id} has {len(state)} states and {len(action)} actions; "
                "there must be one state more"
            )
        goal_parts = {name: _vectors(parts.get(name)) for name in ("achieved_goal", "desired_goal")}
        found = {"states": state, "actions": action} | {k: v for k, v in goal_parts.items() if v is not None}
        for name, array in found.items():
            if index == 0:
                arrays[name] = np.zeros((rows, array.shape[1]), np.float32)
            arrays[name][row : row + len(array)] = array
        lengths[index], row = len(state), row + len(state)

    space = dataset.action_space
    if not hasattr(space, "low"):
        raise GuiderError(f"{source}: actions must be continuous (a Box), not {space}")
    finite = bool(np.isfinite(space.low).all() and np.isfinite(space.high).all())
    states, own, goals = with_goal_space(
        arrays["states"], arrays.get("achieved_goal"), arrays.get("desired_goal"), goal_indices, source
    )
    return Recording(
        states,
        arrays["actions"],
        lengths,
        goals,
        *((space.low, space.high) if finite else (None, None)),
        end_signs=(EndSign("episodes of the dataset", episode_count),),
        goal_indices=own,
    )


def _vectors(array: Any) -> np.ndarray | None:
    return array if isinstance(array, np.ndarray) and array.ndim == 2 else None


def with_goal_space(
    states: np.ndarray,
    achieved: np.ndarray | None,
    desired: np.ndarray | None,
    goal_indices: tuple[int, ...] | None,
    source: str,
) -> tuple[np.ndarray, tuple[int, ...] | None, np.ndarray | None]:
    """States among whose entries the achieved goal is: it is put in front where it is not. states: [rows, S]; achieved,
    desired: [rows, G], None where the source has none.

    Returns (states, the entries of the source's goal space, desired where `goal_indices` name that space or are None).
    """
    if achieved is None:
        return states, None, None
    own = goal_entries(states, achieved)
    if own is None:
        states, own = np.concatenate([achieved, states], axis=1), tuple(range(achieved.shape[1]))
    asked_for = own if goal_indices is None else check_goal_indices(goal_indices, states.shape[1], source)
    same = len(asked_for) == len(own) and np.allclose(states[:, list(asked_for)], achieved, atol=1e-5)
    return states, own, desired if same and desired is not None and desired.shape == achieved.shape else None
