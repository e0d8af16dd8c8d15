# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""Was data recorded on the robot a task is evaluated on? Recorded steps are taken again and compared."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from guider.data.episodes import Episodes
from guider.errors import GuiderError
from guider.support.physics import mujoco
from guider.tasks.simulation import MujocoVectorEnv, Start

STEPS_REPLAYED = 100
# Measured on re-created D4RL data: 1e-7 on its own ant, 0.03 with other contact parameters, such as another release of
# the simulator may bring; 0.2 to 0.6 in another maze with walls where the data goes, 0.3 to 0.4 with half the time step
# or half the torque, 1.0 to 2.6 on Gymnasium's ant.
TOLERANCE = 0.1
ROUNDING = 1e-3


def check_replay(model: Callable[[], mujoco.MjModel], frame_skip: int, environment: str, episodes: Episodes) -> None:
    """Raise GuiderError where `episodes` were recorded on another robot, or in another maze, than `model`.

    From recorded states (qpos followed by qvel), spread over all episodes, the recorded actions are taken. How far a
    step goes, and how far off it lands, is that of the state entry where it is most, in the simulator's units. The
    median landing must be off by no more than TOLERANCE times the median way, or ROUNDING where the robot rests.
    environment: what the model is, for the message.
    """
    transitions = np.flatnonzero(np.arange(len(episodes.observations)) != episodes.last_rows)
    rows = transitions[np.linspace(0, len(transitions) - 1, STEPS_REPLAYED).astype(int)]
    before, after = episodes.observations[rows].astype(float), episodes.observations[rows + 1]
    landed = take_steps(model(), frame_skip, before, episodes.actions[rows])
    way, deviation = (float(np.median(np.abs(where - after).max(axis=1))) for where in (before, landed))
    if not deviation <= max(TOLERANCE * way, ROUNDING):
        raise GuiderError(
            f"{episodes.source} was recorded on another robot or in another maze than {environment}: replayed there, "
            f"a step that goes {way:.2g} lands {deviation:.2g} off (medians); choose the task of its own robot"
        )


def take_steps(model: mujoco.MjModel, frame_skip: int, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """[n, nq + nv] states, [n, nu] actions -> [n, nq + nv] states one environment step later."""
    env = MujocoVectorEnv(model, frame_skip, _never_reset, len(states))
    try:
        starts = [Start(qpos=state[: model.nq], qvel=state[model.nq :], goal=state[:0]) for state in states]
        env.place(np.arange(len(states)), starts)
        return env.step(actions, np.ones(len(states), bool))
    finally:
        env.close()


def _never_reset(rng: np.random.Generator) -> Start:
    raise AssertionError("copies are placed, not reset")
