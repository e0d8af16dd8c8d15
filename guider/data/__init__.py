"""Reading logged trajectories, whatever file they come in, into Episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from guider.data.catalogue import MINARI_PREFIX
from guider.data.d4rl import KITCHEN_ACTIONS, KITCHEN_COLUMNS, kitchen_states, read_d4rl, read_d4rl_kitchen
from guider.data.describe import describe
from guider.data.minari import dataset_directory, read_minari
from guider.data.ogbench import read_ogbench
from guider.data.plain import read_plain
from guider.data.safety import check_path
from guider.data.store import Recording, Store, describe_keys, open_store
from guider.data.wgcsl import is_pickle, read_wgcsl
from guider.episodes import Episodes, make_episodes
from guider.errors import GuiderError

__all__ = ["FORMATS", "describe", "load"]

_READERS: dict[str, Callable[[Store, tuple[int, ...]], Recording]] = {
    "d4rl": read_d4rl,
    "d4rl-kitchen": read_d4rl_kitchen,
    "ogbench": read_ogbench,
    "plain": read_plain,
}
FORMATS = (*_READERS, "minari", "wgcsl")


def load(
    source: str | Path,
    goal_indices: Sequence[int],
    *,
    format: str | None = None,
    action_low: np.ndarray | float | None = None,
    action_high: np.ndarray | float | None = None,
) -> Episodes:
    """Read the trajectories at `source`.

    source: an HDF5 or npz file, a pickle of WGCSL's, the directory of a Minari dataset, or 'minari:ID' for one that is
        installed
    goal_indices: the state entries that make up the goal space
    format: one of FORMATS; None tells it by content:
        minari        'minari:ID', or a directory (or main_data.hdf5) that Minari wrote
        wgcsl         a pickle; it is read without unpickling
        plain         the file holds `lengths` or `episode_ends`
        ogbench       npz with `terminals` but no `timeouts`
        d4rl-kitchen  `terminals` or `timeouts`, 9 actions and 30, 59 or 60 numbers a row: terminals end episodes
        d4rl          any other file with `terminals` or `timeouts`: timeouts and jumps end episodes
    action_low, action_high: bounds of a valid action; where None, those the source states, else inferred

    Raises GuiderError, naming the source and what is wrong with it, for anything that cannot be read or is
    not valid (see make_episodes).
    """
    name = str(source)
    if format is not None and format not in FORMATS:
        raise GuiderError(f"unknown data format {format!r}; choose one of {', '.join(FORMATS)}")
    recording = _read(name, tuple(goal_indices), format)
    return make_episodes(
        recording.observations,
        recording.actions,
        recording.lengths,
        tuple(goal_indices),
        goals=recording.goals,
        action_low=recording.action_low if action_low is None else action_low,
        action_high=recording.action_high if action_high is None else action_high,
        source=name,
    )


def _read(name: str, goal_indices: tuple[int, ...], format: str | None) -> Recording:
    try:
        path = Path(name).expanduser()
    except RuntimeError:
        raise GuiderError(f"{name}: there is no such user here; write the folder's whole path") from None
    is_id = name.startswith(MINARI_PREFIX)
    if not is_id:
        check_path(path)
    directory = None if is_id else dataset_directory(path)
    if is_id or directory is not None or format == "minari":
        if format not in (None, "minari"):
            raise GuiderError(f"{name}: a Minari dataset, which cannot be read as {format}")
        if directory is None and not is_id:
            raise GuiderError(f"{name}: no Minari dataset here (a directory with data/main_data.hdf5)")
        recording = read_minari(name, directory or name.removeprefix(MINARI_PREFIX), goal_indices)
        if (recording.observations.shape[1], recording.actions.shape[1]) == (59, KITCHEN_ACTIONS):
            return replace(recording, observations=kitchen_states(recording.observations))
        return recording
    if path.is_dir():
        raise GuiderError(f"{name}: a directory, but not a Minari dataset's; name a file in it")
    if format == "wgcsl" or (format is None and is_pickle(path)):
        return read_wgcsl(path, goal_indices)
    with open_store(path) as store:
        return _READERS[format or _detect(store)](store, goal_indices)


def _detect(store: Store) -> str:
    if "lengths" in store.keys or "episode_ends" in store.keys:
        return "plain"
    store.require("observations", "actions")
    if store.kind == "npz" and "terminals" in store.keys and "timeouts" not in store.keys:
        return "ogbench"
    if "terminals" not in store.keys and "timeouts" not in store.keys:
        raise store.fail(
            "nothing says where episodes end: missing one of lengths, episode_ends, timeouts, terminals; "
            f"the file holds {describe_keys(store.keys)}"
        )
    columns, action_dim = store.width("observations"), store.width("actions")
    is_kitchen = action_dim == KITCHEN_ACTIONS and columns in KITCHEN_COLUMNS and "terminals" in store.keys
    return "d4rl-kitchen" if is_kitchen else "d4rl"
