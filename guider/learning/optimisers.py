"""Parameter updates: Adam, its learning rate over time, and targets that trail their networks."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax

Params = TypeVar("Params")
Rate = float | jax.Array
Moments = optax.ScaleByAdamState


def adam_init(params: Any) -> Moments:
    """Moments before the first step."""
    moments: Any = optax.scale_by_adam().init(params)
    return moments


def adam_step(rate: Rate, params: Params, gradients: Any, moments: Moments) -> tuple[Params, Moments]:
    """One step of Adam at a learning rate. Returns the new parameters and moments."""
    steps, new_moments = optax.scale_by_adam().update(gradients, moments)
    moved: Any = jax.tree.map(lambda value, step: value - rate * step, params, steps)
    after: Any = new_moments
    return moved, after


def cosine_rate(learning_rate: float, decay: bool, updates: int, moments: Moments) -> Rate:
    """The rate of the next step: constant, or falling to zero along half a cosine over `updates` steps."""
    if not decay:
        return learning_rate
    return learning_rate * 0.5 * (1 + jnp.cos(jnp.pi * jnp.minimum(moments.count / updates, 1.0)))


def trail(target: Params, params: Params, rate: float) -> Params:
    """target + rate * (params - target), leaf by leaf."""
    moved: Any = optax.incremental_update(params, target, rate)  # pyright: ignore[reportArgumentType]
    return moved
