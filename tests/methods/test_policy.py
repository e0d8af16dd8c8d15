"""Acting around any method, on one that shows what it is given."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from guider.errors import GuiderError, GuiderWarning
from guider.methods import METHODS
from guider.methods.policy import Agent, Policy, act, initial_state


@dataclass(frozen=True)
class Config:
    action_scale: float = 1.0


def echo(config, state, goal_indices, observation, goal, acting, reset_mask):
    """(first state entry, goal, steps since a reset counted from 101)."""
    acting = jnp.where(reset_mask, 100.0, acting) + 1
    return jnp.stack([observation[:, 0], goal[:, 0], acting], axis=-1), acting


@pytest.fixture
def policy(monkeypatch) -> Policy:
    """Two state entries, the second of which is the goal; three actions, which are what `echo` answers."""
    method = SimpleNamespace(
        act=echo, initial_acting_state=lambda config, goal_dim, count: jnp.zeros(count), subgoals=None
    )
    monkeypatch.setitem(METHODS, "echo", method)
    return Policy((), -jnp.ones(3), jnp.ones(3), "echo", Config(), (1,), 2)


def answer(policy: Policy, observation, goal) -> list[float]:
    begins = initial_state(policy, 1), jnp.ones(1, bool)
    return act(policy, jnp.array([observation]), jnp.array([goal]), *begins)[0][0].tolist()


def test_actions_by_hand(policy):
    """0.5 of the half range above the middle is 0.5, 5 and 3; half way there from rest (0, 2 and 0)."""
    bounds = {"action_low": jnp.array([-1.0, 2.0, 0.0]), "action_high": jnp.array([1.0, 6.0, 4.0])}
    policy = replace(policy, **bounds)
    assert answer(policy, [0.5, 0.0], [0.5]) == [0.5, 5.0, 2 + 2 * 101]
    gentle = replace(policy, config=Config(action_scale=0.5))
    assert answer(gentle, [0.5, 0.0], [0.5]) == [0.25, 3.5, 1 + 101]


def test_what_is_shown_is_clipped_to_the_limits(policy):
    limited = replace(policy, state_low=jnp.array([-1.0, -2.0]), state_high=jnp.array([1.0, 3.0]))
    assert answer(limited, [-9.0, 0.0], [9.0])[:2] == [-1.0, 3.0]
    assert answer(limited, [9.0, 0.0], [-9.0])[:2] == [1.0, -2.0]
    assert answer(limited, [0.5, 0.0], [2.5])[:2] == [0.5, 2.5]
    assert answer(policy, [-9.0, 0.0], [9.0])[:2] == [-9.0, 9.0]


def test_an_agent_remembers_until_it_is_reset(policy):
    agent = Agent(policy)
    counts = [agent.act([0.0, 0.0], [0.0])[2] for _ in range(3)]
    agent.reset()
    assert [*counts, agent.act([0.0, 0.0], [0.0])[2]] == [101, 102, 103, 101]


@pytest.mark.parametrize(
    ("observation", "goal", "message"),
    [
        ([5.0, 0.0], [0.0], r"state entry 0 is 5, .* \(taken for the limit of -1 to 1\)"),
        ([0.0, -3.0], [0.0], r"state entry 1 is -3, .* \(taken for the limit of -2 to 3\)"),
        ([0.0, 0.0], [4.0], r"goal entry 0 is 4, .* \(taken for the limit of -2 to 3\)"),
    ],
)
def test_what_is_far_off_is_told_once(policy, observation, goal, message):
    agent = Agent(replace(policy, state_low=jnp.array([-1.0, -2.0]), state_high=jnp.array([1.0, 3.0])))
    agent.act([1.0, -2.0], [3.0])
    with pytest.warns(GuiderWarning, match=message):
        agent.act(observation, goal)
    agent.act(observation, goal)  # a second warning would be an error


@pytest.mark.parametrize(
    ("observation", "goal", "message"),
    [
        ([0.0], [0.0], r"observation has shape \(1,\); .* trained on observations of shape \(2,\)"),
        ([0.0, 0.0], [[0.0]], r"goal has shape \(1, 1\)"),
        ([0.0, np.nan], [0.0], "observation holds NaN or inf"),
        ([0.0, 0.0], [np.inf], "goal holds NaN or inf"),
    ],
)
def test_what_does_not_fit_is_refused(policy, observation, goal, message):
    with pytest.raises(GuiderError, match=message):
        Agent(policy).act(observation, goal)
