"""A task of your own is a file like this one: a cart with two wheels that is to drive to a place on a floor.

    export GUIDER_TASKS=docs/own_task.py
    guider collect cart --out cart.hdf5
    guider train cart --data cart.hdf5 --method gcsl
    guider evaluate runs/cart-gcsl-fast

All that is done with a task is done with it: data, training, scores, tables. A package offers its tasks as entry points
of the group `guider.tasks` instead, each a module with TASKS. A Gymnasium goal environment needs no file: gym:ENV_ID.
"""

from __future__ import annotations

import numpy as np

from guider.data.store import Recording
from guider.tasks.types import Collector, Report, Task

FLOOR_M = 2.0
SPEED_M, TURN_RAD = 0.1, 0.5
"""The most that it drives and turns in a step."""
RECORDED_STEPS = 50


def drive(pose: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Poses [n, 3] (x, y, heading) one step on. actions: [n, 2] of speed and turn in [-1, 1]."""
    speed, turn = SPEED_M * actions[:, 0], TURN_RAD * actions[:, 1]
    heading = pose[:, 2] + turn
    x, y = pose[:, 0] + speed * np.cos(heading), pose[:, 1] + speed * np.sin(heading)
    return np.stack([np.clip(x, -FLOOR_M, FLOOR_M), np.clip(y, -FLOOR_M, FLOOR_M), heading], axis=1)


def observe(pose: np.ndarray) -> np.ndarray:
    """States [n, 4]: x, y, cosine and sine of the heading, as a network should see an angle."""
    x, y, heading = pose.T
    return np.stack([x, y, np.cos(heading), np.sin(heading)], axis=1).astype(np.float32)


def somewhere(rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses [count, 3]."""
    return rng.uniform([-FLOOR_M, -FLOOR_M, -np.pi], [FLOOR_M, FLOOR_M, np.pi], (count, 3))


# What evaluation steps: many copies at once. Yours may well wrap a simulator's own vectorised environment.
class Carts:
    def __init__(self, count: int) -> None:
        self.count = count
        self._pose = np.zeros((count, 3))

    def reset(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observations [count, 4] and goals [count, 2]; each copy follows from its seed alone."""
        drawn = [np.random.default_rng(seed) for seed in seeds]
        self._pose = np.concatenate([somewhere(rng, 1) for rng in drawn])
        return observe(self._pose), np.concatenate([somewhere(rng, 1) for rng in drawn])[:, :2].astype(np.float32)

    def step(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Observations [count, 4] after a step of the copies where `active`."""
        self._pose = np.where(active[:, None], drive(self._pose, actions), self._pose)
        return observe(self._pose)

    def close(self) -> None:
        """Nothing to close."""


# How data is made, if it can be made; else leave `collector` out and train on files.
def record(steps: int, seed: int, report: Report) -> Recording:
    """Carts that turn and drive, unsteadily, towards a place drawn anew every 25 steps."""
    rng = np.random.default_rng(seed)
    lengths = np.array([len(rows) for rows in np.array_split(np.arange(steps), -(-steps // RECORDED_STEPS))])
    pose, place = somewhere(rng, len(lengths)), somewhere(rng, len(lengths))
    states, taken = [], []
    for step in range(lengths.max()):
        if step % 25 == 0:
            place = somewhere(rng, len(lengths))
        x, y = (place - pose)[:, :2].T
        off_course = np.angle(np.exp(1j * (np.arctan2(y, x) - pose[:, 2])))
        course = np.stack([np.cos(off_course), off_course / TURN_RAD], axis=1)
        actions = np.clip(course + rng.normal(0, 0.3, course.shape), -1, 1)
        states.append(observe(pose))
        taken.append(actions.astype(np.float32))
        pose = drive(pose, actions)
        report(min((step + 1) * len(lengths), steps), steps)
    observations, actions = (
        np.concatenate([rows[:length, episode] for episode, length in enumerate(lengths)])
        for rows in (np.stack(states), np.stack(taken))
    )
    return Recording(observations, actions, lengths, action_low=-np.ones(2), action_high=np.ones(2))


CART = Task(
    name="cart",
    summary="a cart with two wheels drives to a place",
    domain="cart",  # presets have settings by domain; a new one takes those for all
    goal_indices=(0, 1),
    state_dim=4,
    action_dim=2,
    radius=0.15,
    reach_radius=0.3,
    horizon_steps=100,
    period_steps=10,
    environment="a cart in NumPy",
    source="docs/own_task.py",
    make_env=Carts,
    collector=Collector(record, 20_000, "an unsteady driver between random places"),
)

TASKS = {CART.name: CART}
