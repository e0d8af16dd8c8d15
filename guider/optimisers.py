"""Parameter updates: Adam, and targets that trail their networks."""

from __future__ import annotations

from typing import Any, TypeVar

import optax

Params = TypeVar("Params")
Rate = float | optax.Schedule


def adam_step(rate: Rate, params: Params, gradients: Any, moments: optax.OptState) -> tuple[Params, optax.OptState]:
    """One step of Adam. Returns the new parameters and moments (`optax.adam(rate).init(params)` at first)."""
    steps, moments = optax.adam(rate).update(gradients, moments)
    moved: Any = optax.apply_updates(params, steps)  # pyright: ignore[reportArgumentType]
    return moved, moments


def trail(target: Params, params: Params, rate: float) -> Params:
    """target + rate * (params - target), leaf by leaf."""
    moved: Any = optax.incremental_update(params, target, rate)  # pyright: ignore[reportArgumentType]
    return moved
