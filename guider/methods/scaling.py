"""How raw states and goals are scaled before they enter a network."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider.episodes import Episodes, Spaces


class Scale(NamedTuple):
    """Means and spreads of the data; identity where inputs are raw.

    state_mean, state_std: [S]; goal_mean, goal_std: [G]; step_std: [G], spread of s^G_{t+c} - s^G_t;
    frequencies: [K] radians per standardised goal unit, of the waves that show positions finely (K may be 0).
    """

    state_mean: jax.Array
    state_std: jax.Array
    goal_mean: jax.Array
    goal_std: jax.Array
    step_std: jax.Array
    frequencies: jax.Array

    def state(self, state: jax.Array) -> jax.Array:
        return (state - self.state_mean) / self.state_std

    def goal(self, goal: jax.Array) -> jax.Array:
        return (goal - self.goal_mean) / self.goal_std

    def waves(self, goal: jax.Array) -> jax.Array:
        """Sines and cosines of each goal entry at every frequency. [..., G] -> [..., 2 K G]."""
        phase = self.goal(goal)[..., None] * self.frequencies
        return jnp.concatenate([jnp.sin(phase), jnp.cos(phase)], axis=-1).reshape(*goal.shape[:-1], -1)

    def position(self, goal: jax.Array) -> jax.Array:
        """How networks see a place: [..., G] -> [..., G (1 + 2 K)]."""
        return jnp.concatenate([self.goal(goal), self.waves(goal)], axis=-1)


def wave_frequencies(count: int) -> jax.Array:
    """[count] wavelengths of 4, 2, 1, ... spreads of the data, as radians per spread."""
    return jnp.pi / 2 * 2.0 ** jnp.arange(count)


def unit_scale(spaces: Spaces, waves: int) -> Scale:
    """Raw inputs, with `waves` frequencies."""
    zeros, ones = jnp.zeros, jnp.ones
    state_dim, goal_dim = spaces.state_dim, spaces.goal_dim
    frequencies = wave_frequencies(waves)
    return Scale(zeros(state_dim), ones(state_dim), zeros(goal_dim), ones(goal_dim), ones(goal_dim), frequencies)


def make_scale(episodes: Episodes, starts: np.ndarray, period_steps: int, waves: int) -> Scale:
    """Scale from the data. starts: [W] rows that start a window of c = period_steps steps."""
    mean = episodes.observations.mean(axis=0, dtype=np.float64)
    std = np.maximum(episodes.observations.std(axis=0, dtype=np.float64), 1e-3)
    goal = list(episodes.goal_indices)
    achieved = episodes.achieved
    later = np.minimum(starts + period_steps, episodes.last_rows[starts])
    step_std = np.maximum(np.sqrt(np.mean((achieved[later] - achieved[starts]) ** 2, axis=0)), 1e-3)
    arrays = (mean, std, mean[goal], std[goal], step_std, wave_frequencies(waves))
    return Scale(*(jnp.asarray(array, jnp.float32) for array in arrays))
