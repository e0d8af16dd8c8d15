"""SIGKILL at random moments of training, evaluating, recording, fetching and reproducing; the same command goes on.

In the end everything must be as if nothing had happened: parameters to the bit, each line of metrics once, files whole,
nothing left over. One trial in three is killed twice.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
from pathlib import Path

from drills.common import Drill, Outcome, end, start
from drills.works import KINDS, Scene, begin, command, finished, go_on, prepare, verdict


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    kind = KINDS[number % len(KINDS)]
    with begin(scene, kind, folder) as site:
        for _ in range(rng.choice((1, 1, 2))):
            if not finished(kind, folder):
                arguments, often = command(scene, kind, folder, site)
                process = start(arguments, folder, often)
                try:
                    end(process, rng.uniform(0.1, 1.2) * scene.seconds[kind])
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.communicate()
        return verdict(scene, kind, folder, go_on(scene, kind, folder, site))


DRILL = Drill(trials=50, prepare=prepare, trial=trial, limit_s=240)
