"""Looks at an HDF5 file in a process of its own, so that a file made to crash or to fill memory ends only that one.

`python hdf5_worker.py FILE` prints one JSON object: {"arrays": [[name, shape, kind, itemsize, most_bytes], ...]}, or
{"refused": reason}. It imports nothing of this package, which would take ten times as long as its own work.

It walks the whole structure and reads 32 MiB spread over the file's arrays, which is all of a small file: the filters
that unpack data are native code too. The rest of a large file is left to the reader, whom it would cost twice the time.
Time is limited to 10 s and what a slow disk takes (5 MB/s), memory to 2 GiB.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import sys
from collections import deque
from typing import Any

import h5py
from h5py import h5d, h5g, h5l, h5o, h5z  # pyright: ignore[reportAttributeAccessIssue]

_MEMORY_BYTES = 2 << 30
_LEAST_SECONDS, _BYTES_PER_SECOND = 10, 5_000_000
_MOST_LINKS, _MOST_LEVELS = 1_000_000, 32
_READ_BYTES, _BLOCKS = 32 << 20, 8
_LEAST_SHARE_BYTES = 64 << 10
_LARGEST_CHUNK_BYTES = 256 << 20
_DEFLATE_RATIO, _LZF_RATIO = 1032, 100  # the most that a byte of these can unpack to


class _RefusedError(Exception):
    """Why a file is not read."""


def limit(file_bytes: int) -> None:
    """Whatever goes wrong from here on, this process ends soon and takes no memory that others need."""
    seconds = _LEAST_SECONDS + file_bytes // _BYTES_PER_SECOND
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(seconds)
    for kind, most in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, _MEMORY_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        try:
            resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
        except (OSError, ValueError):
            pass  # a system without this limit; the alarm holds everywhere


def look(path: str) -> list[list[Any]]:
    """[name, shape, kind, itemsize, most_bytes] of every array: NumPy's kind of number, bytes each, and the bytes that
    the file can hold of it at the most, None where its compression sets no bound.

    Raises _RefusedError for a file that leads elsewhere, and whatever h5py raises for one that is damaged.
    """
    file_bytes = os.stat(path).st_size
    with h5py.File(path, "r") as file:
        datasets = _walk(file.id)
        share = max(_LEAST_SHARE_BYTES, _READ_BYTES // max(len(datasets), 1))
        left, arrays = _READ_BYTES, []
        for name, dataset in datasets:
            shape, kind, itemsize = _declared(dataset)
            chunk = _stored_in(name, dataset)
            arrays.append([name, shape, kind, itemsize, _most_bytes(dataset, chunk, itemsize, file_bytes)])
            if left > 0 and shape and 0 not in shape:
                left -= _read_some(dataset, shape, kind, itemsize, math.prod(chunk) * itemsize, min(share, left))
    return arrays


def _walk(root: Any) -> list[tuple[str, Any]]:
    """(name, dataset) of every name a dataset has. A group is entered once, by the first of its names: hard links may
    make circles. Soft links lead on within the file only, and are followed after every link was seen to be none that
    leaves it."""
    datasets, soft, links = [], [], 0
    seen, waiting = {h5o.get_info(root).addr}, deque([(root, "", 1)])
    while waiting:
        group, prefix, level = waiting.popleft()
        for raw in group:
            links += 1
            if links > _MOST_LINKS:
                raise _RefusedError(f"the file holds more than {_MOST_LINKS} names")
            name = prefix + raw.decode("utf-8", "backslashreplace")
            kind = group.links.get_info(raw).type
            if kind == h5l.TYPE_SOFT:
                soft.append((group, raw, name))
                continue
            if kind != h5l.TYPE_HARD:
                raise _RefusedError(f"{_shown(name)} is a link to another file, which is not followed; copy the data")
            item = h5o.open(group, raw)
            if isinstance(item, h5g.GroupID):
                if level == _MOST_LEVELS:
                    raise _RefusedError(f"groups lie more than {_MOST_LEVELS} deep in each other")
                if (address := h5o.get_info(item).addr) not in seen:
                    seen.add(address)
                    waiting.append((item, f"{name}/", level + 1))
            elif hasattr(item, "get_space"):
                datasets.append((name, item))
    for group, raw, name in soft:
        try:
            item = h5o.open(group, raw)
        except (KeyError, OSError, RuntimeError):  # it leads nowhere, or in a circle
            continue
        if hasattr(item, "get_space"):
            datasets.append((name, item))
    return datasets


def _declared(dataset: Any) -> tuple[tuple[int, ...], str, int]:
    """Shape, and the kind and size of its numbers; kind V where NumPy has no like."""
    shape = tuple(map(int, dataset.shape or ()))
    try:
        dtype = dataset.dtype
    except (TypeError, ValueError):
        return shape, "V", dataset.get_type().get_size()
    if dtype.subdtype is not None:
        return shape, "V", dtype.itemsize
    return shape, dtype.kind, dtype.itemsize


def _stored_in(name: str, dataset: Any) -> tuple[int, ...]:
    """The shape of the chunks it lies in, () if it does not. Raises _RefusedError if it does not lie in this file."""
    layout = dataset.get_create_plist()
    if layout.get_layout() == h5d.VIRTUAL:
        raise _RefusedError(f"{_shown(name)} is made of arrays in other files, which are not read; copy the data")
    if layout.get_external_count():
        raise _RefusedError(f"{_shown(name)} lies in another file, which is not read; copy the data")
    return layout.get_chunk() if layout.get_layout() == h5d.CHUNKED else ()


def _most_bytes(dataset: Any, chunk: tuple[int, ...], itemsize: int, file_bytes: int) -> int | None:
    stored = min(dataset.get_storage_size(), file_bytes)
    if not chunk:
        return stored
    in_chunks = dataset.get_num_chunks() * math.prod(chunk) * itemsize
    ratio = math.prod(_ratio(code) for code in _filters(dataset))
    return in_chunks if ratio == math.inf else min(in_chunks, stored * int(ratio))


def _filters(dataset: Any) -> list[int]:
    layout = dataset.get_create_plist()
    return [layout.get_filter(i)[0] for i in range(layout.get_nfilters())]


def _ratio(code: int) -> float:
    if code in (h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32):
        return 1
    return {h5z.FILTER_DEFLATE: _DEFLATE_RATIO, h5z.FILTER_LZF: _LZF_RATIO}.get(code, math.inf)


def _read_some(
    dataset: Any, shape: tuple[int, ...], kind: str, itemsize: int, chunk_bytes: int, share_bytes: int
) -> int:
    """Read blocks of rows spread over the array, about `share_bytes` of it, or all if it has no more; returns how many
    bytes that were. Left out is what NumPy has no like for, and what asks for a filter that only the reader's process
    may have."""
    row_bytes = math.prod(shape[1:]) * itemsize
    if kind == "V" or max(chunk_bytes, row_bytes) > _LARGEST_CHUNK_BYTES:
        return 0
    if not all(map(h5z.filter_avail, _filters(dataset))):
        return 0
    block_rows = max(1, max(share_bytes // _BLOCKS, chunk_bytes) // row_bytes)
    blocks = -(-shape[0] // block_rows)
    read = min(blocks, max(1, share_bytes // (block_rows * row_bytes)))
    array = h5py.Dataset(dataset)
    for i in range(read):
        first = block_rows * (i * (blocks - 1) // max(read - 1, 1))
        array[first : first + block_rows]
    return read * block_rows * row_bytes


def _shown(name: str) -> str:
    return name if name.isprintable() else ascii(name)


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    if "unable to lock file" in text:
        return "another program has it open for writing; close it there, or wait until that program ends"
    if "already open for" in text:
        return (
            "the program that wrote it did not close it; end that program if it still runs, else mark the file as "
            "closed with HDF5's own `h5clear -s FILE`"
        )
    return f"the file is damaged or cut off ({text or type(error).__name__})"


def main(path: str) -> None:
    limit(os.stat(path).st_size)
    try:
        answer: dict[str, Any] = {"arrays": look(path)}
    except _RefusedError as refused:
        answer = {"refused": str(refused)}
    except MemoryError:
        answer = {"refused": f"looking at it takes more than {_MEMORY_BYTES >> 30} GiB of memory"}
    except Exception as error:  # whatever HDF5 and its bindings raise on what others wrote
        answer = {"refused": _reason(error)}
    print(json.dumps(answer), flush=True)
    os._exit(0)  # closing what is damaged may crash as well


if __name__ == "__main__":
    main(sys.argv[1])
