"""Multi-layer perceptrons as plain pytrees, Gaussian heads and twin critics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax.experimental.layout import Layout, with_layout_constraint

Products = Literal["float32", "bfloat16"]
"""Precision of products between hidden layers while training, which are most of the work: bfloat16 rounds their factors
to 8 bits and adds up in float32, several times as fast on a GPU and on a CPU with instructions for it (AMX).
Parameters, inputs, outputs and everything else stay float32."""

Precision = Literal["auto", "float32", "bfloat16"]
"""The same as a setting; auto is what the processor is fastest in (see processor.py), settled when a run starts."""

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


def hidden_product(hidden: jax.Array, weight: jax.Array) -> jax.Array:
    """hidden @ weight between hidden layers, [..., H] x [H, K], under `jax.default_matmul_precision`'s Products."""
    if jax.default_matmul_precision.value != "bfloat16":
        return hidden @ weight
    rows = hidden.reshape(-1, hidden.shape[-1])
    return _rounded_product(rows, weight).reshape(*hidden.shape[:-1], weight.shape[-1])


@jax.custom_vjp
def _rounded_product(rows: jax.Array, weight: jax.Array) -> jax.Array:
    return _rounded_product_forward(rows, weight)[0]


def _rounded_product_forward(rows: jax.Array, weight: jax.Array):
    factors = rows.astype(jnp.bfloat16), weight.astype(jnp.bfloat16)
    return _product(*factors), factors


def _rounded_product_backward(factors: tuple[jax.Array, jax.Array], gradient: jax.Array):
    rows, weight = factors
    gradient = gradient.astype(jnp.bfloat16)
    return _product(gradient, _transposed(weight)), _product(_transposed(rows), gradient)


_rounded_product.defvjp(_rounded_product_forward, _rounded_product_backward)


def _product(rows: jax.Array, columns: jax.Array) -> jax.Array:
    return jnp.dot(rows, columns, preferred_element_type=jnp.float32)


def _transposed(matrix: jax.Array) -> jax.Array:
    """The transpose, laid out row by row: XLA's fast CPU kernels take no factor that is a transposed view."""
    return with_layout_constraint(matrix.T, Layout(major_to_minor=(0, 1)))


Initialisation = Literal["fan_in", "small_outputs"]
"""Of weights and biases. fan_in: all uniform in +-1/sqrt(inputs), PyTorch's way. small_outputs, that of Guider's
authors and of rlkit before them: hidden weights uniform in +-1/sqrt(outputs), hidden biases 0.1, the last layer uniform
in +-0.001, so that all outputs start near 0."""

_SMALL = 1e-3
_HIDDEN_BIAS = 0.1


def _uniform(key: jax.Array, shape: tuple[int, ...], bound: float) -> jax.Array:
    """Uniform in +-bound: the first of a power of two of draws, so that few programs draw for all shapes."""
    power = max(10, (math.prod(shape) - 1).bit_length())
    return _spread(jax.random.uniform(key, (2**power,)), bound, shape)


@partial(jax.jit, static_argnames="shape")
def _spread(draws: jax.Array, bound: float, shape: tuple[int, ...]) -> jax.Array:
    return draws[: math.prod(shape)].reshape(shape) * (2 * bound) - bound


def mlp_init(key: jax.Array, sizes: tuple[int, ...], initialisation: Initialisation = "fan_in") -> Layers:
    """Fresh layers between widths `sizes`."""

    def layer(key, fan_in, fan_out, last):
        w_key, b_key = jax.random.split(key)
        shape = (fan_in, fan_out)
        if initialisation == "fan_in":
            return _uniform(w_key, shape, fan_in**-0.5), _uniform(b_key, (fan_out,), fan_in**-0.5)
        if last:
            return _uniform(w_key, shape, _SMALL), _uniform(b_key, (fan_out,), _SMALL)
        return _uniform(w_key, shape, fan_out**-0.5), jnp.full(fan_out, _HIDDEN_BIAS)

    keys = jax.random.split(key, len(sizes) - 1)
    last = range(len(keys))[-1]
    return tuple(layer(keys[i], sizes[i], sizes[i + 1], i == last) for i in range(len(keys)))


def mlp(
    layers: Layers,
    inputs: jax.Array,
    activation: Callable[[jax.Array], jax.Array] = jax.nn.relu,
    dropout: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """[..., in] -> [..., out]. Dropout follows each hidden activation, and only where a key is given."""
    (weight, bias), *upper = layers
    return _upper_layers(upper, inputs @ weight + bias, activation, dropout, key)


def _upper_layers(
    layers: Sequence[tuple[jax.Array, jax.Array]],
    outputs: jax.Array,
    activation: Callable[[jax.Array], jax.Array] = jax.nn.relu,
    dropout: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """From the first layer's outputs to the last one's."""
    for index, (weight, bias) in enumerate(layers):
        hidden = activation(outputs)
        if dropout > 0.0 and key is not None:
            keep = jax.random.bernoulli(jax.random.fold_in(key, index), 1 - dropout, hidden.shape)
            hidden = jnp.where(keep, hidden / (1 - dropout), 0.0)
        product = hidden @ weight if index == len(layers) - 1 else hidden_product(hidden, weight)
        outputs = product + bias
    return outputs


def gaussian_head(outputs: jax.Array) -> Gaussian:
    """Split [..., 2 * dim] network outputs into a Gaussian with log_std clipped to LOG_STD_RANGE."""
    mean, log_std = jnp.split(outputs, 2, axis=-1)
    return Gaussian(mean, jnp.clip(log_std, *LOG_STD_RANGE))


def twin_init(key: jax.Array, sizes: tuple[int, ...], initialisation: Initialisation = "fan_in") -> Layers:
    """Two independent MLPs stacked along a leading axis."""
    return jax.vmap(lambda k: mlp_init(k, sizes, initialisation))(jax.random.split(key))


def twin_values(twins: Layers, context: jax.Array, actions: jax.Array) -> jax.Array:
    """Both critics' values of actions in context.

    context: [B, context_dim]; actions: [B, dim] -> [2, B], or [B, samples, dim] -> [2, B, samples].
    The first layer's product with the context is computed once and shared by all samples.
    """

    def values(layers):
        (weight, bias), *upper = layers
        context_dim = context.shape[-1]
        from_context = context @ weight[:context_dim] + bias
        if actions.ndim == 3:
            from_context = from_context[:, None]
        outputs = from_context + actions @ weight[context_dim:]
        rows = outputs.reshape(-1, outputs.shape[-1])  # one tall matrix product is faster than one per sample
        return _upper_layers(upper, rows).reshape(actions.shape[:-1])

    return jax.vmap(values)(twins)


def layer_norm_mlp(layers: Layers, inputs: jax.Array) -> jax.Array:
    """[..., in] -> [..., out]; hidden units pass a GELU and are then standardised over the layer (Ba et al. 2016).

    Gains and shifts of their own would only repeat what the next layer's weights and biases can do.
    """

    def activation(outputs: jax.Array) -> jax.Array:
        return jax.nn.standardize(jax.nn.gelu(outputs), axis=-1)

    return mlp(layers, inputs, activation)


class Gru(NamedTuple):
    """Weights of a gated recurrent unit (Cho et al. 2014), its three gates side by side: reset, update, candidate.

    from_input: [in, 3 H]; from_hidden: [H, 3 H]; bias: [3 H]; candidate_bias: [H], inside the reset gate.
    """

    from_input: jax.Array
    from_hidden: jax.Array
    bias: jax.Array
    candidate_bias: jax.Array


def gru_init(key: jax.Array, input_dim: int, hidden_dim: int) -> Gru:
    """Uniform in +-1/sqrt(hidden_dim)."""
    shapes = ((input_dim, 3 * hidden_dim), (hidden_dim, 3 * hidden_dim), (3 * hidden_dim,), (hidden_dim,))
    keys = jax.random.split(key, len(shapes))
    return Gru(*(_uniform(k, shape, hidden_dim**-0.5) for k, shape in zip(keys, shapes, strict=True)))


def gru(weights: Gru, inputs: jax.Array, valid: jax.Array, reverse: bool = False) -> jax.Array:
    """The state [B, H] after reading a sequence from first to last, or from last to first.

    inputs: [B, T, in]; valid: [B, T] bool, False for entries to pass over, which leave the state as it is.
    """

    def step(hidden, entry):
        projected, counts = entry
        seen_reset, seen_update, seen_candidate = jnp.split(projected, 3, axis=-1)
        reset, update, candidate = jnp.split(hidden @ weights.from_hidden, 3, axis=-1)
        reset = jax.nn.sigmoid(seen_reset + reset)
        update = jax.nn.sigmoid(seen_update + update)
        candidate = jnp.tanh(seen_candidate + reset * (candidate + weights.candidate_bias))
        after = update * hidden + (1 - update) * candidate
        return jnp.where(counts[:, None], after, hidden), None

    projected = inputs @ weights.from_input + weights.bias  # of all entries at once: one tall matrix product
    start = jnp.zeros((len(inputs), weights.candidate_bias.shape[0]))
    return jax.lax.scan(step, start, (projected.swapaxes(0, 1), valid.T), reverse=reverse)[0]
