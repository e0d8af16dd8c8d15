"""The method's maths, one equation a function. Equation numbers are the paper's.

Shapes: B rows of a batch, D entries of a goal, latent or action. Per-row scalars are [B].
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp

from guider.goals import Parts, part_distances
from guider.learning.networks import Gaussian


def goal_reward(achieved: jax.Array, goal: jax.Array, radius: float, parts: Parts = ()) -> jax.Array:
    """Eq. 1 shifted so that an absorbing goal is worth 0.

    r = 0 if ||s^G - g||_2 < radius else -1, in goal units; of a goal with several parts, the sum over them.
    achieved, goal: [B, D]. Returns [B].
    """
    return jnp.where(part_distances(achieved, goal, parts) < radius, 0.0, -1.0).sum(axis=-1)


def gaussian_kl(p: Gaussian, q: Gaussian) -> jax.Array:
    """D_KL(p || q) of diagonal Gaussians per dimension, in nats. [B, D] each; returns [B, D]."""
    variance_ratio = jnp.exp(2 * (p.log_std - q.log_std))
    mean_term = ((p.mean - q.mean) * jnp.exp(-q.log_std)) ** 2
    return 0.5 * (variance_ratio + mean_term - 1) - (p.log_std - q.log_std)


def balanced_kl(posterior: Gaussian, prior: Gaussian, balance: float) -> jax.Array:
    """Eq. 3: tau * KL(sg(q) || rho) + (1 - tau) * KL(q || sg(rho)), per dimension, in nats.

    Its value is KL(q || rho) for any tau; tau = `balance` only splits the gradient. Returns [B, D].
    """
    frozen_posterior = jax.lax.stop_gradient(posterior)
    frozen_prior = jax.lax.stop_gradient(prior)
    return balance * gaussian_kl(frozen_posterior, prior) + (1 - balance) * gaussian_kl(posterior, frozen_prior)


def negative_elbo(
    decoded: jax.Array, target: jax.Array, posterior: Gaussian, prior: Gaussian, beta: float, balance: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Eq. 2 with Eq. 3, negated: squared error + beta * KL, both means over dimensions, [B] each.

    -log p is the squared error in goal units squared (m^2 in a maze), mean over goal dimensions, as in the
    authors' code; the KL is in nats, mean over latent dimensions. decoded, target: [B, G].
    Returns (loss, squared error, KL).
    """
    error = jnp.mean((decoded - target) ** 2, axis=-1)
    kl = jnp.mean(balanced_kl(posterior, prior, balance), axis=-1)
    return error + beta * kl, error, kl


def td_target(reward: jax.Array, next_value: jax.Array, discount: float) -> jax.Array:
    """r + gamma * V(s') while the goal is not met; 0 once it is, for there the episode ends.

    reward: [B], 0 where the goal is wholly met after the step, else below (`goal_reward`). Returns [B].
    """
    return jnp.where(reward < 0, reward + discount * next_value, 0.0)


def conservative_gap(sampled: jax.Array, log_density: jax.Array, data: jax.Array) -> jax.Array:
    """CQL(H)'s gap: log of the sum over samples of exp(Q(s, z)) / density(z), minus Q at the data's z.

    sampled, log_density: [..., B, samples]; data: [..., B]. Returns [..., B]. (Kumar et al. 2020, Eq. 4; the importance
    weight is the density the sample was truly drawn from. Their code and Guider's authors' sum where an estimate of the
    integral would take the mean: thresholds are in that unit, and gradients are the same.)
    """
    return jax.nn.logsumexp(sampled - log_density, axis=-1) - data


def expectile_weight(error: jax.Array, expectile: float) -> jax.Array:
    """|tau - 1(error < 0)| with error = target - estimate. [B] -> [B]."""
    return jnp.where(error < 0, 1 - expectile, expectile)


def expectile_loss(error: jax.Array, expectile: float) -> jax.Array:
    """Its weight times error^2. [B] -> [B]."""
    return expectile_weight(error, expectile) * error**2


def advantage_weight(advantage: jax.Array, temperature: float, ceiling: float) -> jax.Array:
    """Eq. 6's weight exp(A / temperature), clipped to [0, ceiling]. [B] -> [B]."""
    return jnp.minimum(jnp.exp(jnp.minimum(advantage / temperature, 20.0)), ceiling)


def weighted_regression(
    weight: jax.Array, predicted: jax.Array, action: jax.Array, error: Literal["squared", "absolute"]
) -> jax.Array:
    """Eq. 6 negated, for a Gaussian policy of fixed spread: weight * mean over dimensions of the squared error; or of
    the absolute error, for a Laplace distribution.

    weight: [B], no gradient; predicted, action: [B, A] scaled to [-1, 1]. Returns [B].
    """
    misses = (predicted - action) ** 2 if error == "squared" else jnp.abs(predicted - action)
    return jax.lax.stop_gradient(weight) * jnp.mean(misses, axis=-1)


def surprise(policy: Gaussian, action: jax.Array, error: Literal["squared", "absolute"]) -> jax.Array:
    """-log density of an action in nats, summed over dimensions: of the Gaussian (squared), or of the Laplace
    distribution with its mean and, as scale, its spread (absolute). policy, action: [..., A]. Returns [...]."""
    if error == "squared":
        return -policy.log_prob(action)
    misses = jnp.abs(action - policy.mean) * jnp.exp(-policy.log_std)
    return (misses + policy.log_std + jnp.log(2.0)).sum(axis=-1)
