"""ROS 2 recordings in MCAP: topics, each with a clock of its own, become one table with a column for every number in
their messages.

A row is what had been said last on every topic when one of them, the clock, spoke: of those that speak once a second or
more the one that does so least often, which mostly is who commands. There is no row where a topic that speaks so often
had long been silent, nor before all have spoken; a topic that speaks so often, but only for a part of the time, is left
out, with a warning.
"""

from __future__ import annotations

import warnings
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from guider.data.safety import first_bytes, memory_fault
from guider.data.store import Store, store_of
from guider.errors import GuiderError, GuiderWarning
from guider.support.extras import extra

_MAGIC = b"\x89MCAP0\r\n"
_OFTEN_S, _SILENT_SPACINGS, _SILENT_S = 1.0, 5, 0.5
_LEAST_PART = 0.5
"""Of the recording, which a topic that speaks often must last."""
_MOST_ENTRIES = 64
"""Longer lists are pictures or scans, of which no state is made here."""
_LARGEST_MESSAGE = 64_000
_LEFT_OUT = ("header", "stamp", "timestamp")
_NAMES = ("name", "names", "joint_names")
_NUMBERS_BETWEEN_LOOKS = 2**20
_BYTES_PER_NUMBER = 16


class NothingSaidError(GuiderError):
    """A sound recording in which no topic says numbers."""


class Column(NamedTuple):
    """What was said of one number. times: nanoseconds, in order; values: as many."""

    times: array[int]
    values: array[float]


class Topic(NamedTuple):
    """times: of all messages, nanoseconds; columns: by field, of the messages that had it."""

    times: array[int]
    columns: dict[str, Column]


def is_mcap(path: Path) -> bool:
    return path.is_file() and first_bytes(path, len(_MAGIC)) == _MAGIC


def read_mcap(source: Path, files: Sequence[Path]) -> Store:
    """Columns `timestamp`, seconds, and `topic.field.field` of one recording, its files in turn; entries of a list go
    by the names that the message has for them, as joints do, or else by number. Needs the extra `ros`.

    Raises GuiderError for what is damaged, and NothingSaidError where no topic says numbers. Warns of topics that are
    left out.
    """
    topics: dict[str, Topic] = {}
    for path in files:
        _listen(path, topics)
    spoken = {name: topic for name, topic in topics.items() if topic.columns}
    if not spoken:
        heard = f"; its topics are {', '.join(sorted(topics)[:12])}" if topics else ""
        raise NothingSaidError(f"{source}: no topic says numbers that can be read{heard}")
    columns, partial = table(spoken)
    if partial:
        listed = "; ".join(f"{name} ({why})" for name, why in sorted(partial.items()))
        warnings.warn(GuiderWarning(f"{source}: left out: {listed}"), stacklevel=2)
    return store_of(str(source), "MCAP", columns)


def table(topics: dict[str, Topic]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """(columns [rows], topics that are left out and why), see this file's first lines."""
    times = {name: np.unique(topic.times) for name, topic in topics.items()}
    began, ended = min(spoken[0] for spoken in times.values()), max(spoken[-1] for spoken in times.values())
    spacing = {name: float(np.median(np.diff(spoken))) for name, spoken in times.items() if len(spoken) > 1}
    often = [name for name, apart in spacing.items() if apart <= _OFTEN_S * 1e9]
    partial = {
        name: f"it speaks from {(times[name][0] - began) * 1e-9:.3g} to {(times[name][-1] - began) * 1e-9:.3g} s of "
        f"{(ended - began) * 1e-9:.3g} s only"
        for name in often
        if times[name][-1] - times[name][0] < _LEAST_PART * (ended - began)
    }
    often = [name for name in often if name not in partial]
    heard = {name: topic for name, topic in topics.items() if name not in partial}
    clock = max(often, key=spacing.__getitem__) if often else max(heard, key=lambda name: len(times[name]))
    rows = times[clock]
    for name in often:
        before = np.searchsorted(times[name], rows, side="right") - 1
        silence = rows - times[name][np.maximum(before, 0)]
        rows = rows[silence <= max(_SILENT_SPACINGS * spacing[name], _SILENT_S * 1e9)]
    middle = times[clock][len(times[clock]) // 2]
    bare = Counter(name.strip("/") for name in heard)
    columns: dict[str, Column] = {}
    for name, topic in heard.items():
        if times[name][0] > middle:
            partial[name] = f"it speaks from {(times[name][0] - began) * 1e-9:.3g} s on only"
            continue
        stem = name.strip("/") if bare[name.strip("/")] == 1 else name
        columns |= {f"{stem}.{field}": column for field, column in topic.columns.items()}
    rows = rows[rows >= max(column.times[0] for column in columns.values())]
    found: dict[str, np.ndarray] = {"timestamp": rows * 1e-9}
    for name, column in columns.items():
        found[name] = np.array(column.values)[np.searchsorted(np.array(column.times), rows, side="right") - 1]
    return found, partial


def numbers(message: Any, before: str = "") -> Iterator[tuple[str, float]]:
    """(field, value) of all numbers in a message, whose fields its slots name, in its messages, and in lists of
    either."""
    fields = {field: getattr(message, field) for field in message.__slots__}
    names = next((list(fields[key]) for key in _NAMES if isinstance(fields.get(key), list)), [])
    for field, value in fields.items():
        if field in _LEFT_OUT or field.endswith("covariance"):
            continue
        for entry, inner in _entries(value, names).items():
            path = f"{before}{field}{'.' if entry else ''}{entry}"
            if isinstance(inner, Real):
                yield path, float(inner)
            elif hasattr(inner, "__slots__"):
                yield from numbers(inner, f"{path}.")


def _entries(value: Any, names: list[Any]) -> dict[str, Any]:
    """What a field holds, by the names of its entries; of a list that is too long, and of text, nothing."""
    if isinstance(value, str):
        return {}
    if not hasattr(value, "__len__"):
        return {"": value}
    if len(value) > _MOST_ENTRIES:
        return {}
    named = names if len(names) == len(value) and len(set(names)) == len(names) else range(len(value))
    return {str(name): entry for name, entry in zip(named, value, strict=True)}


def _listen(path: Path, topics: dict[str, Topic]) -> None:
    """Add what a file's topics say. Of lists without names whose length varies, nothing is kept."""
    with extra("ros", "mcap-ros2-support, which reads ROS 2 recordings,"):
        from mcap.reader import SeekingReader
        from mcap_ros2.decoder import DecoderFactory
    decoders, count = DecoderFactory(), 0
    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=path.stat().st_size)
            summary = reader.get_summary()
            chunks = [chunk.uncompressed_size for chunk in summary.chunk_indexes] if summary else []
            if fault := memory_fault("its messages", max(chunks, default=path.stat().st_size)):
                raise GuiderError(f"{path}: {fault}")
            for schema, channel, message in reader.iter_messages():
                topic = topics.setdefault(channel.topic, Topic(array("q"), {}))
                decode = decoders.decoder_for(channel.message_encoding, schema)
                if decode is None or len(message.data) > _LARGEST_MESSAGE:
                    continue
                topic.times.append(message.log_time)
                for field, value in numbers(decode(message.data)):
                    column = topic.columns.setdefault(field, Column(array("q"), array("d")))
                    column.times.append(message.log_time)
                    column.values.append(value)
                    count += 1
                    if count % _NUMBERS_BETWEEN_LOOKS == 0 and (
                        fault := memory_fault("more", _BYTES_PER_NUMBER * count)
                    ):
                        raise GuiderError(f"{path}: its messages are too many; {fault}")
    except GuiderError:
        raise
    except Exception as error:  # whatever is raised on what others wrote
        raise GuiderError(
            f"{path}: the file is damaged or cut off ({' '.join(str(error).split())[:200]}); where its recorder was "
            "killed, `mcap recover` or `ros2 bag reindex` mends it"
        ) from error
    for topic in topics.values():
        for field in [field for field, column in topic.columns.items() if len(column.times) < len(topic.times)]:
            if field.rpartition(".")[2].isdecimal():
                del topic.columns[field]
