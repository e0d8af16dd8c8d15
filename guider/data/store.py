"""Named arrays, of one HDF5 or npz file or put together by a reader, read with checks."""

from __future__ import annotations

import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import h5py
import numpy as np

from guider.data.arrays import to_float32
from guider.data.episodes import EndSign
from guider.data.safety import Declared, check_path, look_into_hdf5, look_into_npz, memory_fault, size_fault
from guider.errors import GuiderError, GuiderWarning

_DAMAGED = (OSError, ValueError, EOFError, RuntimeError, KeyError, MemoryError, zlib.error, zipfile.BadZipFile)
_LISTED = 6


@dataclass(frozen=True)
class Store:
    """What a source recorded, array by array. Every read raises GuiderError, naming the source and the key, where it
    fails.

    source:  the file's path, for messages
    kind:    what it is: "HDF5", "npz", "CSV", ...
    arrays:  what it declares of each by name, None for what is no array; a group's name and those of its arrays are
             joined by '/', as in 'infos/goal'
    file:    where they are
    entries: array -> names of its columns, where the source names them
    lengths: [episodes] rows of each, where the source keeps episodes apart; None: to be found
    """

    source: str
    kind: str
    arrays: Mapping[str, Declared | None]
    file: h5py.File | np.lib.npyio.NpzFile | Mapping[str, np.ndarray]
    entries: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    lengths: np.ndarray | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(self.arrays)

    def fail(self, message: str) -> GuiderError:
        """The error to raise, with the file's name in front."""
        return GuiderError(f"{self.source}: {message}")

    def require(self, *keys: str) -> None:
        """Raise unless all these arrays are present; the message names those missing and those found."""
        missing = [key for key in keys if key not in self.keys]
        if missing:
            raise self.fail(f"missing {', '.join(missing)}; the file holds {describe_keys(self.keys)}")

    def width(self, key: str) -> int:
        """Columns of a 2-D array; 0 if it has another shape, or is not there."""
        array = self.arrays.get(key)
        return array.shape[1] if array is not None and len(array.shape) == 2 else 0

    def admit(self, key: str) -> None:
        """Raise unless the array is present and can be read: numbers, as many as the file and free memory can hold."""
        self.require(key)
        array = self.arrays[key]
        if array is None:
            raise self.fail(f"{key} is not an array that NumPy saved")
        if array.kind == "O":
            raise self.fail(
                f"{key} holds Python objects, which are never unpickled because that can run code; "
                "save it as an array of numbers"
                if self.kind == "npz"
                else f"{key} holds text or lists; save it as an array of numbers"
            )
        if fault := size_fault(key, [array]) or memory_fault(key, array.float_bytes):
            raise self.fail(fault)

    def matrix(self, key: str) -> np.ndarray:
        """[rows, columns] float32, at least one of each. HDF5 is converted a block at a time: no second copy."""
        self.admit(key)
        try:
            array = self.file[key]
            shape, dtype = array.shape, array.dtype  # pyright: ignore[reportAttributeAccessIssue]
            if len(shape) != 2 or 0 in shape or dtype.kind not in "fiu":
                raise self.fail(f"{key} must be a non-empty 2-D array of numbers, got {dtype} of shape {shape}")
            return to_float32(array, key, self.source)
        except _DAMAGED as error:
            raise self._unreadable(key, error) from error

    def vector(self, key: str) -> np.ndarray:
        """[entries] of numbers or booleans, in the file's own type; a single number is one entry."""
        self.admit(key)
        try:
            array = np.asarray(self.file[key][()])  # pyright: ignore[reportIndexIssue]
        except _DAMAGED as error:
            raise self._unreadable(key, error) from error
        if array.ndim == 2 and array.shape[1] == 1:
            array = array[:, 0]
        array = np.atleast_1d(array)
        if array.ndim != 1 or array.dtype.kind not in "fiub":
            raise self.fail(f"{key} must be a 1-D array of numbers, got {array.dtype} of shape {array.shape}")
        return array

    def flags(self, key: str, rows: int) -> np.ndarray:
        """[rows] bool: one flag per row."""
        array = self.vector(key)
        if len(array) != rows:
            raise self.fail(f"{key} has {len(array)} entries but observations have {rows} rows")
        if not (fits := (array == 0) | (array == 1)).all():
            raise self.fail(f"{key} must mark rows by 0 or 1, got {array[~fits][0]} in row {np.argmin(fits)}")
        return array.astype(bool)

    def column(self, key: str, rows: int) -> np.ndarray | None:
        """[rows] numbers, None where there is no such array or it is something else. Of text, a number for each
        word."""
        array = self.arrays.get(key)
        if array is not None and array.kind == "U" and array.shape == (rows,):
            return np.unique(np.asarray(self.file[key]), return_inverse=True)[1]
        fits = array is not None and array.kind in "fiub" and array.shape in ((rows,), (rows, 1))
        return self.vector(key) if fits else None

    def numbers(self, key: str) -> np.ndarray | None:
        """[rows] or [rows, columns] numbers; None where there are none such under this name."""
        array = self.arrays.get(key)
        if array is None or array.kind not in "fiub" or len(array.shape) not in (1, 2) or 0 in array.shape:
            return None
        return self.vector(key) if len(array.shape) == 1 else self.matrix(key)

    def texts(self, key: str) -> tuple[str, ...]:
        """The words of a 1-D array of text, () where there is no such array."""
        array = self.arrays.get(key)
        return tuple(map(str, self.file[key])) if array is not None and array.kind == "U" else ()  # pyright: ignore[reportArgumentType]

    def _unreadable(self, key: str, error: Exception) -> GuiderError:
        return self.fail(f"cannot read {key}: the file is damaged or cut off ({_in_a_line(error)})")


def store_of(
    source: str,
    kind: str,
    arrays: Mapping[str, np.ndarray],
    entries: Mapping[str, tuple[str, ...]] | None = None,
    lengths: np.ndarray | None = None,
) -> Store:
    """A store of arrays that are in memory."""
    declared = {key: Declared(item.shape, item.dtype.kind, item.itemsize, item.nbytes) for key, item in arrays.items()}
    return Store(source, kind, declared, arrays, entries or {}, lengths)


def in_memory(store: Store) -> dict[str, np.ndarray]:
    """The arrays of a store that a reader put together."""
    return {key: np.asarray(store.file[key]) for key in store.keys}


def stacked(
    source: str,
    kind: str,
    episodes: Iterable[tuple[str, Mapping[str, np.ndarray]]],
    entries: Mapping[str, tuple[str, ...]] | None = None,
) -> Store:
    """A store of episodes that the source keeps apart.

    episodes: (name, arrays) of each, in order: [rows, ...]. Arrays may be a row shorter than the longest of an episode,
        as actions are that lead from state to state: their last row is then filled with zeros, and never read. Left out
        is what is no vector of numbers in each row (pictures, text, what holds for a whole episode), and, with a
        warning, what not every episode has.

    Raises GuiderError where there are no episodes, or rows or widths disagree.
    """
    parts: dict[str, list[np.ndarray]] = {}
    lengths: list[int] = []
    held: list[tuple[str, set[str]]] = []
    for name, found in episodes:
        held.append((name, set(found)))
        arrays = {key: item for key, item in found.items() if item.ndim in (1, 2) and item.dtype.kind in "fiub"}
        if not (rows := max(map(len, arrays.values()), default=0)):
            raise GuiderError(f"{source}: {name} holds no rows of numbers")
        arrays = {key: item for key, item in arrays.items() if len(item) >= min(rows - 1, rows / 2)}
        for key, item in arrays.items():
            if len(item) not in (rows, rows - 1):
                raise GuiderError(f"{source}: {name} has {rows} rows, but {len(item)} of {key}")
            if key in parts and item.shape[1:] != parts[key][0].shape[1:]:
                raise GuiderError(
                    f"{source}: {key} has rows of shape {item.shape[1:]} in {name}, {parts[key][0].shape[1:]} before"
                )
            filled = (
                item if len(item) == rows else np.concatenate([item, np.zeros_like(item, shape=(1, *item.shape[1:]))])
            )
            parts.setdefault(key, []).append(filled)
        lengths.append(rows)
    if not lengths:
        raise GuiderError(f"{source}: holds no episodes")
    lacking = {key: name for name, keys in reversed(held) for key in parts.keys() - keys}
    if lacking:
        listed = ", ".join(f"{key} (not in {name})" for key, name in sorted(lacking.items())[:_LISTED])
        message = f"{source}: left out, as not every episode has it: {listed}"
        warnings.warn(GuiderWarning(message), stacklevel=2)
    whole = {key: np.concatenate(items) for key, items in parts.items() if len(items) == len(lengths)}
    return store_of(source, kind, whole, entries, np.array(lengths))


def describe_keys(keys: tuple[str, ...]) -> str:
    """The names found in a file, shortened, for an error message."""
    if not keys:
        return "no arrays"
    names = (key if key.isprintable() else ascii(key) for key in keys[:12])
    return ", ".join(f"{name:.60}" for name in names) + (f" and {len(keys) - 12} more" if len(keys) > 12 else "")


@contextmanager
def open_store(path: Path) -> Iterator[Store]:
    """Open an HDF5 or npz file, told apart by content, not by name.

    npz is read without pickle: object arrays are refused. Raises GuiderError if the path does not exist, is
    neither kind of file, or is cut off.
    """
    check_path(path)
    if path.is_dir():
        raise GuiderError(f"{path}: not a file")
    file_bytes = path.stat().st_size
    if not file_bytes:
        raise GuiderError(f"{path}: the file is empty")
    try:
        with path.open("rb") as file:
            is_npz = file.read(2) == b"PK"
            is_hdf5 = not is_npz and _has_hdf5_signature(file, file_bytes)
    except OSError as error:
        raise GuiderError(f"{path}: cannot be read ({error.strerror})") from error
    if not is_npz and not is_hdf5:
        raise GuiderError(f"{path}: neither an HDF5 file nor an npz archive")
    arrays = {} if is_npz else look_into_hdf5(path)
    with ExitStack() as opened:
        try:
            if is_npz:
                # np.load leaves a file it opened itself open where the archive is damaged
                raw = opened.enter_context(path.open("rb"))
                file = opened.enter_context(np.load(raw, allow_pickle=False))
                store = Store(str(path), "npz", look_into_npz(file.zip, file_bytes), file)
            else:
                store = Store(str(path), "HDF5", arrays, opened.enter_context(h5py.File(path, "r")))
        except GuiderError as refused:
            raise GuiderError(f"{path}: {refused}") from None
        except _DAMAGED as error:
            raise GuiderError(f"{path}: the file is damaged or cut off ({_in_a_line(error)})") from error
        yield store


def _has_hdf5_signature(file: BinaryIO, file_bytes: int) -> bool:
    """HDF5 begins at byte 0, 512, or any further double of that: a user's own block may come first."""
    start = 0
    while start < file_bytes:
        file.seek(start)
        if file.read(8) == b"\x89HDF\r\n\x1a\n":
            return True
        start = max(512, 2 * start)
    return False


def _in_a_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@dataclass(frozen=True)
class Recording:
    """What a reader found, not yet validated.

    observations: [rows, state_dim] float32
    actions:      [rows, action_dim] float32, one row per state; the last row of an episode is not read
    lengths:      [episodes] states per episode
    goals:        [rows, goal_dim] float32, or None where none are recorded for this goal space
    action_low, action_high: [action_dim], or None where the source does not say
    end_signs:    what said where episodes end
    warning:      what was decided about that and may be wrong, in one line, or None
    goal_indices: the state entries that are the source's own goal space, None where it names none
    state_names, action_names: of the entries, () where the source has no names
    times:        [rows] float64 seconds, None where the source has none
    simulation:   [rows, ...] each, by name: what puts a simulator where it was; nothing is learned from it
    """

    observations: np.ndarray
    actions: np.ndarray
    lengths: np.ndarray
    goals: np.ndarray | None = None
    action_low: np.ndarray | None = None
    action_high: np.ndarray | None = None
    end_signs: tuple[EndSign, ...] = ()
    warning: str | None = None
    goal_indices: tuple[int, ...] | None = None
    state_names: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()
    times: np.ndarray | None = None
    simulation: Mapping[str, np.ndarray] = field(default_factory=dict)
