"""Figure 7: how close the robot comes to its subgoals, on the map, as a histogram and as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from guider.data.episodes import Episodes
from guider.evaluation.rollouts import Trace
from guider.learning.problem import Problem
from guider.methods.policy import Policy
from guider.plots import canvas
from guider.plots.subgoals import subgoals_of
from guider.tasks.mazes import Maze


def fixed_period(policy: Policy) -> Policy:
    """The policy as the paper lets it act: a new subgoal every c steps, only then, and always decoded."""
    periodic = subgoals_of(policy).periodic
    assert periodic is not None
    return replace(policy, config=periodic(policy.config))


def subgoal_outcomes(traces: Sequence[Trace], period_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Every subgoal with a whole period ahead of it, and where the robot was c steps later, [N, G] each.

    traces: rolled out with `fixed_period`. Subgoals cut short by the end of their episode are left out.
    """
    subgoals, outcomes = [], []
    for trace in traces:
        steps = np.flatnonzero(trace.renewed)
        steps = steps[steps + period_steps < len(trace.achieved)]
        subgoals.append(trace.subgoals[steps])
        outcomes.append(trace.achieved[steps + period_steps])
    return np.concatenate(subgoals), np.concatenate(outcomes)


def subgoal_gaps(traces: Sequence[Trace], period_steps: int) -> np.ndarray:
    """[N] distance between each subgoal and where the robot was c steps later (Figure 7), goal units.

    traces: rolled out with `fixed_period`; one that moves on when a subgoal is reached has no such number.
    """
    subgoals, outcomes = subgoal_outcomes(traces, period_steps)
    return np.linalg.norm(subgoals - outcomes, axis=1)


def subgoals_met(
    problem: Problem, maze: Maze, logged: Episodes, traces: Sequence[Trace], first_seed: int, title: str
) -> Figure:
    """Subgoals against where the robot really was c steps later (Figure 7), on the map and as a histogram.

    traces: rolled out with `fixed_period`, at least one of them longer than a period.
    """
    period_steps, reach_radius = problem.period_steps, problem.reach_radius
    subgoals, outcomes = subgoal_outcomes(traces, period_steps)
    gaps = subgoal_gaps(traces, period_steps)
    met = gaps <= reach_radius
    width, height = canvas.panel_size(maze, 8.0)
    figure = canvas.new_figure(
        f"{title}\n{canvas.seed_range(first_seed, len(traces))}, {len(gaps)} subgoals: after "
        f"c = {period_steps} steps the median distance is {np.median(gaps):.2f} m, "
        f"{met.mean():.0%} are within {reach_radius:g} m",
        (width + 3, height + 0.5),
    )
    plan, histogram = figure.subplots(1, 2, width_ratios=(width, 3))
    canvas.ground(plan, maze, logged)
    for chosen, colour in ((met, canvas.GREEN), (~met, canvas.RED)):
        pairs = np.stack([outcomes[chosen], subgoals[chosen]], axis=1)
        plan.add_collection(LineCollection(list(pairs), colors=colour, linewidths=0.7, alpha=0.7, zorder=3))
    plan.plot(*outcomes.T, "o", color=canvas.BLUE, markersize=3, markeredgewidth=0, zorder=4)
    plan.plot(
        *subgoals.T, "*", color=canvas.ORANGE, markersize=6, markeredgecolor=canvas.DARK, markeredgewidth=0.3, zorder=5
    )
    histogram.hist(gaps, bins=24, color=canvas.BLUE, alpha=0.7)
    histogram.axvline(reach_radius, color=canvas.GREEN, label="counts as reached")
    histogram.axvline(float(np.median(gaps)), color=canvas.DARK, linestyle="--", label="median")
    histogram.set(xlabel="distance after c steps (m)", ylabel="subgoals")
    histogram.margins(y=0.2)
    histogram.legend(fontsize=8)
    histogram.set_box_aspect(height / 3)
    canvas.legend(
        figure,
        [
            canvas.star_handle("subgoal"),
            canvas.dot_handle(canvas.BLUE, f"robot {period_steps} steps later"),
            *([Line2D([], [], color=canvas.GREEN, label="reached")] if met.any() else []),
            *([Line2D([], [], color=canvas.RED, label="missed")] if not met.all() else []),
        ],
    )
    return figure
