# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""OGBench's mazes with its own protocol: five goals per maze, episode e aims at goal 1 + e % 5.

OGBench is an extra, imported when an environment is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from guider.errors import GuiderError
from guider.support.physics import mujoco
from guider.tasks.antmaze import FRAME_SKIP as ANT_FRAME_SKIP
from guider.tasks.antmaze import ant_model
from guider.tasks.gym_env import GymVectorEnv
from guider.tasks.mazes import Maze, make_maze
from guider.tasks.replay import check_replay
from guider.tasks.types import Task, accept

CELL_SIZE_M = 4.0
NOISE_M = 1.0
GOALS = 5


class FiveGoals(gymnasium.Wrapper):
    """An OGBench maze whose seed says all: which of the five goals, and where in their cells it starts and aims.

    Start and goal differ from their cells' centres by U(-1, 1) m along each axis, as OGBench has it; it would draw
    that from NumPy's global generator. Observations are dicts for guider.tasks.gym_env.read_goal_observation.
    """

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        assert seed is not None
        _, info = self.env.reset(seed=seed, options={"task_id": 1 + seed % GOALS})
        maze: Any = self.env.unwrapped
        rng = np.random.default_rng([seed, 1])  # the environment draws joints from default_rng(seed)
        maze.set_goal(goal_xy=maze.cur_task_info["goal_xy"] + rng.uniform(-NOISE_M, NOISE_M, 2))
        maze.set_xy(maze.cur_task_info["init_xy"] + rng.uniform(-NOISE_M, NOISE_M, 2))
        return self._observe(maze.get_ob()), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observe(observation), reward, terminated, truncated, info

    def _observe(self, observation: np.ndarray) -> dict[str, np.ndarray]:
        maze: Any = self.env.unwrapped
        return {"observation": observation, "desired_goal": np.array(maze.cur_goal_xy)}


def make_env(env_id: str, radius_m: float) -> gymnasium.Env:
    """Raises GuiderError without OGBench, or where its success radius is another."""
    try:
        import ogbench  # noqa: F401  (it registers its environments)
    except ImportError as error:
        raise GuiderError(f'OGBench\'s {env_id} needs a package: pip install "guider-rl[ogbench]"') from error
    env = gymnasium.make(env_id, disable_env_checker=True)
    maze: Any = env.unwrapped
    Path(maze.fullpath).unlink()  # it leaves one behind for each copy
    if maze._goal_tol != radius_m:
        raise GuiderError(
            f"{env_id}: this OGBench counts a goal as met within {maze._goal_tol:g} m, Guider within {radius_m:g} m; "
            "install ogbench 1.1 or newer"
        )
    return FiveGoals(env)


@dataclass(frozen=True)
class Robot:
    """What OGBench's mazes fix for one robot.

    model: of the robot in a maze, whose qpos and qvel are its state; None where states cannot be replayed
    """

    name: str
    domain: str
    state_dim: int
    action_dim: int
    radius_m: float
    period_steps: int
    model: Callable[[Maze], mujoco.MjModel] | None = None


def _task(robot: Robot, maze: Maze, horizon_steps: int) -> Task:
    env_id = f"{robot.name}-{maze.name}-v0"
    environment = f"OGBench {env_id} in MuJoCo {mujoco.__version__}, 4 m cells"
    check_data = accept
    if robot.model is not None:
        check_data = partial(check_replay, partial(robot.model, maze), ANT_FRAME_SKIP, environment)
    return Task(
        name=f"ogbench-{robot.name}-{maze.name}-navigate-v0",
        summary=f"five routes through the maze {maze.name}",
        domain=robot.domain,
        goal_indices=(0, 1),
        state_dim=robot.state_dim,
        action_dim=robot.action_dim,
        radius=robot.radius_m,
        reach_radius=1.0,
        horizon_steps=horizon_steps,
        period_steps=robot.period_steps,
        environment=environment,
        source="OGBench",
        make_env=partial(GymVectorEnv, partial(make_env, env_id, robot.radius_m)),
        copies=20,
        check_data=check_data,
        maze=maze,
    )


_POINT = Robot("pointmaze", "ogbench-pointmaze", 2, 2, radius_m=1.0, period_steps=25)
# OGBench's ant is D4RL's.
_ANT = Robot("antmaze", "antmaze", 29, 8, radius_m=0.5, period_steps=50, model=ant_model)
_HUMANOID = Robot("humanoidmaze", "humanoidmaze", 69, 21, radius_m=0.5, period_steps=100)

# With the first of the five goals, which is not D4RL's in the large maze.
_MEDIUM, _GIANT = make_maze("medium", CELL_SIZE_M), make_maze("giant", CELL_SIZE_M)
_LARGE = replace(make_maze("large", CELL_SIZE_M), goal_cell=(7, 10))

OGBENCH_TASKS = (
    *(_task(robot, maze, 1000) for robot in (_POINT, _ANT) for maze in (_MEDIUM, _LARGE, _GIANT)),
    _task(_HUMANOID, _MEDIUM, 2000),
    _task(_HUMANOID, _LARGE, 2000),
    _task(_HUMANOID, _GIANT, 4000),
)
