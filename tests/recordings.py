"""Flat arrays of made-up recordings and the files they are written to, shared by the tests of guider.data."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

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
