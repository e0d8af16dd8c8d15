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
    their order. Raises GuiderError for a name that means nothing or two things, and where a function fails."""
    logged = episodes.logged.shape[1]
    names = (episodes.state_names or tuple(map(str, range(logged))))[:logged]
    indices: list[int] = []
    for name in wanted:
        if not is_computed(name):
            indices += entries_called(names, logged, [name], episodes.source)
            continue
        if name in names:
            raise GuiderError(
                f"{episodes.source}: {name} is a state entry and a goal of GUIDER_GOALS; rename the latter"
            )
        turning = name.removeprefix(ANGLE) if name.startswith(ANGLE) else None
        found = [] if turning is None else entries_called(names, logged, [turning], episodes.source)
        for computed in [f"{ANGLE}{entry}" for entry in found] or [name]:
            if computed not in episodes.computed:
                episodes = with_computed(episodes, [computed])
            indices += _entries(computed, episodes.spaces)
    return episodes.with_goal_space(tuple(dict.fromkeys(indices)))


def with_computed(episodes: Episodes, computed: Sequence[str]) -> Episodes:
    """The episodes with further state entries: those of `angle:NUMBER`, and of functions by name."""
    logged = episodes.logged
    for name in computed:
        columns = _checked(name, logged, episodes.source)
        names = episodes.state_names or tuple(map(str, range(logged.shape[1])))
        episodes = replace(
            episodes,
            observations=np.concatenate([episodes.observations, columns], axis=1),
            state_names=(*names, *_names(name, columns.shape[1], names)),
            computed=(*episodes.computed, name),
            computed_widths=(*episodes.computed_widths, columns.shape[1]),
        )
    return episodes


def check_computed(spaces: Spaces) -> None:
    """Raise GuiderError where what is computed is not what it was when the run was trained."""
    if not spaces.computed:
        return
    example = np.array(spaces.example, np.float32)
    found = np.asarray(extended(example[: spaces.logged_dim], spaces.computed), np.float32)
    if found.shape != example.shape or not np.allclose(found, example, rtol=1e-4, atol=1e-5):
        raise GuiderError(
            f"{' or '.join(spaces.computed)} computes something else than when this was trained; let GUIDER_GOALS name "
            "the file as it was then"
        )


def _checked(name: str, logged: np.ndarray, source: str) -> np.ndarray:
    """[rows, entries] float32: what a function makes of states. Raises GuiderError unless it makes the same of one
    state alone, compiled, as a robot's policy asks it to."""
    import jax

    def fail(what: str) -> GuiderError:
        return GuiderError(f"{source}: the goal {name} {what}")

    try:
        columns = np.asarray(_values(name, logged))
        alone = np.stack([jax.jit(lambda state: _values(name, state))(state) for state in logged[:3]])
    except GuiderError:
        raise
    except Exception as error:  # whatever a function of somebody's own raises
        why = " ".join(str(error).split())[:200]
        raise fail(
            "must be computed of states [rows, S] and of one state [S], under jax.jit, with jax.numpy; "
            f"{type(error).__name__}: {why}"
        ) from error
    if columns.ndim != 2 or len(columns) != len(logged) or 0 in columns.shape or columns.dtype.kind not in "fiub":
        raise fail(f"must be numbers [rows, entries], a row for each of {len(logged)} states; got {columns.shape}")
    if bad := int((~np.isfinite(columns)).any(axis=1).sum()):
        raise fail(f"is NaN or infinite in {bad} of {len(columns)} states")
    if alone.shape != columns[:3].shape or not np.allclose(alone, columns[:3], rtol=1e-3, atol=1e-4):
        raise fail(
            "gives one state alone something else than the same state among others; let it look at the last axis only"
        )
    return columns.astype(np.float32)


def _entries(name: str, spaces: Spaces) -> range:
    """Where in a state what is computed under this name stands."""
    place = spaces.computed.index(name)
    first = spaces.logged_dim + sum(spaces.computed_widths[:place])
    return range(first, first + spaces.computed_widths[place])


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


def _names(name: str, width: int, names: tuple[str, ...]) -> tuple[str, ...]:
    if name.startswith(ANGLE):
        of = names[int(name.removeprefix(ANGLE))]
        return f"cos {of}", f"sin {of}"
    return (name,) if width == 1 else tuple(f"{name}.{entry}" for entry in range(width))
