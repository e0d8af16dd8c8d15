"""What the command line does, as Python functions: inspect, train, resume, load, evaluate, plot, film, export."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Unpack

from guider import data as data_sources
from guider import runs
from guider.data import layouts
from guider.data.episodes import Episodes
from guider.errors import GuiderError
from guider.evaluation.rollouts import rollout
from guider.evaluation.score import keep_score, score
from guider.learning import processor
from guider.learning.options import LearningOptions, said
from guider.learning.training import Chunk
from guider.methods.policy import Agent
from guider.methods.view import data_use, learned_windows, why_no_window
from guider.runs import Pace, Run, RunSpec
from guider.runs.asked import check, find_data, number, reading_of, settle, whole
from guider.runs.source import lasting, same_data
from guider.support import files
from guider.support.files import user_path
from guider.tasks import find_task
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
    on_chunk: called between chunks of updates, e.g. to show progress; say: called with lines about what is done before
        training, and about what of the data is learned from, which run.json keeps; pace: how often to report and save.
    stage_cache: directory of stages trained before, by runs that share it: equal ones are taken over, new ones added.
    options: see LearningOptions.
    """
    asked = said(options)
    listed = seeds if isinstance(seeds, Iterable) else range(whole(seeds, "seeds"))
    seeds = tuple(whole(seed, "seeds") for seed in listed)
    _check_seeds(seeds)
    cache = _cache(stage_cache, evaluate_every)
    directory = run_directory(task, out, options)
    runs.check_free(directory)
    check(task, settings, options)
    if isinstance(data, str | Path):
        say(f"reading {data}")
    episodes = find_data(task, data, options)
    problem, config = settle(task, episodes, settings, options)
    held_out = (0.1 if task is None else 0.0) if held_out is None else number(held_out, "held_out")
    if not 0 <= held_out < 1:
        raise GuiderError(f"--held-out is a fraction from 0 to below 1, got {held_out}")
    training, unseen = episodes.split(held_out) if held_out else (episodes, None)
    if unseen is not None and len(learned_windows(config.view, problem, unseen)) == 0:
        raise GuiderError(
            f"{episodes.source}: the {len(unseen.starts)} episodes held out could not be scored: "
            f"{why_no_window(config.view, problem, unseen)}; or hold out more (--held-out), or "
            "none (--held-out 0)"
        )
    use = str(data_use(config.view, problem, training))
    say(f"{use}; training multiplies in {processor.settled(config.precision)}")
    if task is None:
        say(
            f"a goal counts as met within {problem.radius:g}, a subgoal as reached within {problem.reach_radius:g} "
            f"(--reach-radius); subgoals {problem.period_steps} steps ahead (--period-steps), by default the fewest "
            "from 20 on in which what moves goes three radii, a third of the median episode at most"
        )
    say("compiling, which takes a minute at most for each stage")
    spec = RunSpec(
        task=task,
        data=lasting(data, episodes),
        reading=reading_of(options),
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


def inspect(
    data: str | Path, *, task: str | None = None, report: str | Path | None = None, **options: Unpack[LearningOptions]
) -> dict[str, Any]:
    """What logged data holds (see guider.data.describe) and, given a task or a radius, what `train` would make of it:
    options are as there. Where nobody names the goal space, it is assumed to be the first two entries of a state.
    report: a new file, for an HTML page of it."""
    place = None if report is None else files.new_file(report, "--report")
    asked = said(options)
    described_only = task is None and "radius" not in asked
    if described_only and ("reach_radius" in asked or "period_steps" in asked):
        raise GuiderError("--reach-radius and --period-steps say how to train; give --task or --radius with them")
    if not described_only:
        check(task, None, options)
    episodes = find_data(task, data, options, assumed_goal=(0, 1))
    description = data_sources.describe(episodes)
    if not described_only:
        description |= {"training": _data_use(task, episodes, options)}
    if place is not None:
        from guider.plots.inspection import inspection_page

        files.write_text(place, inspection_page(episodes, description))
    return description


def _data_use(task: str | None, episodes: Episodes, options: LearningOptions) -> dict[str, Any]:
    """What training would make of the data."""
    asked = said(options)
    problem, config = settle(task, episodes, None, options)
    use = data_use(config.view, problem, episodes)
    refused = "" if use.windows else f"; {why_no_window(config.view, problem, episodes)}"
    return {
        "method": asked["method"],
        "preset": asked["preset"],
        "radius": problem.radius,
        "reach_radius": problem.reach_radius,
        "period_steps": problem.period_steps,
        "data_use": f"{use}{refused}",
    }


def convert(
    data: str | Path,
    out: str | Path,
    layout: str | None = None,
    *,
    fps: float = 10.0,
    report: Callable[[int, int], None] = lambda done, total: None,
    **options: Unpack[LearningOptions],
) -> str:
    """Read logged data and write it in another layout (see `save_data`), which is returned. options: those of
    LearningOptions that say how it is read. Where nobody names the goal space, it is assumed to be the first entries of
    a state."""
    reads = {"goal_indices", "goal", "state", "action", "format", "episode_ends"}
    if other := sorted(options.keys() - reads):
        raise GuiderError(
            f"--{other[0].replace('_', '-')} says how to train, and nothing is trained here; leave it out"
        )
    episodes = find_data(None, data, options, assumed_goal=(0,))
    return save_data(episodes, out, layout, fps=fps, report=report)


def save_data(
    episodes: Episodes,
    path: str | Path,
    layout: str | None = None,
    *,
    fps: float = 10.0,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> str:
    """Write episodes to a new file or directory; see guider.data.layouts. What `plain` writes, an npz, `load_data`
    reads back as it was: runs on it can be resumed, evaluated and plotted."""
    return layouts.save(episodes, user_path(path), layout, fps=fps, report=report)


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
    opened = runs.as_run(run)
    callback = _with_evaluation(opened.directory, opened.spec, evaluate_every, on_chunk)
    runs.resume(opened, lambda: same_data(opened, data), callback, pace, cache)
    return opened


def load(run: str | Path | Run, seed: int | None = None) -> Agent:
    """The trained agent of a run, ready to `reset()` and `act(observation, goal)`. seed: default the first."""
    opened = runs.as_run(run)
    return Agent(opened.policies()[_seed_index(opened, seed)])


def evaluate(run: str | Path | Run, **options: Any) -> dict[str, Any]:
    """Score a finished run's last checkpoint (options and result: see `score`) and write evaluation.json into it."""
    opened = runs.as_run(run)
    result = score(opened, **options)
    keep_score(opened, result)
    return result


def export(run: str | Path | Run, path: str | Path, *, seed: int | None = None) -> list[Path]:
    """Write a trained policy as a file that runs without this package, and return what was written.

    path: a new file; its ending names the format: .onnx, .npz (with a NumPy actor beside it) or .safetensors (what was
    trained, alone); seed: which trained seed's, default the first. See guider.exporting.
    """
    from guider.exporting import about, export_policy

    opened = runs.as_run(run)
    index = _seed_index(opened, seed)
    policy = opened.policies()[index]
    return export_policy(policy, about(opened.spec, opened.spec.seeds[index], policy), user_path(path))


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

    opened = runs.as_run(run)
    spec = opened.spec
    episodes = same_data(opened, data)
    chosen = _seed_index(opened, seed)
    return draw_run(opened, find_task(spec.task) if spec.task else None, episodes, spec.seeds[chosen], first_seed)


def film(
    run: str | Path | Run,
    path: str | Path,
    *,
    seed: int | None = None,
    episodes: int = 1,
    first_seed: int = 0,
    camera: str | None = None,
    size: tuple[int, int] = (480, 360),
    on_steps: Callable[[int, int], None] = lambda done, total: None,
) -> list[bool]:
    """Film a trained policy in its task's simulator, and return which episodes met their goals.

    path: a new file, .gif or .mp4; seed: which trained seed's policy, default the first; first_seed: of the episodes;
    camera: one of the simulation's, by name; size: width and height of a frame, pixels. See guider.plots.film.
    """
    from guider.plots.drawing import Look
    from guider.plots.film import film as shoot

    opened = runs.as_run(run)
    if opened.spec.task is None:
        raise GuiderError(f"{opened.directory} was trained on your own data, and there is no simulator to film")
    policy, look = opened.policies()[_seed_index(opened, seed)], Look(camera, *size)
    return shoot(policy, find_task(opened.spec.task), path, episodes, first_seed, look, on_steps)


def report(
    run_directories: Sequence[str | Path | Run],
    out: str | Path | None = None,
    *,
    first_seed: int = 0,
    data: str | Path | Episodes | None = None,
) -> Path:
    """Write one HTML page about finished, scored runs (see guider.plots.report) and return its path.

    out: a new file, default report.html in the first run, which is written anew; first_seed: of the episodes rolled
        out;
    data: where the first run's data is now, if it has moved.
    """
    from guider.plots.report import Subject
    from guider.plots.report import report as page

    opened = [runs.as_run(run) for run in run_directories]
    subjects = [Subject(run, same_data(run, None if index else data)) for index, run in enumerate(opened)]
    text = page(subjects, first_seed)
    path = opened[0].directory / "report.html" if out is None else files.new_file(out, "--out")
    files.write_bytes(path, text.encode())
    return path


def _check_seeds(seeds: tuple[int, ...]) -> None:
    if not seeds or len(set(seeds)) != len(seeds) or min(seeds) < 0 or max(seeds) >= 2**32:
        raise GuiderError(f"seeds must be one or more distinct numbers from 0 to 2^32 - 1, got {seeds}")


def _seed_index(run: Run, seed: int | None) -> int:
    seeds = run.spec.seeds
    if seed is not None and seed not in seeds:
        raise GuiderError(f"{run.directory} trained seeds {', '.join(map(str, seeds))}, not {seed}")
    return 0 if seed is None else seeds.index(seed)


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
