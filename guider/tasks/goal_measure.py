"""Whether an environment counts a goal as met where Guider does: its own `compute_reward` is asked, on samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np

from guider.goals import largest_distance

Met = Callable[[np.ndarray, np.ndarray], bool]
"""(achieved [G], desired [G]) -> whether the environment counts the goal as met."""

TIMES_RADIUS = (0.5, 0.9, 0.99, 1.01, 1.1, 2.0, 10.0)
RANDOM_DIRECTIONS = 16


def environments_rule(env: gymnasium.Env, goals: np.ndarray) -> Met | None:
    """Met is what `compute_reward` rewards as it does the goal itself, be that with 0 or 1.

    goals: [N, G]. None where that cannot be asked, or is dense: not even almost there is worth as much as there.
    """
    compute: Any = getattr(env.unwrapped, "compute_reward", None)

    def met(achieved: np.ndarray, desired: np.ndarray) -> bool:
        reward, best = (float(compute(reached.copy(), desired.copy(), {})) for reached in (achieved, desired))
        return reward == best

    try:
        return met if all(met(goal + 1e-6 * (1 + abs(goal)), goal) for goal in goals) else None
    except Exception:  # missing, not implemented, or in need of what only a step tells: whatever it is, not an answer
        return None


def first_disagreement(met: Met, space: Any, goals: np.ndarray, radius: float) -> np.ndarray | None:
    """achieved - desired [G] of a sample that `met` judges otherwise than a radius does; None if there is none.

    space: the Box of achieved goals, beyond which no sample lies; goals: [N, G], those of a few resets.
    """
    for achieved, desired in _samples(space, goals, radius):
        if met(achieved, desired) != (largest_distance(achieved, desired, ()) <= radius):
            return achieved - desired
    return None


def radius_of(met: Met, space: Any, goals: np.ndarray) -> float | None:
    """The radius, to three digits, by which `met` judges; None where it measures otherwise than by one."""
    found = float(np.median([_edge(met, goals[0], direction) for direction in _directions(goals.shape[1])]))
    radius = float(f"{found:.3g}")
    agrees = np.isfinite(radius) and radius > 0 and first_disagreement(met, space, goals, radius) is None
    return radius if agrees else None


def _edge(met: Met, goal: np.ndarray, direction: np.ndarray) -> float:
    """How far from `goal` along `direction` it is no longer met; infinity if it always is."""
    distances = np.geomspace(1e-6, 1e6, 121)
    missed = [not met(goal + distance * direction, goal) for distance in distances]
    if not any(missed):
        return np.inf
    outer = distances[np.argmax(missed)]
    inner = 0.0
    for _ in range(40):
        middle = (inner + outer) / 2
        inner, outer = (middle, outer) if met(goal + middle * direction, goal) else (inner, middle)
    return outer


def _directions(width: int) -> np.ndarray:
    """[directions, G] unit vectors: along each entry both ways, then random ones in all entries or some."""
    rng = np.random.default_rng(0)
    chosen = rng.normal(size=(RANDOM_DIRECTIONS, width))
    chosen[1::2] *= rng.random((RANDOM_DIRECTIONS // 2, width)) < 0.5
    chosen = chosen[chosen.any(axis=1)]
    return np.concatenate([np.eye(width), -np.eye(width), chosen / np.linalg.norm(chosen, axis=1, keepdims=True)])


def _samples(space: Any, goals: np.ndarray, radius: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(achieved, desired): below, near and above the radius; other goals; a turn away; from end to end of a range."""
    low, high = np.asarray(space.low, float), np.asarray(space.high, float)
    directions, axes = _directions(goals.shape[1]), np.eye(goals.shape[1])
    for goal in goals:
        reached = [goal + times * radius * direction for direction in directions for times in TIMES_RADIUS]
        reached += [goal + turn * axis for axis in axes for turn in (-2 * np.pi, 2 * np.pi)]
        for achieved in (*reached, *goals):
            yield np.clip(achieved, low, high).astype(space.dtype).astype(float), goal
    for entry in np.flatnonzero(np.isfinite(low) & np.isfinite(high)):
        achieved, desired = goals[0].copy(), goals[0].copy()
        achieved[entry], desired[entry] = low[entry], high[entry]
        yield achieved, desired
