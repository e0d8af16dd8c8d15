"""phi(s, a) . psi(g), the log odds that g comes after (s, a) rather than anywhere: contrastive RL (Eysenbach et al.
2022; OGBench's CRL)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.critics.types import Steps
from guider.learning.networks import Layers, layer_norm_mlp, twin_init
from guider.learning.training import Metrics
from guider.support.config import check_positive


@dataclass(frozen=True)
class ContrastiveConfig:
    """Settings. Defaults are OGBench's."""

    kind: Literal["contrastive"] = "contrastive"
    representation_dim: int = 512

    def __post_init__(self) -> None:
        check_positive(self, "representation_dim")


class Params(NamedTuple):
    """Twins each. doing: phi; goal: psi."""

    doing: Layers
    goal: Layers


def init(
    key: jax.Array,
    config: ContrastiveConfig,
    hidden: tuple[int, ...],
    state_dim: int,
    place_dim: int,
    action_dim: int,
) -> Params:
    doing_key, goal_key = jax.random.split(key)
    width = config.representation_dim
    return Params(
        doing=twin_init(doing_key, (state_dim + action_dim, *hidden, width)),
        goal=twin_init(goal_key, (place_dim, *hidden, width)),
    )


def represent(params: Params, state: jax.Array, action: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(phi(s, a), psi(g) / sqrt(Z)), [2, B, Z] each."""
    doing = jnp.concatenate([state, action], axis=-1)
    phi = jax.vmap(lambda layers: layer_norm_mlp(layers, doing))(params.doing)
    psi = jax.vmap(lambda layers: layer_norm_mlp(layers, goal))(params.goal)
    return phi, psi / psi.shape[-1] ** 0.5


def loss(
    config: ContrastiveConfig, params: Params, target: Params, steps: Steps, discount: float
) -> tuple[jax.Array, Metrics]:
    """Binary cross entropy of telling each row's own goal from those of all other rows, mean over pairs and twins.

    The goals are geometric futures, 1 / (1 - gamma) steps ahead on average: what makes of the log odds a value.
    """
    phi, psi = represent(params, steps.state, steps.action, steps.goal)
    logits = jnp.einsum("eiz,ejz->eij", phi, psi)
    own = jnp.eye(logits.shape[-1])
    error = jax.nn.softplus(logits) - own * logits
    told_apart = jnp.mean(logits.mean(axis=0).argmax(axis=-1) == jnp.arange(logits.shape[-1]))
    return error.mean(), {"contrastive_loss": error.mean(), "told_apart": told_apart}


def quality(
    config: ContrastiveConfig, params: Params, state: jax.Array, action: jax.Array, goal: jax.Array
) -> jax.Array:
    """The smaller of the twins' log odds, [B]."""
    phi, psi = represent(params, state, action, goal)
    return (phi * psi).sum(axis=-1).min(axis=0)
