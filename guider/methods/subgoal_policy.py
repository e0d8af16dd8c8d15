"""The high-level policy that proposes subgoals (Section 4.3, Eq. 4, Algorithm 1 lines 6-12).

States are images in goal space, actions are latent subgoals z. Where the authors' code and this file differ:
the target critics start as copies of the critics; the Bellman target stops at a met goal; CQL's uniform samples are
weighted by the density they were drawn from; critic, actor, alpha and CQL's weight take one step together, all from
the parameters before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.errors import GuiderError
from guider.learning import losses
from guider.learning.networks import (
    Gaussian,
    Initialisation,
    Layers,
    gaussian_head,
    mlp,
    mlp_init,
    twin_init,
    twin_values,
)
from guider.learning.optimisers import Moments, adam_init, adam_step, trail
from guider.learning.training import Metrics
from guider.methods.view import Scale
from guider.support.config import (
    Changes,
    check_fraction,
    check_networks,
    check_not_negative,
    check_positive,
    check_shares,
)


@dataclass(frozen=True)
class SubgoalPolicyConfig:
    """Settings of the high level. Defaults are the authors' (preset `paper`)."""

    updates: int = 200_000
    batch_size: int = 256
    learning_rate: float = 1e-4
    hidden: tuple[int, ...] = (256, 256, 256)
    discount: float = 0.99
    """gamma per high-level step of c environment steps."""
    target_rate: float = 0.005
    relabel_fraction: float = 0.8
    """Share of goals relabelled with a future state; the rest are recorded goals, where data has them."""
    random_goal_fraction: float = 0.0
    """Share of goals drawn from any trajectory (departure)."""
    goal_offset: int = 0
    """First relabelled goal is s^G_{t+c+offset}: 1 is Algorithm 1's strict range, 0 the authors' code."""
    prior: bool = True
    """Hold the policy to rho by the KL of Eq. 4; without, by CQL's own entropy term (Table 2, w/o prior)."""
    target_divergence: float = 1.0
    """alpha is tuned until KL(pi_h || rho) is this many nats, mean over latent dimensions."""
    temperature_loss: Literal["alpha", "log_alpha"] = "alpha"
    """What of alpha its loss is linear in: the authors', or its logarithm (departure: steps do not grow with alpha)."""
    critic: Literal["cql", "td", "expectile"] = "cql"
    """cql: the paper. td: soft actor-critic's (Table 2, w/o CQL). expectile: no sampling (departure)."""
    samples: int = 10
    """Latents drawn from each of CQL's three proposals, and for the max-Q backup."""
    backup: Literal["min_of_max", "max_of_min"] = "min_of_max"
    """CQL's max-Q backup: the smaller of what each twin thinks best, or the best by the smaller twin (departure)."""
    uniform_box: Literal["common", "per_entry"] = "common"
    """CQL's uniform latents lie between least and greatest of all entries of a batch, or of each entry (departure)."""
    lagrange_threshold: float | None = 5.0
    """Conservative gap above which CQL's weight grows; None keeps the weight fixed (departure)."""
    conservative_weight: float = 1.0
    expectile: float = 0.7
    """Only for the expectile critic."""
    cap_targets: bool = False
    """Keep Bellman targets at or below 0, the value of a met goal (departure)."""
    initialisation: Initialisation = "small_outputs"

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "samples", "target_divergence")
        check_not_negative(self, "goal_offset", "conservative_weight")
        check_fraction(self, "discount", "target_rate", "relabel_fraction", "random_goal_fraction", "expectile")
        check_shares(self)
        if self.critic == "cql" and self.batch_size < 2:
            raise GuiderError("batch_size must be 2 or more: CQL draws from the range of a batch")


STEADY_CRITIC: Changes = {
    "samples": 2,
    "backup": "max_of_min",
    "uniform_box": "per_entry",
    "lagrange_threshold": None,
    "conservative_weight": 0.5,
    "cap_targets": True,
    "temperature_loss": "log_alpha",
    "initialisation": "fan_in",
}
"""Preset `fast`: values that stay at or below 0, from few samples."""
FAST: Changes = STEADY_CRITIC | {
    "updates": 5_000,
    "learning_rate": 1e-3,
    "hidden": (256, 256),
    "relabel_fraction": 0.7,
    "random_goal_fraction": 0.3,
}
"""What it changes in all."""


class Params(NamedTuple):
    """`value` only serves the expectile critic, `lagrange` only CQL's; both are carried always."""

    actor: Layers
    critic: Layers
    value: Layers
    log_alpha: jax.Array
    log_lagrange: jax.Array


class SubgoalPolicyState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: Moments


class Transitions(NamedTuple):
    """Relabelled transitions as the networks see them (Algorithm 1, line 10).

    state, next_state: [B, inputs] scaled (s^G, g_final); latent: [B, Z]; reward: [B], 0 where the goal is met
    after the step, else below; prior, next_prior: rho(z | s^G_t) and rho(z | s^G_{t+c}).
    """

    state: jax.Array
    latent: jax.Array
    reward: jax.Array
    next_state: jax.Array
    prior: Gaussian
    next_prior: Gaussian


def init(key: jax.Array, config: SubgoalPolicyConfig, state_dim: int, latent_dim: int) -> SubgoalPolicyState:
    actor_key, critic_key, value_key = jax.random.split(key, 3)
    style = config.initialisation
    params = Params(
        actor=mlp_init(actor_key, (state_dim, *config.hidden, 2 * latent_dim), style),
        critic=twin_init(critic_key, (state_dim + latent_dim, *config.hidden, 1), style),
        value=mlp_init(value_key, (state_dim, *config.hidden, 1), style),
        log_alpha=jnp.zeros(()),
        log_lagrange=jnp.zeros(()),
    )
    return SubgoalPolicyState(params, params.critic, adam_init(params))


def inputs(scale: Scale, achieved: jax.Array, goal: jax.Array) -> jax.Array:
    """What the networks see: scaled (s^G, g_final), [..., inputs]."""
    return jnp.concatenate([scale.position(achieved), scale.position(goal)], axis=-1)


def propose(params: Params, state: jax.Array) -> Gaussian:
    """pi_h(z | s^G, g_final). state: [..., inputs] scaled (s^G, g_final)."""
    return gaussian_head(mlp(params.actor, state))


def values(params: Params, state: jax.Array, latent: jax.Array) -> jax.Array:
    """The smaller critic's: state [B, inputs], latent [B, Z] or [B, N, Z] -> [B] or [B, N]."""
    return twin_values(params.critic, state, latent).min(axis=0)


def best(params: Params, state: jax.Array, latents: jax.Array) -> jax.Array:
    """The latent that the critic holds for best of each N: [B, N, Z] -> [B, Z]."""
    chosen = values(params, state, latents).argmax(axis=1)
    return jnp.take_along_axis(latents, chosen[:, None, None], axis=1)[:, 0]


def _cap(config: SubgoalPolicyConfig, target: jax.Array) -> jax.Array:
    return jnp.minimum(target, 0.0) if config.cap_targets else target


def _divergence(config: SubgoalPolicyConfig, policy: Gaussian, prior: Gaussian, latent: jax.Array) -> jax.Array:
    """What alpha weighs, [B]: KL(pi_h || rho) in nats, mean over dimensions; without the prior, log pi_h(latent)."""
    return losses.gaussian_kl(policy, prior).mean(axis=-1) if config.prior else policy.log_prob(latent)


def _td_critic_loss(
    config: SubgoalPolicyConfig, params: Params, target_critic: Layers, batch: Transitions, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Soft actor-critic's (Haarnoja et al. 2018): TD error towards r + gamma * (Q(s', z') - alpha * D(s', z')), z' one
    sample of pi_h, Q the smaller target critic, and D, in place of the entropy, what the actor is held by. Sum over the
    twins."""
    next_policy = jax.lax.stop_gradient(propose(params, batch.next_state))
    next_latent = next_policy.sample(key)
    next_value = twin_values(target_critic, batch.next_state, next_latent).min(axis=0)
    held = jnp.exp(jax.lax.stop_gradient(params.log_alpha)) * _divergence(
        config, next_policy, batch.next_prior, next_latent
    )
    target = _cap(config, losses.td_target(batch.reward, next_value - held, config.discount))
    values = twin_values(params.critic, batch.state, batch.latent)
    td = ((values - target) ** 2).mean(axis=-1).sum()
    return td, {"target": target.mean(), "td_error": td, "value": values.mean()}


def _cql_critic_loss(
    config: SubgoalPolicyConfig, params: Params, target_critic: Layers, batch: Transitions, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Algorithm 1, line 11, with CQL (Kumar et al. 2020).

    TD error towards r + gamma * the max-Q backup over `samples` latents of pi_h (see `backup`), and the conservative
    gap over uniform, next-state and current policy samples. Sum over the twins.
    """
    next_key, now_key, uniform_key = jax.random.split(key, 3)
    draws = (config.samples,)
    next_policy = jax.lax.stop_gradient(propose(params, batch.next_state))
    next_latents = next_policy.sample(next_key, draws).swapaxes(0, 1)
    next_values = twin_values(target_critic, batch.next_state, next_latents)
    if config.backup == "min_of_max":
        next_value = next_values.max(axis=-1).min(axis=0)
    else:
        next_value = next_values.min(axis=0).max(axis=-1)
    target = _cap(config, losses.td_target(batch.reward, next_value, config.discount))

    policy = jax.lax.stop_gradient(propose(params, batch.state))
    now_latents = policy.sample(now_key, draws).swapaxes(0, 1)
    entries = None if config.uniform_box == "common" else 0
    low, high = batch.latent.min(axis=entries), batch.latent.max(axis=entries)
    uniform = jax.random.uniform(uniform_key, now_latents.shape, minval=low, maxval=high)
    log_volume = jnp.broadcast_to(jnp.log(high - low), batch.latent.shape[1:]).sum()
    samples = jnp.concatenate([uniform, next_latents, now_latents], axis=1)
    log_density = jnp.concatenate(
        [
            jnp.full(uniform.shape[:2], -log_volume),
            Gaussian(next_policy.mean[:, None], next_policy.log_std[:, None]).log_prob(next_latents),
            Gaussian(policy.mean[:, None], policy.log_std[:, None]).log_prob(now_latents),
        ],
        axis=1,
    )
    fused = twin_values(params.critic, batch.state, jnp.concatenate([batch.latent[:, None], samples], axis=1))
    values, sampled = fused[..., 0], fused[..., 1:]
    td = ((values - target) ** 2).mean(axis=-1).sum()
    gap = losses.conservative_gap(sampled, log_density, values).mean(axis=-1)
    metrics = {"target": target.mean(), "td_error": td, "value": values.mean(), "conservative_gap": gap.mean()}
    if config.lagrange_threshold is None:
        return td + config.conservative_weight * gap.sum(), metrics
    excess = config.conservative_weight * gap - config.lagrange_threshold
    lagrange = jnp.clip(jnp.exp(params.log_lagrange), 0.0, 1e6)
    conservative = jax.lax.stop_gradient(lagrange) * excess.sum()
    lagrange_loss = -lagrange * jax.lax.stop_gradient(excess).mean()
    return td + conservative + lagrange_loss, metrics | {"lagrange": lagrange}


def _expectile_critic_loss(
    config: SubgoalPolicyConfig, params: Params, target_critic: Layers, batch: Transitions
) -> tuple[jax.Array, Metrics]:
    """V by expectile regression on Q over the data's latents, Q by TD on V (Kostrikov et al. 2022)."""
    next_value = jax.lax.stop_gradient(mlp(params.value, batch.next_state)[..., 0])
    target = _cap(config, losses.td_target(batch.reward, next_value, config.discount))
    values = twin_values(params.critic, batch.state, batch.latent)
    td = ((values - target) ** 2).mean(axis=-1).sum()
    frozen = twin_values(target_critic, batch.state, batch.latent).min(axis=0)
    error = frozen - mlp(params.value, batch.state)[..., 0]
    expectile = losses.expectile_loss(error, config.expectile).mean()
    return td + expectile, {"target": target.mean(), "td_error": td, "value": values.mean()}


def _actor_loss(
    config: SubgoalPolicyConfig, params: Params, batch: Transitions, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Eq. 4 negated: E_{z ~ pi_h}[alpha * D - Q(s^G, z, g_final)], and alpha's own loss.

    D is KL(pi_h || rho), tuned to `target_divergence`; without the prior it is log pi_h, tuned to an entropy of
    -latent_dim (see `_divergence`). Q is the smaller of the twins.
    """
    policy = propose(params, batch.state)
    latent = policy.sample(key)
    value = twin_values(jax.lax.stop_gradient(params.critic), batch.state, latent).min(axis=0)
    divergence = _divergence(config, policy, batch.prior, latent)
    aim = config.target_divergence if config.prior else float(latent.shape[-1])
    alpha = jnp.exp(params.log_alpha)
    actor = (jax.lax.stop_gradient(alpha) * divergence - value).mean()
    tuned = alpha if config.temperature_loss == "alpha" else params.log_alpha
    temperature = -tuned * jax.lax.stop_gradient(divergence.mean() - aim)
    metrics = {"divergence": divergence.mean(), "alpha": alpha, "policy_value": value.mean()}
    return actor + temperature, metrics


def update(
    config: SubgoalPolicyConfig, state: SubgoalPolicyState, batch: Transitions, key: jax.Array
) -> tuple[SubgoalPolicyState, Metrics]:
    """One step of Algorithm 1, lines 11-12. Critic and actor read the same parameters and move together."""
    critic_key, actor_key = jax.random.split(key)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        if config.critic == "expectile":
            critic, critic_metrics = _expectile_critic_loss(config, params, state.target_critic, batch)
        else:
            critic_loss = _cql_critic_loss if config.critic == "cql" else _td_critic_loss
            critic, critic_metrics = critic_loss(config, params, state.target_critic, batch, critic_key)
        actor, actor_metrics = _actor_loss(config, params, batch, actor_key)
        return critic + actor, critic_metrics | actor_metrics

    gradients, metrics = jax.grad(loss, has_aux=True)(state.params)
    params, optimiser = adam_step(config.learning_rate, state.params, gradients, state.optimiser)
    target_critic = trail(state.target_critic, params.critic, config.target_rate)
    return SubgoalPolicyState(params, target_critic, optimiser), metrics
