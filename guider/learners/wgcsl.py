"""Weighted goal-conditioned supervised learning (Yang et al. 2022), each of its three weights a switch of its own.

Where the authors' code and this file differ: policy and critic learn from one batch and step together, the policy from
its rows whose goal lies ahead in their own episode, instead of all rows before a fifth of their goals are put back;
targets trail at every update instead of by a tenth every 20; networks start as PyTorch's do. For the mixed sets of all
but Reach the authors turn the discount weight off (`discount_weight`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig, most_likely, predict, regress
from guider.learners.types import LONG, Transitions
from guider.learning import losses
from guider.learning.networks import Layers, mlp_init, twin_init, twin_values
from guider.learning.optimisers import Moments, Rate, adam_init, adam_step, trail
from guider.learning.training import Metrics
from guider.support.config import ByDomain, Changes, check_fraction, check_not_negative, check_positive, under


@dataclass(frozen=True)
class WgcslConfig:
    """Settings. Defaults are the authors'; without any of the three weights, the policy learns as GCSL's."""

    kind: Literal["wgcsl"] = "wgcsl"
    discount: float = 0.98
    twins: bool = False
    """Take the smaller of two critics (departure)."""
    input_limit: float = 5.0
    """Scaled states and goals are clipped to +- this."""
    target_rate: float = 0.005
    discount_weight: bool = True
    """Weigh a goal k steps ahead by gamma^(k - 1)."""
    advantage_weight: bool = True
    """Weigh by exp(A), clipped to [0, weight_ceiling], with A = r + gamma V(s', g) - V(s, g)."""
    best_advantage_weight: bool = True
    """Weigh by `poor_weight` what lies below a percentile of recent advantages."""
    weight_ceiling: float = 10.0
    poor_weight: float = 0.05
    percentile_rise: float = 0.01
    """Points that the percentile rises per update, from 0 (0.15 on the authors' Reach) ..."""
    percentile_ceiling: float = 80.0
    """... up to here."""
    recent_advantages: int = 50_000
    """How many advantages the percentile is taken of."""
    regression: RegressionConfig = field(default_factory=RegressionConfig)

    def __post_init__(self) -> None:
        check_positive(self, "weight_ceiling", "recent_advantages", "input_limit")
        check_not_negative(self, "percentile_rise")
        check_fraction(self, "discount", "target_rate", "poor_weight")


FAST: Changes = {"twins": True, "recent_advantages": 4096}
# Where all episodes are alike, the best advantages are noise.
_LONG = LONG | {"best_advantage_weight": False}
FAST_IN_DOMAIN: ByDomain = {
    "antmaze": _LONG,
    "pointmaze": _LONG,
    "kitchen": _LONG | under("regression", FROM_DEMONSTRATIONS),
}


class Params(NamedTuple):
    actor: Layers
    critic: Layers


class WgcslState(NamedTuple):
    """recent: [recent_advantages] a ring of advantages; seen: how many were ever written."""

    params: Params
    target: Params
    optimiser: Moments
    recent: jax.Array
    seen: jax.Array


def init(key: jax.Array, config: WgcslConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> WgcslState:
    actor_key, critic_key = jax.random.split(key)
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *hidden, action_dim)),
        critic=jax.tree.map(
            lambda leaf: leaf if config.twins else leaf[:1], twin_init(critic_key, (input_dim + action_dim, *hidden, 1))
        ),
    )
    recent = jnp.zeros(config.recent_advantages)
    return WgcslState(params, params, adam_init(params), recent, jnp.zeros((), jnp.int32))


def act(config: WgcslConfig, state: WgcslState, inputs: jax.Array) -> jax.Array:
    """Mean of pi(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return most_likely(state.params.actor, _clipped(config, inputs))


def _clipped(config: WgcslConfig, inputs: jax.Array) -> jax.Array:
    return jnp.clip(inputs, -config.input_limit, config.input_limit)


def weights(config: WgcslConfig, advantage: jax.Array, steps: jax.Array, threshold: jax.Array) -> jax.Array:
    """The product of the weights that are on, [B]; 0 where the goal does not lie ahead in the row's own episode.

    advantage: [B]; steps: [B], see Transitions; threshold: advantages below it are poor.
    """
    weight = jnp.where(steps >= 0, 1.0, 0.0)
    if config.discount_weight:
        weight *= config.discount ** jnp.maximum(steps - 1, 0)
    if config.advantage_weight:
        weight *= losses.advantage_weight(advantage, 1.0, config.weight_ceiling)
    if config.best_advantage_weight:
        weight *= jnp.where(advantage >= threshold, 1.0, config.poor_weight)
    return weight


def update(
    config: WgcslConfig, state: WgcslState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[WgcslState, Metrics]:
    """One step of critic and policy. `key` is for dropout.

    Rewards are 1 where the goal is met after the step, else 0, and do not end the episode; targets are clipped to
    +-1 / (1 - gamma). Targets are of the trailing policy and critic, advantages of those that learn.
    """
    old = state.params
    reward = jnp.where(batch.reward < 0, 0.0, 1.0)
    batch = batch._replace(state=_clipped(config, batch.state), next_state=_clipped(config, batch.next_state))

    def value(params: Params, inputs: jax.Array) -> jax.Array:
        return twin_values(params.critic, inputs, most_likely(params.actor, inputs)).min(axis=0)

    ceiling = 1 / (1 - config.discount)
    target = jnp.clip(reward + config.discount * value(state.target, batch.next_state), -ceiling, ceiling)
    advantage = reward + config.discount * value(old, batch.next_state) - value(old, batch.state)

    size = len(state.recent)
    recent = state.recent.at[(state.seen + jnp.arange(len(advantage))) % size].set(advantage)
    seen = state.seen + len(advantage)
    percentile = jnp.minimum(config.percentile_rise * state.optimiser.count, config.percentile_ceiling)
    threshold = jnp.nanpercentile(jnp.where(jnp.arange(size) < seen, recent, jnp.nan), percentile)
    weight = weights(config, advantage, batch.steps, threshold)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        values = twin_values(params.critic, batch.state, batch.action)
        td = ((values - target) ** 2).mean(axis=-1).sum()
        predicted = predict(config.regression, params.actor, batch.state, key)
        regression, error_metrics = regress(config.regression, weight, predicted, batch.action)
        metrics = {
            "td_error": td,
            "value": values.mean(),
            "advantage_std": advantage.std(),
            "weight": weight.mean(),
        }
        return td + regression, metrics | error_metrics

    gradients, metrics = jax.grad(loss, has_aux=True)(old)
    params, optimiser = adam_step(rate, old, gradients, state.optimiser)
    return WgcslState(params, trail(state.target, params, config.target_rate), optimiser, recent, seen), metrics
