"""What training is asked for, against what the data is: settled, or refused in a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from guider import data as data_sources
from guider.data import AS_FOUND, Reading
from guider.data.episodes import Episodes
from guider.data.goal_spaces import with_goals
from guider.data.suggestions import suggested_period
from guider.errors import GuiderError
from guider.learning.options import LearningOptions, said
from guider.learning.problem import Problem
from guider.learning.windows import moves
from guider.methods import preset_config
from guider.methods.view import check_radius
from guider.support.config import override
from guider.tasks import Task, find_task

MOVING_SHARE = 0.1
"""Of windows that must go a radius or further, before others are left out."""


def check(task: str | None, settings: dict[str, Any] | None, options: LearningOptions) -> None:
    """Raise GuiderError for what can be told before any data is read: names that are none, and options that the task
    decides, or that one's own data needs."""
    if fixed := [name for name in settings or {} if name.startswith("problem.")]:
        raise GuiderError(f"{fixed[0]} is no setting: the task, or an option of its own, decides it")
    asked = said(options)
    benchmark = None if task is None else find_task(task)
    preset_config(asked["method"], asked["preset"], Problem())
    if benchmark is not None and {"goal_indices", "goal", "radius"} & asked.keys():
        raise GuiderError(
            f"{benchmark.name} fixes its goal entries and radius; leave --goal-indices, --goal and --radius out"
        )
    if benchmark is None and "radius" not in asked:
        raise GuiderError(
            "without a task name, say how near to a goal counts as met (--radius 0.5) and which state entries are "
            "the goal (--goal x y, or --goal-indices 0 1)"
        )


def find_data(
    task: str | None,
    data: str | Path | Episodes | None,
    options: LearningOptions,
    assumed_goal: tuple[int, ...] | None = None,
) -> Episodes:
    """All episodes, in the goal space that was asked for. assumed_goal: where nobody names it. Raises GuiderError if
    there are none, or they are not the task's."""
    asked = said(options)
    benchmark = None if task is None else find_task(task)
    if data is None:
        hint = f"make some with `guider collect {task} --out FILE`" if benchmark and benchmark.collector else "a file"
        raise GuiderError(f"no data given: name it with --data ({hint})")
    goal_indices = asked.get("goal_indices")
    if benchmark is not None:
        goal_indices = None if isinstance(data, Episodes) else benchmark.goal_indices
    episodes = episodes_of(data, goal_indices, asked.get("goal", ()), reading_of(options), assumed_goal)
    if benchmark is not None:
        if episodes.goal_indices != benchmark.goal_indices:
            raise GuiderError(
                f"the goal entries of {benchmark.name} are {benchmark.goal_indices}, those of the episodes "
                f"{episodes.goal_indices}; give them as episodes.with_goal_space({benchmark.goal_indices})"
            )
        _check_fits(benchmark, episodes)
    return episodes


def settle(
    task: str | None, episodes: Episodes, settings: dict[str, Any] | None, options: LearningOptions
) -> tuple[Problem, Any]:
    """(what is to be learned, the method's settings), from what was asked and the data."""
    asked = said(options)
    if task is not None:
        problem = problem_of(find_task(task))
    else:
        radius = number(asked["radius"], "radius")
        period = suggested_period(episodes, radius)
        problem = Problem(
            radius,
            2 * radius,
            period,
            window_move=radius if float(np.mean(moves(episodes, period) >= radius)) >= MOVING_SHARE else 0.0,
            goal_dim=len(episodes.goal_indices),
            transitions=int(np.sum(episodes.lengths - 1)),
        )
        check_radius(problem, episodes)
    if "reach_radius" in asked:
        problem = replace(problem, reach_radius=number(asked["reach_radius"], "reach_radius"))
    if "period_steps" in asked:
        problem = replace(problem, period_steps=whole(asked["period_steps"], "period_steps"))
    return problem, override(preset_config(asked["method"], asked["preset"], problem), settings or {})


def reading_of(options: LearningOptions) -> Reading:
    """How the data is to be read."""
    asked = said(options)
    names = {name: data_sources.as_names(asked.get(name, ())) for name in ("state", "action", "episode_ends")}
    return Reading(asked.get("format"), **names)


def problem_of(task: Task) -> Problem:
    """What a task asks to be learned."""
    return Problem(task.radius, task.reach_radius, task.period_steps, task.goal_parts, task.domain)


def episodes_of(
    data: str | Path | Episodes,
    goal_indices: Sequence[int] | None,
    goal: Sequence[str] = (),
    reading: Reading = AS_FOUND,
    assumed_goal: tuple[int, ...] | None = None,
) -> Episodes:
    """Those of a file or dataset (see `guider.load_data`), or the ones given."""
    if not isinstance(data, Episodes):
        return data_sources.load(data, goal_indices, goal=goal, **asdict(reading), assumed_goal=assumed_goal)
    if reading != AS_FOUND:
        raise GuiderError("format, state, action and episode_ends say how to read a file; leave them out for Episodes")
    if goal:
        return with_goals(data, goal)
    return data if goal_indices is None else data.with_goal_space(goal_indices)


def whole(value: Any, name: str) -> int:
    """The value as an int, NumPy's too. Raises GuiderError for anything but a whole number."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise GuiderError(f"{name} must be a whole number, got {value!r}")
    return int(value)


def number(value: Any, name: str) -> float:
    """The value as a float, NumPy's too. Raises GuiderError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise GuiderError(f"{name} must be a number, got {value!r}")
    return float(value)


def _check_fits(task: Task, episodes: Episodes) -> None:
    found = episodes.observations.shape[1], episodes.actions.shape[1]
    if found != (task.state_dim, task.action_dim):
        raise GuiderError(
            f"{episodes.source} holds states of {found[0]} and actions of {found[1]} numbers; "
            f"{task.name} ({task.environment}) has {task.state_dim} and {task.action_dim}"
        )
    task.check_data(episodes)
