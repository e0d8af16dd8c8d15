"""HDF5 files that keep episodes apart: robomimic's and robosuite's, a group an episode, and d3rlpy's, numbered
arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np

from guider.data.safety import memory_fault
from guider.data.store import Store, stacked

_DEMO = re.compile(r"(data/demo_(\d+))/(.+)")
_NUMBERED = re.compile(r"(observations|actions)_(\d+)(?:_(\d+))?")
_NEXT = "next_obs/"


def keeps_episodes_apart(store: Store) -> bool:
    """Whether the file is laid out in one of these ways."""
    return any(_DEMO.fullmatch(key) or key == "actions_0" for key in store.keys)


def read_groups(store: Store) -> Store:
    """Arrays as they are called within an episode's group: `obs/NAME`, `actions`, ... What follows the last state,
    robomimic's next_obs, is one more state. Of robosuite's own states, whose first column is the time, that stands
    apart.

    Raises GuiderError for arrays that cannot be read, and episodes that differ in what they hold.
    """
    return stacked(store.source, store.kind, _episodes(store))


def _episodes(store: Store) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    episodes: dict[str, dict[str, str]] = {}
    for key in store.keys:
        if found := _DEMO.fullmatch(key):
            episodes.setdefault(found[1], {})[found[3]] = key
        elif found := _NUMBERED.fullmatch(key):
            name = found[1] if found[3] is None else f"obs/{found[3]}"
            episodes.setdefault(f"episode {found[2]}", {})[name] = key
    vectors = [item for item in store.arrays.values() if item is not None and len(item.shape) in (1, 2)]
    if fault := memory_fault("its episodes", sum(item.float_bytes for item in vectors)):
        raise store.fail(fault)
    for name in sorted(episodes, key=lambda text: int(re.split(r"[ _]", text)[-1])):
        yield name, _arrays(store, episodes[name])


def _arrays(store: Store, keys: Mapping[str, str]) -> dict[str, np.ndarray]:
    read = {inner: store.numbers(key) for inner, key in keys.items()}
    arrays = {inner: array for inner, array in read.items() if array is not None and not inner.startswith(_NEXT)}
    observed = [inner for inner in arrays if inner.startswith("obs/")]
    followers = {inner: read.get(_NEXT + inner.removeprefix("obs/")) for inner in observed}
    if all(follower is not None for follower in followers.values()):
        arrays |= {
            inner: np.concatenate([arrays[inner], last[-1:]]) for inner, last in followers.items() if last is not None
        }
    states = arrays.get("states")
    if not observed and states is not None and states.ndim == 2 and (np.diff(states[:, 0]) > 0).all():
        arrays |= {"time": states[:, 0], "states": states[:, 1:]}
    return arrays
