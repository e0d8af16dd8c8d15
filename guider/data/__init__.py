"""Reading logged trajectories, whatever file they come in, into Episodes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from guider.data.arrays import read_arrays
from guider.data.catalogue import MINARI_PREFIX
from guider.data.describe import describe
from guider.data.episodes import Episodes, make_episodes
from guider.data.kitchen import KITCHEN_ACTIONS, kitchen_states, read_kitchen
from guider.data.minari import dataset_directory, read_minari
from guider.data.safety import check_path
from guider.data.store import Recording, Store, open_store
from guider.data.wgcsl import is_pickle, read_wgcsl
from guider.errors import GuiderError, GuiderWarning
from guider.support.files import user_path

__all__ = ["FORMATS", "describe", "load"]

FORMATS = ("arrays", "d4rl-kitchen", "minari", "wgcsl")


def load(
    source: str | Path,
    goal_indices: Sequence[int] | None = None,
    *,
    format: str | None = None,
    episode_ends: Sequence[str] = (),
    action_low: np.ndarray | float | None = None,
    action_high: np.ndarray | float | None = None,
    assumed_goal: Sequence[int] | None = None,
) -> Episodes:
    """Read the trajectories at `source`.

    source: an HDF5 or npz file, a pickle of WGCSL's, the directory of a Minari dataset, or 'minari:ID' for one that is
        installed
    goal_indices: the state entries that make up the goal space; None for the source's own, if it names one
    format: one of FORMATS; None tells it by content:
        minari        'minari:ID', or a directory (or main_data.hdf5) that Minari wrote
        wgcsl         a pickle; it is read without unpickling
        d4rl-kitchen  `terminals`, 9 actions and 30 numbers a row, or 60 of which the last 30, a goal, stay
        arrays        any other HDF5 or npz file: one's own, D4RL's, OGBench's
    episode_ends: which signs of where episodes end to take, by name; () decides, see guider.data.ends
    action_low, action_high: bounds of a valid action; where None, those the source states, else inferred
    assumed_goal: taken where neither `goal_indices` nor the source says, instead of raising

    Raises GuiderError, naming the source and what is wrong with it, for anything that cannot be read or is
    not valid (see make_episodes). Warns of what was decided about the data and may be wrong.
    """
    name = str(source)
    if format is not None and format not in FORMATS:
        raise GuiderError(
            f"unknown data format {format!r}; there are {', '.join(FORMATS)} (arrays: D4RL's, OGBench's and one's own)"
        )
    asked = None if goal_indices is None else tuple(goal_indices)
    signs = (episode_ends,) if isinstance(episode_ends, str) else tuple(episode_ends)
    recording = _read(name, asked, assumed_goal, format, signs)
    if recording.warning:
        warnings.warn(GuiderWarning(f"{name}: {recording.warning}"), stacklevel=2)
    known = asked or recording.goal_indices
    if known is None and assumed_goal is None:
        raise _no_goal_space(name)
    episodes = make_episodes(
        recording.observations,
        recording.actions,
        recording.lengths,
        known or tuple(assumed_goal or ()),
        goals=recording.goals,
        action_low=recording.action_low if action_low is None else action_low,
        action_high=recording.action_high if action_high is None else action_high,
        source=name,
        end_signs=recording.end_signs,
    )
    return episodes if asked else replace(episodes, goal_space_from="the source" if known else "assumed")


def _read(
    name: str,
    asked: tuple[int, ...] | None,
    assumed: Sequence[int] | None,
    format: str | None,
    episode_ends: tuple[str, ...],
) -> Recording:
    path = user_path(name)
    is_id = name.startswith(MINARI_PREFIX)
    if not is_id:
        check_path(path)
    directory = None if is_id else dataset_directory(path)
    if is_id or directory is not None or format == "minari":
        if format not in (None, "minari"):
            raise GuiderError(f"{name}: a Minari dataset, which cannot be read as {format}")
        if directory is None and not is_id:
            raise GuiderError(f"{name}: no Minari dataset here (a directory with data/main_data.hdf5)")
        _no_choice(name, episode_ends)
        recording = read_minari(name, directory or name.removeprefix(MINARI_PREFIX), asked)
        if (recording.observations.shape[1], recording.actions.shape[1]) == (59, KITCHEN_ACTIONS):
            recording = replace(recording, observations=kitchen_states(recording.observations))
        return recording
    if path.is_dir():
        raise GuiderError(f"{name}: a directory, but not a Minari dataset's; name a file in it")
    if format == "wgcsl" or (format is None and is_pickle(path)):
        _no_choice(name, episode_ends)
        return read_wgcsl(path, asked)
    with open_store(path) as store:
        is_kitchen = format == "d4rl-kitchen" or (format is None and _is_kitchen(store))
        if asked is None and assumed is None:
            raise _no_goal_space(name)
        read = read_kitchen if is_kitchen else read_arrays
        return read(store, tuple(assumed or ()) if asked is None else asked, episode_ends)


def _no_goal_space(name: str) -> GuiderError:
    return GuiderError(f"{name} does not say which state entries are the goal; name them (--goal-indices 0 1)")


def _no_choice(name: str, episode_ends: tuple[str, ...]) -> None:
    if episode_ends:
        raise GuiderError(f"{name} states its episodes; leave --episode-ends out")


def _is_kitchen(store: Store) -> bool:
    """Whether a file is D4RL's kitchen: by its widths and, of 60 numbers, by a goal that stays from row to row."""
    if not {"observations", "actions", "terminals"} <= set(store.keys) or {"lengths", "episode_ends"} & set(store.keys):
        return False
    columns = store.width("observations")
    if store.width("actions") != KITCHEN_ACTIONS or columns not in (30, 60):
        return False
    return columns == 30 or bool(np.mean(np.diff(store.matrix("observations")[:, 30:], axis=0) == 0) > 0.9)
