"""Goal-conditioned supervised learning (Ghosh et al. 2021): regress the logged action on state and goal.

With goals taken from the future of the same episode it is GCSL; with each episode's own goal, plain behaviour cloning.
Where the authors' code and this file differ: it learns from logged data alone, as WGCSL's authors run it; actions are
continuous, with a fixed spread, where theirs are discrete; the horizon left is not shown.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig, most_likely, predict, regress
from guider.learners.types import Transitions
from guider.learning.networks import Layers, mlp_init
from guider.learning.optimisers import Moments, Rate, adam_init, adam_step
from guider.learning.training import Metrics
from guider.support.config import ByDomain, Changes, under


@dataclass(frozen=True)
class GcslConfig:
    """Settings."""

    kind: Literal["gcsl"] = "gcsl"
    regression: RegressionConfig = field(default_factory=RegressionConfig)


FAST: Changes = {}
FAST_IN_DOMAIN: ByDomain = {"kitchen": under("regression", FROM_DEMONSTRATIONS)}


class GcslState(NamedTuple):
    """params: of the actor."""

    params: Layers
    optimiser: Moments


def init(key: jax.Array, config: GcslConfig, hidden: tuple[int, ...], input_dim: int, action_dim: int) -> GcslState:
    params = mlp_init(key, (input_dim, *hidden, action_dim))
    return GcslState(params, adam_init(params))


def act(config: GcslConfig, state: GcslState, inputs: jax.Array) -> jax.Array:
    """Mean of pi(a | s, g), in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return most_likely(state.params, inputs)


def update(
    config: GcslConfig, state: GcslState, batch: Transitions, key: jax.Array, rate: Rate
) -> tuple[GcslState, Metrics]:
    """One step on the log-likelihood of the logged actions (a Gaussian of fixed spread). `key` is for dropout."""

    def loss(params: Layers) -> tuple[jax.Array, Metrics]:
        predicted = predict(config.regression, params, batch.state, key)
        weight = jnp.ones_like(batch.reward)
        return regress(config.regression, weight, predicted, batch.action)

    gradients, metrics = jax.grad(loss, has_aux=True)(state.params)
    params, optimiser = adam_step(rate, state.params, gradients, state.optimiser)
    return GcslState(params, optimiser), metrics
