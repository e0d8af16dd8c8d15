"""Trials in worker processes with limits: a worker that hangs or dies is a finding, and another takes its place."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue
from typing import Any

from drills.common import ROOT, Drill, Outcome


@dataclass(frozen=True)
class Job:
    """Which drill, with what seed, where, and what its trials share."""

    name: str
    seed: int
    folder: Path
    scene: Any


def load(name: str) -> Drill:
    return importlib.import_module(f"drills.{name}").DRILL


def prepare(name: str, folder: Path) -> Any:
    """What the drill's trials share, made in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_prepare, (name, folder))


def trials(job: Job, numbers: Iterable[int], workers: int) -> Iterator[tuple[int, Outcome]]:
    """(number, outcome) of every trial, as they come."""
    waiting, done = iter(numbers), Queue[tuple[int, Outcome] | None]()
    lock = threading.Lock()

    def take() -> int | None:
        with lock:
            return next(waiting, None)

    def work() -> None:
        worker = _Worker(job)
        try:
            while (number := take()) is not None:
                done.put((number, worker.ask(number)))
        finally:
            worker.stop()
            done.put(None)

    for _ in range(workers):
        threading.Thread(target=work, daemon=True).start()
    for _ in range(workers):
        while (result := done.get()) is not None:
            yield result


class _Worker:
    """A process that does one trial after the other, and is replaced when it does not answer."""

    def __init__(self, job: Job):
        self.job, self.limit_s = job, load(job.name).limit_s
        self.begin()

    def begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.job))
        self.process.start()
        theirs.close()
        self.pipe.recv()  # ready

    def ask(self, number: int) -> Outcome:
        self.pipe.send(number)
        try:
            if self.pipe.poll(self.limit_s):
                return self.pipe.recv()
            outcome = Outcome("hang", "hangs", f"no answer within {self.limit_s:.0f} s")
        except EOFError:
            self.process.join()
            outcome = Outcome("the process died", "traces", f"exit code {self.process.exitcode}")
        self.stop()
        self.begin()
        return outcome

    def stop(self) -> None:
        self.pipe.close()
        for stat in Path("/proc").glob("[0-9]*/stat"):  # all that the worker has started is of its session
            with contextlib.suppress(OSError):
                if int(stat.read_text().rpartition(")")[2].split()[3]) == self.process.pid:
                    os.kill(int(stat.parent.name), signal.SIGKILL)
        self.process.join()


def _prepare(name: str, folder: Path) -> Any:
    return load(name).prepare(folder)


def _serve(pipe: Any, job: Job) -> None:
    os.setsid()
    with (job.folder / "workers.log").open("ab") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    drill = load(job.name)
    if drill.memory is not None:
        most = _memory("VmSize") + drill.memory + drill.memory // 2
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    pipe.send("ready")
    with contextlib.suppress(EOFError):
        while True:
            pipe.send(_trial(drill, job, pipe.recv()))


def _trial(drill: Drill, job: Job, number: int) -> Outcome:
    folder = job.folder / f"trial{number}"
    folder.mkdir()
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted anew
    before = _memory("VmRSS")
    try:
        outcome = drill.trial(job.scene, number, random.Random(f"{job.name}/{job.seed}/{number}"), folder)
    except Exception as error:
        outcome = Outcome("the drill itself broke", "traces", f"{type(error).__name__}: {error}")
    took = _memory("VmHWM") - before
    if drill.memory is not None and took > drill.memory and outcome.fault is None:
        outcome = Outcome("memory", "hangs", f"{took / 2**30:.1f} GiB, then {outcome.what}: {outcome.detail}")
    shutil.rmtree(folder, ignore_errors=True)
    detail = outcome.detail.replace(str(folder), "FOLDER").replace(str(job.folder), "SHARED").replace(str(ROOT), "ROOT")
    return replace(outcome, detail=detail)


def _memory(name: str) -> int:
    """VmSize, VmRSS or VmHWM (peak of VmRSS) of this process, bytes."""
    found = re.search(rf"{name}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(found[1]) if found else 0
