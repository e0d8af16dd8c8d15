"""The graph over logged places in a maze: how far every place is from a goal, and the way there."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from guider.data.episodes import Episodes
from guider.goals import largest_distance
from guider.methods.routes import Routes, next_place, within_steps
from guider.plots import canvas
from guider.tasks.mazes import Maze
from guider.tasks.types import Task


def routes_in_maze(
    task: Task, maze: Maze, logged: Episodes, config: Any, routes: Routes, ends: np.ndarray, title: str
) -> Figure:
    """Places, coloured by the steps that are left to the goal, the edges that a subgoal may lie along, and the chain of
    subgoals from one to the other of `ends` [2, 2] if each is reached."""
    start, goal = ends
    longest = within_steps(config.routes, config.problem)
    known = np.flatnonzero(np.isfinite(np.asarray(routes.places)).all(axis=1))
    places = np.asarray(routes.places)[known]
    edges = np.asarray(routes.edges)[np.ix_(known, known)]
    there = int(np.asarray(largest_distance(places, goal, config.problem.goal_parts)).argmin())
    left = np.asarray(routes.steps)[known, known[there]]
    chain, steps = way(routes, start, goal, longest, config)

    width, height = canvas.panel_size(maze, 9.0)
    arrives = "" if np.array_equal(chain[-1], goal) else ", to the nearest place that a way leads to"
    figure = canvas.new_figure(
        f"{title}\n{len(places)} logged places; {steps:.0f} steps from start to goal, as the data took them{arrives}",
        (width, height + 0.1),
    )
    axes = figure.subplots()
    canvas.ground(axes, maze, logged)
    drawn = np.argwhere((edges > 0) & (edges <= longest))
    lines: Any = places[drawn]
    axes.add_collection(LineCollection(lines, colors=canvas.BLUE, linewidths=0.3, alpha=0.15, zorder=3))
    unreached = np.isinf(left)
    axes.plot(*places[unreached].T, "x", color=canvas.RED, markersize=3, zorder=4)
    reached = places[~unreached]
    dots = axes.scatter(*reached.T, c=left[~unreached], cmap=canvas.TIME_COLOURS, s=9, linewidths=0, zorder=4)
    axes.plot(*np.vstack([start, chain]).T, "-", color=canvas.DARK, linewidth=1.5, zorder=5)
    canvas.numbered_stars(axes, chain)
    canvas.flag(axes, goal, task.radius)
    canvas.colour_bar(figure, dots, [axes], "steps to the goal, as the data took them")
    off = Line2D([], [], color=canvas.RED, marker="x", linestyle="", markersize=4, label="no way to the goal")
    stars = canvas.star_handle("subgoals in order")
    canvas.legend(figure, [canvas.logged_handle(), stars, *([off] if unreached.any() else []), canvas.flag_handle()])
    return figure


def way(routes: Routes, start: np.ndarray, goal: np.ndarray, longest: float, config: Any) -> tuple[np.ndarray, float]:
    """(subgoals [n, G] in order, each chosen where the one before lies, steps from the first to the last)."""
    at, total, chain = jnp.asarray(start, jnp.float32)[None], None, []
    while not chain or not np.array_equal(chain[-1], goal):
        subgoal, left = next_place(routes, at, jnp.asarray(goal)[None], longest, config.problem)
        total = float(left[0]) if total is None else total
        if any(np.array_equal(subgoal[0], earlier) for earlier in chain):
            break
        chain.append(np.asarray(subgoal[0]))
        at = subgoal
    return np.array(chain), total or 0.0
