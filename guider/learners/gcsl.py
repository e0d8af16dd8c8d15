"""Goal-conditioned supervised learning (Ghosh et al. 2021): regress the logged action on state and goal.

With goals taken from the future of the same episode it is GCSL; with each episode's own goal, plain behaviour cloning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider import losses
from guider.learners.types import Metrics, Transitions
from guider.networks import Layers, mlp, mlp_init
from guider.optimisers import Moments, Rate, adam_init, adam_step


@dataclass(frozen=True)
class GcslConfig:
    """There is nothing to set."""

    kind: Literal["gcsl"] = "gcsl"


class GcslState(NamedTuple):
    """params: of the actor."""

    params: Layers
    optimiser: Moments


def init(key: jax.Array, config: GcslConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> GcslState:
    params = mlp_init(key, (input_dim, *hidden, action_dim))
    return GcslState(params, adam_init(params))


def act(state: GcslState, inputs: jax.Array) -> jax.Array:
    """Mean of pi(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return jnp.tanh(mlp(state.params, inputs))


def update(
    config: GcslConfig, state: GcslState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[GcslState, Metrics]:
    """One step on the log-likelihood of the logged actions (a Gaussian of fixed spread). `key` is not needed."""

    def loss(params: Layers) -> jax.Array:
        predicted = jnp.tanh(mlp(params, batch.state))
        return losses.weighted_regression(jnp.ones_like(batch.reward), predicted, batch.action).mean()

    error, gradients = jax.value_and_grad(loss)(state.params)
    params, optimiser = adam_step(rate, state.params, gradients, state.optimiser)
    return GcslState(params, optimiser), {"action_error": error}
