"""Learners against hand-worked numbers, and what flat methods show them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import make_ragged

from guider.data.episodes import make_episodes
from guider.learners import CqlConfig, GcslConfig, IqlConfig, Transitions, WgcslConfig, cql, gcsl, iql, learner, wgcsl
from guider.learners.regression import RegressionConfig
from guider.learning.networks import Gaussian
from guider.learning.problem import Problem
from guider.learning.samplers import FlatBatch, sample_flat
from guider.methods import flat
from guider.methods.flat import FlatConfig
from guider.methods.view import Scale, ViewConfig, prepare

RATE = 1e-3


def batch_of(rows: int = 6, inputs: int = 3, actions: int = 2) -> Transitions:
    normal = jax.random.normal
    return Transitions(
        state=normal(jax.random.key(1), (rows, inputs)),
        action=jnp.tanh(normal(jax.random.key(2), (rows, actions))),
        reward=jnp.where(jnp.arange(rows) % 3 == 0, 0.0, -1.0),
        next_state=normal(jax.random.key(3), (rows, inputs)),
        steps=jnp.arange(rows),
    )


def zeroed(module, config, **changes):
    """A learner's state in which every network answers 0."""
    state = module.init(jax.random.key(0), config, (8,), 3, 2)
    return jax.tree.map(jnp.zeros_like, state)._replace(**changes)


def constant_network(layers, value: float):
    """The same network with its last bias at `value`: it answers that everywhere, the rest being 0."""
    *first, (weight, bias) = layers
    return (*first, (weight, jnp.full_like(bias, value)))


def updated(learner, config, *arguments):
    """Compiled as one program, which is quicker done than its every step."""
    return jax.jit(partial(learner.update, config))(*arguments)


def test_gcsl_regresses_the_logged_actions():
    batch = batch_of()
    state, metrics = updated(gcsl, GcslConfig(), zeroed(gcsl, GcslConfig()), batch, jax.random.key(0), RATE)
    assert float(metrics["action_error"]) == pytest.approx(float((batch.action**2).mean()), rel=1e-6)
    moved = np.asarray(state.params[-1][1])
    np.testing.assert_allclose(moved, RATE * np.sign(np.asarray(batch.action).mean(axis=0)), rtol=1e-4)


def test_dropout_is_for_learning_only():
    config = GcslConfig(regression=RegressionConfig(dropout=0.5))
    state, batch = gcsl.init(jax.random.key(0), config, (64,), 3, 2), batch_of()
    errors = [updated(gcsl, config, state, batch, jax.random.key(k), RATE)[1]["action_error"] for k in (1, 2)]
    assert errors[0] != errors[1]
    kept = jax.nn.relu(batch.state @ state.params[0][0] + state.params[0][1])
    expected = jnp.tanh(kept @ state.params[1][0] + state.params[1][1])
    np.testing.assert_allclose(gcsl.act(config, state, batch.state), expected, rtol=1e-5)


def test_wgcsl_weights_by_hand():
    advantage, steps = jnp.array([0.0, 1.0, -1.0, 9.0]), jnp.array([0, 2, 1, -1])
    config = WgcslConfig(discount=0.5, poor_weight=0.05, weight_ceiling=10.0)
    expected = [1.0, 0.5 * np.e, 1.0 * np.exp(-1) * 0.05, 0.0]
    np.testing.assert_allclose(wgcsl.weights(config, advantage, steps, jnp.array(-0.5)), expected, rtol=1e-6)
    bare = replace(config, discount_weight=False, advantage_weight=False, best_advantage_weight=False)
    np.testing.assert_array_equal(wgcsl.weights(bare, advantage, steps, jnp.array(0.0)), [1, 1, 1, 0])
    ahead = jnp.abs(steps)
    assert float(wgcsl.weights(config, advantage, ahead, jnp.array(0.0))[3]) == 10.0, "exp(9) is clipped"


def test_wgcsl_counts_rewards_of_one_that_do_not_end_and_clips_targets():
    """With values of 3 and gamma = 1/2, targets are 1 + 1.5 where the goal is met, clipped to 2, else 1.5."""
    config = WgcslConfig(discount=0.5)
    state = zeroed(wgcsl, config)
    critic = constant_network(state.params.critic, 3.0)
    params = state.params._replace(critic=critic)
    _, metrics = updated(
        wgcsl, config, state._replace(params=params, target=params), batch_of(), jax.random.key(0), RATE
    )
    met, rest = (3 - 2.0) ** 2, (3 - 1.5) ** 2
    assert float(metrics["td_error"]) == pytest.approx((2 * met + 4 * rest) / 6, rel=1e-6)


def test_wgcsl_takes_its_percentile_of_recent_advantages_only():
    config = WgcslConfig(recent_advantages=8, percentile_rise=1000.0, percentile_ceiling=50.0)
    state = zeroed(wgcsl, config)
    state, _ = updated(wgcsl, config, state, batch_of(), jax.random.key(0), RATE)
    assert int(state.seen) == 6 and np.count_nonzero(state.recent) == 2, "A is 1 where the goal is met, else 0"
    state, _ = updated(wgcsl, config, state, batch_of(), jax.random.key(0), RATE)
    assert int(state.seen) == 12, "the ring starts over"


def test_iql_by_hand():
    """Q = 2, V = 1: the advantage is 1, its expectile loss 0.9, the weight exp(1 / 0.5)."""
    config = IqlConfig(discount=0.5, expectile=0.9, temperature=0.5)
    state = zeroed(iql, config)
    critic, value = constant_network(state.params.critic, 2.0), constant_network(state.params.value, 1.0)
    state = state._replace(params=state.params._replace(critic=critic, value=value), target_critic=critic)
    batch = batch_of()
    _, metrics = updated(iql, config, state, batch, jax.random.key(0), RATE)
    assert float(metrics["weight"]) == pytest.approx(np.exp(2), rel=1e-5)
    assert float(metrics["td_error"]) == pytest.approx(2 * (2 * 2.0**2 + 4 * 2.5**2) / 6, rel=1e-6)


def test_squashed_samples_have_the_density_they_report():
    """In one dimension, against the density's definition by the change of variables, and its integral."""
    policy = Gaussian(jnp.full((1, 1), 0.3), jnp.full((1, 1), -0.5))
    actions, log_density = cql.squashed_sample(policy, jax.random.key(0), 4000)
    raw = np.arctanh(np.asarray(actions, np.float64)[0, :, 0])
    std = np.exp(-0.5)
    normal = np.exp(-0.5 * ((raw - 0.3) / std) ** 2) / (std * np.sqrt(2 * np.pi))
    inside = np.abs(raw) < 2.5  # further out, float32 actions no longer tell raw values apart
    expected = normal[inside] / (1 - np.tanh(raw[inside]) ** 2)
    np.testing.assert_allclose(np.exp(np.asarray(log_density)[0][inside]), expected, rtol=1e-3)


def test_cql_pushes_unlogged_actions_down_and_alpha_towards_its_entropy():
    """With critics at 0 the gap is log-sum-exp of the inverse densities, whose mean is the volume of the box, 2^2; the
    entropy of N(0, 1) squashed is above -2, so alpha falls."""
    config = CqlConfig(samples=200, conservative_weight=1.0)
    state = zeroed(cql, config)
    after, metrics = updated(cql, config, state, batch_of(), jax.random.key(0), RATE)
    assert float(metrics["conservative_gap"]) == pytest.approx(np.log(4 * 600), abs=0.3)
    assert float(metrics["td_error"]) == pytest.approx(2 * 4 / 6, rel=1e-6)
    assert float(after.params.log_alpha) == pytest.approx(-RATE, rel=1e-3)
    assert bool(jnp.any(after.params.critic[-1][1] != 0))


def test_cloning_pulls_the_mean_towards_logged_actions():
    batch = batch_of()._replace(action=jnp.full((6, 2), 0.8))
    config = CqlConfig(samples=2, conservative_weight=0.0, cloning_weight=100.0)
    state, update = zeroed(cql, config), jax.jit(partial(cql.update, config))
    for step in range(50):
        state, _ = update(state, batch, jax.random.key(step), 0.05)
    np.testing.assert_allclose(learner(config).act(config, state, batch.state), batch.action, atol=0.1)


def test_flat_inputs_and_reward_by_hand():
    scale = Scale(jnp.zeros(3), jnp.full(3, 2.0), jnp.zeros(2), jnp.full(2, 10.0), jnp.full(2, 4.0), jnp.zeros(0))
    batch = FlatBatch(
        observation=jnp.array([[1.0, 2.0, 6.0]]),
        action=jnp.zeros((1, 2)),
        next_observation=jnp.array([[2.0, 2.0, 6.0]]),
        achieved=jnp.array([[1.0, 2.0]]),
        next_achieved=jnp.array([[2.0, 2.0]]),
        goal=jnp.array([[2.4, 2.0]]),
        steps=jnp.array([7]),
    )
    config = FlatConfig(problem=Problem(0.5, 1.0, 5), relative=True)
    seen = flat.label(config, scale, batch)
    np.testing.assert_allclose(seen.state, [[0.5, 1.0, 3.0, 0.14, 0.0]], rtol=1e-5)
    np.testing.assert_allclose(seen.next_state, [[1.0, 1.0, 3.0, 0.04, 0.0]], rtol=1e-5, atol=1e-7)
    assert seen.reward.tolist() == [0.0] and seen.steps.tolist() == [7]
    absolute = flat.label(replace(config, relative=False), scale, batch)
    np.testing.assert_allclose(absolute.state, [[0.5, 1.0, 3.0, 0.24, 0.2]], rtol=1e-5)


def flat_samples(episodes, **settings) -> FlatBatch:
    data, _ = prepare(ViewConfig(), Problem(period_steps=5), episodes)
    mix = {"future": "uniform", "mean_goal_steps": 1.0, "relabel_fraction": 1.0, "random_goal_fraction": 0.0}
    return sample_flat(data, jax.random.key(0), 20_000, **(mix | settings))


def test_flat_goals_come_from_ahead_in_their_own_episode():
    """Entry 3 of the test data counts episodes, entry 2 steps; here they are the goal."""
    ragged = make_ragged()
    episodes = make_episodes(ragged.observations, ragged.actions, ragged.lengths, (2, 3))
    batch = flat_samples(episodes)
    assert bool(jnp.all(batch.goal[:, 1] == batch.achieved[:, 1]))
    np.testing.assert_array_equal(batch.goal[:, 0] - batch.achieved[:, 0], batch.steps)
    assert int(batch.steps.min()) == 1
    longest = batch.steps[batch.achieved[:, 1] == 4]
    assert int(longest.max()) == 54
    last = flat_samples(episodes, future="last")
    lengths = np.array(ragged.lengths)[np.asarray(last.goal[:, 1], int)]
    np.testing.assert_array_equal(last.goal[:, 0], lengths - 1)


def test_geometric_goals_are_as_far_ahead_as_asked():
    episodes = make_episodes(np.arange(40_000.0)[:, None], np.zeros((40_000, 1)), [40_000], (0,))
    steps = np.asarray(flat_samples(episodes, future="geometric", mean_goal_steps=20.0).steps)
    assert steps.mean() == pytest.approx(20, rel=0.03)
    assert np.mean(steps <= 10) == pytest.approx(1 - 0.95**10, abs=0.01)


def test_goals_from_elsewhere_are_marked():
    ragged = make_ragged()
    batch = flat_samples(ragged, relabel_fraction=0.5, random_goal_fraction=0.3)
    recorded = np.asarray((batch.goal == 1000.0).all(axis=1))
    assert recorded.mean() == pytest.approx(0.2, abs=0.02)
    assert np.asarray(batch.steps < 0).mean() == pytest.approx(0.5, abs=0.02)
    assert bool(np.all(np.asarray(batch.steps)[recorded] == -1))
