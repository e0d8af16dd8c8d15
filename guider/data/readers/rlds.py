"""RLDS: TFRecord files in which each record is an episode, a tf.train.Example whose features are arrays over its
steps.

Format: tensorflow/core/example/{example,feature}.proto, and TFRecord's frame: the length of a record (8 bytes), a
checksum of that (4), the record, a checksum of it (4; not compared: most of a record are pictures, which are skipped).
"""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from guider.data.safety import first_bytes, memory_fault
from guider.data.store import Store, stacked
from guider.errors import GuiderError, GuiderWarning

_HEAD, _GZIP = 12, b"\x1f\x8b"
_STEPS = "steps/"
_STEP_FLAGS = ("is_first", "is_last", "is_terminal")
_VARINT, _EIGHT_BYTES, _COUNTED, _FOUR_BYTES = 0, 1, 2, 5
"""How the wire format of protocol buffers says how long a field is."""
_SHARD = re.compile(r"\.tfrecord(?:-(\d+)-of-(\d+))?(?:\.gz)?$", re.IGNORECASE)
_CRC_POLYNOMIAL, _CRC_MASK = 0x82F63B78, 0xA282EAD8
"""Of CRC-32C, and what TFRecord adds to it."""


def is_shard(name: str) -> bool:
    """Whether a file is called as RLDS's are: NAME-SPLIT.tfrecord-00000-of-00007."""
    return _SHARD.search(name) is not None


def is_rlds(path: Path) -> bool:
    """Whether a file is TFRecord: by its first record's length and that one's checksum."""
    head = first_bytes(path, _HEAD) if path.is_file() else b""
    if head[:2] == _GZIP and is_shard(path.name):
        return True  # and reading it says what to do
    return (
        len(head) == _HEAD and head != bytes(_HEAD) and _masked_checksum(head[:8]) == struct.unpack("<I", head[8:])[0]
    )


def read_rlds(source: Path, files: Sequence[Path]) -> Store:
    """The episodes of the files in turn: `observation/state`, `action` and whatever else has numbers for each step.

    Raises GuiderError for what is damaged, and for records that are no episodes. Warns where the files are those of
    several splits, or not all of one.
    """
    shards: dict[str, list[re.Match[str]]] = {}
    for path in files:
        if named := _SHARD.search(path.name):
            shards.setdefault(path.name[: named.start()], []).append(named)
    if len(shards) > 1:
        warnings.warn(GuiderWarning(f"{source}: {', '.join(shards)} are read as one set of episodes"), stacklevel=2)
    for split, found in shards.items():
        if (whole := int(found[0][2] or 1)) > len(found):
            warnings.warn(GuiderWarning(f"{source}: of {split}, {len(found)} of {whole} files are here"), stacklevel=2)
    return stacked(str(source), "RLDS", (episode for path in files for episode in _episodes(path)))


def _episodes(path: Path) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    for number, record in enumerate(_records(path)):
        name = f"episode {number} of {path.name}"
        try:
            features = dict(_features(record))
        except (ValueError, IndexError, KeyError, OverflowError) as error:
            raise GuiderError(f"{path}: record {number} is damaged or holds no tf.train.Example") from error
        steps = next((len(features[_STEPS + flag]) for flag in _STEP_FLAGS if _STEPS + flag in features), None)
        if steps == 0:
            continue
        arrays = {
            key.removeprefix(_STEPS): values.reshape(steps, -1)
            for key, values in features.items()
            if key.startswith(_STEPS) and "/ragged_" not in key and steps and len(values) and len(values) % steps == 0
        }
        if not arrays:
            raise GuiderError(f"{path}: record {number} is no episode of RLDS, with steps/is_first and the like")
        yield name, arrays


def _records(path: Path) -> Iterator[memoryview]:
    if first_bytes(path, 2) == _GZIP:
        raise GuiderError(f"{path} is gzipped; unpack it first (gunzip)")
    left = path.stat().st_size
    with path.open("rb") as file:
        while left:
            head = file.read(_HEAD)
            if len(head) < _HEAD or _masked_checksum(head[:8]) != struct.unpack("<I", head[8:])[0]:
                raise GuiderError(f"{path}: the file is damaged or cut off (a record's length)")
            (length,) = struct.unpack("<Q", head[:8])
            left -= _HEAD + length + 4
            if left < 0:
                raise GuiderError(f"{path}: the file is damaged or cut off (in its last record)")
            if fault := memory_fault("an episode", length):
                raise GuiderError(f"{path}: {fault}")
            yield memoryview(file.read(length))
            file.seek(4, 1)


def _features(example: memoryview) -> Iterator[tuple[str, np.ndarray]]:
    """(name, values) of an Example's features that are numbers."""
    for features in _counted(example, 1):
        for entry in _counted(features, 1):
            (name,), (feature,) = _counted(entry, 1), _counted(entry, 2)
            for field, _, values in _fields(feature):
                if field == 2:
                    yield bytes(name).decode(), _floats(values)
                elif field == 3:
                    yield bytes(name).decode(), _integers(values)


def _floats(numbers: memoryview) -> np.ndarray:
    return np.frombuffer(b"".join(bytes(part) for _, _, part in _fields(numbers)), "<f4")


def _integers(numbers: memoryview) -> np.ndarray:
    found: list[int] = []
    for _, kind, part in _fields(numbers):
        if kind == _VARINT:
            found.append(int.from_bytes(part, "little"))
            continue
        at = 0
        while at < len(part):
            value, at = _varint(part, at)
            found.append(value)
    return np.array(found, np.uint64).astype(np.int64)


def _counted(message: memoryview, number: int) -> list[memoryview]:
    """What the fields of this number hold."""
    return [content for field, kind, content in _fields(message) if (field, kind) == (number, _COUNTED)]


def _fields(message: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """(number, how its length is told, content) of each field; a varint's content is its value's 8 bytes."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield tag >> 3, kind, memoryview(value.to_bytes(10, "little"))
            continue
        if kind == _COUNTED:
            size, at = _varint(message, at)
        else:
            size = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4}[kind]
        if at + size > len(message):
            raise ValueError("a field goes beyond its message")
        yield tag >> 3, kind, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """(value, where the next byte is)."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number of more than 64 bits")


def _masked_checksum(content: bytes) -> int:
    """TFRecord's: CRC-32C, turned by 15 bits, and a constant added."""
    crc = 0xFFFFFFFF
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (_CRC_POLYNOMIAL if crc & 1 else 0)
    crc ^= 0xFFFFFFFF
    return ((crc >> 15 | crc << 17) + _CRC_MASK) & 0xFFFFFFFF
