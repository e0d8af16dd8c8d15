"""Episodes in a learned model: the model moves as the robot did, and tells a policy that arrives from one that does
not."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import MODEL_UPDATES, compiled_for_long

from guider.data.episodes import Episodes, make_episodes
from guider.evaluation import imagined
from guider.evaluation.trust import MEANINGS, verdict
from guider.learning.problem import Problem
from guider.methods.policy import Policy

GOAL = (0,)


def turntable(episodes: int = 60, steps: int = 40, seed: int = 0) -> Episodes:
    """A slide and a turning plate: x moves by 0.1 of the first action, the angle by 0.4 of the second and 0.2, and
    wraps."""
    rng = np.random.default_rng(seed)
    states, actions = [], []
    for _ in range(episodes):
        x, angle = rng.uniform(-1, 1), rng.uniform(-np.pi, np.pi)
        push = rng.uniform(-1, 1)
        for _ in range(steps):
            action = np.clip([push + rng.normal(0, 0.2), rng.uniform(-1, 1)], -1, 1)
            states.append([x, angle])
            actions.append(action)
            x += 0.1 * action[0]
            angle = (angle + 0.4 * action[1] + 0.2 + np.pi) % (2 * np.pi) - np.pi
    return make_episodes(np.array(states), np.array(actions), [steps] * episodes, GOAL, action_low=-1, action_high=1)


@pytest.fixture(scope="module")
def model() -> imagined.Model:
    with compiled_for_long(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(imagined, "UPDATES", MODEL_UPDATES)
        return imagined.fit_model(turntable())


def test_the_model_moves_as_the_robot_did(model):
    states = jnp.array([[0.5, 0.0], [-1.0, 3.0], [0.0, -3.0]])
    actions = jnp.array([[1.0, 0.5], [0.0, 1.0], [-1.0, -1.0]])
    each = (jnp.broadcast_to(part, (imagined.MEMBERS, 3, 2)) for part in (states, actions))
    later = np.asarray(imagined.step(model, *each))
    expected = np.array([[0.6, 0.4], [-1.0, 3.6 - 2 * np.pi], [-0.1, -3.2 + 2 * np.pi]])
    np.testing.assert_allclose(later, np.broadcast_to(expected, later.shape), atol=0.12)
    assert np.abs(later - expected).mean(axis=(0, 1)) == pytest.approx(0, abs=0.05)
    error = imagined.model_error(model, turntable(10, seed=1), 10)
    assert error is not None and error < 0.1
    assert imagined.model_error(model, turntable(10, 8, seed=1), 10) is None


DRIVERS = {
    "arrives": lambda observation, goal: jnp.clip(10 * (goal - observation[:, :1]), -1, 1),
    "stays": lambda observation, goal: 0 * goal,
    "runs away": lambda observation, goal: 0 * goal + 1,
}


@pytest.mark.parametrize(
    ("driver", "success", "left"),
    [("arrives", (0.9, 1), (0, 0.1)), ("stays", (0, 0.1), (0, 0)), ("runs away", (0, 0.7), (0.3, 1))],
)
def test_policies_are_told_apart(model, monkeypatch, driver, success, left):
    def act(policy: Any, observation: Any, goal: Any, acting: Any, begins: Any):
        return jnp.concatenate([DRIVERS[driver](observation, goal), 0 * goal], axis=1), acting

    monkeypatch.setattr(imagined, "act", act)
    monkeypatch.setattr(imagined, "initial_state", lambda policy, count: ())
    one = jnp.ones(2)
    policy = Policy(
        state=(), action_low=-one, action_high=one, method="bc", config=Config(driver), goal_indices=GOAL, state_dim=2
    )
    scores = imagined.imagined_scores(policy, model, turntable(), turntable(20, seed=1))
    assert success[0] <= (scores["imagined_success"] or 0.0) <= success[1]
    assert left[0] <= (scores["imagined_left_data"] or 0.0) <= left[1]
    assert (scores["imagined_steps"] is None) == (not scores["imagined_success"])
    assert scores.keys() <= MEANINGS.keys()


def test_a_goal_met_where_nothing_was_logged_is_not_met():
    """Three members' episodes of ten steps: met in time, met after leaving, never met."""
    nowhere = np.zeros((10, 3, 1, 1))
    first_met, first_off = np.array([[4], [6], [10]]), np.array([[10], [5], [10]])
    seen = imagined.Imagined(
        np.zeros((1, 2)), np.zeros((1, 1)), nowhere, nowhere, nowhere[..., 0] > 0, first_met, first_off
    )
    assert seen.success[:, 0].tolist() == [True, False, False]
    assert len(seen.traces(1)[0].achieved) == 5


class Config:
    """Settings that a stand-in policy has; jit tells policies apart by them."""

    problem = Problem(0.1, 0.2, 10)

    def __init__(self, name: str):
        self.name = name


GOOD = {
    "imagined_success": 0.95,
    "imagined_left_data": 0.02,
    "model_error": 0.1,
    "prior_coverage": 0.95,
    "subgoals_in_range": 1.0,
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "would trust it with a first slow try"),
        ({"imagined_success": 0.5}, "would not trust it: it meets only 50% of the goals"),
        ({"imagined_left_data": 0.2}, "would not trust it: it strays from the data in 20%"),
        ({"prior_coverage": 0.7}, "has not seen moves like 30%"),
        ({"subgoals_in_range": 0.6, "imagined_success": 0.1}, "only 10% of the goals in imagination; it proposes 40%"),
        ({"model_error": 0.6}, "cannot tell"),
        ({"model_error": None}, "cannot tell"),
    ],
)
def test_verdicts_in_words(change, words):
    assert words in verdict(GOOD | change)
