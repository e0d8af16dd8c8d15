"""Guider's own low level (Section 4.4, Eq. 5-6, Algorithm 1 lines 13-18): advantage-weighted regression with a critic.

Where the authors' code and this file differ: the target critics start as copies of the critics; the Bellman target
stops at a met goal; critic and actor take one step together, from the parameters before it, and one draw of pi_l(s')
serves both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig, most_likely, regress
from guider.learners.types import Transitions
from guider.learning import losses
from guider.learning.networks import Initialisation, Layers, gaussian_head, mlp, mlp_init, twin_init, twin_values
from guider.learning.optimisers import Moments, Rate, adam_init, adam_step, trail
from guider.learning.training import Metrics
from guider.support.config import ByDomain, Changes, check_fraction, check_positive, under


@dataclass(frozen=True)
class AwrConfig:
    """Settings. Defaults are the authors' (preset `paper`)."""

    kind: Literal["awr"] = "awr"
    discount: float = 0.99
    target_rate: float = 0.005
    weight_ceiling: float = 10.0
    temperature: float = 1.0
    """Advantages are divided by this before the exponential; 1 is Eq. 6."""
    advantage: Literal["one_step", "action_value"] = "one_step"
    """A of Eq. 6. one_step, the authors': r + gamma * Q1(s', pi_l(s')) - Q1(s, pi_l(s)); action_value: min Q(s, a) -
    min Q(s, pi_l(s)) (departure)."""
    policy: Literal["gaussian", "tanh"] = "gaussian"
    """gaussian, the authors': mean and spread are learned, samples are regressed on the logged action and shown to the
    critic, the mean acts; tanh: one action, squashed into the bounds (departure)."""
    initialisation: Initialisation = "small_outputs"
    regression: RegressionConfig = field(default_factory=RegressionConfig)

    def __post_init__(self) -> None:
        check_positive(self, "weight_ceiling", "temperature")
        check_fraction(self, "discount", "target_rate")


FAST: Changes = {"advantage": "action_value", "policy": "tanh", "initialisation": "fan_in"}
FAST_IN_DOMAIN: ByDomain = {"kitchen": under("regression", FROM_DEMONSTRATIONS)}
"""What lies c steps ahead is pursued: the discount stays."""


class Params(NamedTuple):
    actor: Layers
    critic: Layers


class AwrState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: Moments


def init(key: jax.Array, config: AwrConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> AwrState:
    actor_key, critic_key = jax.random.split(key)
    outputs = 2 * action_dim if config.policy == "gaussian" else action_dim
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *hidden, outputs), config.initialisation),
        critic=twin_init(critic_key, (input_dim + action_dim, *hidden, 1), config.initialisation),
    )
    return AwrState(params, params.critic, adam_init(params))


def act(config: AwrConfig, state: AwrState, inputs: jax.Array) -> jax.Array:
    """Mean of pi_l(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    if config.policy == "tanh":
        return most_likely(state.params.actor, inputs)
    return jnp.clip(gaussian_head(mlp(state.params.actor, inputs)).mean, -1.0, 1.0)


def _sample(config: AwrConfig, actor: Layers, inputs: jax.Array, key: jax.Array, learning: bool) -> jax.Array:
    """An action of pi_l(a | s, g), [B, A]: of `gaussian` a sample, of `tanh` the only one. learning: with dropout."""
    dropout = config.regression.dropout if learning else 0.0
    outputs = mlp(actor, inputs, dropout=dropout, key=key)
    if config.policy == "tanh":
        return jnp.tanh(outputs)
    return gaussian_head(outputs).sample(jax.random.fold_in(key, len(actor)))  # dropout folds in less


def update(
    config: AwrConfig, state: AwrState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[AwrState, Metrics]:
    """One step of Algorithm 1, lines 17-18. `key` is for dropout and for samples of a Gaussian policy.

    Critic: TD error towards r + gamma * min Q(s', pi_l(s')), sum over the twins. Actor: Eq. 6, with A as `advantage`
    says, its gradient through log pi_l alone.
    """
    old = state.params
    next_action = _sample(
        config, old.actor, batch.next_state, jax.random.fold_in(key, len(old.actor) + 1), learning=False
    )
    next_value = twin_values(state.target_critic, batch.next_state, next_action).min(axis=0)
    target = losses.td_target(batch.reward, next_value, config.discount)
    first = jax.tree.map(lambda leaf: leaf[:1], old.critic)
    ahead = losses.td_target(batch.reward, twin_values(first, batch.next_state, next_action)[0], config.discount)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        values = twin_values(params.critic, batch.state, batch.action)
        td = ((values - target) ** 2).mean(axis=-1).sum()
        predicted = _sample(config, params.actor, batch.state, key, learning=True)
        if config.advantage == "one_step":
            advantage = ahead - twin_values(first, batch.state, predicted)[0]
        else:
            advantage = values.min(axis=0) - twin_values(old.critic, batch.state, predicted).min(axis=0)
        weight = losses.advantage_weight(advantage, config.temperature, config.weight_ceiling)
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
    target_critic = trail(state.target_critic, params.critic, config.target_rate)
    return AwrState(params, target_critic, optimiser), metrics
