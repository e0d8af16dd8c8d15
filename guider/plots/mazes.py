"""A policy in a maze: where its episodes went, what it proposes everywhere, and what it holds for reachable.

Positions are in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from guider.data.episodes import Episodes
from guider.evaluation.rollouts import Trace
from guider.methods.policy import Policy
from guider.plots import canvas
from guider.plots.subgoals import data_outcomes, proposals, reachable, states_at, subgoals_of
from guider.tasks.mazes import Maze
from guider.tasks.types import Task


def episodes_in_maze(
    task: Task, maze: Maze, logged: Episodes, traces: Sequence[Trace], first_seed: int, title: str
) -> Figure:
    """Where evaluation episodes went, coloured by time, with their subgoals in order (Figures 1b and 3).

    traces: of the episode seeds first_seed, first_seed + 1, ...; stars are thinned, see `legible_subgoals`, and left
    out where the goal is the only subgoal.
    """
    guided = any((trace.subgoals != trace.goal).any() for trace in traces)
    reached = sum(trace.success for trace in traces)
    columns = min(3, len(traces))
    rows = -(-len(traces) // columns)
    width, height = canvas.panel_size(maze, 4.4)
    figure = canvas.new_figure(
        f"{title}\n{canvas.seed_range(first_seed, len(traces))}: {reached} of {len(traces)} goals reached",
        (columns * width, rows * height + 0.6),
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    path = LineCollection([])
    for index, (axes, trace) in enumerate(zip(panels, traces, strict=False)):
        canvas.ground(axes, maze, logged)
        path = canvas.timed_path(axes, trace.achieved, task.horizon_steps)
        if guided:
            chosen = legible_subgoals(trace, 0.6 * maze.cell_size_m)
            canvas.numbered_stars(axes, trace.subgoals[chosen])
        canvas.flag(axes, trace.goal, task.radius)
        outcome = "reached after" if trace.success else "NOT reached in"
        axes.set_title(f"seed {first_seed + index}: {outcome} {len(trace.achieved)} steps", fontsize=9)
        axes.label_outer()
    for axes in panels[len(traces) :]:
        axes.remove()
    canvas.colour_bar(figure, path, list(panels[: len(traces)]), "environment step")
    stars = [canvas.star_handle("subgoals in order (thinned)")] if guided else []
    canvas.legend(figure, [canvas.logged_handle(), *stars, canvas.flag_handle()])
    return figure


def legible_subgoals(trace: Trace, spacing: float) -> np.ndarray:
    """[stars] steps at which a subgoal was chosen, thinned by `spaced`.

    A policy that asks anew whenever a subgoal is reached chooses too many to be read.
    """
    steps = np.flatnonzero(trace.renewed)
    return steps[canvas.spaced(trace.subgoals[steps], spacing)]


def subgoal_arrows(task: Task, maze: Maze, logged: Episodes, policy: Policy, goal: np.ndarray, title: str) -> Figure:
    """From positions all over the maze, the subgoal proposed on the way to `goal` [2].

    Colour is what being there is worth, see guider.methods.method.Subgoals; subgoals in walls have one of their own.
    """
    starts = maze_positions(maze, per_cell=3)
    subgoals, worth = proposals(policy, states_at(logged, starts), goal)
    moves = subgoals - starts
    walled = in_wall(maze, subgoals)
    width, height = canvas.panel_size(maze, 9.0)
    figure = canvas.new_figure(
        f"{title}\nsubgoals proposed towards the goal: median length "
        f"{np.median(np.linalg.norm(moves, axis=1)):.1f} m, {walled.mean():.0%} inside a wall",
        (width, height + 0.1),
    )
    axes = figure.subplots()
    canvas.ground(axes, maze, logged)
    size: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.0018, "zorder": 4}
    arrows = axes.quiver(*starts.T, *moves.T, worth, cmap=canvas.TIME_COLOURS, **size)
    axes.quiver(*starts[walled].T, *moves[walled].T, color=canvas.RED, **size)
    canvas.flag(axes, goal, task.radius)
    canvas.colour_bar(figure, arrows, [axes], subgoals_of(policy).worth(policy.config))
    inside = Line2D([], [], color=canvas.RED, marker=">", markersize=4, label="subgoal inside a wall")
    canvas.legend(figure, [canvas.logged_handle(), *([inside] if walled.any() else []), canvas.flag_handle()])
    return figure


def reachable_in_maze(maze: Maze, logged: Episodes, policy: Policy, positions: np.ndarray, title: str) -> Figure:
    """What is reachable in c steps of a few positions: the prior rho, decoded, beside what the data did.

    positions: [P, 2]. The data's outcomes are those of the windows the prior learns from that start within an
    eighth of a cell of the position. Lengths are medians, in metres.
    """
    samples = reachable(policy, positions, 150)
    starts, later = data_outcomes(logged, policy.config)
    columns = min(4, len(positions))
    rows = -(-len(positions) // columns)
    period = policy.config.problem.period_steps
    figure = canvas.new_figure(
        f"{title}\nreachable in c = {period} steps (median lengths)", (3.3 * columns, 3.5 * rows + 0.7)
    )
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, position, decoded in zip(panels, positions, samples, strict=False):
        near = np.linalg.norm(starts - position, axis=1) <= maze.cell_size_m / 8
        outcomes = canvas.thinned(later[near], 300)
        canvas.ground(axes, maze, logged)
        axes.plot(*outcomes.T, "o", color=canvas.BLUE, markersize=2.5, markeredgewidth=0, zorder=3)
        axes.plot(*decoded.T, "o", color=canvas.ORANGE, markersize=2.5, markeredgewidth=0, zorder=4)
        axes.plot(*position, "P", color=canvas.DARK, markeredgecolor="white", markersize=9, zorder=6)
        reach = 3 * maze.cell_size_m
        axes.set_xlim(position[0] - reach, position[0] + reach)
        axes.set_ylim(position[1] - reach, position[1] + reach)
        lengths = f"prior {_median_length(decoded - position)}, data {_median_length(later[near] - position)}"
        walled = f"{in_wall(maze, decoded).mean():.0%} of the prior inside a wall"
        axes.set_title(f"({position[0]:g}, {position[1]:g}): {lengths}\n{walled}", fontsize=9)
    for axes in panels[len(positions) :]:
        axes.remove()
    canvas.legend(
        figure,
        [
            canvas.logged_handle(),
            canvas.dot_handle(canvas.ORANGE, "samples of the prior, decoded"),
            canvas.dot_handle(canvas.BLUE, f"logged {period} steps later, in the windows learned from"),
            Line2D([], [], marker="P", color=canvas.DARK, linestyle="", label="here"),
        ],
    )
    return figure


def maze_positions(maze: Maze, per_cell: int) -> np.ndarray:
    """[free * per_cell**2, 2]: a regular grid of positions in every free cell, metres."""
    offsets = maze.cell_size_m * ((np.arange(per_cell) + 0.5) / per_cell - 0.5)
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    return (maze.cell_centre(maze.free_cells)[:, None] + grid).reshape(-1, 2)


def spread_positions(maze: Maze, logged: Episodes, count: int) -> np.ndarray:
    """[at most count, 2] centres of visited cells, far apart; the first is closest to the start cell.

    Each is the one furthest from all before it.
    """
    cells = np.unique(maze.cell_of(logged.achieved), axis=0)
    centres = maze.cell_centre(cells[~in_wall(maze, maze.cell_centre(cells))])
    nearest = np.linalg.norm(centres - maze.cell_centre(maze.start_cell), axis=1)
    chosen = [int(np.argmin(nearest))]
    distance = np.linalg.norm(centres - centres[chosen[0]], axis=1)
    while len(chosen) < min(count, len(centres)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(centres - centres[chosen[-1]], axis=1))
    return centres[chosen]


def in_wall(maze: Maze, positions: np.ndarray) -> np.ndarray:
    """[...] bool: which of positions [..., 2] lie inside a wall."""
    return maze.walls[tuple(np.moveaxis(maze.cell_of(positions), -1, 0))]


def _median_length(moves: np.ndarray) -> str:
    return f"{np.median(np.linalg.norm(moves, axis=1)):.1f} m" if len(moves) else "none"
