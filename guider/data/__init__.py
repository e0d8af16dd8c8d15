"""Reading logged trajectories, whatever they come in, into Episodes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.describe import describe
from guider.data.episodes import Episodes, make_episodes
from guider.data.goal_spaces import is_computed, with_goals
from guider.data.readers import open_source
from guider.data.readers.kitchen import is_kitchen, read_kitchen, without_velocities
from guider.data.recording import Wanted, recording_of
from guider.errors import GuiderError, GuiderWarning

__all__ = ["AS_FOUND", "FORMATS", "Reading", "as_names", "describe", "load"]

FORMATS = ("arrays", "d4rl-kitchen", "minari", "wgcsl")


@dataclass(frozen=True)
class Reading:
    """How a source is read, where it does not tell itself: see `load`."""

    format: str | None = None
    state: tuple[str, ...] = ()
    action: tuple[str, ...] = ()
    episode_ends: tuple[str, ...] = ()


AS_FOUND = Reading()


def load(
    source: str | Path,
    goal_indices: Sequence[int] | None = None,
    *,
    state: Sequence[str] = (),
    action: Sequence[str] = (),
    goal: Sequence[str] = (),
    format: str | None = None,
    episode_ends: Sequence[str] = (),
    action_low: np.ndarray | float | None = None,
    action_high: np.ndarray | float | None = None,
    assumed_goal: Sequence[int] | None = None,
) -> Episodes:
    """Read the trajectories at `source`.

    source: told apart by content:
        HDF5 or npz   one's own arrays, D4RL's, OGBench's; robomimic's, robosuite's, d3rlpy's; the package imitation's;
                      ragged or pickled episodes, which are read without unpickling, as are HER's demonstrations
        a folder      LeRobot's (v2, v3); Minari's; or one with a CSV, parquet, npz or npy file for each episode
        a table       CSV, parquet or npy, with a column that says where episodes end
        a pickle      WGCSL's, or a list of dicts of arrays; it is read without unpickling
        minari:ID     a Minari dataset that is installed
    goal_indices: the state entries that make up the goal space; None for the source's own, if it names one
    goal: the same by name, e.g. ("x", "y"); names may hold * and ?; or what is computed, see guider.data.goal_spaces
    state, action: names of the columns that are the state and the action (see guider.data.columns); () for those
        usually called so
    format: one of FORMATS, where content does not tell: d4rl-kitchen is `terminals`, 9 actions and 30 numbers a row, or
        60 of which the last 30, a goal, stay
    episode_ends: which signs of where episodes end to take, by name; () decides, see guider.data.ends
    action_low, action_high: bounds of a valid action; where None, those the source states, else inferred
    assumed_goal: taken where neither `goal_indices` nor the source says, instead of raising

    Raises GuiderError, naming the source and what is wrong with it, for anything that cannot be read or is
    not valid (see make_episodes). Warns of what was decided about the data and may be wrong.
    """
    name = str(source)
    if format is not None and format not in FORMATS:
        raise GuiderError(
            f"unknown data format {format!r}; there are {', '.join(FORMATS)} (arrays: D4RL's, OGBench's and one's own)"
        )
    if goal_indices is not None and goal:
        raise GuiderError("the goal space is named twice, by numbers and by names; leave one out")
    if any(map(is_computed, as_names(goal))):
        reading: dict[str, Any] = {"state": state, "action": action, "format": format, "episode_ends": episode_ends}
        bounds: dict[str, Any] = {"action_low": action_low, "action_high": action_high}
        return with_goals(load(source, **reading, **bounds, assumed_goal=(0,)), as_names(goal))
    wanted = Wanted(
        None if goal_indices is None else tuple(goal_indices),
        as_names(goal),
        None if assumed_goal is None else tuple(assumed_goal),
        as_names(state),
        as_names(action),
        as_names(episode_ends),
    )
    with open_source(name, format) as store:
        kitchen = format == "d4rl-kitchen" or (format is None and is_kitchen(store))
        recording = read_kitchen(store, wanted) if kitchen else recording_of(without_velocities(store), wanted)
    if recording.warning:
        warnings.warn(GuiderWarning(f"{name}: {recording.warning}"), stacklevel=2)
    known = recording.goal_indices
    episodes = make_episodes(
        recording.observations,
        recording.actions,
        recording.lengths,
        wanted.assumed_goal or () if known is None else known,
        goals=recording.goals,
        times=recording.times,
        action_low=recording.action_low if action_low is None else action_low,
        action_high=recording.action_high if action_high is None else action_high,
        source=name,
        end_signs=recording.end_signs,
    )
    asked = wanted.goal_indices is not None or bool(wanted.goal)
    return replace(
        episodes,
        goal_space_from="asked for" if asked else "the source" if known else "assumed",
        state_names=recording.state_names,
        action_names=recording.action_names,
    )


def as_names(names: Sequence[str] | str) -> tuple[str, ...]:
    """One name or several, as several."""
    return (names,) if isinstance(names, str) else tuple(names)
