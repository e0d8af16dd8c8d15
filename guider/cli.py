"""The command line. Every command is a function here; its docstring is its help.

Exit status: 0 done; 1 bad input or a place that cannot be read or written; 2 wrong usage; 3 a fault of guider's;
130 and 143 stopped by Ctrl-C or SIGTERM; 141 nobody reads the output. What was wrong is said in one line;
GUIDER_DEBUG=1 shows the trace.
"""

from __future__ import annotations

import inspect as python_inspect
import json
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.files import user_path
from guider.methods.presets import Preset
from guider.reproduce.paper import TargetName

Json = Annotated[bool, tyro.conf.arg(name="json", help="Print one JSON document instead of text.")]
TaskName = tyro.conf.Positional[str]
RunDirectory = tyro.conf.Positional[Path]


def train(
    task: tyro.conf.Positional[str | None] = None,
    data: str | None = None,
    method: str | None = None,
    preset: Preset | None = None,
    seeds: int | None = None,
    first_seed: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    goal_indices: tuple[int, ...] = (),
    radius: float | None = None,
    reach_radius: float | None = None,
    period_steps: int | None = None,
    held_out: float | None = None,
    format: str | None = None,
    episode_ends: tuple[str, ...] = (),
    set: tuple[str, ...] = (),
    evaluate_every: int = 0,
    stage_cache: Path | None = None,
    log_to: Literal["tensorboard", "wandb"] | None = None,
    as_json: Json = False,
) -> None:
    """Learn a policy from logged data.

    A benchmark:    guider train pointmaze-large --data datasets/pointmaze-large.hdf5 --seeds 4
    Your own logs:  guider train --data logs.npz --goal-indices 0 1 --radius 0.5 --out runs/robot
    After a crash:  guider train --resume runs/robot

    Args:
        task: A benchmark from `guider tasks`; leave it out for your own data.
        data: HDF5 (D4RL), npz (OGBench or your own), a Minari directory or minari:ID. See `guider data inspect`.
        method: What to train: guider (if nothing is said); guider-gcsl, guider-wgcsl or guider-cql (with another low
            level); hiql, opal; or, without subgoals, bc, gcsl, wgcsl, cql-her, iql.
        preset: `fast` (if nothing is said) fits two cores; `paper` is the paper's equations and the authors' settings.
        seeds: How many agents to train at once, in one compiled program; by default 1.
        first_seed: Their seeds count up from here, by default 0, so that several machines can share a set of seeds.
        out: New directory for the run; by default runs/TASK-METHOD-PRESET.
        resume: Continue this interrupted run; the result is the same to the bit. Other settings are the run's own.
        goal_indices: Own data: the state entries that are the goal, e.g. 0 1 for x and y. Minari's goal observations
            name them themselves.
        radius: Own data: a goal counts as met within this distance, in the units of those entries.
        reach_radius: A subgoal counts as reached within this distance; by default twice the radius.
        period_steps: Steps between subgoals (c); by default the task's, or a twentieth of the median episode.
        held_out: Fraction of episodes kept aside for `guider evaluate`; by default 0.1 for own data, else 0.
        format: How to read the data, if its content does not tell: arrays, d4rl-kitchen, minari, wgcsl.
        episode_ends: Which signs of where episodes end to take, of those that `guider data inspect` lists.
        set: Further settings by dotted name, e.g. --set high.samples=2 low.updates=50000.
        evaluate_every: Evaluate on the task after every so many updates of the last stage (0: never).
        stage_cache: Directory where runs share their stages: equal ones trained before are taken over, new ones kept.
        log_to: Also send metrics to TensorBoard (into the run) or Weights & Biases; extras of the package.
        as_json: Print one JSON document instead of text.
    """
    from guider import api, sinks

    if resume is not None:
        said = (task, method, preset, seeds, first_seed, out, radius, reach_radius, period_steps, held_out, format)
        if any(value is not None for value in said) or goal_indices or episode_ends or set:
            raise GuiderError("--resume takes all settings from the run; give only --data if the data has moved")
        directory = user_path(resume)
    else:
        method, preset, seeds = method or "guider", preset or "fast", 1 if seeds is None else seeds
        if seeds < 1:
            raise GuiderError(f"--seeds must be 1 or more, got {seeds}")
        directory = user_path(out) if out is not None else api.default_directory(task, method, preset)
    sink = sinks.sink(log_to, directory)
    with _stage_bars() as (say, show):
        if resume is not None:
            run = api.resume(
                directory, data, evaluate_every=evaluate_every, on_chunk=_both(show, sink), stage_cache=stage_cache
            )
        else:
            first_seed = first_seed or 0
            run = api.train(
                task,
                data,
                goal_indices=goal_indices or None,
                radius=radius,
                reach_radius=reach_radius,
                period_steps=period_steps,
                format=format,
                episode_ends=episode_ends,
                method=method or "guider",
                preset=preset or "fast",
                settings=_assignments(set),
                seeds=range(first_seed, first_seed + (seeds or 1)),
                out=directory,
                held_out=held_out,
                evaluate_every=evaluate_every,
                on_chunk=_both(show, sink),
                say=say,
                stage_cache=stage_cache,
            )
    text = f"trained {run.directory}; next: `guider evaluate {run.directory}` and `guider plot {run.directory}`"
    _answer({"run": str(run.directory), "seeds": list(run.spec.seeds)}, text, as_json)


def evaluate(
    run: RunDirectory,
    episodes: int | None = None,
    first_seed: int | None = None,
    data: str | None = None,
    as_json: Json = False,
) -> None:
    """Score a finished run: success in the environment, or, for your own data, scores on held-out episodes.

    The result, with its whole protocol, is also written to RUN/evaluation.json.

    Args:
        run: Directory of the run.
        episodes: Task only: episodes per trained seed, by default 100.
        first_seed: Task only: environment seeds count up from here, by default 0.
        data: Own data and mazes: where the run's data is now, if it has moved.
        as_json: Print one JSON document instead of text.
    """
    from guider import api

    with _bar("evaluating", "steps") as show:
        result = api.score(run, episodes=episodes, first_seed=first_seed, data=data, on_steps=show)
    _answer(result, _evaluation_table(result), as_json)
    api.keep_score(run, result)  # after it was shown: the place may be read-only


def plot(run: RunDirectory, seed: int | None = None, data: str | None = None, as_json: Json = False) -> None:
    """Draw a finished run into RUN/plots: learning curves, and what its subgoals look like.

    Args:
        run: Directory of the run.
        seed: Which trained seed to draw; by default the first.
        data: Where the run's data is now, if it has moved.
        as_json: Print one JSON document instead of text.
    """
    from guider import api

    paths = [str(path) for path in api.plot(run, seed=seed, data=data)]
    _answer({"plots": paths}, "\n".join(paths), as_json)


def tasks(task: tyro.conf.Positional[str | None] = None, as_json: Json = False) -> None:
    """List the benchmark tasks, or say all about one: environment, goal, protocol, data.

    Three more forms make tasks of your own: gym:ENV_ID of any Gymnasium goal environment, pointmaze:FILE and
    antmaze:FILE in a maze drawn in a text file (# wall, . free, S start, G goal).

    Args:
        task: The task to say all about.
        as_json: Print one JSON document instead of text.
    """
    from guider.tasks import TASKS, find_task

    if task is not None:
        facts = _task_facts(find_task(task))
        _answer(facts, "\n".join(f"{name.replace('_', ' '):>14}  {value}" for name, value in facts.items()), as_json)
        return
    rows = [_task_facts(found) for found in TASKS.values()]
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for title in ("task", "score", "steps", "c", "radius", "paper", "collect"):
        table.add_column(title, no_wrap=True)
    for row, found in zip(rows, TASKS.values(), strict=True):
        columns = (row[name] for name in ("horizon_steps", "period_steps", "radius", "paper_score"))
        made = "yes" if found.collector else "-"
        table.add_row(row["task"], found.score, *("-" if value is None else str(value) for value in columns), made)
    _answer(rows, table, as_json)


def _task_facts(task: Any) -> dict[str, Any]:
    from guider.tasks.types import SCORE_UNITS

    return {
        "task": task.name,
        "summary": task.summary,
        "environment": task.environment,
        "source": task.source,
        "goal_indices": list(task.goal_indices),
        "goal_parts": [list(part) for part in task.goal_parts],
        "radius": task.radius,
        "reach_radius": task.reach_radius,
        "horizon_steps": task.horizon_steps,
        "period_steps": task.period_steps,
        "score": SCORE_UNITS[task.score],
        "data": task.collector.recipe if task.collector else None,
        "paper_score": task.paper_score,
    }


def data(
    action: tyro.conf.Positional[Literal["inspect", "fetch"]],
    source: tyro.conf.Positional[str | None] = None,
    task: str | None = None,
    goal_indices: tuple[int, ...] = (),
    radius: float | None = None,
    reach_radius: float | None = None,
    period_steps: int | None = None,
    format: str | None = None,
    episode_ends: tuple[str, ...] = (),
    out: Path | None = None,
    mirror: str | None = None,
    as_json: Json = False,
) -> None:
    """Look at logged data, or fetch what others published.

    `guider data inspect SOURCE` reads it as training would and says what it holds; with --task or --radius also what
    share of it training would learn from. `guider data fetch` lists what can be fetched; `guider data fetch NAME`
    fetches and checks it, going on where an earlier download broke off.

    Args:
        action: inspect or fetch.
        source: What to inspect: HDF5, npz, a pickle of WGCSL's, a Minari directory or minari:ID. Or a name to fetch.
        task: inspect: the benchmark that it is for.
        goal_indices: inspect: the state entries that are the goal; by default the source's own, or else 0 1.
        radius: inspect: a goal counts as met within this distance, as for `guider train`.
        reach_radius: inspect: as for `guider train`.
        period_steps: inspect: as for `guider train`.
        format: inspect: how to read it, if its content does not tell: arrays, d4rl-kitchen, minari, wgcsl.
        episode_ends: inspect: which signs of where episodes end to take, of those listed.
        out: fetch: directory for the files; by default GUIDER_DATA, or else ~/.cache/guider.
        mirror: fetch: URL of a folder that holds the files under their own names, tried first.
        as_json: Print one JSON document instead of text.
    """
    from guider import api
    from guider.data.catalogue import CATALOGUE, find_dataset
    from guider.data.download import fetch

    reading = (task, radius, reach_radius, period_steps, format)
    if action == "fetch" and (any(value is not None for value in reading) or goal_indices or episode_ends):
        raise GuiderError("guider data fetch takes --out and --mirror only; the other options are for inspect")
    if action == "inspect" and (out is not None or mirror is not None):
        raise GuiderError("guider data inspect takes no --out and no --mirror; they are for fetch")
    if action == "inspect":
        if source is None:
            raise GuiderError("say what to inspect: guider data inspect SOURCE")
        description = api.inspect(
            source,
            task=task,
            goal_indices=goal_indices or None,
            radius=radius,
            reach_radius=reach_radius,
            period_steps=period_steps,
            format=format,
            episode_ends=episode_ends,
        )
        shown = description | {"episode_ends": _end_signs(description["episode_ends"])}
        lines = [f"{name.replace('_', ' '):>20}  {_short(value)}" for name, value in shown.items()]
        _answer(description, "\n".join(lines), as_json)
    elif source is None and (out is not None or mirror is not None):
        raise GuiderError("say what to fetch: guider data fetch NAME; without a name it lists what there is")
    elif source is None:
        rows = [{"name": found.name, "source": found.source} for found in CATALOGUE.values()]
        _answer(rows, "\n".join(f"{row['name']:32}  {row['source']}" for row in rows), as_json)
    else:
        dataset = find_dataset(source)
        with _bar("fetching", "MB") as show:
            paths = fetch(
                dataset, out, mirror, report=lambda done, total: show(done // 10**6, total and total // 10**6)
            )
        files = [str(path) for path in paths]
        _answer({"name": source, "files": files}, "\n".join(f"{file} is complete" for file in files), as_json)


def collect(task: TaskName, out: Path, steps: int | None = None, seed: int = 0, as_json: Json = False) -> None:
    """Record data for a task on this machine, reproducibly from a seed.

    Args:
        task: A task whose data `guider tasks` says can be collected.
        out: New file laid out as D4RL's (.hdf5 or .h5), or, with no ending, new directory of a Minari dataset.
        steps: Rows to record; by default as many as the task's data has in the literature.
        seed: Equal seeds give equal files.
        as_json: Print one JSON document instead of text.
    """
    from guider.data.write import check_destination, write_d4rl, write_minari
    from guider.tasks import find_task

    out = user_path(out)
    found = find_task(task)
    if found.collector is None:
        raise GuiderError(f"{task} cannot be collected here; its data comes from files ({found.source}): --data FILE")
    steps = found.collector.steps if steps is None else steps
    if steps < 2 or seed < 0:
        raise GuiderError(f"--steps must be at least 2 and --seed at least 0, got {steps} and {seed}")
    layout = check_destination(out, 4 * steps * (found.state_dim + found.action_dim))
    with _bar("recording", "steps") as show:
        recording = found.collector.record(steps, seed, show)
    if layout == "d4rl":
        write_d4rl(out, recording, found.goal_indices, found.radius, found.goal_parts)
    else:
        with _bar("writing", "episodes") as show:
            write_minari(
                out,
                recording,
                found.goal_indices,
                found.radius,
                found.goal_parts,
                dataset_id=f"guider/{task}-v0",
                recipe=found.collector.recipe,
                description=f"{found.environment}; made by: guider collect {task} --steps {steps} --seed {seed}",
                seed=seed,
                report=show,
            )
    _answer({"data": str(out), "steps": steps, "seed": seed}, f"recorded {out}", as_json)


def reproduce(
    target: tyro.conf.Positional[TargetName],
    tasks: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    preset: Preset = "fast",
    seeds: int = 4,
    first_seed: int = 0,
    episodes: int = 100,
    data: Path = Path("datasets"),
    out: Path = Path("runs/reproduce"),
    jobs: int = 1,
    set: tuple[str, ...] = (),
    dry_run: bool = False,
    report_only: bool = False,
    as_json: Json = False,
) -> None:
    """Make a table or figure of the paper: record missing data, train, evaluate, report.

    Runs live in OUT/runs/TASK/VARIANT-PRESET and are shared between tables and figures. What is done is skipped and
    what was interrupted goes on, so the same command continues where the last one ended.

    Args:
        target: The table or figure.
        tasks: These tasks in place of the paper's.
        methods: table1, figure4 and figure6: these methods in place of the paper's.
        preset: `fast` fits two cores; `paper` is the paper's equations and the authors' settings.
        seeds: How many agents to train per run.
        first_seed: Their seeds count up from here.
        episodes: Evaluation episodes per trained seed.
        data: Directory that holds TASK.hdf5, or a Minari dataset TASK; missing data is recorded into it.
        out: Directory for plan, runs, logs and results.
        jobs: Runs at a time, each on its own share of the cores.
        set: Settings of every run by dotted name, or of one method's, e.g. --set batch_size=256 guider:high.samples=2.
        dry_run: Show the plan; write and run nothing.
        report_only: Run nothing; write the table or figure of the runs there are.
        as_json: Print one JSON document instead of text.
    """
    from guider.reproduce import report, runner
    from guider.reproduce.plans import Protocol, make_plan

    if dry_run and report_only:
        raise GuiderError("--dry-run shows what would be run, --report-only runs nothing; give one of them")
    protocol = Protocol(preset, seeds, first_seed, episodes, _assignments(set), user_path(data), user_path(out))
    plan = make_plan(target, protocol, tasks, methods)
    if dry_run:
        described = runner.describe(plan)
        lines = [f"{run['state']:>11}  {run['directory']}" for run in described["runs"]]
        _answer(described, "\n".join([plan.title, *described["data_to_record"], *lines]), as_json)
        return
    failures = []
    if not report_only:
        with _plan_bar() as watch:
            failures = runner.execute(plan, jobs, watch)
    document, files = report.write(plan)
    failed = [{"run": f.run.name, "reason": f.reason, "log": str(f.log)} for f in failures]
    shown = [escape(report.table(document)), ""] if "rows" in document else []
    _answer(document | {"failed": failed}, "\n".join([*shown, *map(str, files)]), as_json)
    if failures:
        what = "; ".join(f"{failure['run']}: {failure['reason']}" for failure in failed)
        raise GuiderError(f"{len(failures)} of {len(plan.runs)} runs failed, the same command tries them again: {what}")


COMMANDS: dict[str, Callable[..., None]] = {
    "train": train,
    "evaluate": evaluate,
    "plot": plot,
    "tasks": tasks,
    "data": data,
    "collect": collect,
    "reproduce": reproduce,
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command and say in a line what was wrong, if anything. Returns the exit status, see this file's top."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that lacks a letter shows its number
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore[reportAttributeAccessIssue]
    try:
        with _stopping_on_sigterm(), _showing_warnings():
            tyro.extras.subcommand_cli_from_dict(
                COMMANDS,
                prog="guider",
                description="Learn long, sparse-reward tasks from logged data: get data, train, evaluate, plot.",
                args=_gathered(sys.argv[1:] if arguments is None else arguments),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at its end
        return 141
    except (Exception, KeyboardInterrupt, Stopped) as error:
        if os.environ.get("GUIDER_DEBUG"):
            raise
        status, line = _told(error)
        print(f"guider: {line}", file=sys.stderr)
        return status
    return 0


def _told(error: BaseException) -> tuple[int, str]:
    """(exit status, what to say) of what ended a command."""
    match error:
        case Stopped():
            return 128 + error.signal_number, str(error)
        case KeyboardInterrupt():
            return 128 + signal.SIGINT, "interrupted"
        case GuiderError():
            return 1, str(error)
        case OSError():
            where = f"{error.filename}: " if error.filename else ""
            return 1, f"{where}{error.strerror or error}"
        case MemoryError():
            return 1, f"there is not enough memory ({' '.join(str(error).split()) or 'none is left'})"
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return 3, f"a fault of guider's own, please report it: {what[:300]} (GUIDER_DEBUG=1 shows the trace)"


@contextmanager
def _stopping_on_sigterm() -> Iterator[None]:
    """SIGTERM ends a command as Ctrl-C does: what is open is put in order, children end too."""

    def stop(number: int, frame: Any) -> None:
        raise Stopped("ended by SIGTERM", number)

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread, where signals are for someone else
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _showing_warnings() -> Iterator[None]:
    """Guider's warnings as lines, once each; others as Python shows them."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", GuiderWarning)
        shown, others = [], warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
            if not issubclass(category, GuiderWarning):
                others(message, category, *rest, **more)
            elif str(message) not in shown:
                shown.append(str(message))
                print(f"guider: warning: {message}", file=sys.stderr)

        warnings.showwarning = show
        yield


_OPTION = re.compile(r"--[a-z]")


def _gathered(arguments: list[str]) -> list[str]:
    """The arguments with options that take several values and were given several times put together: all that was said
    counts. Raises GuiderError for any other option given twice."""
    command = COMMANDS.get(arguments[0]) if arguments else None
    if command is None:
        return arguments
    parameters = python_inspect.signature(command).parameters.values()
    several = {f"--{p.name.replace('_', '-')}" for p in parameters if str(p.annotation).startswith("tuple[")}
    gathered: list[list[str]] = [[]]  # positional arguments, then each option with its values
    for argument in arguments:
        if not _OPTION.match(argument):
            gathered[-1].append(argument)
            continue
        name, *value = argument.split("=", 1)
        name = name.replace("_", "-")
        earlier = next((option for option in gathered if option[:1] == [name]), None)
        if earlier is not None and name not in several:
            raise GuiderError(f"{name} is given twice; say it once")
        if earlier is not None:
            gathered.remove(earlier)
        gathered.append([*(earlier or [name]), *value])
    return [argument for option in gathered for argument in option]


def _answer(document: Any, text: Any, as_json: bool) -> None:
    if as_json:
        print(json.dumps(document))
    else:
        Console(highlight=False, soft_wrap=isinstance(text, str)).print(text)


def _assignments(texts: tuple[str, ...]) -> dict[str, str]:
    for text in texts:
        if "=" not in text:
            raise GuiderError(f"--set takes NAME=VALUE pairs, got {text!r}")
    pairs = [text.split("=", 1) for text in texts]
    names = [name for name, _ in pairs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise GuiderError(f"--set gives {twice[0]} twice; say it once")
    return {name: value for name, value in pairs}


def _both(first: Callable[..., None], second: Callable[..., None]) -> Callable[..., None]:
    def call(*arguments: Any) -> None:
        first(*arguments)
        second(*arguments)

    return call


def _progress(*columns: Any) -> Progress:
    return Progress(
        TextColumn("{task.description:>16}"),
        BarColumn(),
        MofNCompleteColumn(),
        *columns,
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


@contextmanager
def _bar(description: str, unit: str):
    with _progress(TextColumn(unit)) as progress:
        bar = progress.add_task(description, total=None)
        yield lambda done, total: progress.update(bar, completed=done, total=total)


@contextmanager
def _plan_bar():
    """A bar over all runs of a plan, and a line for each that ends."""
    from guider.reproduce.runner import Watch

    with _progress() as progress:
        bar = progress.add_task("", total=None)

        def show(done: float, total: int, doing: str) -> None:
            progress.update(bar, completed=done, total=total, description=doing)

        yield Watch(lambda line: progress.console.print(line, highlight=False, markup=False, soft_wrap=True), show)


@contextmanager
def _stage_bars():
    """(a way to say a line, a bar per stage, fed by the engine's chunks: updates done, rate, time left)."""
    with _progress(TextColumn("{task.fields[rate]:.0f}/s")) as progress:
        bars: dict[int, Any] = {}

        def show(chunk: Any, state: Any) -> None:
            index = chunk.position.stage
            if index not in bars:
                bars[index] = progress.add_task(chunk.stage.name, total=chunk.stage.updates, rate=0.0)
            progress.update(bars[index], completed=chunk.position.update, rate=chunk.updates / chunk.seconds)

        yield lambda line: progress.console.print(line, highlight=False, markup=False, soft_wrap=True), show


def _evaluation_table(result: dict[str, Any]) -> Table:
    title = f"{result['task'] or result['data']}, {result['method']}, preset {result['preset']}"
    table = Table(box=None, title=title, caption=f"acts by the {result['acts_by']}")
    table.add_column("seed")
    if result["task"] is None:
        names = list(result["per_seed"][0])
        for name in names:
            table.add_column(name.replace("_", " "))
        for seed, scores in zip(result["training_seeds"], result["per_seed"], strict=True):
            table.add_row(str(seed), *("-" if scores[name] is None else f"{scores[name]:.3f}" for name in names))
        return table
    in_maze = ("fell / stuck / time",) if "ending" in result["per_seed"][0]["episodes"] else ()
    guided = ("subgoals off data", "in walls") if "subgoals_in_walls" in result["per_seed"][0] else ()
    for name in (result["unit"], "95 % interval", "median steps when met", *in_maze, *guided):
        table.add_column(name)
    for seed, scores in zip(result["training_seeds"], result["per_seed"], strict=True):
        low, high = scores["interval_95"]
        cells = [f"{scores['score']:.1f}", f"{low} to {high}", str(scores["median_steps_when_met"])]
        if in_maze:
            endings = scores["episodes"]["ending"]
            cells.append(" / ".join(str(endings.count(cause)) for cause in ("fell", "stuck", "time")))
        if guided:
            shares = (scores["subgoals_off_data"], scores["subgoals_in_walls"])
            cells += ["?" if share is None else f"{100 * share:.1f} %" for share in shares]
        table.add_row(str(seed), *cells)
    low, high = result["interval_95"]
    table.add_row("all", f"{result['score']:.1f}", f"{low} to {high}", "")
    return table


def _end_signs(signs: list[dict[str, Any]]) -> str:
    """How many ends each sign gave, those taken first."""
    taken, others = (
        ", ".join(f"{sign['name']} {sign['ends']:,}" for sign in signs if sign["used"] == used)
        for used in (True, False)
    )
    return taken + (f" (not taken: {others})" if others else "")


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_short(item)}" for name, item in value.items())
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "; ".join(map(_short, value))
    return str(value)
