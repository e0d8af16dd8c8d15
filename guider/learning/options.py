"""What the user says of what is to be learned: the same words in Python and on the command line, said once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from guider.errors import names_like

Preset = Literal["fast", "paper"]


class LearningOptions(TypedDict, total=False):
    """What is learned, how, and from what: `train` and `data inspect` take them alike."""

    method: str
    """What to train: guider (if nothing is said); guider-routes (subgoals by a graph over logged places); guider-gcsl,
    guider-wgcsl or guider-cql (with another low level); hiql, hiql-places, opal; or, without subgoals, bc, gcsl, wgcsl,
    cql-her, iql. Or one of your own, from a file that the environment variable GUIDER_METHODS names."""
    preset: Preset
    """`fast` (if nothing is said) fits two cores; `paper` is the paper's equations and the authors' settings."""
    goal_indices: Sequence[int]
    """Own data: the state entries that are the goal, e.g. 0 1 for x and y. Minari's goal observations name them
    themselves."""
    goal: Sequence[str]
    """Own data: the same by name, e.g. x y, where the data names its columns; * and ? stand for any letters. Or what
    is computed: angle:NAME, an angle in radians on its circle, and functions in the file that GUIDER_GOALS names."""
    state: Sequence[str]
    """The columns that are the state, by name, e.g. observation.state or left_arm_*; by default those usually called
    so."""
    action: Sequence[str]
    """The columns that are the action, by name."""
    radius: float
    """Own data: a goal counts as met within this distance, in the units of those entries."""
    reach_radius: float
    """A subgoal counts as reached within this distance; by default the task's, or twice the radius."""
    period_steps: int
    """Steps between subgoals (c); by default the task's, or the fewest from 20 on in which what moves goes three radii
    (a third of the median episode at most)."""
    format: str
    """How to read the data, if its content does not tell: arrays, d4rl-kitchen, minari, wgcsl."""
    episode_ends: Sequence[str]
    """Which signs of where episodes end to take, of those that `guider data inspect` lists."""


def said(options: Mapping[str, Any]) -> dict[str, Any]:
    """Those that were given, and method and preset. Raises TypeError, as Python does, for a name that is none."""
    names = LearningOptions.__annotations__
    if unknown := options.keys() - names.keys():
        name = sorted(unknown)[0]
        raise TypeError(f"there is no option {name!r}; {names_like(name, names)}")
    given = {name: value for name, value in options.items() if value is not None}
    return {"method": "guider", "preset": "fast"} | given
