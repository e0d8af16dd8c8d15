"""Running a plan: whatever its runs still lack, each in processes of its own, so that none takes the others along.

Below OUT:
    plan.json                    the plans made last, one per table or figure
    runs/TASK/VARIANT-PRESET     a run (see guider.runs; -curve: with a learning curve), and beside it, as .json, what
                                 was asked of it
    stages/                      stages that runs have in common (see guider.runs.stage_cache)
    logs/                        what each run's commands printed
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from guider import data as data_sources
from guider import runs
from guider.errors import GuiderError, Stopped
from guider.reproduce.plans import Plan, PlannedRun, file_name
from guider.support import files
from guider.support.files import parse_line, read_json
from guider.support.locks import hold
from guider.support.stopping import on_signals
from guider.tasks import find_task
from guider.tasks.simulation import available_cores

State = Literal["done", "interrupted", "new"]
EVALUATE_EVERY_UPDATES = {"fast": 2_000, "paper": 25_000}
"""For learning curves."""
POLL_SECONDS = 0.5


@dataclass(frozen=True)
class Failure:
    """A run that failed, why in a few words, and where its output is."""

    run: PlannedRun
    reason: str
    log: Path


@dataclass(frozen=True)
class Watch:
    """How the work shows itself. said: a line per event; progress: (runs done, with fractions, of how many, doing)."""

    said: Callable[[str], None] = lambda line: None
    progress: Callable[[float, int, str], None] = lambda done, total, doing: None


SILENT = Watch()


def state(plan: Plan, run: PlannedRun) -> State:
    """How far a run is: evaluated (done), begun (interrupted), or not there (new).

    Raises GuiderError where its directory holds something else: that is never overwritten.
    """
    directory = plan.directory(run)
    if not directory.exists():
        return "new"
    asked = _request_path(plan, run)
    if not asked.exists():
        raise GuiderError(f"{directory} was not made by `guider reproduce` (no {asked.name}); choose another --out")
    _check_same(directory, read_json(asked, f"remove it and {directory}"), run.request(), "choose another --out")
    path = directory / "evaluation.json"
    if not path.exists():
        return "interrupted"
    result = evaluation(plan, run)
    first = _first_episode_seed(plan, run)
    wanted = {
        "task": run.task,
        "method": run.method,
        "preset": run.preset,
        "training_seeds": list(run.seeds),
        "episodes_per_seed": plan.protocol.episodes,
        "episode_seeds": [first, first + len(run.seeds) * plan.protocol.episodes - 1],
    }
    _check_same(path, result, wanted, "ask for the same, or remove the file to have the run evaluated again")
    return "done"


def _states(plan: Plan) -> dict[str, State]:
    """How far each run is, by name."""
    return {run.name: state(plan, run) for run in plan.runs}


def evaluation(plan: Plan, run: PlannedRun) -> dict[str, Any]:
    """What `guider evaluate` wrote for a run that is done."""
    path = plan.directory(run) / "evaluation.json"
    return read_json(path, "remove it to have the run evaluated again")


def write_plan(plan: Plan) -> Path:
    """Put the plan into OUT/plan.json, in place of an earlier one of the same table or figure, and return its path."""
    path = plan.protocol.out / "plan.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    plans = read_json(path, "remove it, and it is made anew") if path.exists() else {}
    files.write_json(path, plans | {plan.name: describe(plan)})
    return path


def describe(plan: Plan) -> dict[str, Any]:
    """The plan for people to read: every run, how far it is, and the commands that it still takes."""
    states = _states(plan)
    return {
        "title": plan.title,
        "command": plan.command(),
        "runs": [
            {
                "directory": str(plan.directory(run)),
                "state": states[run.name],
                **run.request(),
                "episodes": plan.protocol.episodes,
                "data": str(plan.data_path(run.task)),
                "commands": [_text(command) for command in _commands(plan, run, states[run.name])],
            }
            for run in plan.runs
        ],
        "data_to_record": [_text(_collect(plan, task)) for task in _unrecorded(plan, states)],
    }


def execute(plan: Plan, jobs: int = 1, watch: Watch = SILENT) -> list[Failure]:
    """Bring every run of the plan to its end, `jobs` at a time, and return those that failed.

    Nothing starts, and GuiderError is raised, where a run's directory holds another run, where data is missing that
    cannot be recorded here, or while another runner is at work in the same directory. On SIGTERM and Ctrl-C the
    processes that were started are asked to end, and waited for, before Stopped is raised; a second one does not wait.
    """
    cores = available_cores()
    if not 1 <= jobs <= cores:
        raise GuiderError(f"--jobs must lie between 1 and {cores}, the cores there are, got {jobs}")
    out = plan.protocol.out
    out.mkdir(parents=True, exist_ok=True)

    asked: list[int] = []

    def stopped(number: int) -> Stopped:
        return Stopped(f"interrupted; what is done is kept, and `{plan.command()}` goes on", number)

    def ask(number: int) -> None:
        if asked:
            raise stopped(number)
        asked.append(number)

    # The lock goes to every process that is started: one that outlives this one, which was killed, keeps it.
    busy = f"another `guider reproduce`, or a run it started, is still at work in {out}"
    with on_signals(ask, signal.SIGINT, signal.SIGTERM), hold(out / ".lock", busy) as lock:
        states = _states(plan)
        _check_data(plan, states)
        write_plan(plan)
        failures = _Runner(plan, states, jobs, lock, watch, lambda: bool(asked)).work()
    if asked:
        raise stopped(asked[0])
    return failures


@dataclass
class _Job:
    """A run being worked on. commands: those to come; stages: updates of each stage, once training has begun."""

    run: PlannedRun
    cores: set[int]
    commands: list[list[str]]
    process: subprocess.Popen[bytes]
    stages: tuple[int, ...] = ()


@dataclass
class _Runner:
    """The loop of `execute`. lock: file descriptor that every process keeps open; stop: whether to end early."""

    plan: Plan
    states: dict[str, State]
    jobs: int
    lock: int
    watch: Watch
    stop: Callable[[], bool]
    failures: list[Failure] = field(default_factory=list)

    def work(self) -> list[Failure]:
        self._record_data()
        failed = {failure.run.name for failure in self.failures}
        waiting = [run for run in self.plan.runs if self.states[run.name] != "done" and run.name not in failed]
        total = len(self.plan.runs)
        shares = [set(share.tolist()) for share in np.array_split(_own_cores(), self.jobs)]
        active: list[_Job] = []
        try:
            while (waiting or active) and not self.stop():
                while waiting and shares:
                    active.append(self._begin(waiting.pop(0), shares.pop()))
                time.sleep(POLL_SECONDS)
                for job in [job for job in active if job.process.poll() is not None]:
                    if job.process.returncode == 0 and job.commands:
                        job.process = self._start(job.commands.pop(0), self._log(job.run), job.cores)
                        continue
                    active.remove(job)
                    shares.append(job.cores)
                    if job.process.returncode == 0:
                        score = evaluation(self.plan, job.run)
                        self.watch.said(f"{job.run.name}: {score['score']:.1f} {score['unit']}")
                    else:
                        self._fail(job.run, job.process.returncode, self._log(job.run))
                done = total - len(waiting) - len(active)
                under_way = [_progress(self.plan, job) for job in active]
                fraction = sum(share for share, _ in under_way)
                self.watch.progress(done + fraction, total, ", ".join(doing for _, doing in under_way))
        finally:
            for job in active:
                job.process.terminate()
            for job in active:
                job.process.wait()
        return self.failures

    def _record_data(self) -> None:
        """Record what data is missing, on all cores, one task after the other."""
        for task in _unrecorded(self.plan, self.states):
            self.watch.progress(0, len(self.plan.runs), f"recording {task}")
            log = self._log_path(f"data-{file_name(task)}")
            process = self._start(_collect(self.plan, task), log, set(_own_cores()))
            try:
                while process.poll() is None and not self.stop():
                    time.sleep(POLL_SECONDS)
            finally:
                process.terminate()
                code = process.wait()
            if self.stop():
                return
            if code:
                for run in self.plan.runs:
                    if run.task == task and self.states[run.name] != "done":
                        self._fail(run, code, log)

    def _begin(self, run: PlannedRun, cores: set[int]) -> _Job:
        path = _request_path(self.plan, run)
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_json(path, run.request())
        first, *others = _commands(self.plan, run, self.states[run.name])
        return _Job(run, cores, others, self._start(first, self._log(run), cores))

    def _start(self, command: list[str], log: Path, cores: set[int]) -> subprocess.Popen[bytes]:
        """Start a command on its share of the cores, its output appended to `log`."""
        with log.open("ab") as file:
            file.write(f"$ {_text(command)}\n".encode())
            file.flush()
            with _on_cores(cores):
                return subprocess.Popen(
                    [sys.executable, "-m", "guider", *command],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    pass_fds=(self.lock,),
                )

    def _fail(self, run: PlannedRun, code: int, log: Path) -> None:
        reason = f"killed by signal {-code}" if code < 0 else _last_line(log).removeprefix("guider: ")
        self.failures.append(Failure(run, reason, log))
        self.watch.said(f"{run.name}: FAILED, {reason} (see {log})")

    def _log(self, run: PlannedRun) -> Path:
        return self._log_path(run.name.replace("/", "-"))

    def _log_path(self, name: str) -> Path:
        folder = self.plan.protocol.out / "logs"
        folder.mkdir(exist_ok=True)
        return folder / f"{name}.log"


def _commands(plan: Plan, run: PlannedRun, state: State) -> list[list[str]]:
    """The commands, without `guider`, that a run still takes."""
    if state == "done":
        return []
    directory, data = str(plan.directory(run)), str(plan.data_path(run.task))
    if run.curve:
        way = ["--evaluate-every", str(EVALUATE_EVERY_UPDATES[run.preset])]
    else:
        way = ["--stage-cache", str(plan.protocol.out / "stages")]
    if state == "interrupted":
        learn = ["train", "--resume", directory, "--data", data, *way]
    else:
        learn = ["train", run.task, "--data", data, "--method", run.method, "--preset", run.preset]
        learn += ["--seeds", str(len(run.seeds)), "--first-seed", str(run.seeds[0]), "--out", directory, *way]
        if run.period_steps is not None:
            learn += ["--period-steps", str(run.period_steps)]
        if run.settings:
            learn += ["--set", *(f"{name}={value}" for name, value in run.settings.items())]
    episodes = ["--episodes", str(plan.protocol.episodes), "--first-seed", str(_first_episode_seed(plan, run))]
    return [learn, ["evaluate", directory, *episodes]]


def _first_episode_seed(plan: Plan, run: PlannedRun) -> int:
    """Training seed s is evaluated on the same episodes whatever other seeds it was trained with."""
    return run.seeds[0] * plan.protocol.episodes


def _collect(plan: Plan, task: str) -> list[str]:
    return ["collect", task, "--out", str(plan.data_path(task))]


def _unrecorded(plan: Plan, states: dict[str, State]) -> list[str]:
    """Tasks with runs to do and no data yet."""
    tasks = dict.fromkeys(run.task for run in plan.runs if states[run.name] != "done")
    return [task for task in tasks if not plan.data_path(task).exists()]


def _check_data(plan: Plan, states: dict[str, State]) -> None:
    """Raise GuiderError for data that is missing and cannot be recorded, or is not what finished runs learned from."""
    for task in _unrecorded(plan, states):
        if find_task(task).collector is None:
            raise GuiderError(
                f"{plan.data_path(task)} is missing, and data for {task} cannot be recorded here; put it there "
                f"(it comes from {find_task(task).source}), or name its directory with --data"
            )
    for task in plan.tasks:
        done = [run for run in plan.runs if run.task == task and states[run.name] == "done"]
        path = plan.data_path(task)
        if done and path.exists():
            fingerprint = data_sources.load(path, find_task(task).goal_indices).fingerprint()
            for run in done:
                if (learned := evaluation(plan, run)["fingerprint"]) != fingerprint:
                    raise GuiderError(
                        f"{plan.directory(run)} was trained on data of fingerprint {learned}, {path} has "
                        f"{fingerprint}; choose another --out, or name the other data with --data"
                    )


def _check_same(path: Path, found: dict[str, Any], wanted: dict[str, Any], remedy: str) -> None:
    for name, value in wanted.items():
        if found.get(name) != value:
            what = name.replace("_", " ")
            raise GuiderError(f"{path} answers to {what} {found.get(name)}, not to {value} as asked for; {remedy}")


def _progress(plan: Plan, job: _Job) -> tuple[float, str]:
    """(share of the run's updates that is done, the run and its stage)."""
    directory = plan.directory(job.run)
    line = _last_metrics(directory / "metrics.jsonl")
    if line is None:
        return 0.0, job.run.name
    job.stages = job.stages or tuple(stage.updates for stage in runs.open_run(directory).stages)
    share = line["total_updates"] / sum(job.stages)
    return share, f"{job.run.name}: {line['stage'] if job.commands else 'evaluation'}"


def _last_metrics(path: Path) -> dict[str, Any] | None:
    """The last whole line of metrics.jsonl, or None. Only the file's end is read: it is asked for often."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 2**16))
            lines = file.read().split(b"\n")
        return parse_line(path.name, lines[-2])
    except (FileNotFoundError, IndexError):
        return None


def _own_cores() -> list[int]:
    """The cores this process may use, by number."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(available_cores()))


@contextmanager
def _on_cores(cores: set[int]) -> Iterator[None]:
    """Whatever is started within may use these cores alone, where the system can say so."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _request_path(plan: Plan, run: PlannedRun) -> Path:
    directory = plan.directory(run)
    return directory.with_name(f"{directory.name}.json")


def _last_line(log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if any(map(str.isalnum, line))]
    return lines[-1] if lines else "no output"


def _text(command: Sequence[str]) -> str:
    return shlex.join(["guider", *command])
