"""Looks at an HDF5 file in a process of its own, so that a file made to crash or to fill memory ends only that one.

`python hdf5_worker.py FILE` prints one JSON object: {"arrays": [[name, shape, kind, itemsize, most_bytes], ...]}, or
{"refused": reason}. It imports nothing of this package, which would take ten times as long as its own work.

It walks the whole structure and reads 32 MiB spread over the file's arrays, or 512 arrays, all of a small file: the
filters that unpack data are native code too. The rest of a large file is left to the reader, as reading it here as well
would take twice the time. Memory is limited to 2 GiB, work to 10 s and one more for each MB of the file (an array takes
up to 0.2 ms and at least a kB), and waiting to a minute more.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import sys
from collections import deque
from collections.abc import Iterator
from typing import Any

import h5py
from h5py import h5d, h5g, h5l, h5o, h5z  # pyright: ignore[reportAttributeAccessIssue]

_MEMORY_BYTES = 2 << 30
_LEAST_SECONDS, _MOST_SECONDS, _BYTES_PER_SECOND = 10, 600, 1_000_000
_WAITING_SECONDS = 60
_MOST_LINKS, _MOST_LEVELS = 1_000_000, 32
_READ_BYTES, _BLOCKS = 32 << 20, 8
_LEAST_SHARE_BYTES = 64 << 10  # of what is read, for each array; a smaller one counts as this much
_LARGEST_CHUNK_BYTES = 256 << 20
_DEFLATE_RATIO, _LZF_RATIO = 1032, 100  # the most that a byte of these can unpack to


class _RefusedError(Exception):
    """Why a file is not read."""


def limit(file_bytes: int) -> None:
    """Whatever goes wrong from here on, this process ends soon and takes no memory that others need."""
    seconds = min(_LEAST_SECONDS + file_bytes // _BYTES_PER_SECOND, _MOST_SECONDS)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(seconds + _WAITING_SECONDS)
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
    the file can hold of it at the most.

    Raises _RefusedError for a file that leads elsewhere, and whatever h5py raises for one that is damaged.
    """
    file_bytes = os.stat(path).st_size
    left, arrays = _READ_BYTES, []
    with h5py.File(path, "r") as file:
        for name, dataset in _walk(file.id):
            shape, kind, itemsize = _declared(dataset)
            chunk, filters = _layout(name, dataset.get_create_plist())
            stored = min(dataset.get_storage_size(), file_bytes)
            chunk_bytes = math.prod(chunk) * itemsize if chunk else 0
            most = _most_bytes(dataset, stored, chunk_bytes, filters)
            arrays.append([name, shape, kind, itemsize, most])
            share = min(left, max(_LEAST_SHARE_BYTES, _READ_BYTES * stored // file_bytes))
            # left out is what NumPy has no like for, and what asks for a filter that only the reader's process may have
            if share > 0 and shape and 0 not in shape and kind != "V" and all(map(h5z.filter_avail, filters)):
                left -= max(_read_some(dataset, shape, itemsize, chunk_bytes, share), _LEAST_SHARE_BYTES)
    return arrays


def _walk(root: Any) -> Iterator[tuple[str, Any]]:
    """(name, dataset) of every name a dataset has. A group is entered once, by the first of its names: hard links may
    make circles. Soft links lead on within the file only, and are followed after every link was seen to be none that
    leaves it."""
    soft, links = [], 0
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
                yield name, item
    for group, raw, name in soft:
        try:
            item = h5o.open(group, raw)
        except (KeyError, OSError, RuntimeError):  # it leads nowhere, or in a circle
            continue
        if hasattr(item, "get_space"):
            yield name, item


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


def _layout(name: str, properties: Any) -> tuple[tuple[int, ...], list[int]]:
    """The shape of the chunks it lies in, () for none, and the codes of their filters. Raises _RefusedError if it does
    not lie in this file."""
    layout = properties.get_layout()
    if layout == h5d.VIRTUAL:
        raise _RefusedError(f"{_shown(name)} is made of arrays in other files, which are not read; copy the data")
    if properties.get_external_count():
        raise _RefusedError(f"{_shown(name)} lies in another file, which is not read; copy the data")
    if layout != h5d.CHUNKED:
        return (), []
    return properties.get_chunk(), [properties.get_filter(i)[0] for i in range(properties.get_nfilters())]


def _most_bytes(dataset: Any, stored: int, chunk_bytes: int, filters: list[int]) -> int:
    if not chunk_bytes:
        return stored
    in_chunks = dataset.get_num_chunks() * chunk_bytes
    ratio = math.prod(map(_ratio, filters))
    return in_chunks if ratio == math.inf else min(in_chunks, stored * int(ratio))


def _ratio(code: int) -> float:
    if code in (h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32):
        return 1
    return {h5z.FILTER_DEFLATE: _DEFLATE_RATIO, h5z.FILTER_LZF: _LZF_RATIO}.get(code, math.inf)


def _read_some(dataset: Any, shape: tuple[int, ...], itemsize: int, chunk_bytes: int, share_bytes: int) -> int:
    """Read blocks of rows spread over the array, about `share_bytes` of it, or all if it has no more; returns how many
    bytes that were."""
    row_bytes = math.prod(shape[1:]) * itemsize
    if max(chunk_bytes, row_bytes) > _LARGEST_CHUNK_BYTES:
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
