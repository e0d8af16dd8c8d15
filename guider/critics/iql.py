"""Q(s, a, g) with V(s, g), its expectile over logged actions: implicit Q-learning (Kostrikov et al. 2022) towards goals
(OGBench's GCIQL)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.critics.types import Steps
from guider.learning import losses
from guider.learning.networks import Layers, layer_norm_mlp, mlp_init, twin_init
from guider.learning.training import Metrics
from guider.support.config import check_fraction


@dataclass(frozen=True)
class ImplicitQConfig:
    """Settings. Defaults are OGBench's."""

    kind: Literal["iql"] = "iql"
    expectile: float = 0.9

    def __post_init__(self) -> None:
        check_fraction(self, "expectile")


class Params(NamedTuple):
    value: Layers
    twins: Layers


def init(
    key: jax.Array, config: ImplicitQConfig, hidden: tuple[int, ...], state_dim: int, place_dim: int, action_dim: int
) -> Params:
    value_key, twins_key = jax.random.split(key)
    return Params(
        value=mlp_init(value_key, (state_dim + place_dim, *hidden, 1)),
        twins=twin_init(twins_key, (state_dim + place_dim + action_dim, *hidden, 1)),
    )


def value(params: Params, state: jax.Array, goal: jax.Array) -> jax.Array:
    """V(s, g): [B], minus the discounted steps to the goal."""
    return layer_norm_mlp(params.value, jnp.concatenate([state, goal], axis=-1))[..., 0]


def qualities(params: Params, state: jax.Array, action: jax.Array, goal: jax.Array) -> jax.Array:
    """Both estimates of Q(s, a, g): [2, B]."""
    seen = jnp.concatenate([state, goal, action], axis=-1)
    return jax.vmap(lambda layers: layer_norm_mlp(layers, seen)[..., 0])(params.twins)


def loss(
    config: ImplicitQConfig, params: Params, target: Params, steps: Steps, discount: float
) -> tuple[jax.Array, Metrics]:
    """Expectile regression of V on min Q_target(s, a, g), and regression of both Q on r + gamma * V(s', g)."""
    logged = qualities(target, steps.state, steps.action, steps.goal).min(axis=0)
    current = value(params, steps.state, steps.goal)
    expectile = losses.expectile_loss(logged - current, config.expectile).mean()
    following = jax.lax.stop_gradient(value(params, steps.next_state, steps.goal))
    goal = steps.unmet * (discount * following - 1)
    estimate = qualities(params, steps.state, steps.action, steps.goal)
    error = ((estimate - goal) ** 2).sum(axis=0).mean()
    return expectile + error, {"value_error": expectile, "td_error": error, "value": current.mean()}


def quality(config: ImplicitQConfig, params: Params, state: jax.Array, action: jax.Array, goal: jax.Array) -> jax.Array:
    """The smaller Q(s, a, g), [B]."""
    return qualities(params, state, action, goal).min(axis=0)
