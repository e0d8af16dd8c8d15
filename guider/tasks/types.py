"""What a task is, and what an environment must offer to be evaluated on many copies at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from guider.tasks.mazes import Maze


class VectorEnv(Protocol):
    """Copies of one environment stepped together, on all cores."""

    count: int

    def reset(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start every copy anew; copy i is wholly determined by seeds[i].

        seeds: [count] int. Returns observations [count, state_dim] and goals [count, goal_dim], float32.
        """
        ...

    def step(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Advance the copies where `active` by one step; the others stay as they are.

        actions: [count, action_dim]; active: [count] bool. Returns observations [count, state_dim] float32.
        """
        ...

    def close(self) -> None:
        """Release threads and simulators."""
        ...


@dataclass(frozen=True)
class Task:
    """Everything that names a benchmark; a score is only comparable between equal Tasks.

    goal_indices:  state entries of the goal space
    radius:        goal is met within this distance (goal units)
    reach_radius:  a subgoal counts as reached within this distance (goal units)
    horizon_steps: environment steps an evaluation episode may take
    period_steps:  the default subgoal period c
    environment:   which simulation a score comes from
    make_env:      number of copies -> VectorEnv
    collect:       (steps, seed, path, report progress(done, total)) -> writes D4RL-style HDF5; None if data comes
                   from elsewhere
    maze:          walls for pictures; None outside mazes
    paper_score:   the paper's Guider score (Table 1), None for tasks that are not in it
    """

    name: str
    summary: str
    goal_indices: tuple[int, ...]
    state_dim: int
    action_dim: int
    radius: float
    reach_radius: float
    horizon_steps: int
    period_steps: int
    environment: str
    make_env: Callable[[int], VectorEnv]
    collect: Callable[[int, int, Path, Callable[[int, int], None]], None] | None = None
    maze: Maze | None = None
    paper_score: float | None = None
