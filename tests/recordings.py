"""Flat arrays of made-up recordings and the files they are written to, shared by the tests of guider.data."""

from __future__ import annotations

import io
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from guider.data import load
from guider.errors import GuiderError

GOAL = (0, 1)


def walk(lengths: list[int], state_dim: int = 5, action_dim: int = 2, seed: int = 0) -> dict[str, np.ndarray]:
    """Episodes that start somewhere in a 20 m square and wander noisily from there, laid end to end."""
    rng = np.random.default_rng(seed)
    paths = []
    for length in lengths:
        steps = rng.normal(0, 0.05, (length, 2)) + rng.normal(0, 0.05, 2)
        paths.append(rng.uniform(-10, 10, 2) + np.cumsum(steps, axis=0))
    rows = sum(lengths)
    observations = rng.normal(size=(rows, state_dim))
    observations[:, :2] = np.concatenate(paths)
    return {
        "observations": observations.astype(np.float32),
        "actions": rng.uniform(-1, 1, (rows, action_dim)).astype(np.float32),
    }


def ends(lengths: list[int]) -> np.ndarray:
    """[rows] bool: True on the last row of each episode."""
    flags = np.zeros(sum(lengths), bool)
    flags[np.cumsum(lengths) - 1] = True
    return flags


def antmaze(lengths: list[int], **options) -> dict[str, np.ndarray]:
    """`walk` with what D4RL's antmaze records besides."""
    rows = sum(lengths)
    return walk(lengths, **options) | {
        "rewards": np.zeros(rows, np.float32),
        "terminals": np.zeros(rows, bool),
        "timeouts": ends(lengths),
        "infos/goal": np.repeat(np.arange(2.0 * len(lengths)).reshape(-1, 2), lengths, axis=0),
    }


def write_hdf5(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            file.create_dataset(key, data=array)
    return path


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
    return path


LENGTHS = [20, 30]
ARRAYS = walk(LENGTHS) | {"lengths": np.array(LENGTHS)}


def refusal(source: Path | str, **options) -> str:
    """The one line that says why the source is not read."""
    with pytest.raises(GuiderError) as raised:
        load(source, GOAL, **options)
    message = str(raised.value)
    assert len(message.splitlines()) == 1 and len(message) < 600 + len(str(source))
    return message


def refusal_in_little_memory(source: Path) -> str:
    tracemalloc.start()
    try:
        message = refusal(source)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    return message


def hdf5(folder: Path, make: Callable[[h5py.File], object], without: str = "", **options) -> Path:
    """A whole recording, one array left out, and what `make` adds."""
    path = folder / "logs.hdf5"
    with h5py.File(path, "w", **options) as file:
        for key, array in ARRAYS.items():
            if key != without:
                file[key] = array
        make(file)
    return path


@pytest.fixture
def secret(tmp_path) -> Path:
    return write_hdf5(tmp_path / "secret.hdf5", {"observations": np.zeros((50, 5), np.float32)})


def npy(array: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def archive(folder: Path, *members: tuple[str, bytes]) -> Path:
    path = folder / "logs.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of members that are there twice
        for name, content in members:
            file.writestr(name, content)
    return path


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Some bits flipped, the end cut off, some bytes cut out, zeroed or made up; half of it in the first 2 kB."""
    copy = bytearray(content)
    at = int(rng.integers(min(len(copy), rng.choice([2000, len(copy)]))))
    size = int(rng.integers(1, 200))
    match rng.integers(5):
        case 0:
            copy[at] ^= 1 << int(rng.integers(8))
        case 1:
            del copy[at:]
        case 2:
            del copy[at : at + size]
        case 3:
            copy[at : at + size] = bytes(len(copy[at : at + size]))
        case _:
            copy[at : at + 4] = rng.bytes(len(copy[at : at + 4]))
    return bytes(copy)


def check_data_or_a_line(source: Path) -> bool:
    """Whether the source is refused; anything but data or a line is an error."""
    try:
        load(source, GOAL)
    except GuiderError as error:
        assert len(str(error).splitlines()) == 1
        return True
    return False
