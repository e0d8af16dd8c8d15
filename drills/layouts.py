"""Small logs as people have them, to be changed at random: all hold what `walk` gives."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
from mcap_ros2.writer import Writer

import guider
from drills.common import GOAL, walk
from guider.data.readers.rlds import _masked_checksum

SECOND = 10**9


def _episodes() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(states [n, 4], actions [n, 2]) of each."""
    arrays = walk()
    cuts = np.cumsum(arrays["lengths"])[:-1]
    yield from zip(*(np.split(arrays[name], cuts) for name in ("observations", "actions")), strict=True)


def tables(folder: Path) -> None:
    """A CSV an episode."""
    folder.mkdir()
    for number, (states, actions) in enumerate(_episodes()):
        header = "time_s,x,y,a,b,action_0,action_1"
        rows = np.column_stack([0.1 * np.arange(len(states)), states, actions])
        np.savetxt(folder / f"run_{number}.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")


def groups(path: Path) -> None:
    """robomimic's HDF5."""
    with h5py.File(path, "w") as file:
        for number, (states, actions) in enumerate(_episodes()):
            demo = file.create_group(f"data/demo_{number}")
            demo["actions"], demo["dones"] = actions, np.arange(len(states)) == len(states) - 1
            demo["obs/pose"], demo["obs/rest"] = states[:, :2], states[:, 2:]


def lerobot(folder: Path) -> None:
    arrays = walk()
    episodes = guider.make_episodes(arrays["observations"], arrays["actions"], arrays["lengths"], goal_indices=GOAL)
    guider.save_data(episodes, folder, "lerobot")


def bag(path: Path) -> None:
    """ROS 2's MCAP, of one episode: two topics that speak ten times a second."""
    with path.open("wb") as file:
        writer = Writer(file)
        kind = writer.register_msgdef("own/Numbers", "float64[] data")
        for row, (state, action) in enumerate(zip(*next(_episodes()), strict=True)):
            time = row * SECOND // 10
            for topic, values in (("/state", state), ("/action", action)):
                writer.write_message(topic, kind, {"data": values.tolist()}, time, time, row)
        writer.finish()


def records(path: Path) -> None:
    """RLDS: an episode a TFRecord."""
    named = [
        {"steps/is_first": np.arange(len(states)) == 0, "steps/observation": states, "steps/action": actions}
        for states, actions in _episodes()
    ]
    path.write_bytes(b"".join(_framed(_example(features)) for features in named))


def _framed(record: bytes) -> bytes:
    length = struct.pack("<Q", len(record))
    return length + struct.pack("<I", _masked_checksum(length)) + record + bytes(4)


def _example(features: dict[str, np.ndarray]) -> bytes:
    """A tf.train.Example, of lists of floats and of small numbers."""
    entries = b""
    for name, values in features.items():
        kind, content = (3, values.astype(np.uint8)) if values.dtype == bool else (2, values.astype("<f4"))
        entries += _field(1, _field(1, name.encode()) + _field(2, _field(kind, _field(1, content.tobytes()))))
    return _field(1, entries)


def _field(number: int, content: bytes) -> bytes:
    """Of a protocol buffer, of the kind that has a length; itself in groups of seven bits."""
    length = len(content)
    size = b""
    while length > 0x7F:
        size, length = size + bytes([length & 0x7F | 0x80]), length >> 7
    return bytes([number << 3 | 2]) + size + bytes([length]) + content


LAYOUTS: dict[str, Callable[[Path], None]] = {
    "tables": tables,
    "groups": groups,
    "lerobot": lerobot,
    "bag": bag,
    "records": records,
}
