# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""OGBench's tables, where an arm moves cubes, presses buttons, and slides a drawer and a window: five goals each
(guider.tasks.ogbench_env).

A goal here is what the objects shall be, its entries those of the state that say it: positions of cubes (10 to the
metre, as OGBench's observations have them), which buttons are on, how far drawer and window are open. OGBench shows its
agents a whole state instead, in which the arm is somewhere too, and calls this goal the oracle's: `-states` in a task's
name is for that. Where the arm ends is of no account in either. Success is OGBench's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from guider.collect.ogbench import PlayAtTable, TableKind
from guider.goals import Parts
from guider.support.physics import mujoco
from guider.tasks.gym_env import GymVectorEnv
from guider.tasks.ogbench_env import GOALS, Data, collector, make_unwrapped
from guider.tasks.types import Task

ARM_ENTRIES = 19
"""The state begins with joints and their speeds (12), the gripper's place (3), heading (2), opening and touch."""
CUBE_ENTRIES, BUTTON_ENTRIES = 9, 4
CENTRE_M = (0.425, 0.0, 0.0)
UNITS_TO_METRE = 10.0
CUBE_RADIUS_M, SLIDE_RADIUS_M = 0.04, 0.04
DRAWER_UNITS_TO_METRE, WINDOW_UNITS_TO_METRE = 18.0, 15.0
Goal = Callable[[Any], np.ndarray]
"""(table that has just been reset) -> [G] what is to be reached."""


class FiveGoals(gymnasium.Wrapper):
    """An OGBench table whose seed says all: which of the five goals, which cube is which, and where things start.

    Observations are dicts for guider.tasks.gym_env.read_goal_observation.
    """

    def __init__(self, table: Any, goal: Goal):
        # A table makes another space whenever it is asked, which no seed reaches; its goal's random steps are drawn
        # from it.
        space = gymnasium.spaces.Box(-1.0, 1.0, (5,))
        table.__class__ = type(type(table).__name__, (type(table),), {"action_space": space})
        super().__init__(table)
        self._goal = goal

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        assert seed is not None
        table: Any = self.env
        table.action_space.seed(seed)
        observation, info = table.reset(seed=seed, options={"task_id": 1 + seed % GOALS})
        self._desired = self._goal(table)
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observe(observation), reward, terminated, truncated, info

    def _observe(self, observation: np.ndarray) -> dict[str, np.ndarray]:
        return {"observation": observation, "desired_goal": self._desired.copy()}


def make_env(env_id: str, goal: Goal) -> gymnasium.Env:
    """Raises GuiderError without OGBench."""
    return FiveGoals(make_unwrapped(env_id, terminate_at_goal=False), goal)


def cubes_goal(table: Any) -> np.ndarray:
    """[3 * cubes]: where the cubes shall be."""
    places = np.array([table.data.mocap_pos[target] for target in table._cube_target_mocap_ids])
    return (UNITS_TO_METRE * (places - CENTRE_M)).reshape(-1)


def buttons_goal(table: Any) -> np.ndarray:
    """[buttons]: 1 where a button shall be on, else 0."""
    return table._target_button_states.astype(float)


def scene_goal(table: Any) -> np.ndarray:
    """[7]: where the cube shall be (3), which of two buttons shall be on, how far drawer and window shall be open."""
    drawer_m, window_m = table._target_drawer_pos, table._target_window_pos
    opened = [DRAWER_UNITS_TO_METRE * drawer_m, WINDOW_UNITS_TO_METRE * window_m]
    return np.concatenate([cubes_goal(table), buttons_goal(table), opened])


def whole_state(table: Any) -> np.ndarray:
    """[S]: the state that OGBench shows its agents."""
    return table._cur_goal_ob.copy()


def cube_places(goal: np.ndarray) -> np.ndarray:
    """[cubes, 3]: where in the scene, in metres, a goal [3 * cubes] wants cubes."""
    return goal.reshape(-1, 3) / UNITS_TO_METRE + CENTRE_M


def _cube_tasks(name: str, cubes: int, kind: TableKind, horizon_steps: int, episodes: int) -> tuple[Task, Task]:
    first = [ARM_ENTRIES + CUBE_ENTRIES * cube for cube in range(cubes)]
    return _both(
        f"cube-{name}",
        kind,
        f"an arm puts {cubes} cube{'s' * (cubes > 1)} where they shall be",
        goal_indices=tuple(entry + axis for entry in first for axis in range(3)),
        goal_parts=tuple(tuple(range(3 * cube, 3 * cube + 3)) for cube in range(cubes)),
        radius=UNITS_TO_METRE * CUBE_RADIUS_M,
        state_dim=ARM_ENTRIES + CUBE_ENTRIES * cubes,
        goal=cubes_goal,
        places=cube_places,
        horizon_steps=horizon_steps,
        period_steps=100,  # to fetch a cube and set it down takes some 60
        data=Data(PlayAtTable(kind, 0.1 if kind == "noisy" else 0.0), episodes, 1_001),
    )


def _puzzle_tasks(rows: int, columns: int, kind: TableKind) -> tuple[Task, Task]:
    buttons = rows * columns
    return _both(
        f"puzzle-{rows}x{columns}",
        kind,
        f"an arm presses {buttons} buttons, each of which turns its neighbours too",
        goal_indices=tuple(ARM_ENTRIES + BUTTON_ENTRIES * button + 1 for button in range(buttons)),
        goal_parts=tuple((button,) for button in range(buttons)),
        radius=0.5,
        state_dim=ARM_ENTRIES + BUTTON_ENTRIES * buttons,
        goal=buttons_goal,
        horizon_steps=500,
        period_steps=40,  # from one logged press to the next it is 28 to 38
        data=Data(PlayAtTable(kind, 0.2 if kind == "noisy" else 0.0), 1_000, 1_001),
    )


def _scene_tasks(kind: TableKind) -> tuple[Task, Task]:
    buttons = ARM_ENTRIES + CUBE_ENTRIES
    slides = buttons + 2 * BUTTON_ENTRIES
    slide_radii = tuple(SLIDE_RADIUS_M * units for units in (DRAWER_UNITS_TO_METRE, WINDOW_UNITS_TO_METRE))
    radius = UNITS_TO_METRE * CUBE_RADIUS_M
    return _both(
        "scene",
        kind,
        "an arm sees to a cube, a drawer and a window, and to the two buttons that lock them",
        goal_indices=(*range(ARM_ENTRIES, ARM_ENTRIES + 3), buttons + 1, buttons + 5, slides, slides + 2),
        goal_parts=((0, 1, 2), (3,), (4,), (5,), (6,)),
        part_radii=(radius, radius, radius, *slide_radii),
        radius=radius,
        state_dim=slides + 4,
        goal=scene_goal,
        horizon_steps=750,
        data=Data(PlayAtTable(kind, 0.1 if kind == "noisy" else 0.0), 1_000, 1_001),
    )


def _both(
    name: str,
    kind: TableKind,
    summary: str,
    *,
    goal_indices: tuple[int, ...],
    goal_parts: Parts,
    radius: float,
    part_radii: tuple[float, ...] = (),
    state_dim: int,
    goal: Goal,
    places: Callable[[np.ndarray], np.ndarray] | None = None,
    horizon_steps: int,
    data: Data,
    period_steps: int = 25,
) -> tuple[Task, Task]:
    """The task whose goals are what objects shall be, and the one whose goals are whole states, of which the same
    counts."""
    env_id = f"{name}-v0"
    make_table = partial(make_unwrapped, env_id, terminate_at_goal=False, mode="data_collection")
    task = Task(
        name=f"ogbench-{name}-{kind}-v0",
        summary=summary,
        domain=f"ogbench-{name.split('-')[0]}",
        goal_indices=goal_indices,
        goal_parts=goal_parts,
        part_radii=part_radii,
        state_dim=state_dim,
        action_dim=5,
        radius=radius,
        reach_radius=radius,
        horizon_steps=horizon_steps,
        period_steps=period_steps,
        environment=f"OGBench {env_id} in MuJoCo {mujoco.__version__}, goals are what objects shall be",
        source="OGBench",
        make_env=partial(GymVectorEnv, partial(make_env, env_id, goal)),
        goals=GOALS,
        copies=10,  # a second to build, each
        collector=collector(make_table, data, f"OGBench's {kind} oracles"),
        places=places,
    )
    objects = list(goal_indices)
    whole = replace(
        task,
        name=f"ogbench-{name}-{kind}-states-v0",
        summary=f"{summary}, shown a whole state",
        goal_indices=tuple(range(state_dim)),
        goal_parts=tuple(tuple(objects[entry] for entry in part) for part in goal_parts),
        environment=f"OGBench {env_id} in MuJoCo {mujoco.__version__}, goals are whole states",
        make_env=partial(GymVectorEnv, partial(make_env, env_id, whole_state)),
        places=None if places is None else lambda goal: places(goal[objects]),
    )
    return task, whole


_KINDS: tuple[TableKind, ...] = ("play", "noisy")

_PAIRS = (
    *(
        _cube_tasks(name, cubes, kind, horizon_steps, episodes)
        for name, cubes, horizon_steps, episodes in (
            ("single", 1, 200, 1_000),
            ("double", 2, 500, 1_000),
            ("triple", 3, 1_000, 3_000),
        )
        for kind in _KINDS
    ),
    *(_scene_tasks(kind) for kind in _KINDS),
    *(_puzzle_tasks(rows, columns, kind) for rows, columns in ((3, 3), (4, 4)) for kind in _KINDS),
)
TABLE_TASKS = tuple(task for tasks in zip(*_PAIRS, strict=True) for task in tasks)
