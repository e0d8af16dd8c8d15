"""Regression of logged actions, which most learners share, and how errors count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from guider.learning import losses
from guider.learning.networks import Layers, mlp
from guider.learning.training import Metrics
from guider.support.config import Changes


@dataclass(frozen=True)
class RegressionConfig:
    """Settings. Defaults are those of all authors."""

    error: Literal["squared", "absolute"] = "squared"
    """-log pi for a Gaussian of fixed spread, or for a Laplace distribution: the mean of what was done, or the median
    (departure)."""


FROM_DEMONSTRATIONS: Changes = {"error": "absolute"}
"""Preset `fast` where a centimetre decides and demonstrators differ: what one of them did, not what lies between."""


def most_likely(actor: Layers, inputs: jax.Array) -> jax.Array:
    """The action pi(a | s, g) is centred on, in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return jnp.tanh(mlp(actor, inputs))


def regress(
    config: RegressionConfig, weight: jax.Array, predicted: jax.Array, action: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Mean weighted regression loss, and the mean squared error whatever the loss counts. See losses."""
    loss = losses.weighted_regression(weight, predicted, action, config.error).mean()
    return loss, {"action_error": ((predicted - action) ** 2).mean()}
