"""Multi-layer perceptrons as plain pytrees, Gaussian heads and twin critics."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

Layers = tuple[tuple[jax.Array, jax.Array], ...]

LOG_STD_RANGE = (-5.0, 2.0)


class Gaussian(NamedTuple):
    """Diagonal Gaussian; mean and log_std have shape [..., dim]."""

    mean: jax.Array
    log_std: jax.Array

    def sample(self, key: jax.Array, shape: tuple[int, ...] = ()) -> jax.Array:
        """Reparameterised samples, [*shape, ..., dim]."""
        noise = jax.random.normal(key, (*shape, *self.mean.shape))
        return self.mean + jnp.exp(self.log_std) * noise

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density summed over the last axis, [...]."""
        standardised = (value - self.mean) * jnp.exp(-self.log_std)
        return jnp.sum(-0.5 * standardised**2 - self.log_std - 0.5 * jnp.log(2 * jnp.pi), axis=-1)


def mlp_init(key: jax.Array, sizes: tuple[int, ...]) -> Layers:
    """Weights and biases uniform in +-1/sqrt(fan_in), as the authors' framework does by default."""

    def layer(key, fan_in, fan_out):
        w_key, b_key = jax.random.split(key)
        bound = fan_in**-0.5
        return (
            jax.random.uniform(w_key, (fan_in, fan_out), minval=-bound, maxval=bound),
            jax.random.uniform(b_key, (fan_out,), minval=-bound, maxval=bound),
        )

    keys = jax.random.split(key, len(sizes) - 1)
    return tuple(layer(k, i, o) for k, i, o in zip(keys, sizes[:-1], sizes[1:], strict=True))


def mlp(
    layers: Layers,
    inputs: jax.Array,
    activation: Callable[[jax.Array], jax.Array] = jax.nn.relu,
    dropout: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """[..., in] -> [..., out]. Dropout follows each hidden activation, and only where a key is given."""
    hidden = inputs
    for index, (weight, bias) in enumerate(layers):
        hidden = hidden @ weight + bias
        if index < len(layers) - 1:
            hidden = activation(hidden)
            if dropout > 0.0 and key is not None:
                keep = jax.random.bernoulli(jax.random.fold_in(key, index), 1 - dropout, hidden.shape)
                hidden = jnp.where(keep, hidden / (1 - dropout), 0.0)
    return hidden


def gaussian_head(outputs: jax.Array) -> Gaussian:
    """Split [..., 2 * dim] network outputs into a Gaussian with log_std clipped to LOG_STD_RANGE."""
    mean, log_std = jnp.split(outputs, 2, axis=-1)
    return Gaussian(mean, jnp.clip(log_std, *LOG_STD_RANGE))


def twin_init(key: jax.Array, sizes: tuple[int, ...]) -> Layers:
    """Two independent MLPs stacked along a leading axis."""
    return jax.vmap(lambda k: mlp_init(k, sizes))(jax.random.split(key))


def twin_values(twins: Layers, context: jax.Array, actions: jax.Array) -> jax.Array:
    """Both critics' values of actions in context.

    context: [B, context_dim]; actions: [B, dim] -> [2, B], or [B, samples, dim] -> [2, B, samples].
    The first layer's product with the context is computed once and shared by all samples.
    """

    def values(layers):
        (weight, bias), *rest = layers
        context_dim = context.shape[-1]
        from_context = context @ weight[:context_dim] + bias
        if actions.ndim == 3:
            from_context = from_context[:, None]
        hidden = jax.nn.relu(from_context + actions @ weight[context_dim:])
        rows = hidden.reshape(-1, hidden.shape[-1])  # one tall matrix product is faster than one per sample
        return mlp(tuple(rest), rows).reshape(actions.shape[:-1])

    return jax.vmap(values)(twins)
