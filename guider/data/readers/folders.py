"""Folders: LeRobot's, RLDS's, and those that hold a file for each episode."""

from __future__ import annotations

import os
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.readers.bags import NothingSaidError, read_mcap
from guider.data.readers.files import open_file, refuse_others
from guider.data.readers.rlds import is_shard, read_rlds
from guider.data.readers.tables import read_parquet
from guider.data.store import Store, in_memory, stacked, store_of
from guider.errors import GuiderError, GuiderWarning
from guider.support.files import parse_json

_EPISODE_FILES = {
    **{".csv": "CSV", ".tsv": "CSV", ".parquet": "parquet", ".npy": "npy"},
    **{".npz": "npz", ".hdf5": "HDF5", ".h5": "HDF5", ".pkl": "pickle", ".pickle": "pickle", ".mcap": "MCAP"},
}
_MOST_FILES = 200_000


def read_folder(folder: Path) -> Store:
    """Raises GuiderError, saying what the folder holds, for one that is neither."""
    files = _files(folder)
    if (folder / "meta" / "info.json").is_file():
        return _lerobot(folder, [path for path in files if path.suffix == ".parquet"])
    if records := [path for path in files if is_shard(path.name)]:
        return read_rlds(folder, records)
    kinds = Counter(path.suffix.lower() for path in files if path.suffix.lower() in _EPISODE_FILES)
    if len(kinds) > 1:
        raise GuiderError(
            f"{folder}: holds files of several kinds ({', '.join(kinds)}); keep the episodes of one kind in a folder"
        )
    if not kinds:
        refuse_others(folder, files)
        raise GuiderError(
            f"{folder}: a directory, but not a Minari dataset's nor LeRobot's, nor one of episodes ("
            f"{', '.join(_EPISODE_FILES)}); name a file in it"
        )
    if ".mcap" in kinds:
        return _bags(folder, [path for path in files if path.suffix.lower() == ".mcap"])
    ending = next(iter(kinds))
    episodes = [path for path in files if path.suffix.lower() == ending]
    return stacked(str(folder), _EPISODE_FILES[ending], _episodes(folder, episodes))


def _bags(folder: Path, files: list[Path]) -> Store:
    """ROS 2 recordings, an episode each; files in a folder with metadata.yaml are one recording, cut by its size."""
    recordings: dict[Path, list[Path]] = {}
    for path in files:
        recordings.setdefault(path.parent if (path.parent / "metadata.yaml").is_file() else path, []).append(path)
    stores: dict[Path, Store] = {}
    silent: list[NothingSaidError] = []
    for place, paths in recordings.items():
        try:
            stores[place] = read_mcap(place, paths)
        except NothingSaidError as error:
            silent.append(error)
    if not stores:
        raise silent[0]
    for error in silent:
        warnings.warn(GuiderWarning(f"left out: {error}"), stacklevel=2)
    if len(stores) == 1:
        return next(iter(stores.values()))
    return stacked(str(folder), "MCAP", ((place.name, in_memory(store)) for place, store in stores.items()))


def _lerobot(folder: Path, files: list[Path]) -> Store:
    """LeRobot's versions 2 and 3: tables of frames, several episodes to a table or one, told apart by
    `episode_index`."""
    features = _features(folder / "meta" / "info.json")
    tables = [read_parquet(path) for path in files if path.relative_to(folder).parts[0] == "data"]
    if not tables:
        raise GuiderError(f"{folder}: LeRobot's, but no parquet file is below its folder data")
    shared = [key for key in tables[0] if all(key in table for table in tables)]
    arrays = {key: np.concatenate([table[key] for table in tables]) for key in shared}
    if "episode_index" not in arrays:
        raise GuiderError(f"{folder}: its tables have no column episode_index")
    order = np.lexsort([arrays[key] for key in ("frame_index", "episode_index") if key in arrays])
    arrays = {key: item[order] for key, item in arrays.items()}
    lengths = np.unique(arrays["episode_index"], return_counts=True)[1]
    named = {key: names for key, names in features.items() if key in arrays and arrays[key].shape[1:] == (len(names),)}
    return store_of(str(folder), "LeRobot", arrays, named, lengths)


def _features(path: Path) -> dict[str, tuple[str, ...]]:
    """feature -> names of its entries, where info.json names them."""
    try:
        features = parse_json(path).get("features", {})
    except OSError as error:
        raise GuiderError(f"{path} cannot be read: {error.strerror}") from error
    if not isinstance(features, dict):
        return {}
    named = {key: _words(item.get("names")) for key, item in features.items() if isinstance(item, dict)}
    return {key: tuple(words) for key, words in named.items() if words and len(set(words)) == len(words)}


def _words(names: Any) -> list[str]:
    """The words in lists or dicts of lists, as LeRobot's versions write them."""
    if isinstance(names, str):
        return [names]
    if isinstance(names, dict):
        names = list(names.values()) if all(isinstance(item, list) for item in names.values()) else list(names)
    return [word for item in names for word in _words(item)] if isinstance(names, list) else []


def _episodes(folder: Path, files: list[Path]) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Those of each file: all its rows are one, unless it keeps several apart."""
    for path in files:
        name = path.relative_to(folder).as_posix()
        with open_file(path) as store:
            arrays = {key: found for key in store.keys if (found := store.numbers(key)) is not None}
            if store.lengths is None:
                yield name, arrays
                continue
            ends = np.cumsum(store.lengths)
            for number, (start, end) in enumerate(zip(ends - store.lengths, ends, strict=True)):
                yield f"episode {number} of {name}", {key: array[start:end] for key, array in arrays.items()}


def _files(folder: Path) -> list[Path]:
    """All files below the folder, hidden ones left out. Raises GuiderError for a link among them, which might lead
    anywhere, and where there are too many to be a recording's.
    """
    found: list[Path] = []
    for inner, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(inner, name) for name in names if not name.startswith(".")]
        if len(found) > _MOST_FILES:
            raise GuiderError(f"{folder}: holds more than {_MOST_FILES:,} files; name the folder of one recording")
    read = (path for path in found if path.suffix.lower() in _EPISODE_FILES or is_shard(path.name))
    if link := next((path for path in read if path.is_symlink()), None):
        raise GuiderError(
            f"{link} is a symbolic link, which is not followed; put a copy in its place (cp -rL FOLDER COPY)"
        )
    return sorted((path for path in found if path.is_file()), key=lambda path: _natural(str(path.relative_to(folder))))


def _natural(text: str) -> list[tuple[int, str]]:
    """A key by which episode_2 comes before episode_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text)]
