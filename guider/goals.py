"""When a goal is met: distances in goal space, part by part. Works on NumPy and JAX arrays alike."""

from __future__ import annotations

from typing import Any

Parts = tuple[tuple[int, ...], ...]
"""Entries of the goal vector that belong together, such as the coordinates of one object. () is all as one part."""


def part_distances(achieved: Any, goal: Any, parts: Parts) -> list[Any]:
    """Euclidean distance of each part, in goal units. achieved, goal: [..., G]. Returns P arrays [...]."""
    squares = (achieved - goal) ** 2
    if not parts:
        return [squares.sum(axis=-1) ** 0.5]
    return [squares[..., list(part)].sum(axis=-1) ** 0.5 for part in parts]


def largest_distance(achieved: Any, goal: Any, parts: Parts) -> Any:
    """The distance of the part furthest from its goal, [...]: all parts are within a radius if this is."""
    first, *others = part_distances(achieved, goal, parts)
    for other in others:
        first = first * (first >= other) + other * (other > first)
    return first
