# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""Guider's own pointmaze: a ball with two motors in D4RL's antmaze layouts, with cells of 1 m.

It asks what antmaze asks, to join short and imperfect episodes to a route that none of them shows, of a robot
so simple that data takes seconds to record. It is no benchmark of the literature: no data and no score from
elsewhere belongs to it.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from guider.collect.waypoints import Recipe, record
from guider.support.files import user_path
from guider.support.physics import mujoco
from guider.tasks.mazes import Cell, Maze, floor_places, make_maze, read_maze
from guider.tasks.replay import check_replay
from guider.tasks.simulation import MujocoVectorEnv, Start
from guider.tasks.types import Collector, Task, VectorEnv

CELL_SIZE_M = 1.0
TIMESTEP_S = 0.02
FRAME_SKIP = 5
BALL_RADIUS_M = 0.2
BALL_MASS_KG = 1.0
# A motor drives the ball at up to 3.5 / 2.5 = 1.4 m/s along its axis, 7 environment steps for a cell; speed
# comes and goes with a time constant of 1 / 2.5 = 0.4 s, 4 environment steps.
MOTOR_FORCE_N = 3.5
DAMPING_NS_PER_M = 2.5
START_OFFSET_M = 0.1
GOAL_OFFSET_M = 0.25
GOAL_RADIUS_M = 0.25


@cache
def point_model(maze: Maze) -> mujoco.MjModel:
    """The ball between the walls of `maze`: slide joints along x and y, a motor on each, no gravity."""
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP_S
    spec.option.gravity = [0.0, 0.0, 0.0]
    ball = spec.worldbody.add_body(name="ball", pos=[0.0, 0.0, BALL_RADIUS_M])
    for name, axis in ("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0]):
        joint = ball.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        joint.damping[0] = DAMPING_NS_PER_M
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gear[0] = MOTOR_FORCE_N
        motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.ctrlrange = [-1.0, 1.0]
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_RADIUS_M, 0.0, 0.0], mass=BALL_MASS_KG)
    for row, column in np.argwhere(maze.walls):
        x, y = maze.cell_centre((row, column))
        spec.worldbody.add_geom(
            name=f"wall_{row}_{column}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, BALL_RADIUS_M],
            size=[CELL_SIZE_M / 2, CELL_SIZE_M / 2, BALL_RADIUS_M],
        )
    return spec.compile()


def sample_start(maze: Maze, rng: np.random.Generator) -> Start:
    """Evaluation: at rest near the centre of the start cell, towards a point within the goal cell.

    The start differs from its cell's centre by U(-0.1, 0.1) m along each axis, the goal by U(-0.25, 0.25) m.
    """
    return Start(
        qpos=_near(maze, maze.start_cell, START_OFFSET_M, rng),
        qvel=np.zeros(2),
        goal=_near(maze, maze.goal_cell, GOAL_OFFSET_M, rng),
    )


def sample_start_anywhere(maze: Maze, rng: np.random.Generator) -> Start:
    """Recording: at rest in a uniformly drawn free cell, 0.25 m or less from its centre along each axis.

    Its goal is where it starts: the recorder draws its own.
    """
    cell = maze.free_cells[rng.integers(len(maze.free_cells))]
    xy = _near(maze, cell, GOAL_OFFSET_M, rng)
    return Start(qpos=xy, qvel=np.zeros(2), goal=xy)


def make_env(maze: Maze, count: int) -> VectorEnv:
    """`count` copies of the ball in `maze`, for evaluation."""
    return MujocoVectorEnv(point_model(maze), FRAME_SKIP, partial(sample_start, maze), count)


def make_recording_env(maze: Maze, count: int) -> VectorEnv:
    """`count` copies of the ball in `maze`, started anywhere."""
    return MujocoVectorEnv(point_model(maze), FRAME_SKIP, partial(sample_start_anywhere, maze), count)


def drive(observations: np.ndarray, waypoints: np.ndarray) -> np.ndarray:
    """Proportional-derivative control: [n, 4] observations, [n, 2] waypoints in metres -> [n, 2] actions.

    a = clip(3 (waypoint - position) - velocity, -1, 1)
    """
    return np.clip(3.0 * (waypoints - observations[:, :2]) - observations[:, 2:], -1.0, 1.0)


def _near(maze: Maze, cell: Cell | np.ndarray, offset_m: float, rng: np.random.Generator) -> np.ndarray:
    return maze.cell_centre(cell) + rng.uniform(-offset_m, offset_m, 2)


def custom_task(file: str) -> Task:
    """The ball in the maze drawn in a text file (see read_maze), 1 m to a cell."""
    return _task(f"pointmaze:{file}", read_maze(user_path(file), CELL_SIZE_M))


def _task(name: str, maze: Maze) -> Task:
    """Steps grow with the route: evaluation may take about 1.6 times what `drive` takes, and a recorded episode is too
    short to get from the start cell to the goal cell, where they are four cells or more apart.

    Measured: without noise, `drive` meets the goal in 46-51, 75-80 and 106-111 steps in umaze, medium and large,
    whose routes have 6, 10 and 14 cells, and needs at least 39, 68 and 99 to get into the goal cell.
    """
    recipe = Recipe(
        maze=maze,
        make_env=partial(make_recording_env, maze),
        controller=drive,
        action_dim=2,
        episode_steps=(15 * maze.route_cells + 30) // 4,
        goal_cells=maze.free_cells,
        goal_offsets_m=((-GOAL_OFFSET_M, GOAL_OFFSET_M),),
        goal_radius_m=GOAL_RADIUS_M,
        noise_spread=0.5,
        burst_chance=0.03,
        burst_steps=8,
    )
    environment = f"Guider's ball (1 kg, 3.5 N) in MuJoCo {mujoco.__version__}, 1 m cells, maze {maze.name}"
    return Task(
        name=name,
        summary=f"a ball rolls through the maze {maze.name}; data is recorded in seconds",
        domain="pointmaze",
        goal_indices=(0, 1),
        state_dim=4,
        action_dim=2,
        radius=GOAL_RADIUS_M,
        reach_radius=2 * GOAL_RADIUS_M,
        horizon_steps=(25 * maze.route_cells + 10) // 2,
        period_steps=20,
        environment=environment,
        source="Guider's own",
        make_env=partial(make_env, maze),
        collector=Collector(partial(record, recipe), 200_000, "noisy controller between random cells"),
        check_data=partial(check_replay, partial(point_model, maze), FRAME_SKIP, environment),
        maze=maze,
        places=floor_places,
    )


POINTMAZES = tuple(_task(f"pointmaze-{name}", make_maze(name, CELL_SIZE_M)) for name in ("umaze", "medium", "large"))
