# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""D4RL's kitchen: four things to do within 280 steps, on Gymnasium-Robotics' FrankaKitchen-v1 with the sensor noise of
D4RL's; `kitchen-*-gymnasium` are the same with Gymnasium's, as Minari's data has it.

A state is 30 positions, the robot's 9 joints and the objects' 21, which is all that D4RL's files and this simulation
have in common (guider.data.readers.kitchen.kitchen_states); the goal space is the objects' 21. An episode scores 25 for
each of the task's four subtasks whose joints come within 0.3 of their goal at some step, alone and in any order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from guider.collect.kitchen import PLAY_DECK, WHOLE, Recipe, record
from guider.data.readers.kitchen import kitchen_states
from guider.support.physics import mujoco
from guider.tasks.gym_env import GymVectorEnv
from guider.tasks.gymnasium_tasks import make_gymnasium
from guider.tasks.simulation import on_all_cores
from guider.tasks.types import Collector, Task, VectorEnv

STATE_DIM = 30
GOAL_INDICES = tuple(range(9, STATE_DIM))
RADIUS = 0.3
HORIZON_STEPS = 280
NOISE_RATIOS = {"D4RL": (0.1, 0.1), "Gymnasium": (0.01, 0.0005)}
"""By whose kitchen: of the noise on what sensors say of robot and objects, as shares of the amplitudes (rad, m) in the
robot's description, which both have. D4RL's is 0.01 on the arm's joints, and at most that on objects'. (Gymnasium takes
the objects' amplitudes one entry too early, so that single objects shake less or more than in D4RL's.)"""


@dataclass(frozen=True)
class Subtask:
    """entries: of the goal vector; values: their goal, rad or m (the kettle: position in m, and quaternion)."""

    entries: tuple[int, ...]
    values: tuple[float, ...]


# Source: D4RL's and Gymnasium-Robotics' kitchens, which agree.
SUBTASKS = {
    "microwave": Subtask((13,), (-0.75,)),
    "kettle": Subtask((14, 15, 16, 17, 18, 19, 20), (-0.23, 0.75, 1.62, 0.99, 0.0, 0.0, -0.06)),
    "bottom burner": Subtask((2, 3), (-0.88, -0.01)),
    "light switch": Subtask((8, 9), (-0.69, -0.05)),
    "slide cabinet": Subtask((10,), (0.37,)),
}
MIXED = ("microwave", "kettle", "bottom burner", "light switch")


def goal_vector(subtasks: tuple[str, ...]) -> tuple[float, ...]:
    """The 21 numbers of a goal. Objects of other subtasks stay at 0, as in D4RL's files: doors, knobs and switches
    start within 0.007 of it. The kettle, which does not, is part of every task."""
    goal = np.zeros(len(GOAL_INDICES))
    for subtask in subtasks:
        goal[list(SUBTASKS[subtask].entries)] = SUBTASKS[subtask].values
    return tuple(goal.tolist())


def make_simulator(noise: str) -> Any:
    """Gymnasium-Robotics' KitchenEnv with all its subtasks; it goes on when they are done. noise: of NOISE_RATIOS."""
    robot, objects = NOISE_RATIOS[noise]
    return make_gymnasium(
        "FrankaKitchen-v1", terminate_on_tasks_completed=False, robot_noise_ratio=robot, object_noise_ratio=objects
    ).unwrapped


def make_env(goal: tuple[float, ...], noise: str, count: int) -> VectorEnv:
    """`count` copies of the kitchen, with the same goal in every episode."""
    return GymVectorEnv(partial(make_simulator, noise), count, partial(_read, goal))


def _read(goal: tuple[float, ...], observation: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return kitchen_states(observation["observation"]), np.array(goal)


def _task(data: str, noise: str, subtasks: tuple[str, ...], recorded_steps: int, paper_score: float) -> Task:
    """recorded_steps: rows of D4RL's file."""
    goal = goal_vector(subtasks)
    goal_parts = tuple(SUBTASKS[subtask].entries for subtask in subtasks)
    recipe = Recipe(
        make_env=partial(make_simulator, noise),
        deck=(WHOLE,) if data == "complete" else PLAY_DECK,
        goal=goal,
        goal_indices=GOAL_INDICES,
        goal_parts=goal_parts,
        radius=RADIUS,
        solved_only=data == "complete",
    )
    robotics, physics = version("gymnasium-robotics"), mujoco.__version__
    return Task(
        name=f"kitchen-{data}" if noise == "D4RL" else f"kitchen-{data}-gymnasium",
        summary=f"a robot arm sees to {', '.join(subtasks[:3])} and {subtasks[3]}",
        domain="kitchen",
        goal_indices=GOAL_INDICES,
        goal_parts=goal_parts,
        state_dim=STATE_DIM,
        action_dim=9,
        radius=RADIUS,
        reach_radius=RADIUS,
        horizon_steps=HORIZON_STEPS,
        period_steps=40,
        score="subtasks",
        environment=f"FrankaKitchen-v1 of Gymnasium-Robotics {robotics} in MuJoCo {physics}, {noise}'s sensor noise",
        source="D4RL kitchen",
        make_env=partial(make_env, goal, noise),
        copies=10,  # 80 MB and 0.2 s to build, each
        collector=Collector(partial(on_all_cores, recipe, record=record), recorded_steps, "scripted demonstrations"),
        paper_score=paper_score if noise == "D4RL" else None,
    )


KITCHEN_TASKS = tuple(
    _task(data, noise, subtasks, recorded_steps, paper_score)
    for noise in NOISE_RATIOS
    for data, subtasks, recorded_steps, paper_score in (
        ("complete", WHOLE, 3_680, 68.8),
        ("partial", WHOLE, 136_950, 70.4),
        ("mixed", MIXED, 136_950, 67.1),
    )
)
