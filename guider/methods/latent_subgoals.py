"""The latent model of subgoals reachable within c steps (Section 4.2, Eq. 2-3, Algorithm 1 lines 1-4)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from guider.errors import GuiderError
from guider.goals import Parts, largest_distance
from guider.learning import losses
from guider.learning.networks import Gaussian, Initialisation, Layers, gaussian_head, mlp, mlp_init
from guider.learning.optimisers import Moments, adam_init, adam_step
from guider.learning.problem import Problem
from guider.learning.samplers import Windows
from guider.learning.training import Metrics
from guider.methods.view import Scale
from guider.support.config import Changes, check_fraction, check_networks, check_positive

INSIDE_95 = 1.959964
"""Deviations of a Gaussian to either side that hold its central 95 %."""


@dataclass(frozen=True)
class LatentSubgoalsConfig:
    """Settings of Eq. 2-3. Defaults are the authors' (preset `paper`).

    beta weighs the KL (nats, mean over latent dimensions) against the squared error (goal units squared, see
    `error_in_spreads`, mean over goal dimensions); kl_balance is tau of Eq. 3.
    """

    updates: int = 500_000
    batch_size: int = 100
    learning_rate: float = 3e-4
    latent_dim: int = 2
    hidden: tuple[int, ...] = (256, 256, 256)
    beta: float = 0.1
    kl_balance: float = 0.8
    decoder_dropout: float = 0.1
    relative: bool = False
    """Encode and decode displacements s^G_{t+c} - s^G_t instead of positions (departure from the paper)."""
    error_in_spreads: bool = False
    """Count the squared error in spreads of the data's c-step moves: one beta for all goal units (departure)."""
    initialisation: Initialisation = "small_outputs"

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "latent_dim", "beta")
        check_fraction(self, "kl_balance", "decoder_dropout")
        if self.decoder_dropout == 1:
            raise GuiderError("decoder_dropout must be below 1")


FAST: Changes = {
    "updates": 12_000,
    "batch_size": 256,
    "learning_rate": 5e-4,
    "hidden": (256, 256),
    "beta": 0.1,
    "decoder_dropout": 0.0,
    "relative": True,
    "error_in_spreads": True,
    "initialisation": "fan_in",
}
"""What preset `fast` changes."""

LATENT_DIM = {"fetch": 3, "kitchen": 8}
LEAST_LATENTS, MOST_LATENTS = 2, 8


def latent_dim(problem: Problem) -> int:
    """Of latent subgoals, by domain; not published but for antmaze, whose 2 other tasks get. One's own data gets one
    for each entry of the goal space, up to MOST_LATENTS."""
    of_own = min(MOST_LATENTS, max(LEAST_LATENTS, problem.goal_dim or 0))
    return LATENT_DIM.get(problem.domain or "", of_own)


class LatentParams(NamedTuple):
    encoder: Layers
    decoder: Layers
    prior: Layers


class LatentState(NamedTuple):
    params: LatentParams
    optimiser: Moments


def init(key: jax.Array, config: LatentSubgoalsConfig, goal_dim: int, position_dim: int) -> LatentState:
    """position_dim: entries of a place as the networks see it (Scale.position)."""
    encoder_key, decoder_key, prior_key = jax.random.split(key, 3)
    latent, layers = config.latent_dim, partial(mlp_init, initialisation=config.initialisation)
    params = LatentParams(
        encoder=layers(encoder_key, (position_dim + goal_dim, *config.hidden, 2 * latent)),
        decoder=layers(decoder_key, (position_dim + latent, *config.hidden, goal_dim)),
        prior=layers(prior_key, (position_dim, *config.hidden, 2 * latent)),
    )
    return LatentState(params, adam_init(params))


def encode(
    config: LatentSubgoalsConfig, params: LatentParams, scale: Scale, achieved: jax.Array, later: jax.Array
) -> Gaussian:
    """q(z | s^G_t, s^G_{t+c}). achieved, later: [..., G] in goal units."""
    target = (later - achieved) / scale.step_std if config.relative else scale.goal(later)
    inputs = jnp.concatenate([scale.position(achieved), target], axis=-1)
    return gaussian_head(mlp(params.encoder, inputs, jax.nn.gelu))


def decode(
    config: LatentSubgoalsConfig,
    params: LatentParams,
    scale: Scale,
    achieved: jax.Array,
    latent: jax.Array,
    key: jax.Array | None = None,
) -> jax.Array:
    """Mean of p(s^G_{t+c} | s^G_t, z), [..., G] in goal units. A key switches dropout on."""
    inputs = jnp.concatenate([scale.position(achieved), latent], axis=-1)
    outputs = mlp(params.decoder, inputs, jax.nn.gelu, config.decoder_dropout, key)
    if config.relative:
        return achieved + outputs * scale.step_std
    return outputs * scale.goal_std + scale.goal_mean


def prior(params: LatentParams, scale: Scale, achieved: jax.Array) -> Gaussian:
    """rho(z | s^G_t). achieved: [..., G] in goal units."""
    return gaussian_head(mlp(params.prior, scale.position(achieved)))


def reachable(
    config: LatentSubgoalsConfig, params: LatentParams, scale: Scale, achieved: jax.Array, count: int
) -> jax.Array:
    """z ~ rho(. | s^G), decoded: [B, G] -> [count, B, G]."""
    latents = prior(params, scale, achieved).sample(jax.random.key(0), (count,))
    return decode(config, params, scale, jnp.broadcast_to(achieved, (count, *achieved.shape)), latents)


def coverage(
    config: LatentSubgoalsConfig, params: LatentParams, scale: Scale, achieved: jax.Array, later: jax.Array
) -> jax.Array:
    """Share of the latent entries of moves [B, G] -> [B, G] that lie within rho's central 95 %: 0.95 where it fits."""
    return jnp.mean(_likely(config, params, scale, achieved, later)[0])


def within_reach(
    config: LatentSubgoalsConfig,
    params: LatentParams,
    scale: Scale,
    achieved: jax.Array,
    place: jax.Array,
    radius: float,
    parts: Parts = (),
) -> jax.Array:
    """[B] bool: whether rho holds `place` for one that c steps may lead to: all entries of its latent lie within the
    central 95 %, and it is what that decodes to, within `radius`. achieved, place: [B, G]."""
    likely, latent = _likely(config, params, scale, achieved, place)
    told = decode(config, params, scale, achieved, latent)
    return likely.all(axis=-1) & (largest_distance(told, place, parts) <= radius)


def _likely(
    config: LatentSubgoalsConfig, params: LatentParams, scale: Scale, achieved: jax.Array, later: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """([B, Z] whether each latent entry of a move lies within rho's central 95 %, the latent [B, Z])."""
    latent, expected = encode(config, params, scale, achieved, later).mean, prior(params, scale, achieved)
    return jnp.abs(latent - expected.mean) <= INSIDE_95 * jnp.exp(expected.log_std), latent


def loss(
    config: LatentSubgoalsConfig, params: LatentParams, scale: Scale, batch: Windows, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Eq. 2 negated, mean over the batch."""
    sample_key, dropout_key = jax.random.split(key)
    posterior = encode(config, params, scale, batch.achieved, batch.later)
    reachable = prior(params, scale, batch.achieved)
    decoded = decode(config, params, scale, batch.achieved, posterior.sample(sample_key), dropout_key)
    unit = scale.step_std if config.error_in_spreads else 1.0
    total, error, kl = losses.negative_elbo(
        decoded / unit, batch.later / unit, posterior, reachable, config.beta, config.kl_balance
    )
    metrics = {"loss": total.mean(), "squared_error": error.mean(), "kl": kl.mean()}
    return total.mean(), metrics


def update(
    config: LatentSubgoalsConfig, state: LatentState, scale: Scale, batch: Windows, key: jax.Array
) -> tuple[LatentState, Metrics]:
    """One step of Algorithm 1, line 3."""
    gradients, metrics = jax.grad(lambda p: loss(config, p, scale, batch, key), has_aux=True)(state.params)
    return LatentState(*adam_step(config.learning_rate, state.params, gradients, state.optimiser)), metrics
