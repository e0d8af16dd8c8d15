"""One update of every learner against its published description, written anew in NumPy (tests/reference.py).

As methods/test_updates.py, which does the same for the stages of Guider, in float64."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference as ref
from reference import RATE, normal, plain, shaken
from scipy.special import logsumexp

from guider.learners import (
    AwrConfig,
    CqlConfig,
    GcslConfig,
    IqlConfig,
    LearnerConfig,
    Transitions,
    WgcslConfig,
    awr,
    cql,
    gcsl,
    iql,
    wgcsl,
)
from guider.learners.regression import RegressionConfig

ROWS, INPUTS, ACTIONS = 6, 3, 2
HIDDEN = (4,)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


class Learned:
    """A state, a batch and the noise of one update of a learner."""

    def __init__(self, module, config: LearnerConfig):
        self.config: Any = config
        state = module.init(jax.random.key(0), config, HIDDEN, INPUTS, ACTIONS)
        state = state._replace(params=shaken(state.params))
        if hasattr(state, "target_critic"):
            state = state._replace(target_critic=shaken(state.params.critic, 8))
        if hasattr(state, "target"):
            state = state._replace(target=shaken(state.params, 8))
        self.state = state
        self.batch = Transitions(
            state=2 * normal(1, ROWS, INPUTS),
            action=jnp.tanh(normal(2, ROWS, ACTIONS)),
            reward=jnp.array([-1.0, 0, -1, -1, 0, -1]),
            next_state=2 * normal(3, ROWS, INPUTS),
            steps=jnp.array([3, 1, 7, -1, 2, 4]),
        )
        self.b, self.old = plain(self.batch), plain(state.params)
        self.key = jax.random.key(5)
        self.after, self.metrics = module.update(config, state, self.batch, self.key, RATE)

    def check(self, loss) -> None:
        ref.check_first_step(self.state, self.after, loss, RATE)

    def check_critic_trails(self) -> None:
        ref.check_trails(
            self.state.target_critic, self.after.params.critic, self.after.target_critic, self.config.target_rate
        )

    def regression(self, weight, predicted) -> float:
        """Mean over rows and dimensions of the weighted squared error to the logged action."""
        return (weight[:, None] * (predicted - self.b.action) ** 2).mean()

    def td_error(self, params, target) -> float:
        return ((ref.q(params.critic, self.b.state, self.b.action) - target) ** 2).mean(-1).sum()


def test_awr_as_in_paper():
    """Eq. 6 as the authors have it: samples of a Gaussian are regressed, A looks one step ahead, by critic 1."""
    learned = Learned(awr, AwrConfig(temperature=0.8, weight_ceiling=1.1))
    b, old, target_critic = learned.b, learned.old, plain(learned.state.target_critic)
    count = len(old.actor)
    ahead_key = jax.random.fold_in(jax.random.fold_in(learned.key, count + 1), count)
    next_noise = np.asarray(jax.random.normal(ahead_key, (ROWS, ACTIONS)))
    noise = np.asarray(jax.random.normal(jax.random.fold_in(learned.key, count), (ROWS, ACTIONS)))

    def action(params, state, noise):
        mean, std = ref.gaussian(ref.mlp(params.actor, state))
        return mean + std * noise

    next_action, here = action(old, b.next_state, next_noise), action(old, b.state, noise)
    target = ref.td(b.reward, ref.q(target_critic, b.next_state, next_action).min(0), 0.99)
    ahead = ref.td(b.reward, ref.q(old.critic, b.next_state, next_action)[0], 0.99)
    advantage = ahead - ref.q(old.critic, b.state, here)[0]
    weight = np.clip(np.exp(advantage / 0.8), 0, 1.1)
    assert weight.min() < 1 < weight.max() == 1.1
    learned.check(
        lambda params: learned.td_error(params, target) + learned.regression(weight, action(params, b.state, noise))
    )
    learned.check_critic_trails()
    mean = np.clip(ref.gaussian(ref.mlp(old.actor, b.state))[0], -1, 1)
    np.testing.assert_allclose(awr.act(learned.config, learned.state, learned.batch.state), mean, rtol=1e-9)


@pytest.mark.parametrize("error", ["squared", "absolute"])
def test_awr_as_in_fast(error):
    """A = min Q(s, a) - min Q(s, pi(s)) of a squashed policy without spread."""
    config = AwrConfig(advantage="action_value", policy="tanh", temperature=0.2, regression=RegressionConfig(error))
    learned = Learned(awr, config)
    b, old, target_critic = learned.b, learned.old, plain(learned.state.target_critic)
    next_value = ref.q(target_critic, b.next_state, np.tanh(ref.mlp(old.actor, b.next_state))).min(0)
    target = ref.td(b.reward, next_value, 0.99)
    baseline = ref.q(old.critic, b.state, np.tanh(ref.mlp(old.actor, b.state))).min(0)
    weight = np.clip(np.exp((ref.q(old.critic, b.state, b.action).min(0) - baseline) / 0.2), 0, 10)
    assert weight.min() < 0.9 and weight.max() > 1.1

    def loss(params):
        misses = np.tanh(ref.mlp(params.actor, b.state)) - b.action
        counted = misses**2 if error == "squared" else np.abs(misses)
        return learned.td_error(params, target) + (weight[:, None] * counted).mean()

    learned.check(loss)
    learned.check_critic_trails()


def test_gcsl():
    learned = Learned(gcsl, GcslConfig())
    learned.check(lambda params: learned.regression(np.ones(ROWS), np.tanh(ref.mlp(params, learned.b.state))))


def test_iql():
    learned = Learned(iql, IqlConfig(expectile=0.8, temperature=0.5, weight_ceiling=1.5, discount=0.9))
    b, old = learned.b, learned.old
    target = ref.td(b.reward, ref.mlp(old.value, b.next_state)[:, 0], 0.9)
    logged = ref.q(plain(learned.state.target_critic), b.state, b.action).min(0)
    weight = np.clip(np.exp((logged - ref.mlp(old.value, b.state)[:, 0]) / 0.5), 0, 1.5)
    assert weight.min() < 1 and weight.max() == 1.5

    def loss(params):
        error = logged - ref.mlp(params.value, b.state)[:, 0]
        expectile = np.array([(0.8 if e > 0 else 0.2) * e**2 for e in error]).mean()
        predicted = np.tanh(ref.mlp(params.actor, b.state))
        return learned.td_error(params, target) + expectile + learned.regression(weight, predicted)

    learned.check(loss)
    learned.check_critic_trails()


@pytest.mark.parametrize("twins", [False, True])
def test_wgcsl(twins):
    """Yang et al. 2022: gamma^(k-1), exp(A) and the best-advantage weight, whose percentile is 0 in the first update;
    in a second state it is 50, of a ring of ten that seven advantages were written to before, or none."""
    config = WgcslConfig(twins=twins, discount=0.6, input_limit=1.5, recent_advantages=10, percentile_rise=50.0)
    learned = Learned(wgcsl, config)
    ring = np.linspace(-3, 3, 10)
    optimiser = learned.state.optimiser._replace(count=jnp.asarray(1, jnp.int32))

    def second(seen: int):
        filled = {"recent": jnp.asarray(ring), "seen": jnp.asarray(seen, jnp.int32)}
        state = learned.state._replace(optimiser=optimiser, **filled)
        return wgcsl.update(config, state, learned.batch, learned.key, RATE)

    b, old, trailing = learned.b, learned.old, plain(learned.state.target)
    seen, next_seen = np.clip(b.state, -1.5, 1.5), np.clip(b.next_state, -1.5, 1.5)
    reward = np.array([0.0, 1, 0, 0, 1, 0])

    def value(params, inputs):
        return ref.q(params.critic, inputs, np.tanh(ref.mlp(params.actor, inputs))).min(0)

    target = np.clip(reward + 0.6 * value(trailing, next_seen), -2.5, 2.5)
    advantage = reward + 0.6 * value(old, next_seen) - value(old, seen)
    weight = 0.6 ** np.array([2, 0, 6, 0, 1, 3]) * np.clip(np.exp(advantage), 0, 10)
    weight[3] = 0.0  # its goal lies elsewhere

    def loss(params):
        error = ((ref.q(params.critic, seen, b.action) - target) ** 2).mean(-1).sum()
        return error + learned.regression(weight, np.tanh(ref.mlp(params.actor, seen)))

    learned.check(loss)  # with a percentile of 0 no advantage is poor
    ref.check_trails(learned.state.target, learned.after.params, learned.after.target, config.target_rate)
    np.testing.assert_allclose(learned.after.recent[:ROWS], advantage, rtol=1e-9)
    for written, counted in ((7, slice(None)), (0, slice(ROWS))):
        filled = ring.copy()
        filled[(written + np.arange(ROWS)) % 10] = advantage
        after, metrics = second(written)
        np.testing.assert_allclose(after.recent, filled, rtol=1e-9)
        poor = np.where(advantage >= np.percentile(filled[counted], 50), 1.0, 0.05)
        assert 0 < (poor == 1).sum() < ROWS
        assert float(metrics["weight"]) == pytest.approx((weight * poor).mean(), rel=1e-9)


@pytest.mark.parametrize("error", ["squared", "absolute"])
def test_cql(error):
    """Kumar et al. 2020 on a squashed Gaussian, whose densities change with tanh; alpha aims at an entropy of -A."""
    config = CqlConfig(
        samples=3, conservative_weight=0.7, cloning_weight=0.3, discount=0.9, regression=RegressionConfig(error=error)
    )
    learned = Learned(cql, config)
    learned = _with_alpha(learned, 0.4)
    b, old = learned.b, learned.old
    uniform_key, next_key, now_key, actor_key = jax.random.split(learned.key, 4)

    def squashed(params, state, noise):
        mean, std = ref.gaussian(ref.mlp(params.actor, state))
        raw = mean + std * noise
        return np.tanh(raw), ref.log_density(mean, std, raw) - np.log(1 - np.tanh(raw) ** 2).sum(-1)

    def samples(state, key):
        actions, density = squashed(old, state, np.asarray(jax.random.normal(key, (3, ROWS, ACTIONS))))
        return actions.swapaxes(0, 1), density.T

    next_actions, next_density = samples(b.next_state, next_key)
    now_actions, now_density = samples(b.state, now_key)
    uniform = np.asarray(jax.random.uniform(uniform_key, now_actions.shape, minval=-1.0, maxval=1.0))
    backed_up = ref.q_of_samples(plain(learned.state.target_critic), b.next_state, next_actions).min(0).max(-1)
    target = ref.td(b.reward, backed_up, 0.9)
    noise = np.asarray(jax.random.normal(actor_key, (1, ROWS, ACTIONS)))[0]
    old_entropy = squashed(old, b.state, noise)[1].mean()

    def loss(params):
        weighted = [
            ref.q_of_samples(params.critic, b.state, actions) - density
            for actions, density in (
                (uniform, np.full((ROWS, 3), -np.log(4.0))),
                (next_actions, next_density),
                (now_actions, now_density),
            )
        ]
        data = ref.q(params.critic, b.state, b.action)
        gap = (logsumexp(np.concatenate(weighted, -1), axis=-1) - data).mean(-1).sum()
        action, density = squashed(params, b.state, noise)
        actor = (np.exp(old.log_alpha) * density - ref.q(old.critic, b.state, action).min(0)).mean()
        alpha = -params.log_alpha * (old_entropy - ACTIONS)
        misses = np.abs(np.tanh(ref.gaussian(ref.mlp(params.actor, b.state))[0]) - b.action)
        cloned = (misses**2 if error == "squared" else misses).mean()
        return learned.td_error(params, target) + 0.7 * gap + actor + alpha + 0.3 * cloned

    learned.check(loss)
    learned.check_critic_trails()


def _with_alpha(learned: Learned, log_alpha: float) -> Learned:
    learned.state = learned.state._replace(params=learned.state.params._replace(log_alpha=jnp.asarray(log_alpha)))
    learned.old = plain(learned.state.params)
    learned.after, learned.metrics = cql.update(learned.config, learned.state, learned.batch, learned.key, RATE)
    return learned


@pytest.mark.parametrize("config", [AwrConfig(), replace(AwrConfig(), initialisation="fan_in")])
def test_initialisation(config):
    """The authors': hidden weights in +-1/sqrt(outputs), hidden biases 0.1, last layer in +-0.001; else PyTorch's."""
    state = awr.init(jax.random.key(0), config, (64, 16), 100, 3)
    ours = config.initialisation == "small_outputs"
    for layers, fan_in in ((state.params.actor, 100), (state.params.critic, 103)):
        bounds = [(64**-0.5, 0.1), (16**-0.5, 0.1), (1e-3, 1e-3)]
        if not ours:
            bounds = [(n**-0.5, n**-0.5) for n in (fan_in, 64, 16)]
        for (weights, biases), (of_weights, of_biases) in zip(layers, bounds, strict=True):
            assert 0.9 * of_weights < float(jnp.abs(weights).max()) <= of_weights
            assert float(weights.min()) < -0.8 * of_weights and float(weights.max()) > 0.8 * of_weights
            assert 0.5 * of_biases < float(jnp.abs(biases).max()) <= of_biases
    assert bool(jnp.all(state.params.actor[0][1] == 0.1)) == ours
