"""CQL+HER: conservative Q-learning (Kumar et al. 2020; CQL(H) on a soft actor-critic) on relabelled goals.

Where the authors' code and this file differ: its weight is fixed instead of tuned by a threshold; the Bellman target
stops at a met goal; targets start as copies of the critics; the backup and the penalty share the samples of the next
state, and the best by the smaller critic is backed up; cloning, if any, goes on throughout; critic, actor and alpha
step together. Guider's authors published no code of their CQL+HER.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig, regress
from guider.learners.types import LONG, Transitions
from guider.learning import losses
from guider.learning.networks import Gaussian, Layers, gaussian_head, mlp, mlp_init, twin_init, twin_values
from guider.learning.optimisers import Moments, Rate, adam_init, adam_step, trail
from guider.learning.training import Metrics
from guider.support.config import ByDomain, Changes, check_fraction, check_not_negative, check_positive, under


@dataclass(frozen=True)
class CqlConfig:
    """Settings. Defaults are CQL's for antmaze, with its weight fixed instead of tuned by a threshold."""

    kind: Literal["cql"] = "cql"
    discount: float = 0.99
    target_rate: float = 0.005
    samples: int = 10
    """Actions drawn from each of the three proposals, and for the max-Q backup."""
    conservative_weight: float = 5.0
    cloning_weight: float = 0.0
    """Of the regression on the logged action in the actor's loss (departure; CQL clones in early updates alone)."""
    regression: RegressionConfig = field(default_factory=RegressionConfig)
    """How cloning counts errors."""

    def __post_init__(self) -> None:
        check_positive(self, "samples")
        check_not_negative(self, "conservative_weight", "cloning_weight")
        check_fraction(self, "discount", "target_rate")


FAST: Changes = {"samples": 2, "conservative_weight": 1.0, "cloning_weight": 10.0}
"""Values that stay low, from few samples, and a policy near the data."""
FAST_IN_DOMAIN: ByDomain = {
    "antmaze": LONG,
    "pointmaze": LONG,
    # Values of up to 4 / (1 - discount) would drown the cloning.
    "kitchen": LONG | under("regression", FROM_DEMONSTRATIONS) | {"cloning_weight": 1000.0},
}


class Params(NamedTuple):
    actor: Layers
    critic: Layers
    log_alpha: jax.Array


class CqlState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: Moments


def init(key: jax.Array, config: CqlConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> CqlState:
    actor_key, critic_key = jax.random.split(key)
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *hidden, 2 * action_dim)),
        critic=twin_init(critic_key, (input_dim + action_dim, *hidden, 1)),
        log_alpha=jnp.zeros(()),
    )
    return CqlState(params, params.critic, adam_init(params))


def act(config: CqlConfig, state: CqlState, inputs: jax.Array) -> jax.Array:
    """tanh of the mean of pi(. | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return jnp.tanh(_policy(state.params.actor, inputs).mean)


def _policy(actor: Layers, inputs: jax.Array) -> Gaussian:
    """The distribution whose samples tanh turns into actions."""
    return gaussian_head(mlp(actor, inputs))


def squashed_sample(policy: Gaussian, key: jax.Array, count: int) -> tuple[jax.Array, jax.Array]:
    """`count` actions a = tanh(u), u ~ policy, for each of [B] rows: ([B, count, A], log densities [B, count])."""
    raw = policy.sample(key, (count,))
    squeeze = 2 * (jnp.log(2.0) - raw - jax.nn.softplus(-2 * raw))  # log(1 - tanh(u)^2)
    log_density = policy.log_prob(raw) - squeeze.sum(axis=-1)
    return jnp.tanh(raw).swapaxes(0, 1), log_density.swapaxes(0, 1)


def update(
    config: CqlConfig, state: CqlState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[CqlState, Metrics]:
    """One step of critic, actor and entropy temperature alpha (tuned to an entropy of -A). `key` is for samples and
    dropout."""
    uniform_key, next_key, now_key, actor_key = jax.random.split(key, 4)
    old = state.params
    action_dim = batch.action.shape[-1]
    next_actions, next_density = squashed_sample(_policy(old.actor, batch.next_state), next_key, config.samples)
    now_actions, now_density = squashed_sample(_policy(old.actor, batch.state), now_key, config.samples)
    next_value = twin_values(state.target_critic, batch.next_state, next_actions).min(axis=0).max(axis=-1)
    target = losses.td_target(batch.reward, next_value, config.discount)
    uniform = jax.random.uniform(uniform_key, now_actions.shape, minval=-1.0, maxval=1.0)
    uniform_density = jnp.full(now_density.shape, -action_dim * jnp.log(2.0))
    log_density = jnp.concatenate([uniform_density, next_density, now_density], axis=1)
    candidates = jnp.concatenate([batch.action[:, None], uniform, next_actions, now_actions], axis=1)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        fused = twin_values(params.critic, batch.state, candidates)
        values = fused[..., 0]
        td = ((values - target) ** 2).mean(axis=-1).sum()
        gap = losses.conservative_gap(fused[..., 1:], log_density, values).mean(axis=-1)

        policy = _policy(params.actor, batch.state)
        (action,), (density,) = (part.swapaxes(0, 1) for part in squashed_sample(policy, actor_key, 1))
        value = twin_values(old.critic, batch.state, action).min(axis=0)
        alpha = jnp.exp(params.log_alpha)
        actor = (jax.lax.stop_gradient(alpha) * density - value).mean()
        temperature = -params.log_alpha * jax.lax.stop_gradient(density.mean() - action_dim)
        dropout, dropout_key = config.regression.dropout, jax.random.fold_in(key, len(old.actor))
        cloned = jnp.tanh(gaussian_head(mlp(params.actor, batch.state, dropout=dropout, key=dropout_key)).mean)
        cloning, error_metrics = regress(config.regression, jnp.ones_like(batch.reward), cloned, batch.action)
        metrics = {
            "td_error": td,
            "value": values.mean(),
            "conservative_gap": gap.mean(),
            "alpha": alpha,
            "policy_value": value.mean(),
        }
        total = td + config.conservative_weight * gap.sum() + actor + temperature + config.cloning_weight * cloning
        return total, metrics | error_metrics

    gradients, metrics = jax.grad(loss, has_aux=True)(old)
    params, optimiser = adam_step(rate, old, gradients, state.optimiser)
    target_critic = trail(state.target_critic, params.critic, config.target_rate)
    return CqlState(params, target_critic, optimiser), metrics
