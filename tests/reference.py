"""Networks, densities and gradients in plain NumPy and float64, to hold the package's updates against.

Nothing here is shared with the package but the layout of its parameters: an MLP is a tuple of (weights [in, out],
biases [out]), twins have them stacked. Gradients are central differences of a loss that is written down, not derived.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

STEP = 1e-6
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


def relu(x):
    return np.maximum(x, 0.0)


def gelu(x):
    return 0.5 * x * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3)))


def mlp(layers, x, activation=relu):
    *hidden, (weights, biases) = layers
    for hidden_weights, hidden_biases in hidden:
        x = activation(x @ hidden_weights + hidden_biases)
    return x @ weights + biases


def layer_norm_mlp(layers, x):
    def standardised_gelu(outputs):
        hidden = gelu(outputs)
        centred = hidden - hidden.mean(-1, keepdims=True)
        return centred / np.sqrt((centred**2).mean(-1, keepdims=True) + 1e-5)

    return mlp(layers, x, standardised_gelu)


def gru(weights, entries, counts):
    """The state after a window, read from its first entry to its last."""

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    hidden = np.zeros((len(entries), len(weights.candidate_bias)))
    for step in range(entries.shape[1]):
        seen = np.split(entries[:, step] @ weights.from_input + weights.bias, 3, -1)
        kept = np.split(hidden @ weights.from_hidden, 3, -1)
        reset, update = sigmoid(seen[0] + kept[0]), sigmoid(seen[1] + kept[1])
        candidate = np.tanh(seen[2] + reset * (kept[2] + weights.candidate_bias))
        after = update * hidden + (1 - update) * candidate
        hidden = np.where(counts[:, step, None], after, hidden)
    return hidden


def twin(layers, index):
    return tuple((weights[index], biases[index]) for weights, biases in layers)


def q(critics, state, action):
    """[2, B], or [1, B] of a single critic."""
    count = len(critics[0][0])
    return np.stack([mlp(twin(critics, i), np.concatenate([state, action], -1))[..., 0] for i in range(count)])


def q_of_samples(critics, state, samples):
    """samples: [B, n, Z]. Returns [2, B, n], the critics asked sample by sample."""
    return np.stack([q(critics, state, samples[:, n]) for n in range(samples.shape[1])], axis=-1)


def gaussian(outputs):
    mean, log_std = np.split(outputs, 2, axis=-1)
    return mean, np.exp(np.clip(log_std, -5.0, 2.0))


def log_density(mean, std, value):
    return (-0.5 * ((value - mean) / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi)).sum(-1)


def kl(mean_p, std_p, mean_q, std_q):
    """D_KL(p || q) per dimension."""
    return np.log(std_q / std_p) + (std_p**2 + (mean_p - mean_q) ** 2) / (2 * std_q**2) - 0.5


def td(reward, next_value, discount):
    """r + gamma V(s') where the goal is not met (r < 0), else 0."""
    return np.array([0.0 if r >= 0 else r + discount * v for r, v in zip(reward, next_value, strict=True)])


def gradients(loss: Callable[[Any], float], params: Any) -> Any:
    """Of a loss of a pytree of float64 arrays, by central differences."""
    leaves, structure = jax.tree.flatten(jax.tree.map(lambda leaf: np.array(leaf, np.float64), params))

    def value() -> float:
        return float(loss(jax.tree.unflatten(structure, leaves)))

    slopes = [np.zeros_like(leaf) for leaf in leaves]
    for leaf, slope in zip(leaves, slopes, strict=True):
        flat, flat_slope = leaf.reshape(-1), slope.reshape(-1)
        for index, centre in enumerate(flat.copy()):
            ends = []
            for side in (1, -1):
                flat[index] = centre + side * STEP
                ends.append(value())
            flat[index] = centre
            flat_slope[index] = (ends[0] - ends[1]) / (2 * STEP)
    return jax.tree.unflatten(structure, slopes)


def adam(params: Any, slopes: Any, rate: float) -> Any:
    """Adam's first step (Kingma & Ba 2015)."""

    def step(value, slope):
        mean, square = (1 - BETA_1) * slope, (1 - BETA_2) * slope**2
        return value - rate * (mean / (1 - BETA_1)) / (np.sqrt(square / (1 - BETA_2)) + EPSILON)

    return jax.tree.map(step, jax.tree.map(np.asarray, params), slopes)


def check_first_step(before: Any, after: Any, loss: Callable[[Any], float], rate: float) -> None:
    """Whether a learner's state took Adam's first step down `loss`: its gradients, its parameters.

    before, after: states with `params` and `optimiser`. Moments tell the gradient itself: Adam's first step hardly
    depends on its size.
    """
    slopes = gradients(loss, before.params)
    taken = jax.tree.map(lambda moment: np.asarray(moment) / (1 - BETA_1), after.optimiser.mu)
    jax.tree.map(lambda ours, theirs: np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-7), slopes, taken)
    expected = adam(before.params, taken, rate)
    jax.tree.map(
        lambda ours, theirs: np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-5 * rate), expected, after.params
    )


def check_trails(target: Any, params: Any, after: Any, rate: float) -> None:
    """Whether `after` is the target moved by `rate` towards the new parameters."""
    jax.tree.map(
        lambda old, new, moved: np.testing.assert_allclose(
            moved, (1 - rate) * np.asarray(old) + rate * np.asarray(new), rtol=1e-12, atol=1e-14
        ),
        target,
        params,
        after,
    )


RATE = 1e-2


def normal(seed: int, *shape: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape))


def shaken(tree: Any, seed: int = 9, spread: float = 0.3) -> Any:
    """The same with `spread` N(0, 1) added everywhere."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf + spread * rng.normal(size=leaf.shape)), tree)


def plain(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: np.array(leaf), tree)
