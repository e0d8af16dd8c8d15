"""The same begun twice at once: two resumes, two trainings, two `reproduce`, two fetches, two runs with one cache.

One may wait or be refused in a line; what comes out is what one alone makes, each line of metrics once.
"""

from __future__ import annotations

import random
import shutil
import time
from pathlib import Path

from drills.common import Drill, Outcome, end, restored, same, start
from drills.common import steps as checkpoints
from drills.works import Scene, begin, command, prepare, verdict

KINDS = ("resume", "train", "train with a cache", "reproduce", "collect", "minari", "fetch", "evaluate")


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    named = KINDS[number % len(KINDS)]
    kind = "train" if named == "resume" else named
    with begin(scene, kind, folder) as site:
        if named == "resume":
            shutil.copytree(scene.whole["train"] / "run", folder / "run")
            newest = checkpoints(folder / "run")[-1]
            shutil.rmtree(newest) if newest.is_dir() else newest.unlink()
        arguments, often = command(scene, kind, folder, site)
        pair = [arguments, arguments]
        if kind == "train with a cache":  # two runs, which train the same stages
            pair = [arguments, [word.replace(str(folder / "run"), str(folder / "second")) for word in arguments]]
        processes = []
        for words in pair:
            processes.append(start(words, folder, often))
            time.sleep(rng.choice((0.0, 0.0, rng.uniform(0, scene.seconds[kind]))))
        ended = [end(process) for process in processes]
        for each in ended:
            if fault := each.fault():
                return Outcome(f"{named}: {fault.what}", fault.fault, fault.detail)
        if all(each.status for each in ended):
            return Outcome(f"{named}: both gave up", "lost", ended[0].lines()[0])
        if kind == "train with a cache":
            if not same(restored(folder / "second"), restored(folder / "run")):
                return Outcome(f"{named}: the two differ", "silent")
            shutil.rmtree(folder / "second")
        outcome = verdict(scene, kind, folder, min(ended, key=lambda each: each.status))
    refused = any(each.status for each in ended)
    if outcome.fault:
        return Outcome(outcome.what.replace(kind, named, 1), outcome.fault, outcome.detail)
    return Outcome("equal, the other refused in a line" if refused else "equal, both done")


DRILL = Drill(trials=16, prepare=prepare, trial=trial, limit_s=240)
