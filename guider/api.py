"""What the command line does, as Python functions: inspect, train, resume, load, evaluate, plot."""

from __future__ import annotations

import re
import statistics
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from guider import data as data_sources
from guider import runs
from guider.data.episodes import IN_MEMORY, Episodes
from guider.errors import GuiderError, GuiderWarning
from guider.evaluation.heldout import held_out_scores
from guider.evaluation.outcomes import ending, subgoal_shares
from guider.evaluation.rollouts import Rollouts, rollout
from guider.evaluation.summary import summary
from guider.learning import processor
from guider.learning.options import LearningOptions, said
from guider.learning.problem import Problem
from guider.learning.training import Chunk
from guider.learning.windows import no_window
from guider.methods import find_method, preset_config
from guider.methods.policy import Agent, Policy
from guider.methods.view import check_radius, data_use, learned_windows
from guider.runs import Pace, Run, RunSpec
from guider.support import files
from guider.support.config import differences, override
from guider.support.files import user_path
from guider.tasks import Task, find_task
from guider.tasks.types import SCORE_UNITS

DEFAULT_PACE = Pace()
TUNING_SEED = 1_000_000
"""Evaluation episodes during training use seeds from here on, those of `evaluate` start at 0: choices made
while watching curves never saw the episodes of the score."""


def train(
    task: str | None = None,
    data: str | Path | Episodes | None = None,
    *,
    settings: dict[str, Any] | None = None,
    seeds: int | Sequence[int] = 1,
    out: str | Path | None = None,
    held_out: float | None = None,
    evaluate_every: int = 0,
    on_chunk: Callable[[Chunk, Any], None] = lambda chunk, state: None,
    say: Callable[[str], None] = lambda line: None,
    stage_cache: str | Path | None = None,
    pace: Pace = DEFAULT_PACE,
    **options: Unpack[LearningOptions],
) -> Run:
    """Train on a task's data or on your own, and return the finished run.

    task: a name from `guider tasks`, or None for your own data, which then needs `radius` (goal units) and, where the
        data does not name its goal space, `goal_indices`.
    data: a file or dataset (see `guider.load_data`), or Episodes.
    settings: further settings by dotted name, e.g. {"high.samples": 2}; see guider.methods and guider.learners.
    seeds: how many agents to train at once (seeds 0, 1, ...), or their seeds.
    out: run directory, new; default runs/TASK-METHOD-PRESET.
    held_out: fraction of episodes kept for `evaluate`; default 0 for a task, 0.1 for your own data.
    evaluate_every: evaluate all seeds at the first chunk's end after every so many updates of the last stage; 0 for
        never.
    on_chunk: called between chunks of updates, e.g. to show progress; say: called before training with a line about
        what of the data is learned from, which run.json keeps; pace: how often to report and save.
    stage_cache: directory of stages trained before, by runs that share it: equal ones are taken over, new ones added.
    options: see LearningOptions.
    """
    asked = said(options)
    listed = seeds if isinstance(seeds, Iterable) else range(_whole(seeds, "seeds"))
    seeds = tuple(_whole(seed, "seeds") for seed in listed)
    _check_seeds(seeds)
    cache = _cache(stage_cache, evaluate_every)
    directory = run_directory(task, out, options)
    runs.check_free(directory)
    problem, episodes, config = _settle(task, data, settings, asked)
    held_out = (0.1 if task is None else 0.0) if held_out is None else _number(held_out, "held_out")
    if not 0 <= held_out < 1:
        raise GuiderError(f"--held-out is a fraction from 0 to below 1, got {held_out}")
    training, unseen = episodes.split(held_out) if held_out else (episodes, None)
    if unseen is not None and len(learned_windows(config.view, problem, unseen)) == 0:
        raise GuiderError(
            f"{episodes.source}: the {len(unseen.starts)} episodes held out could not be scored: "
            f"{no_window(unseen, problem.period_steps, config.view.minimum_move)}; or hold out more (--held-out), or "
            "none (--held-out 0)"
        )
    use = str(data_use(config.view, problem, training))
    say(f"{use}; training multiplies in {processor.settled(config.precision)}")
    spec = RunSpec(
        task=task,
        data=_lasting(data, episodes),
        format=asked.get("format"),
        episode_ends=tuple(asked.get("episode_ends", ())),
        fingerprint=episodes.fingerprint(),
        held_out=held_out,
        method=asked["method"],
        preset=asked["preset"],
        seeds=seeds,
        config=config,
        spaces=episodes.spaces,
    )
    facts = {"episode_ends": [asdict(sign) for sign in episodes.end_signs], "data_use": use}
    callback = _with_evaluation(directory, spec, evaluate_every, on_chunk)
    return runs.start(directory, spec, facts, episodes, callback, pace, cache)


def inspect(data: str | Path, *, task: str | None = None, **options: Unpack[LearningOptions]) -> dict[str, Any]:
    """What logged data holds (see guider.data.describe) and, given a task or a radius, what `train` would make of it:
    options are as there. Where nobody names the goal space, it is assumed to be the first two entries of a state."""
    asked = said(options)
    described_only = task is None and "radius" not in asked
    if described_only and ("reach_radius" in asked or "period_steps" in asked):
        raise GuiderError("--reach-radius and --period-steps say how to train; give --task or --radius with them")
    reading = {name: asked.pop(name) for name in ("format", "episode_ends") if name in asked}
    named = find_task(task).goal_indices if task is not None else None
    episodes = data_sources.load(data, asked.get("goal_indices", named), **reading, assumed_goal=(0, 1))
    description = data_sources.describe(episodes)
    if described_only:
        return description
    problem, _, config = _settle(task, episodes, None, asked)
    use = data_use(config.view, problem, episodes)
    refused = "" if use.windows else f"; {no_window(episodes, problem.period_steps, config.view.minimum_move)}"
    return description | {
        "training": {
            "method": asked["method"],
            "preset": asked["preset"],
            "radius": problem.radius,
            "reach_radius": problem.reach_radius,
            "period_steps": problem.period_steps,
            "data_use": f"{use}{refused}",
        }
    }


def _settle(
    task: str | None,
    data: str | Path | Episodes | None,
    settings: dict[str, Any] | None,
    asked: dict[str, Any],
) -> tuple[Problem, Episodes, Any]:
    """(what is to be learned, all episodes, the method's settings), from what the user said and the data."""
    if fixed := [name for name in settings or {} if name.startswith("problem.")]:
        raise GuiderError(f"{fixed[0]} is no setting: the task, or an option of its own, decides it")
    benchmark = None if task is None else find_task(task)
    method, preset = asked["method"], asked["preset"]
    preset_config(method, preset, Problem())  # a name that is none is told before any data is read
    if data is None:
        hint = f"make some with `guider collect {task} --out FILE`" if benchmark and benchmark.collector else "a file"
        raise GuiderError(f"no data given: name it with --data ({hint})")
    reading = {name: asked[name] for name in ("format", "episode_ends") if name in asked}
    if benchmark is not None:
        if "goal_indices" in asked or "radius" in asked:
            raise GuiderError(
                f"{benchmark.name} fixes its goal entries and radius; leave --goal-indices and --radius out"
            )
        episodes = _episodes(data, None if isinstance(data, Episodes) else benchmark.goal_indices, **reading)
        if episodes.goal_indices != benchmark.goal_indices:
            raise GuiderError(
                f"the goal entries of {benchmark.name} are {benchmark.goal_indices}, those of the episodes "
                f"{episodes.goal_indices}; give them as episodes.with_goal_space({benchmark.goal_indices})"
            )
        _check_fits(benchmark, episodes)
        problem = _problem(benchmark)
    else:
        if "radius" not in asked:
            raise GuiderError(
                "without a task name, say how near to a goal counts as met (--radius 0.5) and which state entries are "
                "the goal (--goal-indices 0 1)"
            )
        episodes = _episodes(data, asked.get("goal_indices"), **reading)
        period = max(5, round(statistics.median(episodes.lengths.tolist()) / 20))
        period = min(period, int(episodes.lengths.max()) - 1)
        radius = _number(asked["radius"], "radius")
        problem = Problem(radius, 2 * radius, period)
        check_radius(problem, episodes)
    if "reach_radius" in asked:
        problem = replace(problem, reach_radius=_number(asked["reach_radius"], "reach_radius"))
    if "period_steps" in asked:
        problem = replace(problem, period_steps=_whole(asked["period_steps"], "period_steps"))
    return problem, episodes, override(preset_config(method, preset, problem), settings or {})


def run_directory(task: str | None, out: str | Path | None, options: LearningOptions) -> Path:
    """Where a run goes: `out`, or else runs/TASK-METHOD-PRESET."""
    if out is not None:
        return user_path(out)
    asked = said(options)
    return Path("runs") / f"{re.sub(r'[^A-Za-z0-9.-]+', '-', task or 'own')}-{asked['method']}-{asked['preset']}"


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
    opened = _open(run)
    callback = _with_evaluation(opened.directory, opened.spec, evaluate_every, on_chunk)
    runs.resume(opened, lambda: _same_data(opened, data), callback, pace, cache)
    return opened


def load(run: str | Path | Run, seed: int | None = None) -> Agent:
    """The trained agent of a run, ready to `reset()` and `act(observation, goal)`. seed: default the first."""
    opened = _open(run)
    return Agent(opened.policies()[_seed_index(opened, seed)])


def evaluate(run: str | Path | Run, **options: Any) -> dict[str, Any]:
    """Score a finished run's last checkpoint (options and result: see `score`) and write evaluation.json into it."""
    opened = _open(run)
    result = score(opened, **options)
    keep_score(opened, result)
    return result


def keep_score(run: str | Path | Run, result: dict[str, Any]) -> None:
    """Write what `score` returned into the run's evaluation.json."""
    files.write_json(_open(run).directory / "evaluation.json", result)


def score(
    run: str | Path | Run,
    *,
    episodes: int | None = None,
    first_seed: int | None = None,
    data: str | Path | Episodes | None = None,
    on_steps: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """The score of a finished run's last checkpoint.

    On a task: `episodes` episodes (100) for every seed, environment seeds first_seed (0) + seed index * episodes + e.
    On one's own data: the episodes that training never saw (see guider.evaluation.heldout).
    Returns the score with its protocol: environment, data, preset and its departures, seeds, interval.
    """
    count, first = 100 if episodes is None else episodes, 0 if first_seed is None else first_seed
    if count < 1 or first < 0:
        raise GuiderError(f"--episodes must be 1 or more and --first-seed 0 or more, got {count} and {first}")
    opened = _open(run)
    spec = opened.spec
    policies = opened.policies()
    protocol = {
        "task": spec.task,
        "method": spec.method,
        "preset": spec.preset,
        "departures": _departures(spec),
        "precision": spec.config.precision,
        "acts_by": find_method(spec.method).acts_by(spec.config),
        "period_steps": spec.config.problem.period_steps,
        "reach_radius": spec.config.problem.reach_radius,
        "data": spec.data,
        "fingerprint": spec.fingerprint,
        "training_seeds": list(spec.seeds),
        "updates": {stage.name: stage.updates for stage in opened.stages},
        "checkpoint": "last",
        "versions": runs.versions(),
        "evaluated_on": processor.describe(),
    }
    if spec.task is None and (episodes is not None or first_seed is not None):
        raise GuiderError(
            "a run on one's own data is scored on held-out episodes; leave --episodes and --first-seed out"
        )
    task = None if spec.task is None else find_task(spec.task)
    if task is not None and task.maze is None and data is not None:
        raise GuiderError(f"{spec.task} is scored in its environment; leave --data out")
    if task is None:
        logged = _same_data(opened, data)
        if spec.held_out == 0:
            raise GuiderError(f"{opened.directory} held no episodes out; train with --held-out 0.1 to score it")
        unseen = logged.split(spec.held_out)[1]
        result = protocol | {
            "held_out_episodes": len(unseen.starts),
            "held_out_use": str(data_use(spec.config.view, spec.config.problem, unseen)),
            "per_seed": [held_out_scores(policy, unseen) for policy in policies],
        }
    else:

        def rolled_out(index: int, policy: Policy) -> Rollouts:
            return rollout(
                policy,
                task,
                count,
                first + index * count,
                on_steps=lambda done, of: on_steps(index * of + done, len(policies) * of),
            )

        outcomes = [rolled_out(index, policy) for index, policy in enumerate(policies)]
        result = protocol | summary(task, outcomes, first)
        if task.maze is not None:
            guided = find_method(spec.method).pursued is not None
            logged = _logged_places(opened, data) if guided else None
            for scores, outcome in zip(result["per_seed"], outcomes, strict=True):
                scores["episodes"]["ending"] = [ending(trace, task, task.maze) for trace in outcome.traces]
                if guided:
                    scores |= subgoal_shares(outcome.traces, task.maze, logged, spec.config.problem.reach_radius)
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

    opened = _open(run)
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
    if data is None and spec.data == IN_MEMORY:
        raise GuiderError(f"{run.directory} was trained on arrays in memory; give the same Episodes (data=episodes)")
    try:
        given = spec.data if data is None else data
        episodes = _episodes(given, spec.spaces.goal_indices, spec.format, spec.episode_ends)
    except GuiderError as error:
        if data is not None:
            raise
        raise GuiderError(f"{error} (what {run.directory} was trained on; if it has moved: --data PLACE)") from error
    fingerprint = episodes.fingerprint()
    if fingerprint != spec.fingerprint:
        raise GuiderError(
            f"{episodes.source} (fingerprint {fingerprint}) is not the data {run.directory} was trained on "
            f"({spec.data}, fingerprint {spec.fingerprint}); give that with --data"
        )
    return episodes


def _logged_places(run: Run, data: str | Path | Episodes | None) -> np.ndarray | None:
    """s^G of the run's data, or None, with a warning, where that is not where it was and nobody says where it is."""
    try:
        return _same_data(run, data).achieved
    except GuiderError as error:
        if data is not None:
            raise
        warnings.warn(GuiderWarning(f"how many subgoals lie off the data is not told: {error}"), stacklevel=2)
        return None


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
            files.append_line(directory / "evaluations.jsonl", line)

    return callback


def _cache(directory: str | Path | None, evaluate_every: int) -> Path | None:
    if directory is not None and evaluate_every:
        raise GuiderError("--evaluate-every needs the last stage trained here; leave --stage-cache out")
    return None if directory is None else user_path(directory)


def _open(run: str | Path | Run) -> Run:
    return run if isinstance(run, Run) else runs.open_run(user_path(run))


def _whole(number: Any, name: str) -> int:
    """The number as an int, NumPy's too. Raises GuiderError for anything but a whole number."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise GuiderError(f"{name} must be a whole number, got {number!r}")
    return int(number)


def _number(number: Any, name: str) -> float:
    """The number as a float, NumPy's too. Raises GuiderError for anything else."""
    if isinstance(number, bool) or not isinstance(number, int | float | np.number):
        raise GuiderError(f"{name} must be a number, got {number!r}")
    return float(number)


def _lasting(data: str | Path | Episodes | None, episodes: Episodes) -> str:
    """The data's name, such that it is found again from another directory."""
    path = None if isinstance(data, Episodes) else user_path(episodes.source)
    return str(path.absolute()) if path is not None and path.exists() else episodes.source


def _episodes(
    data: str | Path | Episodes,
    goal_indices: Sequence[int] | None,
    format: str | None = None,
    episode_ends: Sequence[str] = (),
) -> Episodes:
    if not isinstance(data, Episodes):
        return data_sources.load(data, goal_indices, format=format, episode_ends=episode_ends)
    if format is not None or episode_ends:
        raise GuiderError("format and episode_ends say how to read a file; leave them out for Episodes")
    return data if goal_indices is None else data.with_goal_space(goal_indices)


def _check_fits(task: Task, episodes: Episodes) -> None:
    found = episodes.observations.shape[1], episodes.actions.shape[1]
    if found != (task.state_dim, task.action_dim):
        raise GuiderError(
            f"{episodes.source} holds states of {found[0]} and actions of {found[1]} numbers; "
            f"{task.name} ({task.environment}) has {task.state_dim} and {task.action_dim}"
        )
    task.check_data(episodes)
