"""V(s, g) by expectile regression, learned without actions: implicit V-learning (the value of HIQL, Park et al. 2023;
OGBench's GCIVL). Actions are weighed by the step's gain in V."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from guider.critics.types import Steps
from guider.learning import losses
from guider.learning.networks import Layers, layer_norm_mlp, twin_init
from guider.learning.training import Metrics
from guider.support.config import check_fraction


@dataclass(frozen=True)
class ImplicitVConfig:
    """Settings. Defaults are OGBench's."""

    kind: Literal["ivl"] = "ivl"
    expectile: float = 0.9

    def __post_init__(self) -> None:
        check_fraction(self, "expectile")


Params = Layers
"""Of V's twins."""


def init(
    key: jax.Array, config: ImplicitVConfig, hidden: tuple[int, ...], state_dim: int, place_dim: int, action_dim: int
) -> Params:
    return twin_init(key, (state_dim + place_dim, *hidden, 1))


def values(params: Params, state: jax.Array, goal: jax.Array) -> jax.Array:
    """Both estimates of V(s, g): [2, B], minus the discounted steps to the goal."""
    seen = jnp.concatenate([state, goal], axis=-1)
    return jax.vmap(lambda layers: layer_norm_mlp(layers, seen)[..., 0])(params)


def loss(
    config: ImplicitVConfig, params: Params, target: Params, steps: Steps, discount: float
) -> tuple[jax.Array, Metrics]:
    """Expectile regression of V(s, g) on r + gamma * V_target(s', g); sum over the twins.

    Each twin regresses on its own target; which side of the expectile a row is on is the sign of
    A = r + gamma * min V_target(s', g) minus the mean of V_target(s, g), for both.
    """
    following = discount * steps.unmet * values(target, steps.next_state, steps.goal)
    advantage = following.min(axis=0) - steps.unmet - values(target, steps.state, steps.goal).mean(axis=0)
    estimate = values(params, steps.state, steps.goal)
    weight = losses.expectile_weight(advantage, config.expectile)
    error = weight * (following - steps.unmet - estimate) ** 2
    return error.mean(axis=-1).sum(), {"value_error": error.mean(), "value": estimate.mean()}


def advantage(config: ImplicitVConfig, params: Params, steps: Steps) -> jax.Array:
    """How much nearer the step came, [B]: V(s', g) - V(s, g), means of the twins."""
    after, before = values(params, steps.next_state, steps.goal), values(params, steps.state, steps.goal)
    return (after - before).mean(axis=0)
