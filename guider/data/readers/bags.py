"""ROS 2 recordings in MCAP: topics, each with a clock of its own, become one table with a column for every number in
their messages.

A row is what had been said last on every topic when one of them spoke: of those that speak once a second or more, for
half of the time at least, the one that does so least often, which mostly is who commands. Rows begin when all have
spoken; who begins in the second half is left out.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.safety import first_bytes, memory_fault
from guider.data.store import Store, store_of
from guider.errors import GuiderError
from guider.support.extras import extra

_MAGIC = b"\x89MCAP0\r\n"
_LEAST_HZ = 1.0
_MOST_ENTRIES = 64
"""Longer lists are pictures or scans, of which no state is made here."""
_LARGEST_MESSAGE = 64_000
_LEFT_OUT = ("header", "stamp", "timestamp")
_NAMES = ("name", "names", "joint_names")

Said = dict[str, dict[str, list[tuple[int, float]]]]
"""topic -> field -> (nanoseconds, value) in the order of time."""


def is_mcap(path: Path) -> bool:
    return path.is_file() and first_bytes(path, len(_MAGIC)) == _MAGIC


def read_mcap(path: Path) -> Store:
    """Columns `timestamp`, seconds, and `topic.field.field`; entries of a list go by the names that the message has for
    them, as joints do, or else by number. Needs the extra `ros`.

    Raises GuiderError for what is damaged, and where no topic says numbers.
    """
    said, silent = _said(path)
    if not said:
        heard = f"; its topics are {', '.join(sorted(silent)[:12])}" if silent else ""
        raise GuiderError(f"{path}: no topic says numbers that can be read{heard}")
    return store_of(str(path), "MCAP", table(said))


def table(said: Said) -> dict[str, np.ndarray]:
    """Columns [rows] of what was said, see this file's first lines."""
    spoken = {
        topic: np.unique([time for column in fields.values() for time, _ in column]) for topic, fields in said.items()
    }
    whole = max(times[-1] for times in spoken.values()) - min(times[0] for times in spoken.values())
    spacing = {
        topic: float(np.median(np.diff(times)))
        for topic, times in spoken.items()
        if len(times) > 1 and times[-1] - times[0] >= whole / 2
    }
    often = [topic for topic, apart in spacing.items() if apart <= 1e9 / _LEAST_HZ]
    clock = max(often, key=spacing.__getitem__) if often else max(spoken, key=lambda topic: len(spoken[topic]))
    rows = spoken[clock]
    columns = {
        f"{topic.strip('/')}.{field}": column for topic, fields in said.items() for field, column in fields.items()
    }
    middle = rows[len(rows) // 2]
    columns = {name: column for name, column in columns.items() if column[0][0] <= middle}
    rows = rows[rows >= max(column[0][0] for column in columns.values())]
    found: dict[str, np.ndarray] = {"timestamp": rows * 1e-9}
    for name, column in columns.items():
        times, values = (np.array(part) for part in zip(*column, strict=True))
        found[name] = values[np.searchsorted(times, rows, side="right") - 1]
    return found


def numbers(message: Any, before: str = "") -> Iterator[tuple[str, float]]:
    """(field, value) of all numbers in a message, whose fields its slots name, in its messages, and in lists of
    either."""
    fields = {field: getattr(message, field) for field in message.__slots__}
    names = next((list(fields[key]) for key in _NAMES if isinstance(fields.get(key), list)), [])
    for field, value in fields.items():
        if field in _LEFT_OUT or field.endswith("covariance"):
            continue
        entries = _entries(value, names)
        for entry, inner in entries.items():
            path = f"{before}{field}{'.' if entry else ''}{entry}"
            if isinstance(inner, Real):
                yield path, float(inner)
            elif hasattr(inner, "__slots__"):
                yield from numbers(inner, f"{path}.")


def _entries(value: Any, names: list[Any]) -> dict[str, Any]:
    """What a field holds, by the names of its entries; of a list that is too long, and of text, nothing."""
    if isinstance(value, str | bytes | bytearray | memoryview):
        return {}
    if not hasattr(value, "__len__"):
        return {"": value}
    if len(value) > _MOST_ENTRIES:
        return {}
    named = names if len(names) == len(value) and len(set(names)) == len(names) else range(len(value))
    return {str(name): entry for name, entry in zip(named, value, strict=True)}


def _said(path: Path) -> tuple[Said, set[str]]:
    """(what was said, topics without numbers)."""
    with extra("ros", "mcap-ros2-support, which reads ROS 2 recordings,"):
        from mcap.reader import SeekingReader
        from mcap_ros2.decoder import DecoderFactory
    decoders = DecoderFactory()
    said: Said = defaultdict(lambda: defaultdict(list))
    topics: set[str] = set()
    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=path.stat().st_size)
            summary = reader.get_summary()
            unpacked = sum(chunk.uncompressed_size for chunk in summary.chunk_indexes) if summary else 0
            if fault := memory_fault("its messages", max(unpacked, path.stat().st_size)):
                raise GuiderError(f"{path}: {fault}")
            for schema, channel, message in reader.iter_messages():
                topics.add(channel.topic)
                decode = decoders.decoder_for(channel.message_encoding, schema)
                if decode is None or len(message.data) > _LARGEST_MESSAGE:
                    continue
                for field, value in numbers(decode(message.data)):
                    said[channel.topic][field].append((message.log_time, value))
    except GuiderError:
        raise
    except Exception as error:  # whatever is raised on what others wrote
        raise GuiderError(f"{path}: the file is damaged or cut off ({' '.join(str(error).split())[:200]})") from error
    return said, topics - set(said)
