"""The paper's figures, drawn from finished runs, and the numbers in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter

from guider import data as data_sources
from guider import runs
from guider.evaluation.rollouts import Trace, rollout
from guider.evaluation.statistics import mean_and_deviation
from guider.plots import canvas, caption, episodes_in_maze
from guider.plots.gaps import fixed_period, subgoal_gaps, subgoals_met
from guider.reproduce.plans import Plan, file_name
from guider.reproduce.scores import Cell, Grid, summary
from guider.support import files
from guider.tasks import find_task

COLOURS = (canvas.BLUE, canvas.ORANGE, canvas.GREEN, canvas.RED, "#CC79A7", "#56B4E9", canvas.DARK, canvas.WALL)
EPISODES_SHOWN = 3
EPISODES_MEASURED = 20
ENTRIES_SHOWN = 4

Drawn = tuple[dict[str, Figure], list[dict[str, Any]]]
"""Pictures by the end of their name, and the numbers in them."""


def draw(plan: Plan, grid: Grid) -> tuple[list[Path], list[dict[str, Any]]]:
    """Draw what finished runs there are into OUT, as NAME.png or NAME-*.png. Returns (pictures, numbers)."""
    finished = [[cell for cell in row if cell.result] for row in grid]
    figures, numbers = _DRAWERS[plan.name](plan, [row for row in finished if row])
    plan.protocol.out.mkdir(parents=True, exist_ok=True)
    saved = []
    for ending, figure in figures.items():
        path = plan.protocol.out / f"{'-'.join(filter(None, (plan.name, ending)))}.png"
        canvas.save(figure, path)
        saved.append(path)
    return saved, numbers


def _subgoals_along_episodes(plan: Plan, grid: Grid) -> Drawn:
    """Figure 3: the first seed's subgoals in the first evaluation episodes, on the map or against time."""
    figures, numbers = {}, []
    for cell in (cell for row in grid for cell in row):
        assert cell.result is not None
        run, task = runs.open_run(plan.directory(cell.run)), find_task(cell.task)
        first_seed = cell.result["episode_seeds"][0]
        traces = rollout(run.policies()[0], task, EPISODES_SHOWN, first_seed).traces
        title = caption(run.spec, run.spec.seeds[:1])
        if task.maze is not None:
            logged = data_sources.load(plan.data_path(cell.task), task.goal_indices)
            figure = episodes_in_maze(task, task.maze, logged, traces, first_seed, title)
        else:
            figure = _episodes_over_time(traces, first_seed, title)
        figures[file_name(cell.task)] = figure
        episodes = [
            {
                "episode_seed": first_seed + index,
                "success": trace.success,
                "steps": len(trace.achieved),
                "goal": trace.goal.tolist(),
                "subgoals": [
                    {"step": int(step), "subgoal": trace.subgoals[step].tolist()}
                    for step in np.flatnonzero(trace.renewed)
                ],
            }
            for index, trace in enumerate(traces)
        ]
        numbers.append({"task": cell.task, "run": cell.run.name, "seed": run.spec.seeds[0], "episodes": episodes})
    return figures, numbers


def _episodes_over_time(traces: Sequence[Trace], first_seed: int, title: str) -> Figure:
    """The goal's most varied entries along episodes, with every subgoal from the step it was chosen in."""
    spread = np.concatenate([trace.achieved for trace in traces]).std(axis=0)
    entries = np.sort(np.argsort(spread)[::-1][:ENTRIES_SHOWN])
    figure = canvas.new_figure(
        f"{title}\n{canvas.seed_range(first_seed, len(traces))}", (4.2 * len(traces), 2.0 * len(entries) + 0.9)
    )
    panels = figure.subplots(len(entries), len(traces), squeeze=False, sharex="col", sharey="row")
    for column, trace in enumerate(traces):
        chosen = np.flatnonzero(trace.renewed)
        for axes, entry in zip(panels[:, column], entries, strict=True):
            axes.plot(trace.achieved[:, entry], color=canvas.BLUE)
            axes.plot(chosen, trace.subgoals[chosen, entry], "*", color=canvas.ORANGE, markersize=8)
            axes.axhline(trace.goal[entry], color=canvas.GREEN, linestyle="--", linewidth=1)
        outcome = "goal met" if trace.success else "goal not met"
        panels[0, column].set_title(f"seed {first_seed + column}: {outcome}", fontsize=9)
        panels[-1, column].set_xlabel("environment step")
    for axes, entry in zip(panels[:, 0], entries, strict=True):
        axes.set_ylabel(f"goal entry {entry}")
    canvas.legend(
        figure,
        [
            Line2D([], [], color=canvas.BLUE, label="achieved"),
            canvas.star_handle("subgoal, where it was chosen"),
            Line2D([], [], color=canvas.GREEN, linestyle="--", label="final goal"),
        ],
    )
    return figure


def _bars(plan: Plan, grid: Grid) -> Drawn:
    """Figure 4: a panel per task, a bar per method with its standard deviation over seeds, and the paper's score."""
    if not grid:
        return {}, []
    figure, panels = _panels(plan, grid, 5.0)
    for axes, row in zip(panels, grid, strict=True):
        for place, cell in enumerate(row):
            mean, deviation = mean_and_deviation(cell.scores)
            axes.bar(place, mean, yerr=deviation, color=_colour(plan, cell), capsize=3)
            if cell.paper is not None:
                axes.plot(place, cell.paper[0], "_", color=canvas.DARK, markersize=22, markeredgewidth=2)
        labels = [cell.variant.label.replace(" + ", " +\n") for cell in row]
        axes.set_xticks(range(len(row)), labels, fontsize=8, rotation=30)
        axes.set_ylim(bottom=0)
    dash = Line2D([], [], marker="_", color=canvas.DARK, linestyle="", markersize=12, label="the paper's score")
    canvas.legend(figure, [dash])
    return {"": figure}, [{"task": row[0].task, "methods": [summary(cell) for cell in row]} for row in grid]


def _curves(plan: Plan, grid: Grid) -> Drawn:
    """Figures 5 and 6: scores during training, mean and standard deviation over seeds; dashed, the paper's score."""
    if not grid:
        return {}, []
    figure, panels = _panels(plan, grid, 4.0)
    numbers, shown = [], {}
    for axes, row in zip(panels, grid, strict=True):
        curves = []
        for cell in row:
            lines = files.read_lines(plan.directory(cell.run) / "evaluations.jsonl")
            updates = [line["total_updates"] for line in lines]
            scores = np.array([line["score"] for line in lines])
            mean, deviation = scores.mean(axis=1), scores.std(axis=1)
            colour = _colour(plan, cell)
            axes.fill_between(updates, mean - deviation, mean + deviation, color=colour, alpha=0.2, linewidth=0)
            (drawn,) = axes.plot(updates, mean, "o-", color=colour, markersize=3, label=cell.variant.label)
            shown[cell.variant.name] = drawn
            if cell.paper is not None:
                axes.axhline(cell.paper[0], color=colour, linestyle="--", linewidth=0.8)
            curve = {"updates": updates, "scores_per_seed": scores.T.tolist(), "episodes": lines[-1]["episodes"]}
            curves.append(summary(cell) | {"curve": curve})
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set_xlabel("updates of all stages", fontsize=8)
        axes.set_ylim(bottom=0)
        numbers.append({"task": row[0].task, "variants": curves})
    dashed = Line2D([], [], color=canvas.DARK, linestyle="--", linewidth=0.8, label="the paper's score")
    canvas.legend(figure, [*shown.values(), dashed])
    return {"": figure}, numbers


def _gaps(plan: Plan, grid: Grid) -> Drawn:
    """Figure 7: how far every subgoal lies from where the agent was c steps later; pictures of the first seed."""
    figures, numbers = {}, []
    for row in grid:
        task = find_task(row[0].task)
        assert task.maze is not None
        logged = data_sources.load(plan.data_path(task.name), task.goal_indices)
        for cell in row:
            assert cell.result is not None
            run, period = runs.open_run(plan.directory(cell.run)), cell.result["period_steps"]
            first_seed = cell.result["episode_seeds"][0]
            gaps = []
            for policy in run.policies():
                measured = rollout(fixed_period(policy), task, EPISODES_MEASURED, first_seed).traces
                gaps.append(subgoal_gaps(measured, period))
                ending = f"{file_name(task.name)}-{cell.variant.name}"
                if ending not in figures and len(gaps[-1]):
                    title = caption(run.spec, run.spec.seeds[:1])
                    figures[ending] = subgoals_met(
                        policy.config.problem, task.maze, logged, measured, first_seed, title
                    )
            numbers.append(
                {
                    "task": task.name,
                    "variant": cell.variant.name,
                    "run": cell.run.name,
                    "period_steps": period,
                    "episodes_per_seed": EPISODES_MEASURED,
                    "reach_radius": task.reach_radius,
                    "all_seeds": gap_statistics(np.concatenate(gaps), task.reach_radius),
                    "per_seed": [gap_statistics(of_seed, task.reach_radius) for of_seed in gaps],
                }
            )
    return figures, numbers


def gap_statistics(gaps: np.ndarray, reach_radius: float) -> dict[str, Any]:
    """Figure 7 in numbers. gaps: [N] goal units, each a subgoal's distance from where the agent was c steps later."""
    if not len(gaps):
        return {"subgoals": 0}
    lower, median, upper = np.quantile(gaps, [0.25, 0.5, 0.75]).tolist()
    return {
        "subgoals": len(gaps),
        "mean": float(gaps.mean()),
        "median": median,
        "quartiles": [lower, upper],
        "within_reach_radius_percent": float(100 * (gaps <= reach_radius).mean()),
    }


def _panels(plan: Plan, grid: Grid, width: float) -> tuple[Figure, list[Axes]]:
    """A panel per task, with its name and unit."""
    columns = min(4, len(grid))
    rows = -(-len(grid) // columns)
    asked = plan.protocol
    figure = canvas.new_figure(
        f"{plan.title}\npreset {asked.preset}, {asked.seeds} seeds, standard deviation over seeds",
        (width * columns, 3.2 * rows + 0.9),
    )
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, row in zip(panels, grid, strict=False):
        assert row[0].result is not None
        axes.set_title(row[0].task, fontsize=9)
        axes.set_ylabel(row[0].result["unit"], fontsize=8)
        axes.set_axisbelow(True)
        axes.grid(axis="y", color=canvas.GRID, linewidth=0.6)
        axes.tick_params(labelsize=8)
    for axes in panels[len(grid) :]:
        axes.remove()
    return figure, list(panels[: len(grid)])


def _colour(plan: Plan, cell: Cell) -> str:
    return COLOURS[plan.variants.index(cell.variant) % len(COLOURS)]


_DRAWERS: dict[str, Callable[[Plan, Grid], Drawn]] = {
    "figure3": _subgoals_along_episodes,
    "figure4": _bars,
    "figure5": _curves,
    "figure6": _curves,
    "figure7": _gaps,
}
