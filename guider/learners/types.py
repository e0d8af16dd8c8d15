"""What every learner of a goal-conditioned policy is given, and what it offers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax

from guider.support.config import ByDomain, Changes

LONG: Changes = {"discount": 0.995}
"""Preset `fast` where final goals lie hundreds of steps ahead."""


class Transitions(NamedTuple):
    """Transitions labelled with a goal, as the networks see them.

    state, next_state: [B, inputs] scaled state and goal; action: [B, A] in [-1, 1]; reward: [B], 0 where the goal is
    met after the step, else below; steps: [B] int, how many steps ahead in its own episode the goal was taken from, -1
    where it was not.
    """

    state: jax.Array
    action: jax.Array
    reward: jax.Array
    next_state: jax.Array
    steps: jax.Array


@dataclass(frozen=True)
class Learner:
    """The functions of one learner; `config` is an instance of its config type throughout.

    init:   (key, config, hidden, input_dim, action_dim) -> state, a NamedTuple with `params` and `optimiser`
    update: (config, state, Transitions, key, learning rate) -> (state, metrics)
    act:    (config, state, inputs [..., inputs]) -> the most likely actions [..., A] in [-1, 1]
    fast, fast_in_domain: what preset `fast` changes, alone and as Guider's low level alike: Figure 4 compares what
            stands above
    """

    init: Callable[..., Any]
    update: Callable[..., Any]
    act: Callable[..., Any]
    fast: Changes
    fast_in_domain: ByDomain
