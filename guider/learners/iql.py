"""Implicit Q-learning (Kostrikov et al. 2022), conditioned on goals: no action is asked for that the data lacks.

Where the authors' code and this file differ: the policy has a fixed spread, and no dropout or cosine rate in `paper`;
the Bellman target stops at a met goal; V, Q and policy step together; networks start as PyTorch's do; three layers of
256, where theirs are two, as for all flat methods here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax

from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig, most_likely, predict, regress
from guider.learners.types import LONG, Transitions
from guider.learning import losses
from guider.learning.networks import Layers, mlp, mlp_init, twin_init, twin_values
from guider.learning.optimisers import Moments, Rate, adam_init, adam_step, trail
from guider.learning.training import Metrics
from guider.support.config import ByDomain, Changes, check_fraction, check_positive, under


@dataclass(frozen=True)
class IqlConfig:
    """Settings. Defaults are the authors' for antmaze."""

    kind: Literal["iql"] = "iql"
    discount: float = 0.99
    target_rate: float = 0.005
    expectile: float = 0.9
    temperature: float = 0.1
    """Advantages are divided by this before the exponential."""
    weight_ceiling: float = 100.0
    regression: RegressionConfig = field(default_factory=RegressionConfig)

    def __post_init__(self) -> None:
        check_positive(self, "weight_ceiling", "temperature")
        check_fraction(self, "discount", "target_rate", "expectile")


FAST: Changes = {"expectile": 0.7, "temperature": 0.5}
FAST_IN_DOMAIN: ByDomain = {
    "antmaze": LONG,
    "pointmaze": LONG,
    "kitchen": LONG | under("regression", FROM_DEMONSTRATIONS),
}


class Params(NamedTuple):
    actor: Layers
    critic: Layers
    value: Layers


class IqlState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: Moments


def init(key: jax.Array, config: IqlConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> IqlState:
    actor_key, critic_key, value_key = jax.random.split(key, 3)
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *hidden, action_dim)),
        critic=twin_init(critic_key, (input_dim + action_dim, *hidden, 1)),
        value=mlp_init(value_key, (input_dim, *hidden, 1)),
    )
    return IqlState(params, params.critic, adam_init(params))


def act(config: IqlConfig, state: IqlState, inputs: jax.Array) -> jax.Array:
    """Mean of pi(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return most_likely(state.params.actor, inputs)


def update(
    config: IqlConfig, state: IqlState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[IqlState, Metrics]:
    """One step of V (expectile of Q over logged actions), Q (towards r + gamma V(s', g)) and the policy (regression
    weighted by exp(A / temperature), A = Q - V). `key` is for dropout."""
    old = state.params
    target = losses.td_target(batch.reward, mlp(old.value, batch.next_state)[..., 0], config.discount)
    logged = twin_values(state.target_critic, batch.state, batch.action).min(axis=0)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        values = twin_values(params.critic, batch.state, batch.action)
        td = ((values - target) ** 2).mean(axis=-1).sum()
        error = logged - mlp(params.value, batch.state)[..., 0]
        expectile = losses.expectile_loss(error, config.expectile).mean()
        advantage = jax.lax.stop_gradient(error)
        weight = losses.advantage_weight(advantage, config.temperature, config.weight_ceiling)
        predicted = predict(config.regression, params.actor, batch.state, key)
        regression, error_metrics = regress(config.regression, weight, predicted, batch.action)
        metrics = {
            "td_error": td,
            "value": values.mean(),
            "advantage_std": advantage.std(),
            "weight": weight.mean(),
        }
        return td + expectile + regression, metrics | error_metrics

    gradients, metrics = jax.grad(loss, has_aux=True)(old)
    params, optimiser = adam_step(rate, old, gradients, state.optimiser)
    target_critic = trail(state.target_critic, params.critic, config.target_rate)
    return IqlState(params, target_critic, optimiser), metrics
