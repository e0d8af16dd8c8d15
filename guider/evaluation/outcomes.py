"""How episodes in a maze ended, and whether the subgoals pursued lay where the data has been."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.spatial import KDTree

from guider.evaluation.rollouts import Trace
from guider.tasks.mazes import Maze
from guider.tasks.types import Task

Ending = Literal["met", "fell", "stuck", "time"]
"""met: the goal was; fell: it was not, and the robot ended on its back; stuck: nor that, and for the last fifth of its
time it stayed within half a cell of where it ended; time: it was still on its way."""

_STUCK_SHARE = 0.2


def ending(trace: Trace, task: Task, maze: Maze) -> Ending:
    """How an episode in the task's maze ended."""
    if trace.success:
        return "met"
    if task.fallen is not None and task.fallen(trace.last_state):
        return "fell"
    last = trace.achieved[-round(_STUCK_SHARE * task.horizon_steps) :]
    far = np.linalg.norm(last - trace.achieved[-1], axis=1).max()
    return "stuck" if far <= maze.cell_size_m / 2 else "time"


def proposed(traces: Sequence[Trace]) -> np.ndarray:
    """[P, G] subgoals, each as often as it was chosen."""
    return np.concatenate([trace.subgoals[trace.renewed] for trace in traces])


def share_off_data(subgoals: np.ndarray, logged: np.ndarray, radius: float) -> float:
    """Share of subgoals [P, G] that no logged place [N, G] lies within `radius` of."""
    nearest, _ = KDTree(logged).query(subgoals, distance_upper_bound=np.nextafter(radius, np.inf))
    return float(np.isinf(nearest).mean())


def share_in_walls(subgoals: np.ndarray, maze: Maze) -> float:
    """Share of subgoals [P, 2] in metres that lie inside a wall."""
    return float(maze.walls[tuple(maze.cell_of(subgoals).T)].mean())


def subgoal_shares(
    traces: Sequence[Trace], maze: Maze, logged: np.ndarray | None, radius: float
) -> dict[str, float | None]:
    """Of the subgoals chosen, the shares in walls and off the data. logged: [N, G], or None where nobody knows."""
    subgoals = proposed(traces)
    off = None if logged is None else share_off_data(subgoals, logged, radius)
    return {"subgoals_in_walls": share_in_walls(subgoals, maze), "subgoals_off_data": off}
