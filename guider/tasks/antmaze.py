# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""D4RL's antmaze: its ant, its mazes and its evaluation protocol.

The ant is Gymnasium's `ant.xml` turned into the robot D4RL recorded its data on: the bodies are the same, the
time step is twice as long and the motors are five times weaker. Stepping it from a recorded state with the
recorded action lands on the next recorded state (tests/test_antmaze.py): data and evaluation share one robot.
Gymnasium-Robotics' `AntMaze_*` is the other robot, and scores on it are not comparable.
"""

from __future__ import annotations

import importlib.util
from functools import cache, partial
from pathlib import Path

import mujoco
import numpy as np

from guider.errors import GuiderError
from guider.tasks.mazes import Maze, make_maze
from guider.tasks.simulation import MujocoVectorEnv, Start
from guider.tasks.types import Task, VectorEnv

CELL_SIZE_M = 4.0
WALL_HEIGHT_M = 2.0
TIMESTEP_S = 0.02
FRAME_SKIP = 5
MOTOR_GEAR = 30.0
CONTACT_SOLREF = (0.02, 1.0)
CONTACT_SOLIMP = (0.8, 0.8, 0.01)
INITIAL_QPOS = (0, 0, 0.55, 1, 0, 0, 0, 0, 1, 0, -1, 0, -1, 0, 1)
RESET_QPOS_RANGE = 0.1
RESET_QVEL_SPREAD = 0.1
GOAL_OFFSETS_M = (1.0, 0.5)


@cache
def ant_model(maze: Maze) -> mujoco.MjModel:
    """D4RL's ant in `maze`.

    Source: D4RL's ant.xml, whose bodies are those of Gymnasium's; what differs is set here.
    """
    spec = mujoco.MjSpec.from_file(str(_gymnasium_ant()))
    spec.option.timestep = TIMESTEP_S
    for actuator in spec.actuators:
        actuator.gear[0] = MOTOR_GEAR
    for geom in [spec.default.geom, *spec.geoms]:
        geom.solref[:2] = CONTACT_SOLREF
        geom.solimp[:3] = CONTACT_SOLIMP
    half_size = CELL_SIZE_M / 2, CELL_SIZE_M / 2, WALL_HEIGHT_M / 2
    for row, column in np.argwhere(maze.walls):
        x, y = maze.cell_centre((row, column))
        spec.worldbody.add_geom(
            name=f"wall_{row}_{column}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, WALL_HEIGHT_M / 2],
            size=half_size,
            contype=1,
            conaffinity=1,
        )
    return spec.compile()


def sample_start(maze: Maze, rng: np.random.Generator) -> Start:
    """D4RL's evaluation: near the centre of the start cell, towards a goal drawn within the goal cell.

    qpos differs from INITIAL_QPOS by U(-0.1, 0.1) in every entry, qvel is 0.1 N(0, 1). To each coordinate of
    the goal cell's centre U(0, 1) + U(0, 0.5) metres are added; no coordinate falls below 0.
    """
    qpos = np.array(INITIAL_QPOS, float)
    qpos[:2] = maze.cell_centre(maze.start_cell)
    offsets = sum(rng.uniform(0.0, upper, 2) for upper in GOAL_OFFSETS_M)
    return Start(
        qpos=qpos + rng.uniform(-RESET_QPOS_RANGE, RESET_QPOS_RANGE, 15),
        qvel=RESET_QVEL_SPREAD * rng.standard_normal(14),
        goal=np.maximum(maze.cell_centre(maze.goal_cell) + offsets, 0.0),
    )


def make_env(maze: Maze, count: int) -> VectorEnv:
    """`count` copies of D4RL's ant in `maze`."""
    return MujocoVectorEnv(ant_model(maze), FRAME_SKIP, partial(sample_start, maze), count)


def _gymnasium_ant() -> Path:
    """Gymnasium's ant. Found without importing Gymnasium, which would load every environment's registry."""
    package = importlib.util.find_spec("gymnasium")
    if package is None or package.origin is None:
        raise GuiderError("antmaze builds its ant from Gymnasium's: install gymnasium")
    return Path(package.origin).parent / "envs" / "mujoco" / "assets" / "ant.xml"


def _task(maze_name: str, horizon_steps: int, paper_score: float) -> Task:
    maze = make_maze(maze_name, CELL_SIZE_M)
    return Task(
        name=f"antmaze-{maze_name}-diverse",
        summary=f"an ant walks through D4RL's {maze_name} maze",
        goal_indices=(0, 1),
        state_dim=29,
        action_dim=8,
        radius=0.5,
        reach_radius=1.0,
        horizon_steps=horizon_steps,
        period_steps=50,
        environment=f"D4RL ant (gear 30) in MuJoCo {mujoco.__version__}, 4 m cells",
        make_env=partial(make_env, maze),
        maze=maze,
        paper_score=paper_score,
    )


ANTMAZES = (
    _task("umaze", 700, 88.5),
    _task("medium", 1000, 87.3),
    _task("large", 1000, 80.8),
)
