"""A walker for D4RL's ant: a small network that walks in any direction it is told.

It was trained from scratch by `tools/train_ant_walker.py`; its weights are `guider/assets/ant_walker.npz`.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np

VIEW_DIM = 29


def walker_view(observations: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """What the walker sees, all in the frame of the ant's torso, so that every heading looks alike.

    observations: [n, 29] qpos (15) and qvel (14) of the ant; directions: [n, 2] where to go, world frame, any length.
    Returns [n, VIEW_DIM]: height of the torso (m), world's up (3), joint angles (8, rad), linear (3, m/s), angular
    (3, rad/s) and joint (8, rad/s) velocities, unit direction (3).
    """
    unit = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-8)
    to_world = rotations(observations[:, 3:7])
    flat = np.concatenate([unit, np.zeros((len(unit), 1))], axis=1)
    return np.concatenate(
        [
            observations[:, 2:3],
            to_world[:, 2],
            observations[:, 7:15],
            np.einsum("nij,ni->nj", to_world, observations[:, 15:18]),
            observations[:, 18:29],
            np.einsum("nij,ni->nj", to_world, flat),
        ],
        axis=1,
    )


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """[n, 4] quaternions (w, x, y, z; any length) -> [n, 3, 3] rotations from body to world."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


@cache
def _weights() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    with files("guider").joinpath("assets/ant_walker.npz").open("rb") as file, np.load(file) as arrays:
        return tuple((arrays[f"weights_{i}"], arrays[f"biases_{i}"]) for i in range(len(arrays.files) // 2))


def walk(observations: np.ndarray, waypoints: np.ndarray) -> np.ndarray:
    """The walker's action towards its waypoint. [n, 29], [n, 2] metres -> [n, 8] in [-1, 1]. Without memory."""
    *hidden, (weights, biases) = _weights()
    values = walker_view(observations, waypoints - observations[:, :2])
    for hidden_weights, hidden_biases in hidden:
        values = np.maximum(values @ hidden_weights + hidden_biases, 0.0)
    return np.tanh(values @ weights + biases)
