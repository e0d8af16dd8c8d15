"""What the command line does, as Python functions: train, resume, load, evaluate, plot."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from guider import data as data_sources
from guider import runs
from guider.config import differences, override
from guider.episodes import Episodes
from guider.errors import GuiderError
from guider.evaluation import Rollouts, bootstrap_interval, rollout, wilson_interval
from guider.heldout import held_out_scores
from guider.policy import Agent, Policy
from guider.presets import Preset, preset_config
from guider.problem import Problem
from guider.runs import Pace, Run, RunSpec
from guider.tasks import Task, find_task
from guider.tasks.types import SCORE_UNITS
from guider.training import Chunk

DEFAULT_PACE = Pace()
TUNING_SEED = 1_000_000
"""Evaluation episodes during training use seeds from here on, those of `evaluate` start at 0: choices made
while watching curves never saw the episodes of the score."""


def train(
    task: str | None = None,
    data: str | Path | Episodes | None = None,
    *,
    goal_indices: Sequence[int] | None = None,
    radius: float | None = None,
    reach_radius: float | None = None,
    period_steps: int | None = None,
    format: str | None = None,
    method: str = "guider",
    preset: Preset = "fast",
    settings: dict[str, Any] | None = None,
    seeds: int | Sequence[int] = 1,
    out: str | Path | None = None,
    held_out: float | None = None,
    evaluate_every: int = 0,
    on_chunk: Callable[[Chunk, Any], None] = lambda chunk, state: None,
    stage_cache: str | Path | None = None,
    pace: Pace = DEFAULT_PACE,
) -> Run:
    """Train on a task's data or on your own, and return the finished run.

    task: a name from `guider tasks`, or None for your own data, which then needs `goal_indices` and `radius`
        (goal units).
    data: a file or dataset (see `guider.load_data`), or Episodes.
    reach_radius: a subgoal counts as reached this near; default the task's, or twice the radius.
    period_steps: c; default the task's, or a twentieth of the median episode, at least 5.
    settings: further settings by dotted name, e.g. {"high.samples": 2}; see guider.methods and guider.learners.
    seeds: how many agents to train at once (seeds 0, 1, ...), or their seeds.
    out: run directory, new; default runs/TASK-METHOD-PRESET.
    held_out: fraction of episodes kept for `evaluate`; default 0 for a task, 0.1 for your own data.
    evaluate_every: evaluate all seeds at the first chunk's end after every so many updates of the last stage; 0 for
        never.
    on_chunk: called between chunks of updates, e.g. to show progress; pace: how often to report and save.
    stage_cache: directory of stages trained before, by runs that share it: equal ones are taken over, new ones added.
    """
    seeds = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    _check_seeds(seeds)
    cache = _cache(stage_cache, evaluate_every)
    if fixed := [name for name in settings or {} if name.startswith("problem.")]:
        raise GuiderError(f"{fixed[0]} is no setting: the task, or an option of its own, decides it")
    benchmark = None if task is None else find_task(task)
    if data is None:
        hint = f"make some with `guider collect {task} --out FILE`" if benchmark and benchmark.collector else "a file"
        raise GuiderError(f"no data given: name it with --data ({hint})")
    goal_indices = _goal_indices(benchmark, data, goal_indices, radius)
    episodes = _episodes(data, goal_indices, format)
    if benchmark is not None:
        _check_fits(benchmark, episodes)
        problem = _problem(benchmark)
    else:
        assert radius is not None
        problem = Problem(radius, 2 * radius, max(5, round(statistics.median(episodes.lengths.tolist()) / 20)))
    chosen = {"reach_radius": reach_radius, "period_steps": period_steps}
    problem = replace(problem, **{name: value for name, value in chosen.items() if value is not None})
    config = override(preset_config(method, preset, problem), settings or {})
    held_out = (0.0 if benchmark else 0.1) if held_out is None else held_out
    if not 0 <= held_out < 1:
        raise GuiderError(f"--held-out is a fraction from 0 to below 1, got {held_out}")
    spec = RunSpec(
        task=task,
        data=episodes.source,
        format=format,
        fingerprint=episodes.fingerprint(),
        held_out=held_out,
        method=method,
        preset=preset,
        seeds=seeds,
        config=config,
        spaces=episodes.spaces,
    )
    directory = Path(out) if out else default_directory(task, method, preset)
    callback = _with_evaluation(directory, spec, evaluate_every, on_chunk)
    return runs.start(directory, spec, episodes, callback, pace, cache)


def default_directory(task: str | None, method: str, preset: str) -> Path:
    """Where a run goes if nobody says otherwise."""
    return Path("runs") / f"{re.sub(r'[^A-Za-z0-9.-]+', '-', task or 'own')}-{method}-{preset}"


def resume(
    run: str | Path,
    data: str | Path | Episodes | None = None,
    *,
    evaluate_every: int = 0,
    on_chunk: Callable[[Chunk, Any], None] = lambda chunk, state: None,
    stage_cache: str | Path | None = None,
    pace: Pace = DEFAULT_PACE,
) -> Run:
    """Continue an interrupted run to its end, bit-equal to one never interrupted.

    data: where the run's data is now, if it has moved; stage_cache: see `train`. Raises GuiderError if it is not the
    same data.
    """
    cache = _cache(stage_cache, evaluate_every)
    opened = runs.open_run(run)
    callback = _with_evaluation(opened.directory, opened.spec, evaluate_every, on_chunk)
    runs.resume(opened, lambda: _same_data(opened, data), callback, pace, cache)
    return opened


def load(run: str | Path | Run, seed: int | None = None) -> Agent:
    """The trained agent of a run, ready to `reset()` and `act(observation, goal)`. seed: default the first."""
    opened = run if isinstance(run, Run) else runs.open_run(run)
    return Agent(opened.policies()[_seed_index(opened, seed)])


def evaluate(
    run: str | Path | Run,
    *,
    episodes: int = 100,
    first_seed: int = 0,
    data: str | Path | Episodes | None = None,
    on_steps: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Score a finished run's last checkpoint and write evaluation.json into it.

    On a task: `episodes` episodes for every seed, environment seeds first_seed + seed index * episodes + e.
    On one's own data: the episodes that training never saw (see guider.heldout).
    Returns the score with its protocol: environment, data, preset and its departures, seeds, interval.
    """
    if episodes < 1 or first_seed < 0:
        raise GuiderError(f"--episodes must be 1 or more and --first-seed 0 or more, got {episodes} and {first_seed}")
    opened = run if isinstance(run, Run) else runs.open_run(run)
    spec = opened.spec
    policies = opened.policies()
    protocol = {
        "task": spec.task,
        "method": spec.method,
        "preset": spec.preset,
        "departures": _departures(spec),
        "period_steps": spec.config.problem.period_steps,
        "reach_radius": spec.config.problem.reach_radius,
        "data": spec.data,
        "fingerprint": spec.fingerprint,
        "training_seeds": list(spec.seeds),
        "updates": {stage.name: stage.updates for stage in opened.stages},
        "checkpoint": "last",
        "versions": runs.versions(),
    }
    if spec.task is None:
        logged = _same_data(opened, data)
        if spec.held_out == 0:
            raise GuiderError(f"{opened.directory} held no episodes out; train with --held-out 0.1 to score it")
        unseen = logged.split(spec.held_out)[1]
        result = protocol | {
            "held_out_episodes": len(unseen.starts),
            "per_seed": [held_out_scores(policy, unseen) for policy in policies],
        }
    else:
        task = find_task(spec.task)

        def outcome(index: int, policy: Policy) -> Rollouts:
            return rollout(
                policy,
                task,
                episodes,
                first_seed + index * episodes,
                on_steps=lambda done, of: on_steps(index * of + done, len(policies) * of),
            )

        outcomes = [outcome(index, policy) for index, policy in enumerate(policies)]
        result = protocol | _summary(task, outcomes, first_seed)
    runs.write_json(opened.directory / "evaluation.json", result)
    return result


def plot(
    run: str | Path | Run,
    *,
    seed: int | None = None,
    first_seed: int = 0,
    data: str | Path | Episodes | None = None,
) -> list[Path]:
    """Draw a finished run into its folder `plots` (see guider.plots.draw_run) and return the paths.

    seed: which trained seed's subgoals to draw, default the first; first_seed: of the episodes rolled out;
    data: where the run's data is now, if it has moved.
    """
    from guider.plots import draw_run  # matplotlib takes a second to import

    opened = run if isinstance(run, Run) else runs.open_run(run)
    spec = opened.spec
    episodes = _same_data(opened, data)
    chosen = _seed_index(opened, seed)
    return draw_run(opened, find_task(spec.task) if spec.task else None, episodes, spec.seeds[chosen], first_seed)


def _problem(task: Task) -> Problem:
    return Problem(task.radius, task.reach_radius, task.period_steps, task.goal_parts, task.domain)


def _departures(spec: RunSpec) -> dict[str, Any]:
    """Where a run's settings depart from `paper` on its task; for one's own data radii and period are its own."""
    problem = spec.config.problem if spec.task is None else _problem(find_task(spec.task))
    return differences(spec.config, preset_config(spec.method, "paper", problem))


def _check_seeds(seeds: tuple[int, ...]) -> None:
    if not seeds or len(set(seeds)) != len(seeds) or min(seeds) < 0 or max(seeds) >= 2**32:
        raise GuiderError(f"seeds must be one or more distinct numbers from 0 to 2^32 - 1, got {seeds}")


def _seed_index(run: Run, seed: int | None) -> int:
    seeds = run.spec.seeds
    if seed is not None and seed not in seeds:
        raise GuiderError(f"{run.directory} trained seeds {', '.join(map(str, seeds))}, not {seed}")
    return 0 if seed is None else seeds.index(seed)


def _same_data(run: Run, data: str | Path | Episodes | None) -> Episodes:
    """The run's data, from `data` if it has moved. Raises GuiderError if it is not the same."""
    spec = run.spec
    episodes = _episodes(spec.data if data is None else data, spec.spaces.goal_indices, spec.format)
    fingerprint = episodes.fingerprint()
    if fingerprint != spec.fingerprint:
        raise GuiderError(
            f"{episodes.source} (fingerprint {fingerprint}) is not the data {run.directory} was trained on "
            f"({spec.data}, fingerprint {spec.fingerprint}); give that with --data"
        )
    return episodes


def _summary(task: Task, outcomes: list[Rollouts], first_seed: int) -> dict[str, Any]:
    """The task's score, per seed and over seeds: Wilson's interval for one seed's success rate, else bootstrap's."""
    scores = np.stack([outcome.score for outcome in outcomes])
    means, count = scores.mean(axis=1), scores.shape[1]

    def interval(outcome: Rollouts) -> list[float]:
        if task.score == "success":
            return [round(100 * bound, 1) for bound in wilson_interval(int(outcome.success.sum()), count)]
        return [round(bound, 1) for bound in bootstrap_interval(outcome.score[None])]

    per_seed = [
        {
            "score": float(outcome.score.mean()),
            "interval_95": interval(outcome),
            "goal_met_percent": float(100 * outcome.success.mean()),
            "median_steps_when_met": float(np.median(outcome.steps[outcome.success]))
            if outcome.success.any()
            else None,
        }
        for outcome in outcomes
    ]
    return {
        "environment": task.environment,
        "horizon_steps": task.horizon_steps,
        "radius": task.radius,
        "episodes_per_seed": count,
        "episode_seeds": [first_seed, first_seed + scores.size - 1],
        "unit": SCORE_UNITS[task.score],
        "score": float(means.mean()),
        "score_std_over_seeds": float(means.std()),  # of these seeds, ddof 0
        "interval_95": [round(bound, 1) for bound in bootstrap_interval(scores)],
        "per_seed": per_seed,
        "paper_score": task.paper_score,
    }


def _with_evaluation(
    directory: Path, spec: RunSpec, every: int, on_chunk: Callable[[Chunk, Any], None]
) -> Callable[[Chunk, Any], None]:
    """on_chunk, and every so many updates of the last stage an evaluation on a copy of the state."""
    if not every:
        return on_chunk
    if spec.task is None or every < 0:
        raise GuiderError("--evaluate-every takes a number of updates above 0, and needs a task to evaluate on")
    task = find_task(spec.task)
    stages = Run(directory, spec).stages
    episodes = 20

    def callback(chunk: Chunk, state: Any) -> None:
        on_chunk(chunk, state)
        update = chunk.position.update
        crossed = update // every > (update - chunk.updates) // every or update == chunk.stage.updates
        if chunk.position.stage == len(stages) - 1 and crossed:
            outcomes = [rollout(policy, task, episodes, TUNING_SEED) for policy in runs.policies(spec, state)]
            line = {
                "stage": chunk.stage.name,
                "update": update,
                "total_updates": runs.total_updates(stages, chunk.position),
                "score": [float(outcome.score.mean()) for outcome in outcomes],
                "unit": SCORE_UNITS[task.score],
                "episodes": episodes,
            }
            runs.append_line(directory / "evaluations.jsonl", line)

    return callback


def _cache(directory: str | Path | None, evaluate_every: int) -> Path | None:
    if directory is not None and evaluate_every:
        raise GuiderError("--evaluate-every needs the last stage trained here; leave --stage-cache out")
    return None if directory is None else Path(directory)


def _goal_indices(
    task: Task | None, data: Any, goal_indices: Sequence[int] | None, radius: float | None
) -> Sequence[int]:
    """The goal space, from the task where there is one. Raises GuiderError where it, or the radius, is not settled."""
    if task is not None:
        if goal_indices is not None or radius is not None:
            raise GuiderError(f"{task.name} fixes its goal entries and radius; leave --goal-indices and --radius out")
        return task.goal_indices
    if isinstance(data, Episodes) and goal_indices is None:
        goal_indices = data.goal_indices
    if goal_indices is None or radius is None:
        raise GuiderError(
            "without a task name, say which state entries are the goal (--goal-indices 0 1) "
            "and how near counts as met (--radius 0.5)"
        )
    return goal_indices


def _episodes(data: str | Path | Episodes, goal_indices: Sequence[int], format: str | None) -> Episodes:
    return data if isinstance(data, Episodes) else data_sources.load(data, goal_indices, format=format)


def _check_fits(task: Task, episodes: Episodes) -> None:
    found = episodes.observations.shape[1], episodes.actions.shape[1]
    if found != (task.state_dim, task.action_dim):
        raise GuiderError(
            f"{episodes.source} holds states of {found[0]} and actions of {found[1]} numbers; "
            f"{task.name} ({task.environment}) has {task.state_dim} and {task.action_dim}"
        )
    task.check_data(episodes)
