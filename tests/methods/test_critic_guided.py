"""What the methods that a critic guides show their networks, and who learns from which goal."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import equal, make_ragged
from reference import check_trails

from guider.critics import ImplicitVConfig
from guider.learning.problem import Problem
from guider.learning.samplers import CriticBatch, sample_critic
from guider.methods import critic_guided, preset_config
from guider.methods.critic_guided import CriticGuidedConfig
from guider.methods.view import Scale, prepare


def test_a_state_that_meets_the_goal_ends_the_episode_whatever_comes_next():
    """Scaled: (x - 1) / 2; waves of a quarter turn per spread."""
    scale = Scale(jnp.ones(3), jnp.full(3, 2.0), jnp.ones(1), jnp.full(1, 2.0), jnp.ones(1), jnp.full(1, jnp.pi / 2))
    batch = CriticBatch(
        observation=jnp.array([[1.0, 5, 3], [9, 5, 3]]),
        action=jnp.zeros((2, 1)),
        next_observation=jnp.array([[3.0, 5, 3], [1, 5, 3]]),
        achieved=jnp.array([[1.0], [9.0]]),
        next_achieved=jnp.array([[3.0], [1.0]]),
        goal=jnp.array([[1.4], [1.4]]),
        actor_goal=jnp.zeros((2, 1)),
    )
    config = CriticGuidedConfig(problem=Problem(radius=0.5))
    steps = critic_guided.label(config, scale, batch, batch.goal)
    assert steps.unmet.tolist() == [0.0, 1.0]
    np.testing.assert_allclose(steps.state[0], [0, 2, 1, 0, 1], atol=1e-6)
    np.testing.assert_allclose(steps.next_state[0], [1, 2, 1, 1, 0], atol=1e-6)
    np.testing.assert_allclose(steps.place[1], [4, 0, 1], atol=1e-5)
    np.testing.assert_allclose(steps.goal[0], [0.2, np.sin(0.1 * np.pi), np.cos(0.1 * np.pi)], atol=1e-6)


def test_critic_and_policy_learn_from_goals_of_their_own(monkeypatch):
    config = CriticGuidedConfig(hidden=(8,), batch_size=16, target_rate=0.3, critic=ImplicitVConfig())
    episodes = make_ragged()
    data, scale = prepare(config.view, config.problem, episodes)
    state = critic_guided.init(config, episodes.spaces, scale, jax.random.key(0))
    (stage,) = critic_guided.stages(config)

    def after(**other: float) -> Any:
        def sample(*arguments):
            batch = sample_critic(*arguments)
            return batch._replace(**{name: getattr(batch, name) + by for name, by in other.items()})

        monkeypatch.setattr(critic_guided, "sample_critic", sample)
        return stage.update(state, data, jax.random.key(1))[0]

    usual, of_critic, of_policy = after(), after(goal=3.0), after(actor_goal=3.0)
    assert equal(usual.params.actor, of_critic.params.actor) and not equal(usual.params.critic, of_critic.params.critic)
    assert equal(usual.params.critic, of_policy.params.critic) and not equal(usual.params.actor, of_policy.params.actor)
    check_trails(state.policy.target, usual.params.critic, usual.target, 0.3)


@pytest.mark.parametrize(
    ("method", "weights"),
    [("gciql", (0.003, 1.0, 0.1, 0.3)), ("crl", (0.03, 3.0, 0.1, 0.1)), ("qrl", (0.0003, 0.3, 0.001, 0.003))],
)
def test_cloning_and_discount_are_ogbenchs_for_the_domains_navigate_and_play_sets(method, weights):
    domains = "ogbench-pointmaze", "ogbench-scene", "humanoidmaze", "antmaze"
    found = [preset_config(method, "paper", Problem(domain=domain)) for domain in domains]
    assert tuple(config.cloning for config in found) == weights
    assert [config.discount for config in found] == [0.99, 0.99, 0.995, 0.99]
