# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""The four Fetch tasks, on Gymnasium-Robotics' robot arm, each with two data sets: expert and mixed.

A goal is a position, of the gripper in Reach and of the object elsewhere. An episode takes 50 steps and scores 1 for
each after which the goal is met, so that what counts is to arrive soon and to stay.
"""

from __future__ import annotations

from functools import partial
from importlib.metadata import version

import numpy as np

from guider.collect.fetch import EPISODE_STEPS, Recipe, record
from guider.collect.fetch_experts import Expert, pick, push, reach, slide
from guider.support.physics import mujoco
from guider.tasks.gym_env import GymVectorEnv
from guider.tasks.gymnasium_tasks import make_gymnasium
from guider.tasks.simulation import on_all_cores
from guider.tasks.types import Collector, Task, VectorEnv

RADIUS_M = 0.05
EXPERT_SHARES = {"expert": 1.0, "mixed": 0.1}
GRIPPER, OBJECT = (0, 1, 2), (3, 4, 5)


def make_env(env_id: str, count: int) -> VectorEnv:
    """`count` copies of a Fetch environment."""
    return GymVectorEnv(partial(make_gymnasium, env_id), count)


def _task(
    name: str,
    data: str,
    env_id: str,
    expert: Expert,
    summary: str,
    goal_indices: tuple[int, ...],
    state_dim: int,
    episodes: int,
    paper_score: float,
) -> Task:
    """episodes: how many WGCSL's data set has."""
    recipe = Recipe(partial(make_gymnasium, env_id), expert, EXPERT_SHARES[data])
    actors = {"expert": "scripted expert with noise", "mixed": "90 % random actions, 10 % scripted expert with noise"}
    return Task(
        name=f"fetch-{name}-{data}",
        summary=summary,
        domain="fetch",
        goal_indices=goal_indices,
        state_dim=state_dim,
        action_dim=4,
        radius=RADIUS_M,
        reach_radius=RADIUS_M,
        horizon_steps=EPISODE_STEPS,
        period_steps=10,
        score="return",
        environment=f"{env_id} of Gymnasium-Robotics {version('gymnasium-robotics')} in MuJoCo {mujoco.__version__}",
        source="WGCSL (Yang et al. 2022)",
        make_env=partial(make_env, env_id),
        copies=20,  # 0.1 s to build, each
        collector=Collector(partial(on_all_cores, recipe, record=record), episodes * (EPISODE_STEPS + 1), actors[data]),
        places=np.atleast_2d,
        paper_score=paper_score,
    )


def _tasks(
    name: str,
    env_id: str,
    expert: Expert,
    summary: str,
    paper_scores: tuple[float, float],
    goal_indices: tuple[int, ...] = OBJECT,
    state_dim: int = 25,
    episodes: int = 40_000,
) -> tuple[Task, ...]:
    """The same task with either data set."""
    return tuple(
        _task(name, data, env_id, expert, summary, goal_indices, state_dim, episodes, score)
        for data, score in zip(EXPERT_SHARES, paper_scores, strict=True)
    )


FETCH_TASKS = (
    *_tasks(
        "reach", "FetchReach-v4", reach, "a robot arm moves its gripper to a point", (48.0, 47.0), GRIPPER, 10, 2_000
    ),
    *_tasks("push", "FetchPush-v4", push, "a robot arm pushes a cube to a point on the table", (39.9, 33.4)),
    *_tasks("slide", "FetchSlide-v4", slide, "a robot arm strikes a puck that slides out of its reach", (7.6, 4.1)),
    *_tasks("pick", "FetchPickAndPlace-v4", pick, "a robot arm lifts a cube to a point in the air", (40.9, 33.2)),
)
