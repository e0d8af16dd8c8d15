"""The hierarchy at work: when a subgoal is new, which one it is, and what becomes of its actions."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import make_ragged, plain_scale, tiny

from guider import runs
from guider.data import AS_FOUND
from guider.learning.networks import twin_values
from guider.learning.problem import Problem
from guider.methods import guider as method
from guider.methods import latent_subgoals, subgoal_policy
from guider.methods.guider import guider_config
from guider.methods.policy import Policy, act, initial_state
from guider.methods.view import prepare
from guider.support.config import override


@pytest.mark.parametrize("asked", [True, False])
def test_a_final_goal_within_reach_is_pursued(monkeypatch, asked):
    monkeypatch.setattr(
        latent_subgoals, "within_reach", lambda c, p, s, here, place, r, parts: jnp.array([True, False])
    )
    paper = guider_config("paper", Problem(0.1, 0.2, 5))
    config = replace(paper, final_goal_substitution=True, final_goal_within_reach=asked)
    state = method.init(config, make_ragged().spaces, plain_scale(), jax.random.key(1))
    goal = jnp.full((2, 2), 9.0)
    subgoal, _ = method.propose_subgoal(config, state, jnp.zeros((2, 2)), goal)
    assert (subgoal == goal).all(axis=1).tolist() == [asked, False]


def constant_policy(**acting) -> Policy:
    """Untrained policy whose networks are zero: it proposes its own position and never moves."""
    config = tiny(replace(guider_config("paper", Problem(0.5, 1.0, 3)), **acting))
    config = replace(config, latent=replace(config.latent, relative=True))
    state = method.init(config, make_ragged().spaces, plain_scale(), jax.random.key(0))
    state = state._replace(
        latent=jax.tree.map(jnp.zeros_like, state.latent),
        high=jax.tree.map(jnp.zeros_like, state.high),
        low=jax.tree.map(jnp.zeros_like, state.low),
    )
    return Policy(state, jnp.array([0.0, -2.0]), jnp.array([4.0, 2.0]), "guider", config, (0, 1), 4)


def renewals(policy: Policy, positions, resets=(0,)) -> list[bool]:
    """Whether the subgoal is new at each step; a subgoal is the position it was proposed at. resets: steps at which an
    episode begins."""
    acting, seen = initial_state(policy, 1), []
    for step, x in enumerate(positions):
        observation = jnp.array([[x, 0.0, 0.0, 0.0]])
        actions, acting = act(policy, observation, jnp.array([[100.0, 0.0]]), acting, jnp.array([step in resets]))
        assert actions.tolist() == [[2.0, 0.0]], "zero network output is the middle of the action bounds"
        seen.append(float(acting.subgoal[0, 0]) == x)
    return seen


def test_a_new_subgoal_every_period():
    assert renewals(constant_policy(), [0, 5, 6, 7, 8, 9, 10]) == [
        True,
        False,
        False,
        True,
        False,
        False,
        True,
    ]


def test_a_new_subgoal_when_an_episode_begins():
    assert renewals(constant_policy(), [0, 5, 6, 7, 8, 9], resets=(0, 2)) == [True, False, True, False, False, True]


def test_a_new_subgoal_as_soon_as_reached():
    policy = constant_policy(replan="reached")
    assert renewals(policy, [0, 5, 0.5, 7, 8, 7.5]) == [True, False, True, False, False, True]


def test_a_new_subgoal_at_every_step():
    assert all(renewals(constant_policy(replan="step"), [0, 5, 6, 7, 8]))


def test_final_goal_is_substituted_only_within_reach():
    policy = constant_policy(final_goal_substitution=True)
    goal = jnp.array([[0.9, 0.0], [1.1, 0.0]])
    subgoal, _ = method.propose_subgoal(policy.config, policy.state, jnp.zeros((2, 2)), goal)
    np.testing.assert_allclose(subgoal, [[0.9, 0.0], [0.0, 0.0]])


@pytest.mark.parametrize("prior", [True, False])
def test_candidates_are_the_priors_or_without_it_the_policys_and_the_critic_chooses(prior):
    """Two candidates of a distribution of no spread lie at its mean: where the prior is off, nothing of it is left."""
    episodes = make_ragged()
    config = override(tiny(guider_config("fast", Problem(0.5, 1.0, 5))), {"high.prior": prior, "replan": "reached"})
    _, scale = prepare(config.view, config.problem, episodes)
    state = method.init(config, episodes.spaces, scale, jax.random.key(0))
    achieved, goal = jnp.asarray(episodes.achieved[:4]), jnp.full((4, 2), 100.0)
    inputs = subgoal_policy.inputs(scale, achieved, goal)
    policy = subgoal_policy.propose(state.high.params, inputs)
    source = latent_subgoals.prior(state.latent.params, scale, achieved) if prior else policy
    _, mean = method.propose_subgoal(config, state, achieved, goal)
    np.testing.assert_array_equal(mean, policy.mean)
    often = ", a new one every 5 steps or once it is reached"
    assert method.acts_by(config) == f"mean of the subgoal policy{often}"
    assert method.acts_by(replace(config, replan="step")) == "mean of the subgoal policy, a new one at every step"
    assert method.acts_by(replace(config, replan="period")) == "mean of the subgoal policy, a new one every 5 steps"

    many = replace(config, candidates=32)
    assert method.acts_by(many) == f"best of 32 samples of the {'prior' if prior else 'subgoal policy'}{often}"
    _, chosen = method.propose_subgoal(many, state, achieved, goal)
    _, once_more = method.propose_subgoal(many, state, achieved, goal)
    np.testing.assert_array_equal(chosen, once_more)
    elsewhere = source.sample(jax.random.key(5), (500,)).swapaxes(0, 1)
    values = twin_values(state.high.params.critic, inputs, elsewhere).min(axis=0)
    best = twin_values(state.high.params.critic, inputs, chosen).min(axis=0)
    assert bool(jnp.all(best > jnp.quantile(values, 0.8, axis=1))), "better than most of what it offers"
    drawn = source.sample(jax.random.key(0), (32,)).swapaxes(0, 1)
    assert bool(jnp.all((drawn == chosen[:, None]).all(axis=-1).any(axis=1))), "one of its samples"


def untrained(config, episodes) -> Policy:
    _, scale = prepare(config.view, config.problem, episodes)
    state = method.init(config, episodes.spaces, scale, jax.random.key(0))
    return Policy(state, -jnp.ones(2), jnp.ones(2), "guider", config, (0, 1), 4)


def test_actions_are_scaled_towards_the_resting_action(fast_config, ragged):
    """0, or the bound nearest to it: a throttle that rests at an end of its range stays there."""
    low, high, rest = jnp.array([-1.0, 2.0]), jnp.array([1.0, 6.0]), jnp.array([0.0, 2.0])
    policy = replace(untrained(fast_config, ragged), action_low=low, action_high=high)
    gentle = replace(policy, config=replace(fast_config, action_scale=0.25))
    inputs = jnp.ones((1, 4)), jnp.ones((1, 2)), initial_state(policy, 1), jnp.ones(1, bool)
    (full, _), (quarter, _) = act(policy, *inputs), act(gentle, *inputs)
    np.testing.assert_allclose(quarter[0] - rest, 0.25 * (full[0] - rest), rtol=1e-5, atol=1e-6)
    assert jnp.abs(full[0] - rest).min() > 1e-3


def test_what_the_data_never_varied_is_not_shown(fast_config, ragged):
    """Beyond the data's range and half of it more, an entry or a goal changes nothing: a constant one never does."""
    spaces = replace(ragged.spaces, state_low=(-20.0, -20, 0, 3), state_high=(20.0, 20, 8, 3))
    (policy,) = runs.policies(
        runs.RunSpec(None, "", AS_FOUND, "", 0.0, "guider", "fast", (0,), fast_config, spaces),
        jax.tree.map(lambda leaf: leaf[None], untrained(fast_config, ragged).state),
    )

    def answer(observation, goal=(1.0, 1.0)):
        begins = initial_state(policy, 1), jnp.ones(1, bool)
        return np.asarray(act(policy, jnp.array([observation]), jnp.array([goal]), *begins)[0])

    np.testing.assert_array_equal(answer([0.0, 0, 4, 3]), answer([0.0, 0, 4, 3.05]))
    np.testing.assert_array_equal(answer([0.0, 0, 12, 3]), answer([0.0, 0, 1e6, 3]))
    np.testing.assert_array_equal(answer([0.0, 0, 4, 3], (40.0, 0)), answer([0.0, 0, 4, 3], (1e6, 0)))
    assert np.abs(answer([0.0, 0, 4, 3]) - answer([0.0, 0, 8, 3])).max() > 1e-4
    assert np.abs(answer([0.0, 0, 4, 3]) - answer([39.0, 0, 4, 3])).max() > 1e-4


def test_acting_is_batched_row_by_row(fast_config, ragged):
    policy = untrained(fast_config, ragged)
    observations, goals = jnp.asarray(ragged.observations[:6]), jnp.ones((6, 2))
    together, _ = act(policy, observations, goals, initial_state(policy, 6), jnp.ones(6, bool))
    for row in range(6):
        alone, _ = act(policy, observations[row : row + 1], goals[:1], initial_state(policy, 1), jnp.ones(1, bool))
        np.testing.assert_allclose(alone[0], together[row], rtol=1e-4, atol=1e-5)
