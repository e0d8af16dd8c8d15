"""Pictures of a run: how it learned, which subgoals it proposes, and where it went.

Every picture is a pure function from data to a matplotlib Figure; `draw_run` saves those of one run. `title`
is the first line of a picture's title, see `caption`. Positions are in goal units, which are metres in mazes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from guider.data.episodes import Episodes
from guider.evaluation.rollouts import rollout
from guider.methods import find_method
from guider.methods.routes import Routes
from guider.plots import canvas
from guider.plots.curves import learning_curves, score_curve
from guider.plots.gaps import fixed_period, subgoal_gaps, subgoals_met
from guider.plots.logs import subgoals_on_logs
from guider.plots.mazes import episodes_in_maze, reachable_in_maze, spread_positions, subgoal_arrows
from guider.plots.routes import routes_in_maze
from guider.runs import Run, RunSpec
from guider.support.files import read_lines
from guider.tasks.types import Task

__all__ = [
    "caption",
    "draw_run",
    "episodes_in_maze",
    "learning_curves",
    "reachable_in_maze",
    "routes_in_maze",
    "score_curve",
    "subgoal_arrows",
    "subgoals_met",
    "subgoals_on_logs",
]

EPISODES_MEASURED = 20


def draw_run(
    run: Run, task: Task | None, episodes: Episodes, seed: int, first_seed: int, episodes_shown: int = 6
) -> list[Path]:
    """Draw everything there is to draw of a run into its folder `plots`, and return the paths: of a method without
    decoded subgoals, its curves and, in mazes, its episodes.

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
        canvas.save(figure, path)
        saved.append(path)

    if lines := read_lines(run.directory / "metrics.jsonl"):
        save("learning", learning_curves(lines, title_of_all, find_method(spec.method).metric_labels(spec.config)))
    if lines := read_lines(run.directory / "evaluations.jsonl"):
        save("scores", score_curve(lines, title_of_all))
    policy = run.policies()[spec.seeds.index(seed)]
    logged, shown = episodes.split(spec.held_out) if spec.held_out else (episodes, episodes)
    kind = "held-out" if spec.held_out else "training"

    subgoals = find_method(spec.method).subgoals
    if task is None or task.maze is None:
        if subgoals is not None:
            save(f"subgoals-seed{seed}", subgoals_on_logs(logged, shown, kind, policy, title))
        return saved

    maze, problem = task.maze, policy.config.problem
    traces = rollout(policy, task, episodes_shown, first_seed).traces
    save(f"episodes-seed{seed}", episodes_in_maze(task, maze, logged, traces, first_seed, title))
    if subgoals is None:
        return saved
    save(f"arrows-seed{seed}", subgoal_arrows(task, maze, logged, policy, traces[0].goal, title))
    routes = getattr(policy.state, "high", None)
    if isinstance(routes, Routes) and np.isfinite(routes.places).any():
        ends = np.stack([traces[0].achieved[0], traces[0].goal])
        save(f"routes-seed{seed}", routes_in_maze(task, maze, logged, policy.config, routes, ends, title))
    if subgoals.reachable is not None:
        positions = spread_positions(maze, logged, 8)
        save(f"reachable-seed{seed}", reachable_in_maze(maze, logged, policy, positions, title))
    if subgoals.periodic is not None:
        measured = rollout(fixed_period(policy), task, EPISODES_MEASURED, first_seed).traces
        if len(subgoal_gaps(measured, problem.period_steps)):
            save(f"met-seed{seed}", subgoals_met(problem, maze, logged, measured, first_seed, title))
    return saved


def caption(spec: RunSpec, seeds: Sequence[int]) -> str:
    """What is drawn: task (or data), method, preset and seeds."""
    shown = f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
    return f"{spec.task or Path(spec.data).name}, {spec.method}, preset {spec.preset}, {shown}"
