"""Which rows are learned from, and the episodes on the device."""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes
from guider.errors import GuiderError

Boundary = Literal["clip", "drop"]
MoveWithin = Literal["period", "episode"]


class Data(NamedTuple):
    """Episodes on the device. Rows are those of `Episodes`.

    observations: [N, S]; actions: [N, A], scaled so that the action bounds are -1 and 1;
    achieved: [N, G], s^G; goals: [N, G] recorded goals, or None; last_row: [N], last row of the episode;
    transition_rows: [M], rows to learn actions from; window_rows: [W], rows where a c-step window may start.
    """

    observations: jax.Array
    actions: jax.Array
    achieved: jax.Array
    goals: jax.Array | None
    last_row: jax.Array
    transition_rows: jax.Array
    window_rows: jax.Array


def window_starts(
    episodes: Episodes,
    period_steps: int,
    boundary: Boundary,
    minimum_move: float = 0.0,
    move_within: MoveWithin = "period",
) -> np.ndarray:
    """Rows t from which a window of c = `period_steps` may start. Returns [W] int32.

    boundary "drop": t + c lies within the episode. "clip": any t with a successor; the window then ends at
    the episode's last state (the authors' choice). Left out are windows whose ends lie closer than `minimum_move`
    (goal units), or, with move_within "episode", all of an episode that stays closer than that to its first state.
    """
    last = episodes.last_rows
    rows = np.arange(len(last), dtype=np.int32)
    later = np.minimum(rows + period_steps, last)
    keep = rows + (period_steps if boundary == "drop" else 1) <= last
    if minimum_move > 0:
        achieved = episodes.achieved
        if move_within == "period":
            keep &= np.linalg.norm(achieved[later] - achieved, axis=1) >= minimum_move
        else:
            first = np.repeat(achieved[episodes.starts], episodes.lengths, axis=0)
            furthest = np.maximum.reduceat(np.linalg.norm(achieved - first, axis=1), episodes.starts)
            keep &= np.repeat(furthest >= minimum_move, episodes.lengths)
    return rows[keep]


def moving_windows(
    episodes: Episodes,
    period_steps: int,
    boundary: Boundary,
    minimum_move: float,
    move_within: MoveWithin,
    minimum_window_move: float,
) -> np.ndarray:
    """`window_starts`, of which those that go less far than `minimum_window_move` from end to end are left out."""
    starts = window_starts(episodes, period_steps, boundary, minimum_move, move_within)
    if minimum_window_move == 0:
        return starts
    return np.intersect1d(starts, window_starts(episodes, period_steps, boundary, minimum_window_move))


def device_data(
    episodes: Episodes,
    period_steps: int,
    boundary: Boundary,
    minimum_move: float,
    move_within: MoveWithin = "period",
    minimum_window_move: float = 0.0,
) -> Data:
    """Episodes on the device; a CPU device shares their memory. Transitions are learned from where a clipped window
    may start, see `window_starts`. Raises GuiderError where there is no window."""
    last = episodes.last_rows
    half_range = (episodes.action_high - episodes.action_low) / 2
    centre = (episodes.action_high + episodes.action_low) / 2
    transition_rows = window_starts(episodes, period_steps, "clip", minimum_move, move_within)
    window_rows = moving_windows(episodes, period_steps, boundary, minimum_move, move_within, minimum_window_move)
    if len(window_rows) == 0:
        raise GuiderError(f"{episodes.source}: {no_window(episodes, period_steps, minimum_move, minimum_window_move)}")
    return Data(
        observations=jax.device_put(episodes.observations, may_alias=True),
        actions=jnp.asarray((episodes.actions - centre) / half_range),
        achieved=jnp.asarray(episodes.achieved),
        goals=None if episodes.goals is None else jax.device_put(episodes.goals, may_alias=True),
        last_row=jnp.asarray(last),
        transition_rows=jnp.asarray(transition_rows),
        window_rows=jnp.asarray(window_rows),
    )


def no_window(episodes: Episodes, period_steps: int, minimum_move: float, minimum_window_move: float = 0.0) -> str:
    """Why no row starts a window of c = `period_steps` steps that moves so far, and what would help."""
    setting = "minimum_move" if minimum_move >= minimum_window_move else "minimum_window_move"
    minimum_move = max(minimum_move, minimum_window_move)
    longest = int(episodes.lengths.max())
    if longest <= period_steps:
        return (
            f"no episode holds a window of {period_steps} steps, the longest has {longest} states; choose a period of "
            f"{longest - 1} steps or fewer (--period-steps)"
        )
    furthest = {steps: moves(episodes, steps).max() for steps in (period_steps, *_longer(period_steps, longest))}
    here = furthest[period_steps]
    enough = next((steps for steps, move in furthest.items() if move >= minimum_move), None)
    longer = f"a longer period (--period-steps {enough}), or " if enough else ""
    return (
        f"no window of {period_steps} steps moves {minimum_move:g} in goal space (view.{setting}), the furthest "
        f"moves {here:.3g}; choose {longer}a smaller distance (--set view.{setting}={here / 2:.2g}; 0 learns from "
        "every row)"
    )


def _longer(period_steps: int, longest: int) -> list[int]:
    """Longer periods to look at, up to those of the longest episode."""
    return [steps for power in range(1, 12) if (steps := period_steps * 2**power) < longest] + [longest - 1]


def moves(episodes: Episodes, steps: int) -> np.ndarray:
    """[windows] how far s^G moves in `steps` steps, from every row with as many ahead in its episode."""
    first = np.flatnonzero(np.arange(len(episodes.observations)) + steps <= episodes.last_rows)
    achieved = episodes.achieved
    return np.linalg.norm(achieved[first + steps] - achieved[first], axis=1)
