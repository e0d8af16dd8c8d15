"""One update of every stage of Guider's against its published description, written anew in NumPy (tests/reference.py).

All in float64: what agrees does so to 1e-5 and better. Targets are shaken first, so that they differ from what learns.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference as ref
from reference import RATE, normal, plain, shaken
from scipy.special import logsumexp

from guider.learning.networks import Gaussian
from guider.learning.samplers import Windows
from guider.methods import latent_subgoals, subgoal_policy
from guider.methods.latent_subgoals import LatentSubgoalsConfig
from guider.methods.subgoal_policy import SubgoalPolicyConfig
from guider.methods.view import Scale

ROWS, INPUTS, ACTIONS = 6, 3, 2
HIDDEN = (4,)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


# The latent model (Eq. 2-3)


@pytest.mark.parametrize(("dropout", "in_spreads"), [(0.0, True), (0.4, False)])
def test_latent_model(dropout, in_spreads):
    """-log p is the squared error in goal units, or in spreads of moves, which are 3 here; a mean over dimensions, as
    is the KL, whose gradient Eq. 3 splits."""
    config = LatentSubgoalsConfig(
        hidden=HIDDEN,
        beta=0.3,
        kl_balance=0.7,
        decoder_dropout=dropout,
        learning_rate=RATE,
        error_in_spreads=in_spreads,
    )
    one, unit = jnp.ones(2), 3.0 if in_spreads else 1.0
    scale = Scale(one, one, 0 * one, one, 3 * one, jnp.zeros(0))
    state = latent_subgoals.init(jax.random.key(0), config, 2, 2)
    state = state._replace(params=shaken(state.params))
    batch = Windows(normal(1, ROWS, 2), normal(2, ROWS, 2))
    key = jax.random.key(3)
    after, metrics = latent_subgoals.update(config, state, scale, batch, key)

    sample_key, dropout_key = jax.random.split(key)
    noise = np.asarray(jax.random.normal(sample_key, (ROWS, 2)))
    kept = np.asarray(jax.random.bernoulli(jax.random.fold_in(dropout_key, 0), 1 - dropout, (ROWS, *HIDDEN)))
    now, later = np.asarray(batch.achieved), np.asarray(batch.later)
    frozen = plain(state.params)

    def posterior(params):
        return ref.gaussian(ref.mlp(params.encoder, np.concatenate([now, later], -1), ref.gelu))

    def loss(params):
        mean, std = posterior(params)
        prior = ref.gaussian(ref.mlp(params.prior, now))
        (weights, biases), last = params.decoder
        hidden = ref.gelu(np.concatenate([now, mean + std * noise], -1) @ weights + biases)
        decoded = np.where(kept, hidden / (1 - dropout), 0.0) @ last[0] + last[1]
        balanced = 0.7 * ref.kl(*posterior(frozen), *prior) + 0.3 * ref.kl(
            mean, std, *ref.gaussian(ref.mlp(frozen.prior, now))
        )
        return ((((decoded - later) / unit) ** 2).mean(-1) + 0.3 * balanced.mean(-1)).mean()

    ref.check_first_step(state, after, loss, RATE)
    assert float(metrics["loss"]) == pytest.approx(loss(frozen), rel=1e-9)


# The high level (Eq. 4)


class High:
    """A state, a batch and the noise of one update of the high level, and what its losses are made of."""

    def __init__(self, **settings):
        self.config = SubgoalPolicyConfig(**{"hidden": HIDDEN, "learning_rate": RATE, "samples": 3} | settings)
        state = subgoal_policy.init(jax.random.key(0), self.config, INPUTS, 2)
        params = shaken(state.params)._replace(log_alpha=jnp.asarray(0.4), log_lagrange=jnp.asarray(-0.3))
        *below, (weights, biases) = shaken(params.critic, 8, spread=1.0)
        high = (*below, (weights, biases + 1.5))  # some targets lie above 0
        self.state = state._replace(params=params, target_critic=high)
        self.batch = subgoal_policy.Transitions(
            state=normal(1, ROWS, INPUTS),
            latent=normal(2, ROWS, 2),
            reward=jnp.array([-1.0, 0, -1, -1, -2, -1]),
            next_state=normal(3, ROWS, INPUTS),
            prior=Gaussian(normal(4, ROWS, 2), 0.3 * normal(5, ROWS, 2)),
            next_prior=Gaussian(normal(6, ROWS, 2), 0.3 * normal(7, ROWS, 2)),
        )
        self.old, self.b = plain(self.state.params), plain(self.batch)
        self.target = plain(self.state.target_critic)
        key = jax.random.key(11)
        self.critic_key, self.actor_key = jax.random.split(key)
        self.after, self.metrics = subgoal_policy.update(self.config, self.state, self.batch, key)

    def policy(self, params, state):
        return ref.gaussian(ref.mlp(params.actor, state))

    def held_by(self, policy, prior: Gaussian, latent):
        mean, std = policy
        if self.config.prior:
            return ref.kl(mean, std, prior.mean, np.exp(prior.log_std)).mean(-1)
        return ref.log_density(mean, std, latent)

    def actor_loss(self, params) -> float:
        b, config = self.b, self.config
        policy = self.policy(params, b.state)
        latent = policy[0] + policy[1] * np.asarray(jax.random.normal(self.actor_key, (ROWS, 2)))
        held = self.held_by(policy, b.prior, latent)
        actor = (np.exp(self.old.log_alpha) * held - ref.q(self.old.critic, b.state, latent).min(0)).mean()
        old_policy = self.policy(self.old, b.state)
        old_latent = old_policy[0] + old_policy[1] * np.asarray(jax.random.normal(self.actor_key, (ROWS, 2)))
        excess = self.held_by(old_policy, b.prior, old_latent).mean() - (
            config.target_divergence if config.prior else 2
        )
        tuned = np.exp(params.log_alpha) if config.temperature_loss == "alpha" else params.log_alpha
        return actor - tuned * excess

    def check(self, critic_loss) -> None:
        ref.check_first_step(self.state, self.after, lambda params: critic_loss(params) + self.actor_loss(params), RATE)
        ref.check_trails(self.state.target_critic, self.after.params.critic, self.after.target_critic, 0.005)


@pytest.mark.parametrize(
    "settings",
    [
        {"lagrange_threshold": 2.5, "conservative_weight": 0.7},
        {"lagrange_threshold": 2.5, "prior": False, "temperature_loss": "log_alpha"},
        {"lagrange_threshold": None, "conservative_weight": 0.7, "backup": "max_of_min", "uniform_box": "per_entry"},
        {"lagrange_threshold": 2.5, "cap_targets": True},
    ],
    ids=["paper", "without prior", "fast", "capped"],
)
def test_high_level_with_cql(settings):
    """Kumar et al. 2020: max-Q backup, CQL(H) over three proposals, and the Lagrange multiplier of its threshold."""
    high = High(**settings)
    config, b = high.config, high.b
    next_key, now_key, uniform_key = jax.random.split(high.critic_key, 3)
    shape = (config.samples, ROWS, 2)

    def samples(state, key):
        mean, std = high.policy(high.old, state)
        drawn = mean + std * np.asarray(jax.random.normal(key, shape))
        return drawn.swapaxes(0, 1), ref.log_density(mean, std, drawn).T

    next_latents, next_log_density = samples(b.next_state, next_key)
    now_latents, now_log_density = samples(b.state, now_key)
    if config.uniform_box == "common":
        low, high_end = np.full(2, b.latent.min()), np.full(2, b.latent.max())
    else:
        low, high_end = b.latent.min(axis=0), b.latent.max(axis=0)
    uniform = low + (high_end - low) * np.asarray(jax.random.uniform(uniform_key, now_latents.shape))
    uniform_log_density = np.full((ROWS, config.samples), -np.log((high_end - low)[0] * (high_end - low)[1]))

    backed_up = ref.q_of_samples(high.target, b.next_state, next_latents)
    value = backed_up.max(-1).min(0) if config.backup == "min_of_max" else backed_up.min(0).max(-1)
    assert (backed_up.max(-1).min(0) > backed_up.min(0).max(-1))[b.reward < 0].any(), "else the two backups are one"
    target = ref.td(b.reward, value, config.discount)
    if config.cap_targets:
        assert target.max() > 0, "else capping them shows nothing"
        target = np.minimum(target, 0.0)

    def gaps(params):
        sampled = [
            ref.q_of_samples(params.critic, b.state, latents) - density
            for latents, density in (
                (uniform, uniform_log_density),
                (next_latents, next_log_density),
                (now_latents, now_log_density),
            )
        ]
        data = ref.q(params.critic, b.state, b.latent)
        return (logsumexp(np.concatenate(sampled, -1), axis=-1) - data).mean(-1)

    old_gaps = gaps(high.old)

    def critic_loss(params):
        error = ((ref.q(params.critic, b.state, b.latent) - target) ** 2).mean(-1).sum()
        if config.lagrange_threshold is None:
            return error + config.conservative_weight * gaps(params).sum()
        weight = config.conservative_weight
        multiplier = -np.exp(params.log_lagrange) * (weight * old_gaps - config.lagrange_threshold).mean()
        return error + np.exp(high.old.log_lagrange) * weight * gaps(params).sum() + multiplier

    high.check(critic_loss)
    assert float(high.metrics["conservative_gap"]) == pytest.approx(old_gaps.mean(), rel=1e-9)
    assert float(high.metrics["target"]) == pytest.approx(target.mean(), rel=1e-9)


@pytest.mark.parametrize("prior", [True, False])
def test_high_level_without_cql_is_soft_actor_critic(prior):
    """Haarnoja et al. 2018: one sample is backed up, less alpha times what the actor is held by there."""
    high = High(critic="td", prior=prior)
    b = high.b
    mean, std = high.policy(high.old, b.next_state)
    latent = mean + std * np.asarray(jax.random.normal(high.critic_key, (ROWS, 2)))
    held = high.held_by((mean, std), b.next_prior, latent)
    value = ref.q(high.target, b.next_state, latent).min(0) - np.exp(high.old.log_alpha) * held
    target = ref.td(b.reward, value, 0.99)
    high.check(lambda params: ((ref.q(params.critic, b.state, b.latent) - target) ** 2).mean(-1).sum())


def test_high_level_with_expectiles():
    """Kostrikov et al. 2022: V leans to the upper side of Q over logged latents."""
    high = High(critic="expectile", expectile=0.8)
    b = high.b
    target = ref.td(b.reward, ref.mlp(high.old.value, b.next_state)[:, 0], 0.99)
    logged = ref.q(high.target, b.state, b.latent).min(0)

    def critic_loss(params):
        error = logged - ref.mlp(params.value, b.state)[:, 0]
        expectile = np.array([(0.8 if e > 0 else 0.2) * e**2 for e in error]).mean()
        return ((ref.q(params.critic, b.state, b.latent) - target) ** 2).mean(-1).sum() + expectile

    high.check(critic_loss)
