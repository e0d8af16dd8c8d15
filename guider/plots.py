"""Pictures of a run: how it learned, which subgoals it proposes, and where it went.

Every picture is a pure function from data to a matplotlib Figure; `draw_run` saves those of one run. `title`
is the first line of a picture's title, see `caption`. Positions are in goal units, which are metres in mazes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke
from matplotlib.ticker import EngFormatter

from guider.episodes import Episodes
from guider.evaluation import Trace, rollout
from guider.methods import guider, latent_subgoals
from guider.networks import twin_values
from guider.policy import Policy
from guider.runs import Run, RunSpec, read_lines
from guider.samplers import window_starts
from guider.tasks.mazes import Maze
from guider.tasks.types import Task

# Okabe and Ito's colours, which colour-blind readers tell apart.
BLUE, ORANGE, RED, GREEN = "#0072B2", "#E69F00", "#D55E00", "#009E73"
LOGGED, WALL, DARK, GRID = "#A3B1BF", "#8D949B", "#202428", "#E4E7EA"
TIME_COLOURS = "viridis"
FLAG = Outline([(0, 0), (0.08, 0), (0.08, 0.45), (0.75, 0.72), (0, 1), (0, 0)])
DOTS_PER_INCH = 120
LOGGED_SHOWN = 20_000
EPISODES_MEASURED = 20

METRIC_LABELS = {
    "squared_error": "squared error (goal units²)",
    "kl": "KL of posterior and prior (nats)",
    "value": "critic value",
    "td_error": "TD error",
    "divergence": "KL of policy and prior (nats)",
    "conservative_gap": "conservative gap",
    "action_error": "squared error of actions",
    "weight": "advantage weight",
}
"""Metrics in the order of their importance; a stage shows its first four, others after these."""
LOGARITHMIC = ("squared_error", "td_error")
METRICS_SHOWN = 4


def caption(spec: RunSpec, seeds: Sequence[int]) -> str:
    """What is drawn: task (or data), method, preset and seeds."""
    shown = f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
    return f"{spec.task or Path(spec.data).name}, {spec.method}, preset {spec.preset}, {shown}"


def learning_curves(lines: Sequence[dict[str, Any]], title: str) -> Figure:
    """A row of panels per stage: its main metrics against its updates, thin per seed and bold in the mean.

    lines: of metrics.jsonl, at least one.
    """
    stages = list(dict.fromkeys(line["stage"] for line in lines))
    figure = _figure(title, (3.2 * METRICS_SHOWN, 2.3 * len(stages) + 0.4))
    panels = figure.subplots(len(stages), METRICS_SHOWN, squeeze=False)
    for stage, row in zip(stages, panels, strict=True):
        chosen = [line for line in lines if line["stage"] == stage]
        names = _main_metrics(chosen[0]["metrics"])
        updates = [line["update"] for line in chosen]
        for axes, name in zip(row, names, strict=False):
            values = np.array([line["metrics"][name] for line in chosen])
            _seed_lines(axes, updates, values)
            axes.set_title(METRIC_LABELS.get(name, name.replace("_", " ")), fontsize=9)
            if name in LOGARITHMIC and (values > 0).all():
                axes.set_yscale("log")
        for axes in row[len(names) :]:
            axes.remove()
        row[0].set_ylabel(stage, fontweight="bold")
    figure.align_ylabels(panels[:, 0])
    figure.supxlabel("updates of the stage", fontsize=9)
    return figure


def success_curve(lines: Sequence[dict[str, Any]], title: str) -> Figure:
    """Success rate during training, mean and standard deviation over seeds (Figures 5 and 6).

    lines: of evaluations.jsonl, at least one.
    """
    updates = [line["total_updates"] for line in lines]
    rates = 100 * np.array([line["success"] for line in lines])
    mean, deviation = rates.mean(axis=1), rates.std(axis=1)
    seeds, episodes = rates.shape[1], lines[-1]["episodes"]
    figure = _figure(f"{title}\nmean and standard deviation of {seeds} seeds, {episodes} episodes each", (6, 4))
    axes = figure.subplots()
    axes.fill_between(updates, mean - deviation, mean + deviation, color=BLUE, alpha=0.2, linewidth=0)
    _seed_lines(axes, updates, rates, "o-")
    axes.set(xlabel="updates of all stages", ylabel="success (%)", ylim=(-2, 102))
    return figure


def episodes_in_maze(
    task: Task, maze: Maze, logged: Episodes, traces: Sequence[Trace], first_seed: int, title: str
) -> Figure:
    """Where evaluation episodes went, coloured by time, with their subgoals in order (Figures 1b and 3).

    traces: of the episode seeds first_seed, first_seed + 1, ...; stars are thinned, see `legible_subgoals`.
    """
    reached = sum(trace.success for trace in traces)
    columns = min(3, len(traces))
    rows = -(-len(traces) // columns)
    width, height = _panel_size(maze, 4.4)
    figure = _figure(
        f"{title}\n{_seed_range(first_seed, len(traces))}: {reached} of {len(traces)} goals reached",
        (columns * width, rows * height + 0.6),
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    path = LineCollection([])
    for index, (axes, trace) in enumerate(zip(panels, traces, strict=False)):
        _ground(axes, maze, logged)
        path = _timed_path(axes, trace.achieved, task.horizon_steps)
        chosen = legible_subgoals(trace, 0.6 * maze.cell_size_m)
        _numbered_stars(axes, trace.subgoals[chosen])
        _flag(axes, trace.goal, task.radius)
        outcome = "reached after" if trace.success else "NOT reached in"
        axes.set_title(f"seed {first_seed + index}: {outcome} {len(trace.achieved)} steps", fontsize=9)
        axes.label_outer()
    for axes in panels[len(traces) :]:
        axes.remove()
    _colour_bar(figure, path, list(panels[: len(traces)]), "environment step")
    _legend(figure, [_logged_handle(), _star_handle("subgoals in order (thinned)"), _flag_handle()])
    return figure


def legible_subgoals(trace: Trace, spacing: float) -> np.ndarray:
    """[stars] steps at which a subgoal was chosen, thinned by `spaced`.

    A policy that asks anew whenever a subgoal is reached chooses too many to be read.
    """
    steps = np.flatnonzero(trace.renewed)
    return steps[spaced(trace.subgoals[steps], spacing)]


def spaced(points: np.ndarray, spacing: float) -> np.ndarray:
    """[kept] indices of points [N, G] that lie further than `spacing` from all kept before them."""
    kept: list[int] = []
    for index, point in enumerate(points):
        if (np.linalg.norm(points[kept] - point, axis=1) > spacing).all():
            kept.append(index)
    return np.array(kept, int)


def subgoal_arrows(task: Task, maze: Maze, logged: Episodes, policy: Policy, goal: np.ndarray, title: str) -> Figure:
    """From positions all over the maze, the subgoal proposed on the way to `goal` [2].

    Colour is the critic's value of that subgoal; those inside a wall have a colour of their own.
    """
    starts = maze_positions(maze, per_cell=3)
    subgoals, values = proposals(policy, starts, goal)
    moves = subgoals - starts
    walled = in_wall(maze, subgoals)
    width, height = _panel_size(maze, 9.0)
    figure = _figure(
        f"{title}\nsubgoals proposed towards the goal: median length "
        f"{np.median(np.linalg.norm(moves, axis=1)):.1f} m, {walled.mean():.0%} inside a wall",
        (width, height + 0.1),
    )
    axes = figure.subplots()
    _ground(axes, maze, logged)
    size: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.0018, "zorder": 4}
    arrows = axes.quiver(*starts.T, *moves.T, values, cmap=TIME_COLOURS, **size)
    axes.quiver(*starts[walled].T, *moves[walled].T, color=RED, **size)
    _flag(axes, goal, task.radius)
    _colour_bar(figure, arrows, [axes], "critic value of the subgoal")
    inside = Line2D([], [], color=RED, marker=">", markersize=4, label="subgoal inside a wall")
    _legend(figure, [_logged_handle(), inside, _flag_handle()])
    return figure


def maze_positions(maze: Maze, per_cell: int) -> np.ndarray:
    """[free * per_cell**2, 2]: a regular grid of positions in every free cell, metres."""
    offsets = maze.cell_size_m * ((np.arange(per_cell) + 0.5) / per_cell - 0.5)
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    return (maze.cell_centre(maze.free_cells)[:, None] + grid).reshape(-1, 2)


def in_wall(maze: Maze, positions: np.ndarray) -> np.ndarray:
    """[...] bool: which of positions [..., 2] lie inside a wall."""
    return maze.walls[tuple(np.moveaxis(maze.cell_of(positions), -1, 0))]


def proposals(policy: Policy, achieved: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Subgoals that pi_h proposes and the critic's value of them (the smaller of the twins).

    achieved: [B, G]; goal: [G] or [B, G]. Returns ([B, G], [B]).
    """
    goals = np.broadcast_to(goal, achieved.shape)
    subgoals, values = _proposals(policy, jnp.asarray(achieved, jnp.float32), jnp.asarray(goals, jnp.float32))
    return np.asarray(subgoals), np.asarray(values)


@jax.jit
def _proposals(policy: Policy, achieved: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    state: guider.GuiderState = policy.state
    subgoal, latent = guider.propose_subgoal(policy.config, state, achieved, goal)
    inputs = guider.high_inputs(state.scale, achieved, goal)
    return subgoal, twin_values(state.high.params.critic, inputs, latent).min(axis=0)


def reachable_in_maze(maze: Maze, logged: Episodes, policy: Policy, positions: np.ndarray, title: str) -> Figure:
    """What is reachable in c steps of a few positions: the prior rho, decoded, beside what the data did.

    positions: [P, 2]. The data's outcomes are those of the windows the prior learns from that start within an
    eighth of a cell of the position. Lengths are medians, in metres.
    """
    samples = prior_samples(policy, positions, 150)
    starts, later = data_outcomes(logged, policy.config)
    columns = min(4, len(positions))
    rows = -(-len(positions) // columns)
    period = policy.config.period_steps
    figure = _figure(f"{title}\nreachable in c = {period} steps (median lengths)", (3.3 * columns, 3.5 * rows + 0.7))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, position, decoded in zip(panels, positions, samples, strict=False):
        near = np.linalg.norm(starts - position, axis=1) <= maze.cell_size_m / 8
        outcomes = _thinned(later[near], 300)
        _ground(axes, maze, logged)
        axes.plot(*outcomes.T, "o", color=BLUE, markersize=2.5, markeredgewidth=0, zorder=3)
        axes.plot(*decoded.T, "o", color=ORANGE, markersize=2.5, markeredgewidth=0, zorder=4)
        axes.plot(*position, "P", color=DARK, markeredgecolor="white", markersize=9, zorder=6)
        reach = 3 * maze.cell_size_m
        axes.set_xlim(position[0] - reach, position[0] + reach)
        axes.set_ylim(position[1] - reach, position[1] + reach)
        lengths = f"prior {_median_length(decoded - position)}, data {_median_length(later[near] - position)}"
        walled = f"{in_wall(maze, decoded).mean():.0%} of the prior inside a wall"
        axes.set_title(f"({position[0]:g}, {position[1]:g}): {lengths}\n{walled}", fontsize=9)
    for axes in panels[len(positions) :]:
        axes.remove()
    _legend(
        figure,
        [
            _logged_handle(),
            _dot_handle(ORANGE, "samples of the prior, decoded"),
            _dot_handle(BLUE, f"logged positions {period} steps after starting here"),
            Line2D([], [], marker="P", color=DARK, linestyle="", label="here"),
        ],
    )
    return figure


def prior_samples(policy: Policy, achieved: np.ndarray, count: int) -> np.ndarray:
    """[B, count, G]: subgoals z ~ rho(. | s^G), decoded, for each of achieved [B, G]."""
    return np.asarray(_prior_samples(policy, jnp.asarray(achieved, jnp.float32), count)).swapaxes(0, 1)


@partial(jax.jit, static_argnums=2)
def _prior_samples(policy: Policy, achieved: jax.Array, count: int) -> jax.Array:
    """[count, B, G]."""
    state: guider.GuiderState = policy.state
    params = state.latent.params
    reachable = latent_subgoals.prior(params, state.scale, achieved)
    latents = reachable.sample(jax.random.key(0), (count,))
    origins = jnp.broadcast_to(achieved, (count, *achieved.shape))
    return latent_subgoals.decode(policy.config.latent, params, state.scale, origins, latents)


def data_outcomes(logged: Episodes, config: guider.GuiderConfig) -> tuple[np.ndarray, np.ndarray]:
    """s^G at both ends of every c-step window that training draws from, [W, G] each."""
    rows = window_starts(logged, config.period_steps, config.boundary, config.minimum_move)
    later = np.minimum(rows + config.period_steps, logged.last_rows[rows])
    return logged.achieved[rows], logged.achieved[later]


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


def fixed_period(policy: Policy) -> Policy:
    """The policy as the paper lets it act: a new subgoal every c steps, only then, and always decoded."""
    return replace(policy, config=replace(policy.config, replan="period", final_goal_substitution=False))


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
    task: Task,
    maze: Maze,
    logged: Episodes,
    traces: Sequence[Trace],
    period_steps: int,
    first_seed: int,
    title: str,
) -> Figure:
    """Subgoals against where the robot really was c steps later (Figure 7), on the map and as a histogram.

    traces: rolled out with `fixed_period`, at least one of them longer than a period.
    """
    subgoals, outcomes = subgoal_outcomes(traces, period_steps)
    gaps = subgoal_gaps(traces, period_steps)
    met = gaps <= task.reach_radius
    width, height = _panel_size(maze, 8.0)
    figure = _figure(
        f"{title}\n{_seed_range(first_seed, len(traces))}, {len(gaps)} subgoals: after "
        f"c = {period_steps} steps the median distance is {np.median(gaps):.2f} m, "
        f"{met.mean():.0%} are within {task.reach_radius:g} m",
        (width + 3, height + 0.5),
    )
    plan, histogram = figure.subplots(1, 2, width_ratios=(width, 3))
    _ground(plan, maze, logged)
    for chosen, colour in ((met, GREEN), (~met, RED)):
        pairs = np.stack([outcomes[chosen], subgoals[chosen]], axis=1)
        plan.add_collection(LineCollection(list(pairs), colors=colour, linewidths=0.7, alpha=0.7, zorder=3))
    plan.plot(*outcomes.T, "o", color=BLUE, markersize=3, markeredgewidth=0, zorder=4)
    plan.plot(*subgoals.T, "*", color=ORANGE, markersize=6, markeredgecolor=DARK, markeredgewidth=0.3, zorder=5)
    histogram.hist(gaps, bins=24, color=BLUE, alpha=0.7)
    histogram.axvline(task.reach_radius, color=GREEN, label="counts as reached")
    histogram.axvline(float(np.median(gaps)), color=DARK, linestyle="--", label="median")
    histogram.set(xlabel="distance after c steps (m)", ylabel="subgoals")
    histogram.margins(y=0.2)
    histogram.legend(fontsize=8)
    histogram.set_box_aspect(height / 3)
    _legend(
        figure,
        [
            _star_handle("subgoal"),
            _dot_handle(BLUE, f"robot {period_steps} steps later"),
            Line2D([], [], color=GREEN, label="reached"),
            Line2D([], [], color=RED, label="missed"),
        ],
    )
    return figure


def subgoals_on_logs(logged: Episodes, held_out: Episodes, policy: Policy, title: str) -> Figure:
    """Without a maze: subgoals proposed every c steps along held-out episodes, towards their last states.

    A goal space of two entries is drawn as a plane, any other as its most varied entries against time.
    """
    if logged.spaces.goal_dim == 2:
        return _subgoals_in_plane(logged, held_out, policy, title)
    return _subgoals_over_time(logged, held_out, policy, title)


def _subgoals_in_plane(logged: Episodes, held_out: Episodes, policy: Policy, title: str) -> Figure:
    paths = _first_paths(held_out, 4)
    period = policy.config.period_steps
    columns = min(2, len(paths))
    rows = -(-len(paths) // columns)
    figure = _figure(
        f"{title}\nsubgoals every c = {period} steps along held-out episodes, towards their last states",
        (5.5 * columns + 0.5, 4.5 * rows + 0.9),
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    spread = logged.achieved.std(axis=0)
    line = LineCollection([])
    for index, (axes, achieved) in enumerate(zip(panels, paths, strict=False)):
        here = achieved[::period]
        subgoals, _ = proposals(policy, here, achieved[-1])
        shown = spaced(subgoals / spread, 0.2)
        samples = prior_samples(policy, here[shown], 40).reshape(-1, 2)
        axes.plot(*_thinned(logged.achieved, LOGGED_SHOWN).T, ",", color=LOGGED, zorder=0)
        axes.plot(*samples.T, "o", color=ORANGE, alpha=0.5, markersize=2, markeredgewidth=0, zorder=2)
        line = _timed_path(axes, achieved, max(len(path) for path in paths))
        _numbered_stars(axes, subgoals[shown])
        _flag(axes, achieved[-1], policy.config.radius)
        axes.set_title(f"held-out episode {index}, {len(achieved)} states", fontsize=9)
        axes.set(xlabel=_entry_name(logged, 0), ylabel=_entry_name(logged, 1))
        axes.label_outer()
    for axes in panels[len(paths) :]:
        axes.remove()
    _colour_bar(figure, line, list(panels[: len(paths)]), "step of the episode")
    samples_handle = _dot_handle(ORANGE, "samples of the prior, decoded")
    _legend(
        figure,
        [_logged_handle(), _star_handle("subgoals in order (thinned)"), samples_handle, _flag_handle()],
    )
    return figure


def _subgoals_over_time(logged: Episodes, held_out: Episodes, policy: Policy, title: str) -> Figure:
    paths = _first_paths(held_out, 3)
    period = policy.config.period_steps
    entries = np.sort(np.argsort(logged.achieved.std(axis=0))[::-1][:4])
    figure = _figure(
        f"{title}\nsubgoals every c = {period} steps along held-out episodes, towards their last states",
        (4.2 * len(paths), 2.2 * len(entries) + 0.9),
    )
    panels = figure.subplots(len(entries), len(paths), squeeze=False, sharex="col", sharey="row")
    for column, achieved in enumerate(paths):
        steps = np.arange(0, len(achieved), period)
        subgoals, _ = proposals(policy, achieved[steps], achieved[-1])
        samples = prior_samples(policy, achieved[steps], 20)
        for axes, entry in zip(panels[:, column], entries, strict=True):
            later = np.repeat(steps + period, samples.shape[1])
            axes.plot(later, samples[..., entry].ravel(), "o", color=ORANGE, alpha=0.4, markersize=2.5)
            axes.plot(achieved[:, entry], color=BLUE)
            axes.plot(steps + period, subgoals[:, entry], "*", color=RED, markersize=8, markeredgecolor=DARK)
            axes.axhline(achieved[-1, entry], color=GREEN, linestyle="--", linewidth=1)
        panels[0, column].set_title(f"held-out episode {column}", fontsize=9)
        panels[-1, column].set_xlabel("step of the episode")
    for axes, entry in zip(panels[:, 0], entries, strict=True):
        axes.set_ylabel(_entry_name(logged, int(entry)))
    _legend(
        figure,
        [
            Line2D([], [], color=BLUE, label="logged"),
            Line2D([], [], color=RED, marker="*", linestyle="", label="subgoal, where it is due"),
            _dot_handle(ORANGE, "samples of the prior, decoded"),
            Line2D([], [], color=GREEN, linestyle="--", label="final goal"),
        ],
    )
    return figure


def draw_run(
    run: Run, task: Task | None, episodes: Episodes, seed: int, first_seed: int, episodes_shown: int = 6
) -> list[Path]:
    """Draw everything there is to draw of a run into its folder `plots`, and return the paths.

    episodes: all data of the run, held-out ones included; seed: which of its policies to draw;
    first_seed: of the evaluation episodes to roll out, of which `episodes_shown` are drawn. Curves come first,
    and are saved before GuiderError is raised where training is unfinished.
    """
    spec = run.spec
    folder = run.directory / "plots"
    folder.mkdir(exist_ok=True)
    title, title_of_all = caption(spec, (seed,)), caption(spec, spec.seeds)
    saved: list[Path] = []

    def save(name: str, figure: Figure) -> None:
        path = folder / f"{name}.png"
        temporary = folder / f".{name}.{os.getpid()}"
        figure.savefig(temporary, format="png", dpi=DOTS_PER_INCH, bbox_inches="tight")
        temporary.replace(path)
        saved.append(path)

    if lines := read_lines(run.directory / "metrics.jsonl"):
        save("learning", learning_curves(lines, title_of_all))
    if lines := read_lines(run.directory / "evaluations.jsonl"):
        save("success", success_curve(lines, title_of_all))
    policy = run.policies()[spec.seeds.index(seed)]
    logged, held_out = episodes.split(spec.held_out) if spec.held_out else (episodes, episodes)

    if task is None or task.maze is None:
        save(f"subgoals-seed{seed}", subgoals_on_logs(logged, held_out, policy, title))
        return saved

    maze, period = task.maze, policy.config.period_steps
    traces = rollout(policy, task, episodes_shown, first_seed, keep_traces=episodes_shown).traces
    save(f"episodes-seed{seed}", episodes_in_maze(task, maze, logged, traces, first_seed, title))
    save(f"arrows-seed{seed}", subgoal_arrows(task, maze, logged, policy, traces[0].goal, title))
    positions = spread_positions(maze, logged, 8)
    save(f"reachable-seed{seed}", reachable_in_maze(maze, logged, policy, positions, title))
    measured = rollout(fixed_period(policy), task, EPISODES_MEASURED, first_seed, keep_traces=EPISODES_MEASURED).traces
    if len(subgoal_gaps(measured, period)):
        save(f"met-seed{seed}", subgoals_met(task, maze, logged, measured, period, first_seed, title))
    return saved


def _figure(title: str, size: tuple[float, float]) -> Figure:
    """An empty figure; size: width and height in inches."""
    figure = Figure(figsize=size, layout="compressed")
    figure.suptitle(title, fontsize=10, parse_math=False)
    return figure


def _seed_range(first: int, count: int) -> str:
    return f"episode seeds {first} to {first + count - 1}" if count > 1 else f"episode seed {first}"


def _panel_size(maze: Maze, width: float) -> tuple[float, float]:
    """Inches of a panel of the given width that shows the whole maze, with room for its title."""
    rows, columns = maze.walls.shape
    return width, width * (rows - 1) / (columns - 1) + 0.3


def _main_metrics(metrics: dict[str, Any]) -> list[str]:
    order = list(METRIC_LABELS)
    ranked = sorted(metrics, key=lambda name: order.index(name) if name in order else len(order))
    return ranked[:METRICS_SHOWN]


def _seed_lines(axes: Axes, updates: Sequence[int], values: np.ndarray, style: str = "-") -> None:
    """values: [points, seeds]."""
    if values.shape[1] > 1:
        axes.plot(updates, values, color=BLUE, linewidth=0.7, alpha=0.4)
    axes.plot(updates, values.mean(axis=1), style, color=BLUE, linewidth=1.8, markersize=4)
    axes.grid(color=GRID, linewidth=0.6)
    axes.tick_params(labelsize=8, which="both")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))


def _ground(axes: Axes, maze: Maze, logged: Episodes) -> None:
    """The layer below all maze pictures: walls and logged positions, in metres."""
    size = maze.cell_size_m
    corners = maze.cell_centre(maze.free_cells) - size / 2
    cells = [Rectangle((x, y), size, size) for x, y in corners]
    axes.set_facecolor(WALL)
    axes.add_collection(PatchCollection(cells, facecolor="white", edgecolor="white", linewidth=0.5, zorder=0))
    axes.plot(*_thinned(logged.achieved, LOGGED_SHOWN).T, ",", color=LOGGED, zorder=1)
    rows, columns = maze.walls.shape
    low, high = maze.cell_centre((0, 0)), maze.cell_centre((rows - 1, columns - 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)


def _timed_path(axes: Axes, achieved: np.ndarray, last_step: int) -> LineCollection:
    """A line through achieved [steps, 2], coloured by time from step 0 to `last_step`."""
    line = LineCollection(
        list(np.stack([achieved[:-1], achieved[1:]], axis=1)), cmap=TIME_COLOURS, linewidths=1.8, zorder=3
    )
    line.set_array(np.arange(len(achieved) - 1))
    line.set_clim(0, last_step)
    axes.add_collection(line)
    axes.plot(*achieved[0], "o", color="white", markeredgecolor=DARK, markersize=6, zorder=4)
    return line


def _numbered_stars(axes: Axes, subgoals: np.ndarray) -> None:
    axes.plot(*subgoals.T, "*", color=ORANGE, markersize=11, markeredgecolor=DARK, markeredgewidth=0.5, zorder=5)
    for number, position in enumerate(subgoals, start=1):
        axes.annotate(
            str(number),
            position,
            (4, 4),
            textcoords="offset points",
            fontsize=8,
            color=DARK,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=6,
        )


def _flag(axes: Axes, goal: np.ndarray, radius: float) -> None:
    """The final goal, and the circle within which it counts as met."""
    axes.add_patch(Circle((goal[0], goal[1]), radius, facecolor="none", edgecolor=RED, zorder=6))
    axes.plot(*goal, marker=FLAG, color=RED, markersize=20, markeredgecolor=DARK, markeredgewidth=0.5, zorder=7)


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    """At most about `count` of points [N, ...], evenly chosen."""
    return points[:: max(1, len(points) // count)]


def _median_length(moves: np.ndarray) -> str:
    return f"{np.median(np.linalg.norm(moves, axis=1)):.1f} m" if len(moves) else "none"


def _first_paths(episodes: Episodes, count: int) -> list[np.ndarray]:
    """s^G of the first `count` episodes, [states, G] each."""
    return np.split(episodes.achieved, episodes.starts[1:])[:count]


def _entry_name(episodes: Episodes, entry: int) -> str:
    return f"state entry {episodes.goal_indices[entry]}"


def _colour_bar(figure: Figure, drawn: ScalarMappable, panels: Sequence[Axes], label: str) -> None:
    bar = figure.colorbar(drawn, ax=panels, fraction=0.025, pad=0.01)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=8)


def _legend(figure: Figure, handles: list[Line2D]) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)


def _dot_handle(colour: str, label: str) -> Line2D:
    return Line2D([], [], marker="o", color=colour, linestyle="", markersize=4, label=label)


def _logged_handle() -> Line2D:
    return _dot_handle(LOGGED, "logged positions")


def _star_handle(label: str) -> Line2D:
    return Line2D([], [], marker="*", color=ORANGE, markeredgecolor=DARK, linestyle="", markersize=9, label=label)


def _flag_handle() -> Line2D:
    return Line2D([], [], marker=FLAG, color=RED, linestyle="", markersize=9, label="final goal")
