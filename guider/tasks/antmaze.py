# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""D4RL's antmaze: its ant, its mazes and its evaluation protocol; and the same ant in mazes of one's own.

The ant is Gymnasium's `ant.xml` turned into the robot D4RL recorded its data on: the bodies are the same, the
time step is twice as long and the motors are five times weaker. Stepping it from a recorded state with the
recorded action lands on the next recorded state (tests/tasks/test_antmaze.py): data and evaluation share one robot.
Gymnasium-Robotics' `AntMaze_*` is the other robot, and scores on it are not comparable.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from guider.collect.ant_walker import walk
from guider.collect.waypoints import Recipe, record
from guider.errors import GuiderError
from guider.support.files import user_path
from guider.support.physics import mujoco
from guider.tasks.mazes import Maze, floor_places, make_maze, read_maze
from guider.tasks.replay import check_replay
from guider.tasks.simulation import MujocoVectorEnv, Start
from guider.tasks.types import Collector, Task, VectorEnv

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
GOAL_RADIUS_M = 0.5
RECORDED_GOAL_CELLS = {
    "umaze": ((3, 1),),
    "medium": ((2, 6), (5, 1), (6, 5)),
    "large": ((1, 6), (3, 5), (3, 10), (5, 2), (7, 4), (7, 6), (7, 9)),
}
"""Cells that D4RL's recordings of `diverse` aim at; they start in all others. Source: D4RL's generator."""
RECORDED_START_OFFSET_M = (0.0, 1.0)
EVERYWHERE_START_OFFSET_M = (-0.5, 1.0)
ACTION_NOISE_SPREAD = 0.2
# The extension of D4RL that brought the ultra maze twice shifts goals by half a metre towards the origin.
ULTRA_GOAL_SHIFT_M = -1.0


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


def sample_start(maze: Maze, goal_shift_m: float, rng: np.random.Generator) -> Start:
    """D4RL's evaluation: near the centre of the start cell, towards a goal drawn within the goal cell.

    qpos differs from INITIAL_QPOS by U(-0.1, 0.1) in every entry, qvel is 0.1 N(0, 1). To each coordinate of
    the goal cell's centre U(0, 1) + U(0, 0.5) + goal_shift_m metres are added; no coordinate falls below 0.
    """
    qpos = np.array(INITIAL_QPOS, float)
    qpos[:2] = maze.cell_centre(maze.start_cell)
    offsets = sum(rng.uniform(0.0, upper, 2) for upper in GOAL_OFFSETS_M)
    return Start(
        qpos=qpos + rng.uniform(-RESET_QPOS_RANGE, RESET_QPOS_RANGE, 15),
        qvel=RESET_QVEL_SPREAD * rng.standard_normal(14),
        goal=np.maximum(maze.cell_centre(maze.goal_cell) + offsets + goal_shift_m, 0.0),
    )


def sample_recorded_start(
    maze: Maze, cells: np.ndarray, offset_m: tuple[float, float], rng: np.random.Generator
) -> Start:
    """Recording: in a uniformly drawn one of `cells`, U(*offset_m) from its centre along each axis, else as in
    evaluation.

    cells: [cells, 2] (row, column). The start's goal is where it is: the recorder draws its own.
    """
    start = sample_start(maze, 0.0, rng)
    cell = cells[rng.integers(len(cells))]
    start.qpos[:2] = maze.cell_centre(cell) + rng.uniform(*offset_m, 2)
    return Start(start.qpos, start.qvel, start.qpos[:2])


def make_recording_env(maze: Maze, cells: np.ndarray, offset_m: tuple[float, float], count: int) -> VectorEnv:
    """`count` copies of D4RL's ant in `maze`, for recording (see sample_recorded_start)."""
    return MujocoVectorEnv(ant_model(maze), FRAME_SKIP, partial(sample_recorded_start, maze, cells, offset_m), count)


def diverse(maze: Maze) -> Recipe:
    """D4RL's generator of `diverse` sets, with our walker in the place of its policy: from cells without a goal towards
    one goal in a cell that has one, 1001 rows, with noise on actions and waypoints; an ant that arrives early stays
    about its goal."""
    goal_cells = np.array(RECORDED_GOAL_CELLS[maze.name])
    has_goal = np.zeros_like(maze.walls)
    has_goal[tuple(goal_cells.T)] = True
    start_cells = np.argwhere(~maze.walls & ~has_goal)
    recipe = _recipe(maze, start_cells, RECORDED_START_OFFSET_M, goal_cells, 1001)
    return replace(recipe, centre_to_centre=True)


def everywhere(maze: Maze) -> Recipe:
    """As `diverse`, but from any free cell to any, 1000 rows: a goal may lie where it starts."""
    return _recipe(maze, maze.free_cells, EVERYWHERE_START_OFFSET_M, maze.free_cells, 1000)


def _recipe(
    maze: Maze, start_cells: np.ndarray, start_offset_m: tuple[float, float], goal_cells: np.ndarray, episode_steps: int
) -> Recipe:
    return Recipe(
        maze=maze,
        make_env=partial(make_recording_env, maze, start_cells, start_offset_m),
        controller=walk,
        action_dim=8,
        episode_steps=episode_steps,
        goal_cells=goal_cells,
        goal_offsets_m=tuple((0.0, upper) for upper in GOAL_OFFSETS_M),
        goal_radius_m=GOAL_RADIUS_M,
        further_goals=False,
        waypoint_offset_m=(0.0, 1.0),
        noise_spread=ACTION_NOISE_SPREAD,
    )


def on_its_back(state: np.ndarray) -> bool:
    """Whether the up axis of the torso of an ant in a state [29] points below the horizon."""
    _, x, y, _ = state[3:7] / np.linalg.norm(state[3:7])
    return bool(1 - 2 * (x * x + y * y) < 0)


def make_env(maze: Maze, goal_shift_m: float, count: int) -> VectorEnv:
    """`count` copies of D4RL's ant in `maze`."""
    return MujocoVectorEnv(ant_model(maze), FRAME_SKIP, partial(sample_start, maze, goal_shift_m), count)


def custom_task(file: str) -> Task:
    """D4RL's ant in the maze drawn in a text file (see read_maze), 4 m to a cell.

    It may take 100 steps per cell of the shortest way, as in D4RL's medium maze, and at least 700.
    """
    maze = read_maze(user_path(file), CELL_SIZE_M)
    return _task(
        f"antmaze:{file}",
        maze,
        everywhere,
        horizon_steps=max(700, 100 * maze.route_cells),
        source="a maze of one's own",
    )


def _gymnasium_ant() -> Path:
    """Gymnasium's ant. Found without importing Gymnasium, which would load every environment's registry."""
    package = importlib.util.find_spec("gymnasium")
    if package is None or package.origin is None:
        raise GuiderError("antmaze builds its ant from Gymnasium's: install gymnasium")
    return Path(package.origin).parent / "envs" / "mujoco" / "assets" / "ant.xml"


def _task(
    name: str,
    maze: Maze,
    recipe: Callable[[Maze], Recipe] | None,
    horizon_steps: int,
    source: str = "D4RL antmaze v2",
    goal_shift_m: float = 0.0,
    paper_score: float | None = None,
) -> Task:
    """recipe: how its data is made here; None where start and goal cells were picked by hand."""
    environment = f"D4RL ant (gear {MOTOR_GEAR:g}) in MuJoCo {mujoco.__version__}, 4 m cells, maze {maze.name}"
    return Task(
        name=name,
        summary=f"an ant walks through the maze {maze.name}",
        domain="antmaze",
        goal_indices=(0, 1),
        state_dim=29,
        action_dim=8,
        radius=GOAL_RADIUS_M,
        reach_radius=1.0,
        horizon_steps=horizon_steps,
        period_steps=50,
        environment=environment,
        source=source,
        make_env=partial(make_env, maze, goal_shift_m),
        check_data=partial(check_replay, partial(ant_model, maze), FRAME_SKIP, environment),
        collector=_collector(recipe(maze)) if recipe else None,
        maze=maze,
        places=floor_places,
        fallen=on_its_back,
        paper_score=paper_score,
    )


def _collector(recipe: Recipe) -> Collector:
    """A million rows, or the whole episodes in them."""
    rows = 1_000_000 // recipe.episode_steps * recipe.episode_steps
    return Collector(partial(record, recipe), rows, "our own ant walker, with noise")


_UMAZE, _MEDIUM, _LARGE, _ULTRA = (make_maze(name, CELL_SIZE_M) for name in ("umaze", "medium", "large", "ultra"))

# Tasks of one maze differ in their data alone: where it starts and what it aims at (play: picked by hand).
ANTMAZES = (
    _task("antmaze-umaze-diverse", _UMAZE, diverse, 700, paper_score=88.5),
    _task("antmaze-umaze-everywhere", _UMAZE, everywhere, 700),
    _task("antmaze-medium-diverse", _MEDIUM, diverse, 1000, paper_score=87.3),
    _task("antmaze-medium-everywhere", _MEDIUM, everywhere, 1000),
    _task("antmaze-medium-play", _MEDIUM, None, 1000),
    _task("antmaze-large-diverse", _LARGE, diverse, 1000, paper_score=80.8),
    _task("antmaze-large-everywhere", _LARGE, everywhere, 1000),
    _task("antmaze-large-play", _LARGE, None, 1000),
    _task(
        "antmaze-ultra-diverse",
        _ULTRA,
        everywhere,
        2000,
        source="Jiang et al. 2023's extension of D4RL",
        goal_shift_m=ULTRA_GOAL_SHIFT_M,
    ),
)
