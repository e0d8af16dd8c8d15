"""What a task is, and what an environment must offer to be evaluated on many copies at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from guider.data.episodes import Episodes
from guider.data.store import Recording
from guider.goals import Parts
from guider.tasks.mazes import Maze

Score = Literal["success", "return", "subtasks"]
"""How an episode is scored.

success:  100 if the goal is met after some step, else 0; the episode ends there
return:   number of steps after which the goal is met; the episode runs to the horizon
subtasks: 100 times the share of the goal's parts met after some step; the episode ends with the last of them
"""

SCORE_UNITS = {"success": "success (%)", "return": "steps with the goal met", "subtasks": "subtasks done (%)"}

Report = Callable[[int, int], None]
"""report(done, total): progress of long work."""


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


@dataclass(frozen=True, eq=False)
class Scene:
    """What there is to see of one copy. model, data: MuJoCo's, the latter as the copy stands now; camera: how its
    environment looks at it, as attributes of a free camera (lookat, distance, azimuth, elevation), where it says so."""

    model: Any
    data: Any
    camera: dict[str, Any]


@runtime_checkable
class Visible(Protocol):
    """A VectorEnv that can be filmed."""

    def scene(self, copy: int) -> Scene:
        """What there is to see of a copy. Raises GuiderError where it is no MuJoCo simulation."""
        ...


@dataclass(frozen=True)
class Collector:
    """How data for a task is made on this machine.

    record: (steps, 2 or more, seed, report) -> what was recorded, the same for equal steps and seed
    steps:  rows recorded unless the user says otherwise
    recipe: in a few words, who acts
    """

    record: Callable[[int, int, Report], Recording]
    steps: int
    recipe: str


def accept(episodes: Episodes) -> None:
    """The check of data that nothing is known to be wrong with."""


@dataclass(frozen=True)
class Task:
    """Everything that names a benchmark; a score is only comparable between equal Tasks.

    domain:        tasks of one domain share settings in presets
    goal_indices:  state entries of the goal space
    goal_parts:    entries of the goal that must each be within the radius, see guider.goals
    radius:        goal is met within this distance (goal units)
    part_radii:    of each part in turn, where they are judged by other distances; training holds all to `radius`
    reach_radius:  a subgoal counts as reached within this distance (goal units)
    horizon_steps: environment steps an evaluation episode may take
    period_steps:  the default subgoal period c
    score:         how an episode is scored
    environment:   which simulation a score comes from
    source:        where the definition comes from
    make_env:      number of copies -> VectorEnv
    goals:         how many there are, an episode with seed n aiming at number n % goals; 1 where each draws its own
    copies:        how many copies evaluation steps at once, at most
    collector:     how data is made here; None if it is not
    check_data:    raises GuiderError where episodes of the right shape were recorded on another robot
    maze:          walls for pictures; None outside mazes
    fallen:        whether a robot in a state [S] lies on its back; None for those that cannot
    places:        goals [G] -> [things, 3], where in the scene they are, metres; None where they are no places
    paper_score:   the paper's Guider score (Table 1), None for tasks that are not in it
    """

    name: str
    summary: str
    domain: str
    goal_indices: tuple[int, ...]
    state_dim: int
    action_dim: int
    radius: float
    reach_radius: float
    horizon_steps: int
    period_steps: int
    environment: str
    source: str
    make_env: Callable[[int], VectorEnv]
    score: Score = "success"
    goal_parts: Parts = ()
    part_radii: tuple[float, ...] = ()
    goals: int = 1
    copies: int = 100
    collector: Collector | None = None
    check_data: Callable[[Episodes], None] = accept
    maze: Maze | None = None
    fallen: Callable[[np.ndarray], bool] | None = None
    places: Callable[[np.ndarray], np.ndarray] | None = None
    paper_score: float | None = None
