"""What a method sees of logged data: which rows it learns from, and how they are scaled before they enter a network."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import SMALLEST_SPREAD, Episodes, Spaces
from guider.errors import GuiderError, GuiderWarning
from guider.goals import largest_distance
from guider.learning.problem import Problem
from guider.learning.windows import (
    Boundary,
    Data,
    MoveWithin,
    device_data,
    moves,
    moving_windows,
    no_window,
    window_starts,
)
from guider.support.config import check_not_negative, check_positive

_FINEST_STEP = 0.1
_LONG_STEP = 4.0  # radii


@dataclass(frozen=True)
class ViewConfig:
    """Settings that every method has. Defaults are raw inputs from all rows."""

    boundary: Boundary = "clip"
    """c-step windows that would leave their episode end at its last state (clip), or are not used (drop)."""
    minimum_move: float = 0.0
    """Learn only where s^G moves this far or further (goal units), so that idle stretches do not shape what is learned
    (departure; 0 keeps all)."""
    minimum_window_move: float = 0.0
    """And the same, within c steps, of the windows alone that say what is reachable: resting is learned from too, but
    must not make all moves look unlikely to the prior (departure)."""
    move_within: MoveWithin = "period"
    """Where it has to: from here to c steps on, or from the episode's first state to any other of it."""
    normalise: bool = False
    """Standardise what the networks see by the data's mean and spread (departure)."""
    smallest_spread: float = 1e-3
    """`normalise` takes smaller spreads of goal entries for this (goal units): the noise of what stands still is not
    blown up."""
    position_waves: int = 0
    """Show places also as sines and cosines at this many frequencies, so that small networks can tell the two sides of
    a wall apart (departure; needs `normalise`)."""

    def __post_init__(self) -> None:
        check_not_negative(self, "minimum_move", "minimum_window_move", "position_waves")
        check_positive(self, "smallest_spread")
        if self.position_waves and not self.normalise:
            raise GuiderError("position_waves needs normalise: wavelengths are counted in spreads of the data")


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


def prepare(view: ViewConfig, problem: Problem, episodes: Episodes) -> tuple[Data, Scale]:
    """Data on the device and the scaling it implies."""
    data = device_data(
        episodes, problem.period_steps, view.boundary, view.minimum_move, view.move_within, view.minimum_window_move
    )
    if not view.normalise:
        return data, unit_scale(view, episodes.spaces)
    rows = np.asarray(data.window_rows)
    return data, make_scale(episodes, rows, problem.period_steps, view.position_waves, view.smallest_spread)


def learned_windows(view: ViewConfig, problem: Problem, episodes: Episodes) -> np.ndarray:
    """[W] rows of `episodes` that start a c-step window which training draws from."""
    return moving_windows(
        episodes, problem.period_steps, view.boundary, view.minimum_move, view.move_within, view.minimum_window_move
    )


def why_no_window(view: ViewConfig, problem: Problem, episodes: Episodes) -> str:
    """Why `learned_windows` are none, and what would help."""
    return no_window(episodes, problem.period_steps, view.minimum_move, view.minimum_window_move)


@dataclass(frozen=True)
class Use:
    """Which of the logged rows training draws from.

    windows: of c steps, for what names subgoals; settings: those of the view that leave some out, by name and in words.
    """

    transitions: int
    of_transitions: int
    windows: int
    of_windows: int
    settings: tuple[str, ...]

    def __str__(self) -> str:
        fraction = self.transitions / self.of_transitions
        share = f"{self.transitions:,} of {self.of_transitions:,} transitions ({fraction:.0%})"
        why = f"; left out by {', '.join(self.settings)}" if self.settings else ""
        return f"{share} and, for subgoals and skills, {self.windows:,} of {self.of_windows:,} windows are used{why}"


def data_use(view: ViewConfig, problem: Problem, episodes: Episodes) -> Use:
    """What share of the data training draws from, and why not from all."""
    period, distance, within = problem.period_steps, view.minimum_move, view.move_within
    used, every = (
        (
            len(window_starts(episodes, period, "clip", move, within)),
            len(moving_windows(episodes, period, view.boundary, move, within, window_move)),
        )
        for move, window_move in ((distance, view.minimum_window_move), (0.0, 0.0))
    )
    unclipped = len(window_starts(episodes, period, "clip"))
    settings = []
    if distance and used != every:
        where = f"{period} steps" if within == "period" else "their episode"
        settings.append(f"view.minimum_move={distance:g} (rows whose goal entries move less within {where})")
    if view.minimum_window_move and used[1] != every[1]:
        settings.append(
            f"view.minimum_window_move={view.minimum_window_move:g} (windows that move less within {period} steps)"
        )
    if every[1] != unclipped:
        settings.append(f"view.boundary={view.boundary} (windows of {period} steps that would leave their episode)")
    return Use(used[0], every[0], used[1], unclipped, tuple(settings))


def check_radius(problem: Problem, episodes: Episodes) -> None:
    """Raise GuiderError where every goal would be met before a step is taken, or float32 cannot tell goals apart.

    Warns where that is so of most, or where a step goes so much further than a radius that goals are passed unmet.
    """
    achieved = episodes.achieved
    first = np.repeat(achieved[episodes.starts], episodes.lengths, axis=0)
    furthest = float(np.max(largest_distance(achieved, first, problem.goal_parts)))
    if furthest <= problem.radius:
        raise GuiderError(
            f"{episodes.source}: no episode gets further than {furthest:.3g} from where it starts in goal space, so "
            f"every goal is met within the radius {problem.radius:g} at once; choose a smaller radius (its unit is "
            "that of the goal entries), or check which entries are the goal"
        )
    rows, spacing = np.abs(achieved).argmax(axis=0), np.spacing(np.abs(achieved).max(axis=0))
    if (coarse := spacing > _FINEST_STEP * problem.radius).any():
        entry = int(np.argmax(coarse))
        raise GuiderError(
            f"{episodes.source}: goal entry {entry} is {achieved[rows[entry], entry]:.7g} in row {rows[entry]}, where "
            f"float32, in which networks compute, tells apart only steps of {spacing[entry]:.2g}: too coarse for the "
            f"radius {problem.radius:g}; if all positions lie that far off, subtract an origin from them and from goals"
        )
    ends = achieved[episodes.last_rows[episodes.starts]]
    near = np.mean(largest_distance(achieved[episodes.starts], ends, problem.goal_parts) <= problem.radius)
    step = float(np.median(moves(episodes, 1)))
    for suspect, what in (
        (near > 0.5, f"{near:.0%} of the episodes end within the radius {problem.radius:g} of where they start"),
        (step > _LONG_STEP * problem.radius, f"the median step goes {step:.3g}, past the radius {problem.radius:g}"),
    ):
        if suspect:
            warnings.warn(GuiderWarning(f"{episodes.source}: {what}; is that its unit?"), stacklevel=2)


def unit_scale(view: ViewConfig, spaces: Spaces) -> Scale:
    """Raw inputs, and the shapes of any scale."""
    zeros, ones = jnp.zeros, jnp.ones
    state_dim, goal_dim = spaces.state_dim, spaces.goal_dim
    frequencies = wave_frequencies(view.position_waves)
    return Scale(zeros(state_dim), ones(state_dim), zeros(goal_dim), ones(goal_dim), ones(goal_dim), frequencies)


def make_scale(episodes: Episodes, starts: np.ndarray, period_steps: int, waves: int, smallest_spread: float) -> Scale:
    """Scale from the data. starts: [W] rows that start a window of c = period_steps steps."""
    mean = episodes.observations.mean(axis=0, dtype=np.float64)
    std = np.maximum(episodes.observations.std(axis=0, dtype=np.float64), SMALLEST_SPREAD)
    goal = list(episodes.goal_indices)
    std[goal] = np.maximum(std[goal], smallest_spread)
    achieved = episodes.achieved
    later = np.minimum(starts + period_steps, episodes.last_rows[starts])
    step_std = np.maximum(np.sqrt(np.mean((achieved[later] - achieved[starts]) ** 2, axis=0)), smallest_spread)
    arrays = (mean, std, mean[goal], std[goal], step_std, wave_frequencies(waves))
    return Scale(*(jnp.asarray(array, jnp.float32) for array in arrays))
