"""When a goal is met: distances in goal space, part by part. Works on NumPy and JAX arrays alike."""

from __future__ import annotations

from typing import Any

import numpy as np

Parts = tuple[tuple[int, ...], ...]
"""Entries of the goal vector that belong together, such as the coordinates of one object. () is all as one part."""


def part_distances(achieved: Any, goal: Any, parts: Parts) -> Any:
    """Euclidean distance of each part, in goal units. achieved, goal: [..., G]. Returns [..., P]."""
    squares = (achieved - goal) ** 2
    parts = parts or (tuple(range(squares.shape[-1])),)
    arrays = squares.__array_namespace__()
    # A square root, and a sum entry by entry, are four times as fast as a power and a sum over so short an axis.
    sums = [sum(squares[..., entry] for entry in part) for part in parts]
    return arrays.sqrt(arrays.stack(sums, axis=-1))


def largest_distance(achieved: Any, goal: Any, parts: Parts) -> Any:
    """The distance of the part furthest from its goal, [...]: all parts are within a radius if this is."""
    return part_distances(achieved, goal, parts).max(axis=-1)


def goal_entries(states: np.ndarray, achieved: np.ndarray) -> tuple[int, ...] | None:
    """The state entries that hold the achieved goal in every row, or None where some goal entry is not among them.

    states: [rows, S]; achieved: [rows, G].
    """
    entries: list[int] = []
    for column in achieved.T:
        equal = np.ones(states.shape[1], bool)
        equal[entries] = False
        for rows in (slice(100), slice(None)):  # few rows rule most entries out
            for entry in np.flatnonzero(equal):
                equal[entry] = np.allclose(states[rows, entry], column[rows], atol=1e-5)
        if not equal.any():
            return None
        entries.append(int(np.argmax(equal)))
    return tuple(entries)
