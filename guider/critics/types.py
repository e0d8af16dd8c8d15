"""What a critic is given, and asked."""

from __future__ import annotations

from typing import NamedTuple

import jax


class Steps(NamedTuple):
    """Logged steps towards a goal, as networks see them (scaled).

    state, next_state: [B, S]; action: [B, A] in [-1, 1]; place, goal: [B, P], where the state is in goal space, and the
    goal; unmet: [B], 1 until the state meets the goal, where the episode ends, else 0.
    """

    state: jax.Array
    action: jax.Array
    next_state: jax.Array
    place: jax.Array
    goal: jax.Array
    unmet: jax.Array
