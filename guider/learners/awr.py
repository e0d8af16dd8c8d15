"""Guider's own low level (Section 4.4, Eq. 5-6, Algorithm 1 lines 13-18): advantage-weighted regression with a critic.

Where the authors' code and this file differ: the target critics start as copies of the critics, and the
Bellman target stops at a met goal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax

from guider import losses
from guider.config import check_fraction, check_positive
from guider.learners.regression import RegressionConfig, most_likely, predict, regress
from guider.learners.types import Transitions
from guider.networks import Layers, mlp_init, twin_init, twin_values
from guider.optimisers import Moments, Rate, adam_init, adam_step, trail
from guider.training import Metrics


@dataclass(frozen=True)
class AwrConfig:
    """Settings. Defaults are the authors' (preset `paper`)."""

    kind: Literal["awr"] = "awr"
    discount: float = 0.99
    target_rate: float = 0.005
    weight_ceiling: float = 10.0
    temperature: float = 1.0
    """Advantages are divided by this before the exponential; 1 is Eq. 6."""
    regression: RegressionConfig = field(default_factory=RegressionConfig)

    def __post_init__(self) -> None:
        check_positive(self, "weight_ceiling", "temperature")
        check_fraction(self, "discount", "target_rate")


class Params(NamedTuple):
    actor: Layers
    critic: Layers


class AwrState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: Moments


def init(key: jax.Array, config: AwrConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> AwrState:
    actor_key, critic_key = jax.random.split(key)
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *hidden, action_dim)),
        critic=twin_init(critic_key, (input_dim + action_dim, *hidden, 1)),
    )
    return AwrState(params, params.critic, adam_init(params))


def act(state: AwrState, inputs: jax.Array) -> jax.Array:
    """Mean of pi_l(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return most_likely(state.params.actor, inputs)


def update(
    config: AwrConfig, state: AwrState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[AwrState, Metrics]:
    """One step of Algorithm 1, lines 17-18. `key` is for dropout.

    Critic: TD error towards r + gamma * min Q(s', pi_l(s')), sum over the twins. Actor: Eq. 6, where
    A = min Q(s, a) - min Q(s, pi_l(s)), its gradient through log pi_l alone.
    """
    old = state.params
    next_value = twin_values(state.target_critic, batch.next_state, most_likely(old.actor, batch.next_state)).min(
        axis=0
    )
    target = losses.td_target(batch.reward, next_value, config.discount)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        values = twin_values(params.critic, batch.state, batch.action)
        td = ((values - target) ** 2).mean(axis=-1).sum()
        predicted = predict(config.regression, params.actor, batch.state, key)
        baseline = twin_values(old.critic, batch.state, jax.lax.stop_gradient(predicted)).min(axis=0)
        advantage = jax.lax.stop_gradient(values.min(axis=0) - baseline)
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
