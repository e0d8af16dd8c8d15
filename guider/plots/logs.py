"""A policy on logs, without a maze: what it proposes along their episodes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from guider.data.episodes import Episodes, entry_name
from guider.methods.policy import Policy
from guider.plots import canvas
from guider.plots.subgoals import proposals, reachable, subgoals_of

Kind = Literal["held-out", "training"]


def subgoals_on_logs(logged: Episodes, shown: Episodes, kind: Kind, policy: Policy, title: str) -> Figure:
    """Without a maze: subgoals proposed every c steps along the first episodes, towards their last states.

    logged: what training saw; shown: the episodes to draw; kind: what these are.
    A goal space of two entries is drawn as a plane, any other as its most varied entries against time.
    """
    if logged.spaces.goal_dim == 2:
        return _subgoals_in_plane(logged, shown, kind, policy, title)
    return _subgoals_over_time(logged, shown, kind, policy, title)


def _subgoals_in_plane(logged: Episodes, shown: Episodes, kind: Kind, policy: Policy, title: str) -> Figure:
    paths = _first_paths(shown, 4)
    period = policy.config.problem.period_steps
    columns = min(2, len(paths))
    rows = -(-len(paths) // columns)
    figure = canvas.new_figure(
        f"{title}\nsubgoals every c = {period} steps along {kind} episodes, towards their last states",
        (5.5 * columns + 0.5, 4.5 * rows + 0.9),
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    spread = logged.achieved.std(axis=0)
    spread[spread == 0] = 1  # an entry that never changes
    line = LineCollection([])
    for index, (axes, (states, achieved)) in enumerate(zip(panels, paths, strict=False)):
        here = achieved[::period]
        subgoals, _ = proposals(policy, states[::period], achieved[-1])
        kept = canvas.spaced(subgoals / spread, 0.2)
        samples = reachable(policy, here[kept], 40).reshape(-1, 2)
        canvas.logged_dots(axes, logged)
        axes.plot(*samples.T, "o", color=canvas.ORANGE, alpha=0.5, markersize=2, markeredgewidth=0, zorder=2)
        line = canvas.timed_path(axes, achieved, max(len(states) for states, _ in paths))
        canvas.numbered_stars(axes, subgoals[kept])
        canvas.flag(axes, achieved[-1], policy.config.problem.radius)
        axes.set_title(f"{kind} episode {index}, {len(achieved)} states", fontsize=9)
        axes.set(xlabel=_entry_name(logged, 0), ylabel=_entry_name(logged, 1))
        axes.label_outer()
    for axes in panels[len(paths) :]:
        axes.remove()
    canvas.colour_bar(figure, line, list(panels[: len(paths)]), "step of the episode")
    canvas.legend(
        figure,
        [
            canvas.dot_handle(canvas.LOGGED, "logged states"),
            canvas.star_handle("subgoals in order (thinned)"),
            *_samples_handle(policy),
            canvas.flag_handle(),
        ],
    )
    return figure


def _subgoals_over_time(logged: Episodes, shown: Episodes, kind: Kind, policy: Policy, title: str) -> Figure:
    paths = _first_paths(shown, 3)
    period = policy.config.problem.period_steps
    goal_dim = logged.spaces.goal_dim
    entries = np.sort(np.argsort(logged.achieved.std(axis=0))[::-1][:4])
    chosen = f"; the {len(entries)} most varied of {goal_dim} goal entries" if goal_dim > len(entries) else ""
    figure = canvas.new_figure(
        f"{title}\nsubgoals every c = {period} steps along {kind} episodes, towards their last states{chosen}",
        (4.2 * len(paths), 2.2 * len(entries) + 0.9),
    )
    panels = figure.subplots(len(entries), len(paths), squeeze=False, sharex="col", sharey="row")
    for column, (states, achieved) in enumerate(paths):
        steps = np.arange(0, len(achieved), period)
        subgoals, _ = proposals(policy, states[steps], achieved[-1])
        samples = reachable(policy, achieved[steps], 20)
        for axes, entry in zip(panels[:, column], entries, strict=True):
            later = np.repeat(steps + period, samples.shape[1])
            axes.plot(later, samples[..., entry].ravel(), "o", color=canvas.ORANGE, alpha=0.4, markersize=2.5)
            axes.plot(achieved[:, entry], color=canvas.BLUE)
            axes.plot(
                steps + period, subgoals[:, entry], "*", color=canvas.RED, markersize=8, markeredgecolor=canvas.DARK
            )
            axes.axhline(achieved[-1, entry], color=canvas.GREEN, linestyle="--", linewidth=1)
        panels[0, column].set_title(f"{kind} episode {column}", fontsize=9)
        panels[-1, column].set_xlabel("step of the episode")
    for axes, entry in zip(panels[:, 0], entries, strict=True):
        axes.set_ylabel(_entry_name(logged, int(entry)))
    canvas.legend(
        figure,
        [
            Line2D([], [], color=canvas.BLUE, label="logged"),
            Line2D([], [], color=canvas.RED, marker="*", linestyle="", label="subgoal, when it is due"),
            *_samples_handle(policy),
            Line2D([], [], color=canvas.GREEN, linestyle="--", label="final goal"),
        ],
    )
    return figure


def _first_paths(episodes: Episodes, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(states [states, S], s^G [states, G]) of the first `count` episodes."""
    of_states, of_places = (np.split(rows, episodes.starts[1:]) for rows in (episodes.observations, episodes.achieved))
    return list(zip(of_states, of_places, strict=True))[:count]


def _samples_handle(policy: Policy) -> list[Line2D]:
    """What stands for samples in a legend, where a method has any."""
    has_any = subgoals_of(policy).reachable is not None
    return [canvas.dot_handle(canvas.ORANGE, "samples of the prior, decoded")] if has_any else []


def _entry_name(episodes: Episodes, entry: int) -> str:
    return entry_name(episodes.state_names, episodes.goal_indices[entry])
