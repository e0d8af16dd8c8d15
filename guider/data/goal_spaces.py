"""Goals that are no entries of a logged state: angles on a circle, and what a function of one's own makes of a state.

`angle:NAME` is the cosine and sine of an entry in radians: near where angles are, across the place where its number
wraps too. Other names are of functions in a file that GUIDER_GOALS names (docs/own_goal.py). What is computed stands
behind the entries of a state as if it had been logged there, for learning and in pictures; a robot need not know of it:
its policy computes it anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from guider.data.columns import entries_called
from guider.data.episodes import Episodes, Spaces
from guider.errors import GuiderError
from guider.support import plugins

ANGLE = "angle:"


def is_computed(name: str) -> bool:
    """Whether a goal of this name is computed, and no entry."""
    return name.startswith(ANGLE) or name in plugins.known("goals", {})


def with_goals(episodes: Episodes, wanted: Sequence[str]) -> Episodes:
    """The episodes with the goal space that is wanted: patterns of entries' names, and names of what is computed, in
    their order. Raises GuiderError for a name that means nothing, and where a function fails."""
    logged = episodes.logged.shape[1]
    names = episodes.state_names[:logged]
    indices: list[int] = []

    def called(pattern: str) -> tuple[int, ...]:
        return entries_called(names, logged, [pattern], episodes.source)

    for name in wanted:
        if not is_computed(name):
            indices += called(name)
            continue
        turning = called(name.removeprefix(ANGLE)) if name.startswith(ANGLE) else ()
        before = episodes.observations.shape[1]
        episodes = with_computed(episodes, [f"{ANGLE}{entry}" for entry in turning] or [name])
        indices += range(before, episodes.observations.shape[1])
    return episodes.with_goal_space(tuple(dict.fromkeys(indices)))


def with_computed(episodes: Episodes, computed: Sequence[str]) -> Episodes:
    """The episodes with further state entries: those of `angle:NUMBER`, and of functions by name."""
    logged = episodes.logged
    for name in computed:
        try:
            columns = np.asarray(_values(name, logged), np.float32)
        except GuiderError:
            raise
        except Exception as error:  # whatever a function of somebody's own raises
            raise GuiderError(
                f"{episodes.source}: the goal {name} cannot be computed ({type(error).__name__}: {error})"
            ) from error
        if columns.ndim != 2 or len(columns) != len(logged) or not np.isfinite(columns).all():
            raise GuiderError(
                f"{episodes.source}: the goal {name} must be finite numbers [rows, entries], a row for each of "
                f"{len(logged)} states; got {columns.shape}"
            )
        episodes = replace(
            episodes,
            observations=np.concatenate([episodes.observations, columns], axis=1),
            state_names=episodes.state_names and (*episodes.state_names, *_names(name, columns.shape[1], episodes)),
            computed=(*episodes.computed, name),
            computed_widths=(*episodes.computed_widths, columns.shape[1]),
        )
    return episodes


def goals_of(spaces: Spaces) -> list[str]:
    """What `with_goals` is to be asked for to give this goal space: entries by number, and what is computed."""
    of_entry = [str(entry) for entry in range(spaces.logged_dim)]
    for name, width in zip(spaces.computed, spaces.computed_widths, strict=True):
        of_entry += [name] * width
    return list(dict.fromkeys(of_entry[entry] for entry in spaces.goal_indices))


def extended(states: Any, computed: Sequence[str]) -> Any:
    """States [..., S], of NumPy or JAX, with what is computed of them behind: [..., S + computed]."""
    if not computed:
        return states
    space = states.__array_namespace__()
    return space.concat([states, *(_values(name, states) for name in computed)], axis=-1)


def _values(name: str, states: Any) -> Any:
    if not name.startswith(ANGLE):
        return plugins.find("goals", name, {})(states)
    entry = int(name.removeprefix(ANGLE))
    angle, space = states[..., entry : entry + 1], states.__array_namespace__()
    return space.concat([space.cos(angle), space.sin(angle)], axis=-1)


def _names(name: str, width: int, episodes: Episodes) -> tuple[str, ...]:
    if name.startswith(ANGLE):
        of = episodes.state_names[int(name.removeprefix(ANGLE))]
        return f"cos {of}", f"sin {of}"
    return (name,) if width == 1 else tuple(f"{name}.{entry}" for entry in range(width))
