"""Minari 0.5 datasets, as they lie on this machine; nothing is downloaded."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.columns import ACHIEVED, DESIRED
from guider.data.safety import MAIN_FILE, METADATA_FILE, check_minari
from guider.data.store import Store, in_memory, stacked, store_of
from guider.errors import GuiderError
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


def read_minari(source: str, location: str | Path) -> Store:
    """Read the dataset with the id `location`, or in the directory `location`.

    An episode of T actions has T + 1 states. Observations that are dicts become an array for each of their entries,
    dicts in them too ("observation/position"); goals that are dicts are left out.

    Raises GuiderError for a dataset that is not on this machine, is damaged, or whose states or actions are not
    vectors.
    """
    directory = _installed(source, location) if isinstance(location, str) else location
    check_minari(source, directory)
    from minari import MinariDataset  # takes a while, and other sources do without

    try:
        return _gather(MinariDataset(directory), source)
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


def _gather(dataset: Any, source: str) -> Store:
    if len(dataset) == 0:
        raise GuiderError(f"{source}: the Minari dataset holds no episodes")
    space = dataset.action_space
    if not hasattr(space, "low"):
        raise GuiderError(f"{source}: actions must be continuous (a Box), not {space}")
    store = stacked(source, "Minari", _episodes(dataset, source))
    if not (np.isfinite(space.low).all() and np.isfinite(space.high).all()):
        return store
    bounds = {"action_low": np.atleast_1d(space.low), "action_high": np.atleast_1d(space.high)}
    return store_of(source, "Minari", in_memory(store) | bounds, lengths=store.lengths)


def _episodes(dataset: Any, source: str) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    for episode in dataset.iterate_episodes():
        arrays = _flat("", episode.observations)
        if not isinstance(episode.actions, np.ndarray) or episode.actions.ndim != 2:
            raise GuiderError(f"{source}: actions must be vectors (a 1-D Box); these are not")
        for name, array in arrays.items():
            if len(array) != len(episode.actions) + 1:
                raise GuiderError(
                    f"{source}: episode {episode.id} has {len(array)} rows of {name} and {len(episode.actions)} "
                    "actions; there must be one state more"
                )
        yield f"episode {episode.id}", arrays | {"actions": episode.actions}


def _flat(name: str, recorded: Any) -> dict[str, np.ndarray]:
    """array name -> array of what was observed, dicts in dicts too."""
    if not isinstance(recorded, dict):
        return {name or "observation": np.asarray(recorded)}
    arrays: dict[str, np.ndarray] = {}
    for key, item in recorded.items():
        if not (isinstance(item, dict) and key in (ACHIEVED, DESIRED)):
            within = (
                key if key in (ACHIEVED, DESIRED) or (not name and key == "observation") else f"{name or 'obs'}/{key}"
            )
            arrays |= _flat(within, item)
    return arrays
