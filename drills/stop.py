"""SIGTERM and Ctrl-C at random moments of the same work: one line, status 143 or 130, no children left, and it goes on.

A signal that comes while Python still starts may end the program by itself; a shell shows that as the same status.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

from drills.common import Drill, Ended, Outcome, end, start
from drills.works import KINDS, Scene, begin, command, go_on, prepare, verdict

PATIENCE_S = 20.0
STARTING_S = 1.5
"""Of the processor's time, which Python takes to import what a command needs."""


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    kind = KINDS[number % len(KINDS)]
    sent = rng.choice((signal.SIGTERM, signal.SIGINT))
    delay = rng.uniform(0.2, 1.1) * scene.seconds[kind]
    with begin(scene, kind, folder) as site:
        arguments, often = command(scene, kind, folder, site)
        process, starting = start(arguments, folder, often), False
        try:
            ended = end(process, delay)
        except subprocess.TimeoutExpired:
            starting = _worked(process.pid) < STARTING_S
            # A terminal sends Ctrl-C to all that run in it, `kill` only to the one that is named.
            os.killpg(process.pid, sent) if sent == signal.SIGINT else process.send_signal(sent)
            try:
                ended = end(process, PATIENCE_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return Outcome(f"{kind}: goes on after {sent.name}", "hangs")
        if fault := _manners(ended, sent, starting) or _left(process.pid):
            return Outcome(f"{kind}: {fault.what} at {sent.name}", fault.fault, f"{fault.detail}, after {delay:.1f} s")
        return verdict(scene, kind, folder, go_on(scene, kind, folder, site))


def _manners(ended: Ended, sent: signal.Signals, starting: bool) -> Outcome | None:
    if ended.status == 0 or (starting and ended.status == -sent and "Traceback" not in ended.err):
        return None
    if ended.status == -sent and "Traceback" not in ended.err:
        return Outcome("ended without a word", "silent")
    if fault := ended.fault():
        return fault
    return None if ended.status == 128 + sent else Outcome(f"status {ended.status}", "traces", ended.lines()[0])


def _worked(process: int) -> float:
    """Seconds that a process has kept processors busy."""
    ticks = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def _left(group: int) -> Outcome | None:
    """Whether processes of the group are still there a moment after its head has ended."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return None
        time.sleep(0.1)
    os.killpg(group, signal.SIGKILL)
    return Outcome("children left", "hangs")


DRILL = Drill(trials=40, prepare=prepare, trial=trial, limit_s=240)
