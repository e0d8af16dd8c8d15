"""Regression of logged actions, which most learners share: how errors count, and how the network is kept simple."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from guider.errors import GuiderError
from guider.learning import losses
from guider.learning.networks import Layers, mlp
from guider.learning.training import Metrics
from guider.support.config import Changes, check_fraction


@dataclass(frozen=True)
class RegressionConfig:
    """Settings. Defaults are those of all authors."""

    error: Literal["squared", "absolute"] = "squared"
    """-log pi for a Gaussian of fixed spread, or for a Laplace distribution: the mean of what was done, or the median
    (departure)."""
    dropout: float = 0.0
    """Of hidden units while learning (departure)."""

    def __post_init__(self) -> None:
        check_fraction(self, "dropout")
        if self.dropout == 1:
            raise GuiderError("dropout must be below 1")


FROM_DEMONSTRATIONS: Changes = {"error": "absolute"}
"""Preset `fast` where demonstrators differ and a centimetre decides: what was done, not what lies between. (Dropout
blurs that.)"""


def most_likely(actor: Layers, inputs: jax.Array) -> jax.Array:
    """The action pi(a | s, g) is centred on, in [-1, 1]. inputs: [..., inputs] scaled. Returns [..., A]."""
    return jnp.tanh(mlp(actor, inputs))


def predict(config: RegressionConfig, actor: Layers, inputs: jax.Array, key: jax.Array) -> jax.Array:
    """The same while learning, with dropout."""
    return jnp.tanh(mlp(actor, inputs, dropout=config.dropout, key=key))


def regress(
    config: RegressionConfig, weight: jax.Array, predicted: jax.Array, action: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Mean weighted regression loss, and the mean squared error whatever the loss counts. See losses."""
    loss = losses.weighted_regression(weight, predicted, action, config.error).mean()
    return loss, {"action_error": ((predicted - action) ** 2).mean()}
