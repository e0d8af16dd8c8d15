"""Tables with a column for everything that was measured or commanded: CSV, parquet, npy."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.safety import first_bytes, memory_fault
from guider.data.store import Store, store_of
from guider.errors import GuiderError
from guider.support.extras import extra

_BYTES_PER_CHARACTER = 12  # of text that is taken apart
_DELIMITERS = ",;\t| "
_MISSING = ("", "nan", "NaN", "NAN", "null", "None", "NA", "n/a")


def table_kind(path: Path) -> str | None:
    """Which of READERS reads the file, by its first bytes and, for text, its name; None if none does."""
    head = first_bytes(path, 8)
    if head[:4] == b"PAR1":
        return "parquet"
    if head[:6] == b"\x93NUMPY":
        return "npy"
    return "CSV" if path.is_file() and path.suffix.lower() in (".csv", ".tsv") and b"\0" not in head else None


def read_table(path: Path) -> Store:
    """The columns of a table, [rows] or [rows, width]. Raises GuiderError for what is damaged or no table."""
    kind = table_kind(path)
    if kind is None:
        raise GuiderError(f"{path}: not a table (CSV, parquet or npy)")
    return store_of(str(path), kind, READERS[kind](path))


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """column -> [rows] float64, or int64 where all are whole numbers; missing values are NaN; and text,
    by which an episode may be known. The first line names the columns.
    """
    if fault := memory_fault("the text", _BYTES_PER_CHARACTER * path.stat().st_size):
        raise GuiderError(f"{path}: {fault}")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            first = file.readline()
            delimiter = max(_DELIMITERS, key=first.count)
            names = [name.strip() for name in next(csv.reader([first], delimiter=delimiter, skipinitialspace=True), [])]
            rows = [row for row in csv.reader(file, delimiter=delimiter, skipinitialspace=True) if row]
    except (OSError, UnicodeError, csv.Error) as error:
        raise GuiderError(f"{path}: cannot be read as CSV ({error})") from error
    if not rows:
        raise GuiderError(f"{path}: holds no rows below its first line, which names the columns")
    if all(_is_number(name) for name in names):
        raise GuiderError(f"{path}: its first line holds numbers; put the columns' names there")
    names = [name or f"unnamed_{i}" for i, name in enumerate(names)]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise GuiderError(f"{path}: two columns are called {twice!r}")
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise GuiderError(f"{path}: line {number} has {len(row)} values for {len(names)} columns")
    return {name: _column(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


def read_parquet(path: Path) -> dict[str, np.ndarray]:
    """column -> [rows] numbers or [rows, width], of lists that are equally long. Text stays,
    other kinds are left out. Needs the extra `parquet`.
    """
    with extra("parquet", "pyarrow, which reads parquet,"):
        from pyarrow import parquet
    try:
        with parquet.ParquetFile(path) as file:
            declared = sum(file.metadata.row_group(i).total_byte_size for i in range(file.metadata.num_row_groups))
            if fault := memory_fault("the table", declared):
                raise GuiderError(f"{path}: {fault}")
            wanted = [field.name for field in file.schema_arrow if _is_read(field.type)]
            table = file.read(columns=wanted)
            return {name: found for name in wanted if (found := _arrow(table.column(name))) is not None}
    except GuiderError:
        raise
    except Exception as error:  # whatever Arrow raises on what others wrote
        raise GuiderError(f"{path}: the file is damaged or cut off ({' '.join(str(error).split())[:200]})") from error


def read_npy(path: Path) -> dict[str, np.ndarray]:
    """Columns of a structured array by name, those of a plain one by number, as `column_0`."""
    try:
        array = np.load(path, allow_pickle=False, mmap_mode="r")
    except (OSError, ValueError, EOFError) as error:
        raise GuiderError(f"{path}: cannot be read ({' '.join(str(error).split())})") from error
    if fault := memory_fault("the array", array.nbytes):
        raise GuiderError(f"{path}: {fault}")
    if array.dtype.names:
        return {name: np.array(array[name]) for name in array.dtype.names}
    if array.ndim != 2 or 0 in array.shape or array.dtype.kind not in "fiub":
        raise GuiderError(f"{path}: holds {array.dtype} of shape {array.shape}, not a table of numbers [rows, columns]")
    return {f"column_{i}": np.array(array[:, i]) for i in range(array.shape[1])}


READERS: Mapping[str, Callable[[Path], dict[str, np.ndarray]]] = {
    "CSV": read_csv,
    "parquet": read_parquet,
    "npy": read_npy,
}


def _column(texts: tuple[str, ...]) -> np.ndarray:
    for kind in (np.int64, np.float64):
        try:
            return np.array(texts).astype(kind)
        except (ValueError, OverflowError):
            continue
    words = [text.strip() for text in texts]
    try:
        return np.array([np.nan if word in _MISSING else float(word) for word in words])
    except ValueError:
        pass
    if set(words) <= {"True", "False", "true", "false"}:
        return np.array([word in ("True", "true") for word in words])
    return np.array(words)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_read(kind: Any) -> bool:
    from pyarrow import types

    def is_plain(inner: Any) -> bool:
        return types.is_integer(inner) or types.is_floating(inner) or types.is_boolean(inner)

    is_list = types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind)
    return (
        is_plain(kind) or types.is_string(kind) or types.is_timestamp(kind) or (is_list and is_plain(kind.value_type))
    )


def _arrow(column: Any) -> np.ndarray | None:
    """[rows] or [rows, width]; None for lists of different lengths."""
    from pyarrow import types

    kind, rows = column.type, len(column)
    if types.is_string(kind):
        return np.array(column.to_pylist(), str)
    if types.is_timestamp(kind):
        return (
            column.cast("int64").to_numpy().astype(np.float64) * {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        )
    if not hasattr(kind, "value_type"):
        return np.asarray(column.to_numpy())
    if column.null_count:
        return None
    inner = np.concatenate([np.asarray(part.flatten()) for part in column.chunks] or [np.zeros(0)])
    lengths = {len(item) for part in column.chunks for item in part.slice(0, 1)} if rows else {0}
    width = max(lengths, default=0)
    if types.is_fixed_size_list(kind):
        return inner.reshape(rows, kind.list_size)
    ends = [np.diff(part.offsets.to_numpy()) for part in column.chunks]
    return inner.reshape(rows, width) if width and all((steps == width).all() for steps in ends) else None
