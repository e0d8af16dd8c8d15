"""Fitted Q evaluation: values that are known beforehand, and steps drawn as they are said to be."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import labelled

from guider.evaluation import fitted
from guider.learning.problem import Problem
from guider.methods.policy import Policy


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("name", ["towards", "right"])
def test_values_on_a_line_by_hand(name):
    """21 places, a step moves by one to the right or left as its action says. What a policy that meets the goal after n
    steps more is worth is 0.9^(n - 1), and what one that never does is worth nothing."""
    rng = np.random.default_rng(0)
    place, goal = rng.integers(-10, 11, (2, 20_000)).astype(np.float32)
    action = rng.choice(np.array([-1, 1], np.float32), 20_000)
    after = np.clip(place + action, -10, 10)
    does = {"towards": np.sign(goal - after), "right": np.ones_like(after)}[name]
    now, then = (jnp.stack([at, doing, goal, goal - at], axis=1) for at, doing in ((place, action), (after, does)))
    values = fitted.fit(fitted.Steps(now, then, jnp.asarray(np.abs(after - goal) < 0.5)), 0.9, 4000)
    steps = np.arange(1, 9)
    to_the_right = jnp.stack([jnp.zeros(8), jnp.ones(8), steps, steps], axis=1)
    found = np.asarray(fitted.value(values, to_the_right))
    assert found.shape == (fitted.MEMBERS, 8)
    np.testing.assert_allclose(found.mean(axis=0), 0.9 ** (steps - 1), atol=0.12)
    to_the_left = jnp.stack([jnp.zeros(8), jnp.ones(8), -steps, -steps], axis=1)
    expected = 0.9 ** (steps + 1) if name == "towards" else np.zeros(8)
    np.testing.assert_allclose(np.asarray(fitted.value(values, to_the_left)).mean(axis=0), expected, atol=0.12)


@pytest.fixture
def policy(monkeypatch) -> Any:
    """Whose action is ten times the step in its episode, plus the goal's."""

    def act(policy: Policy, observation: Any, goal: Any, acting: Any, begins: Any):
        assert bool(jnp.all(begins))
        return 10 * observation[:, 1:] + goal[:, 1:], acting

    monkeypatch.setattr(fitted, "compiled_act", act)
    monkeypatch.setattr(fitted, "initial_state", lambda policy, count: ())
    return SimpleNamespace(config=SimpleNamespace(problem=Problem(0.5, 1.0, 5)), goal_indices=(0, 1))


def test_steps_goals_and_what_the_policy_does_by_their_distribution(policy):
    """States are (episode, step): of episodes of 3 and 30 states, rows, goals and what is met tell where they are
    from."""
    now, then, met = map(np.asarray, fitted.logged_steps(policy, labelled([3, 30])))
    episode, step, goal_episode, goal_step = now[:, 0], now[:, 1], now[:, 3], now[:, 4]
    assert np.bincount(episode.astype(int)) / len(now) == pytest.approx([2 / 31, 29 / 31], abs=0.01)
    assert set(step[episode == 0]) == {0, 1} and set(step[episode == 1]) == set(range(29)), "never from a last row"
    np.testing.assert_array_equal(then[:, :2], np.stack([episode, step + 1], axis=1))
    np.testing.assert_array_equal(then[:, 2], 10 * (step + 1) + goal_step)
    np.testing.assert_array_equal(then[:, 3:5], now[:, 3:5])
    for rows in (now, then):
        np.testing.assert_array_equal(rows[:, 5:], rows[:, 3:5] - rows[:, :2])
    np.testing.assert_array_equal(met, (goal_episode == episode) & (goal_step == step + 1))
    elsewhere = goal_episode != episode
    assert elsewhere.mean() == pytest.approx(0.25, abs=0.01), "half of the goals are ends, of either episode"
    np.testing.assert_array_equal(goal_step[elsewhere], np.where(episode[elsewhere] == 0, 29, 2))
    began = (episode == 1) & (step == 0) & ~elsewhere
    assert (goal_step[began] == 29).mean() == pytest.approx((1 / 29 * 2 + 1) / 3, abs=0.05)
    assert goal_step[began].min() == 1 and np.all(goal_step[~elsewhere] > step[~elsewhere])


def test_nothing_is_worth_much_before_anything_is_learned(policy):
    assert 0 < fitted.fitted_value(policy, *labelled([30] * 20).split(0.2)) < 0.2
