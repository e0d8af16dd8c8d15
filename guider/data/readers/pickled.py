"""Pickles of episodes, which are never unpickled (guider.data.pickles): WGCSL's dict of arrays o, u, g and ag, and
lists of dicts, an episode each; and arrays whose first axis is the episode, pickled ones too: ragged lists, HER's
demonstrations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.columns import ACHIEVED, ACTIONS, DESIRED, STATES
from guider.data.pickles import array, is_pickle, notes, objects, open_pickle, pickle_faults
from guider.data.safety import memory_fault
from guider.data.store import Store, stacked, store_of
from guider.errors import GuiderError


def read_pickle(path: Path) -> Store:
    """Raises GuiderError for anything but arrays of numbers in one of the two layouts."""
    if not is_pickle(path):
        raise GuiderError(f"{path}: no such file, or not a pickle of protocol 2 to 5")
    with open_pickle(path) as content:
        if isinstance(content, list):
            return stacked(str(path), "pickle", _dicts(content, str(path)))
        return _wgcsl(content, str(path))


def _wgcsl(content: Any, source: str) -> Store:
    """o [episodes, T + 1, state], u [episodes, T, action], g [episodes, T, goal], ag [episodes, T + 1, goal]: states,
    actions, the goals aimed at and the goals achieved. Other entries are ignored. An episode's last goal stands for its
    last state too.
    """

    def fail(message: str) -> GuiderError:
        return GuiderError(f"{source}: {message}")

    arrays = {}
    for key in ("o", "u", "g", "ag"):
        if not isinstance(content, dict) or key not in content:
            raise fail(f"the pickle is not a dict with {key}, nor a list of episodes")
        arrays[key] = array(content[key], key)
        if arrays[key].ndim != 3:
            raise fail(f"{key} has {arrays[key].ndim} dimensions instead of [episodes, rows, columns]")
    states, actions, goals, achieved = arrays.values()
    episodes, steps = actions.shape[:2]
    for key, found, rows in (("o", states, steps + 1), ("g", goals, steps), ("ag", achieved, steps + 1)):
        if found.shape[:2] != (episodes, rows):
            raise fail(f"{key} has shape {found.shape}, but u {actions.shape} asks for {(episodes, rows)} rows")
    if goals.shape[2] != achieved.shape[2]:
        raise fail(f"g has {goals.shape[2]} columns but ag has {achieved.shape[2]}")
    named = {
        "observation": states,
        ACHIEVED: achieved,
        DESIRED: np.concatenate([goals, goals[:, -1:]], axis=1),
        "actions": np.concatenate([actions, np.zeros_like(actions[:, :1])], axis=1),
    }
    flat = {key: found.reshape(-1, found.shape[2]) for key, found in named.items()}
    return store_of(source, "pickle", flat, lengths=np.full(episodes, steps + 1))


def _dicts(content: list[Any], source: str) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """The arrays of each dict in a list; entries that are none are left out."""
    for number, episode in enumerate(content):
        if not isinstance(episode, dict):
            raise GuiderError(f"{source}: entry {number} of the list is not a dict of arrays, as an episode would be")
        yield (
            f"entry {number} of the list",
            {key: found for key, item in episode.items() if (found := _numbers(item)) is not None},
        )


def _numbers(note: Any) -> np.ndarray | None:
    """The array that was noted, None if it is none of numbers."""
    try:
        return array(note, "it")
    except Exception as error:  # its own refusals: what is no array of numbers is not read
        if isinstance(error, GuiderError):
            raise
        return None


def has_episode_axis(store: Store) -> bool:
    """Whether the actions are [episodes, rows, columns], or an npz holds states or actions as Python objects."""
    if any((item := store.arrays.get(key)) is not None and len(item.shape) == 3 for key in ACTIONS):
        return True
    kinds = {key: item.kind for key, item in store.arrays.items() if item is not None}
    return store.kind == "npz" and any(kinds.get(key) == "O" for key in (*STATES, *ACTIONS))


def read_episode_axis(store: Store) -> Store:
    """Arrays [episodes, rows, columns], and an npz's object arrays: [episodes] of arrays [rows, columns] (ragged), or
    [episodes, rows] of dicts of vectors, as in HER's demonstrations.

    Raises GuiderError for object arrays of anything else.
    """
    columns: dict[str, list[Mapping[str, np.ndarray] | np.ndarray]] = {}
    for key, declared in store.arrays.items():
        if declared is None or key in ("info", "infos"):
            continue
        if declared.kind == "O" and store.kind == "npz":
            columns[key] = _objects(store, key)
        elif len(declared.shape) == 3 and declared.kind in "fiu":
            store.admit(key)
            columns[key] = list(np.asarray(store.file[key]))
    count = len(next(iter(columns.values())))
    if any(len(column) != count for column in columns.values()):
        raise store.fail(f"{', '.join(columns)} hold different numbers of episodes")
    return stacked(store.source, "npz", ((f"episode {i}", _side_by_side(columns, i)) for i in range(count)))


def _side_by_side(columns: Mapping[str, list[Any]], index: int) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for key, column in columns.items():
        arrays |= column[index] if isinstance(column[index], dict) else {key: column[index]}
    return arrays


def _objects(store: Store, key: str) -> list[Any]:
    """[episodes] arrays, or dicts of arrays, of one object array of an npz."""
    declared = store.arrays[key]
    archive = store.file.zip  # pyright: ignore[reportAttributeAccessIssue]
    assert declared is not None and archive is not None
    with pickle_faults(f"{store.source}: {key}"), archive.open(f"{key}.npy") as file:
        if fault := memory_fault(key, declared.most_bytes):
            raise store.fail(fault)
        version = np.lib.format.read_magic(file)
        (np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0)(file)
        found = objects(notes(file.read()))
        if found is None:
            raise store.fail(f"{key} holds Python objects that are no arrays or dicts; save it as an array of numbers")
        shape, items = found
        if len(shape) == 1:
            return [array(item, f"{key}[{i}]") for i, item in enumerate(items)]
        if len(shape) != 2 or not all(isinstance(item, dict) and item for item in items):
            raise store.fail(f"{key} holds Python objects that are no dicts, one for each step of each episode")
        names, steps = tuple(items[0]), shape[1]
        if math.prod(shape) == 0 or any(tuple(item) != names for item in items):
            raise store.fail(f"{key} holds dicts that have different entries")
        episodes = [items[start : start + steps] for start in range(0, len(items), steps)]
        return [
            {name: np.stack([array(item[name], name) for item in episode]) for name in names} for episode in episodes
        ]
