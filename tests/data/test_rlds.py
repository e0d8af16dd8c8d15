"""RLDS: records as TensorFlow writes them become episodes, and damaged ones a line."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from guider.data import load
from guider.data.readers import rlds
from guider.errors import GuiderError, GuiderWarning


def varint(value: int) -> bytes:
    out = b""
    while value > 0x7F:
        out, value = out + bytes([value & 0x7F | 0x80]), value >> 7
    return out + bytes([value])


def field(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def example(features: dict[str, np.ndarray | list[bytes]]) -> bytes:
    """A tf.train.Example; integers that are negative take ten bytes."""
    entries = b""
    for name, values in features.items():
        if isinstance(values, list):
            content = field(1, b"".join(field(1, text) for text in values))
        elif values.dtype.kind == "f":
            content = field(2, field(1, values.astype("<f4").tobytes()))
        else:
            content = field(3, field(1, b"".join(varint(int(value) % 2**64) for value in values.ravel())))
        entries += field(1, field(1, name.encode()) + field(2, content))
    return field(1, entries)


def write(path: Path, records: list[bytes]) -> Path:
    def framed(record: bytes) -> bytes:
        length = struct.pack("<Q", len(record))
        return length + struct.pack("<I", rlds._masked_checksum(length)) + record + bytes(4)

    path.write_bytes(b"".join(map(framed, records)))
    return path


def episode(number: int, steps: int) -> bytes:
    ramp = np.arange(steps, dtype=np.float32)
    first = np.zeros(steps, np.int64)
    first[:1] = 1
    return example(
        {
            "steps/is_first": first,
            "steps/observation/state": np.stack([ramp, ramp + number, -ramp], axis=1),
            "steps/observation/image": [b"\xff" * 300] * steps,
            "steps/action": np.stack([ramp / 10, -ramp / 10], axis=1),
            "steps/language_instruction": [b"put it there"] * steps,
            "steps/reward": np.zeros(steps, np.float32),
            "steps/lag": -np.ones(steps, np.int64),
            "episode_metadata/number": np.array([number]),
        }
    )


def test_checksums_are_castagnolis():
    """Of "123456789" CRC-32C is known: 0xE3069283; TFRecord turns it and adds 0xA282EAD8."""
    assert rlds._masked_checksum(b"123456789") == ((0xE3069283 >> 15 | 0xE3069283 << 17) + 0xA282EAD8) & 0xFFFFFFFF


def test_records_are_episodes_by_hand(tmp_path):
    path = write(tmp_path / "set-train.tfrecord-00000-of-00001", [episode(0, 4), episode(1, 3)])
    store = rlds.read_rlds(path, [path])
    assert set(store.keys) == {"is_first", "observation/state", "action", "reward", "lag"}
    assert store.lengths is not None and list(store.lengths) == [4, 3]
    np.testing.assert_array_equal(
        store.matrix("observation/state"),
        [[0, 0, 0], [1, 1, -1], [2, 2, -2], [3, 3, -3], [0, 1, 0], [1, 2, -1], [2, 3, -2]],
    )
    assert list(store.vector("is_first")) == [1, 0, 0, 0, 1, 0, 0] and set(store.vector("lag")) == {-1}


def test_a_folder_of_shards_is_one_set(tmp_path):
    write(tmp_path / "set-train.tfrecord-00001-of-00002", [episode(2, 5)])
    write(tmp_path / "set-train.tfrecord-00000-of-00002", [episode(0, 4), episode(1, 3)])
    (tmp_path / "dataset_info.json").write_text("{}")
    found = load(tmp_path, (0, 1))
    assert list(found.lengths) == [4, 3, 5] and found.observations.shape == (12, 3) and found.actions.shape == (12, 2)
    with pytest.warns(GuiderWarning, match="of set-train, 1 of 2 files are here"):
        assert load(tmp_path / "set-train.tfrecord-00001-of-00002", (0, 1)).observations[0, 1] == 2


def test_single_values_need_not_be_packed():
    """A float or an integer of its own, as the older wire format has them."""
    floats = memoryview(varint(1 << 3 | 5) + struct.pack("<f", 1.5) + varint(1 << 3 | 5) + struct.pack("<f", -2.0))
    assert list(rlds._floats(floats)) == [1.5, -2]
    integers = memoryview(varint(1 << 3) + varint(300) + varint(1 << 3) + varint(2**64 - 7))
    assert list(rlds._integers(integers)) == [300, -7]


def refused(path: Path) -> str:
    with pytest.raises(GuiderError) as error:
        rlds.read_rlds(path, [path])
    assert "\n" not in str(error.value) and str(path) in str(error.value)
    return str(error.value)


def test_damage_is_a_line(tmp_path):
    whole = write(tmp_path / "a.tfrecord", [episode(0, 4), episode(1, 3)]).read_bytes()
    path = tmp_path / "b.tfrecord"
    path.write_bytes(whole[:-10])
    assert "cut off (in its last record)" in refused(path)
    path.write_bytes(whole[:3] + b"\x01" + whole[4:])
    assert "a record's length" in refused(path)
    assert not rlds.is_rlds(path) and rlds.is_rlds(tmp_path / "a.tfrecord")
    write(path, [b"\x0a\x05hello"])
    assert "holds no tf.train.Example" in refused(path)
    write(path, [example({"label": np.arange(3)})])
    assert "no episode of RLDS" in refused(path)
    rng = np.random.default_rng(0)
    for _ in range(300):
        content = bytearray(whole)
        content[rng.integers(12, len(content))] ^= int(rng.integers(1, 256))
        path.write_bytes(content)
        try:
            rlds.read_rlds(path, [path])
        except (GuiderError, GuiderWarning):
            pass  # the latter of a damaged name, which the other episode has whole


def test_splits_missing_files_and_others_beside_them_are_told(tmp_path):
    write(tmp_path / "set-train.tfrecord-00001-of-00002", [episode(0, 4)])
    write(tmp_path / "set-val.tfrecord-00000-of-00001", [episode(1, 4), episode(2, 0)])
    (tmp_path / "set-val.tfrecord.index").write_bytes(b"something else")
    with pytest.warns(GuiderWarning) as told:
        found = load(tmp_path, (0, 1))
    assert list(found.lengths) == [4, 4], "an episode of no steps is none"
    assert [str(warning.message).partition(": ")[2] for warning in told] == [
        "set-train, set-val are read as one set of episodes",
        "of set-train, 1 of 2 files are here",
    ]


def test_ragged_features_are_left_out_and_gzipped_files_named(tmp_path):
    ragged = {"steps/is_first": np.array([1, 0, 0]), "steps/reward": np.zeros(3, np.float32)}
    ragged |= {"steps/obs/ragged_flat_values": np.arange(6.0), "steps/obs/ragged_row_lengths_0": np.array([1, 4, 1])}
    path = write(tmp_path / "a.tfrecord", [example(ragged)])
    assert set(rlds.read_rlds(path, [path]).keys) == {"is_first", "reward"}
    zipped = tmp_path / "b.tfrecord.gz"
    zipped.write_bytes(gzip.compress(path.read_bytes()))
    with pytest.raises(GuiderError, match="is gzipped; unpack it first"):
        load(zipped, (0, 1))


def test_links_are_not_followed(tmp_path):
    (tmp_path / "set").mkdir()
    write(tmp_path / "a.tfrecord", [episode(0, 4)])
    (tmp_path / "set" / "a.tfrecord").symlink_to(tmp_path / "a.tfrecord")
    with pytest.raises(GuiderError, match="is a symbolic link"):
        load(tmp_path / "set", (0, 1))
