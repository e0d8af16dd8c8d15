# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""OGBench's mazes, through which a point, an ant or a humanoid goes: five goals each (guider.tasks.ogbench_env)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from guider.collect.ant_walker import walk
from guider.collect.ogbench import MazeKind, Wander
from guider.errors import GuiderError
from guider.support.physics import mujoco
from guider.tasks.antmaze import FRAME_SKIP as ANT_FRAME_SKIP
from guider.tasks.antmaze import ant_model, on_its_back
from guider.tasks.gym_env import GymVectorEnv
from guider.tasks.mazes import Maze, floor_places, make_maze
from guider.tasks.ogbench_env import GOALS, Data, collector, make_unwrapped
from guider.tasks.replay import check_replay
from guider.tasks.types import Task, accept

CELL_SIZE_M = 4.0
NOISE_M = 1.0
TELEPORT_RADII = 1.5


class FiveGoals(gymnasium.Wrapper):
    """An OGBench maze whose seed says all: which of the five goals, and where in their cells it starts and aims.

    Start and goal differ from their cells' centres by U(-1, 1) m along each axis, as OGBench has it; it would draw
    that, and where a teleporter leads, from NumPy's global generator. Observations are dicts for
    guider.tasks.gym_env.read_goal_observation.
    """

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        maze: Any = env.unwrapped
        self._teleporters, maze._teleport_info = maze._teleport_info, None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        assert seed is not None
        _, info = self.env.reset(seed=seed, options={"task_id": 1 + seed % GOALS})
        maze: Any = self.env.unwrapped
        self._rng = np.random.default_rng([seed, 1])  # the environment draws joints from default_rng(seed)
        maze.set_goal(goal_xy=maze.cur_task_info["goal_xy"] + self._rng.uniform(-NOISE_M, NOISE_M, 2))
        maze.set_xy(maze.cur_task_info["init_xy"] + self._rng.uniform(-NOISE_M, NOISE_M, 2))
        return self._observe(maze.get_ob()), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._teleporters is not None:
            self._teleport(self._teleporters)
        return self._observe(observation), reward, terminated, truncated, info

    def _teleport(self, teleporters: dict[str, Any]) -> None:
        """Whoever is near an entrance is at a random exit before the next step; this step has seen the entrance."""
        maze: Any = self.env.unwrapped
        away = np.linalg.norm(np.array(teleporters["teleport_in_xys"]) - maze.get_xy(), axis=1)
        if away.min() <= TELEPORT_RADII * teleporters["teleport_radius"]:
            exits = teleporters["teleport_out_xys"]
            maze.set_xy(np.array(exits[self._rng.integers(len(exits))]))

    def _observe(self, observation: np.ndarray) -> dict[str, np.ndarray]:
        maze: Any = self.env.unwrapped
        return {"observation": observation, "desired_goal": np.array(maze.cur_goal_xy)}


def make_maze_env(env_id: str) -> Any:
    """Unwrapped. Raises GuiderError without OGBench."""
    maze = make_unwrapped(env_id, terminate_at_goal=False)
    Path(maze.fullpath).unlink()  # it leaves one behind for each copy
    return maze


def make_env(env_id: str, radius_m: float) -> gymnasium.Env:
    """Raises GuiderError without OGBench, or where its success radius is another."""
    maze = make_maze_env(env_id)
    if maze._goal_tol != radius_m:
        raise GuiderError(
            f"{env_id}: this OGBench counts a goal as met within {maze._goal_tol:g} m, Guider within {radius_m:g} m; "
            "install ogbench 1.1 or newer"
        )
    return FiveGoals(maze)


def go_straight(observation: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The point's expert: its action is where it is to go."""
    return direction


def walk_on(observation: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Our own walker's action for one ant [29]."""
    return walk(observation[None], observation[None, :2] + direction)[0]


@dataclass(frozen=True)
class Robot:
    """What OGBench's mazes fix for one robot.

    model: of the robot in a maze, whose qpos and qvel are its state; None where states cannot be replayed
    act, noise: who wanders while recording, and the noise on that; None where there is nobody to
    """

    name: str
    domain: str
    state_dim: int
    action_dim: int
    radius_m: float
    period_steps: int
    model: Callable[[Maze], mujoco.MjModel] | None = None
    fallen: Callable[[np.ndarray], bool] | None = None
    act: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    noise: float = 0.0
    expert: str = ""


def _task(robot: Robot, maze: Maze, kind: MazeKind, horizon_steps: int) -> Task:
    env_id = f"{robot.name}-{maze.name}-v0"
    environment = f"OGBench {env_id} in MuJoCo {mujoco.__version__}, 4 m cells"
    check_data = accept
    if robot.model is not None:
        check_data = partial(check_replay, partial(robot.model, maze), ANT_FRAME_SKIP, environment)
    made = None
    if robot.act is not None:
        noise = 1.0 if kind == "explore" else robot.noise
        data = Data(Wander(kind, robot.act, noise), *_amount(kind, maze.name))
        made = collector(partial(make_maze_env, env_id), data, f"OGBench's protocol of {kind} with {robot.expert}")
    return Task(
        name=f"ogbench-{robot.name}-{maze.name}-{kind}-v0",
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
        goals=GOALS,
        copies=20,
        collector=made,
        check_data=check_data,
        maze=maze,
        places=floor_places,
        fallen=robot.fallen,
    )


def _amount(kind: MazeKind, maze: str) -> tuple[int, int]:
    """Episodes, and rows of each, in OGBench's sets."""
    if kind == "stitch":
        return 5_000, 201
    if kind == "explore":
        return 10_000, 501
    return (500, 2_001) if maze == "giant" else (1_000, 1_001)


_POINT = Robot(
    "pointmaze",
    "ogbench-pointmaze",
    2,
    2,
    radius_m=1.0,
    period_steps=25,
    act=go_straight,
    noise=0.5,
    expert="its own point",
)
# OGBench's ant is D4RL's; its expert is not published.
_ANT = Robot(
    "antmaze",
    "antmaze",
    29,
    8,
    radius_m=0.5,
    period_steps=50,
    model=ant_model,
    fallen=on_its_back,
    act=walk_on,
    noise=0.2,
    expert="our own ant walker",
)
_HUMANOID = Robot("humanoidmaze", "humanoidmaze", 69, 21, radius_m=0.5, period_steps=100)

# With the first of the five goals, which is not D4RL's in the large maze.
_MEDIUM, _GIANT, _TELEPORT = (make_maze(name, CELL_SIZE_M) for name in ("medium", "giant", "teleport"))
_LARGE = replace(make_maze("large", CELL_SIZE_M), goal_cell=(7, 10))
_KINDS: tuple[MazeKind, ...] = ("navigate", "stitch")

MAZE_TASKS = (
    *(
        _task(robot, maze, kind, 1000)
        for robot in (_POINT, _ANT)
        for maze in (_MEDIUM, _LARGE, _GIANT, _TELEPORT)
        for kind in _KINDS
    ),
    *(_task(_ANT, maze, "explore", 1000) for maze in (_MEDIUM, _LARGE, _TELEPORT)),
    *(
        _task(_HUMANOID, maze, kind, horizon_steps)
        for maze, horizon_steps in ((_MEDIUM, 2000), (_LARGE, 2000), (_GIANT, 4000))
        for kind in _KINDS
    ),
)
