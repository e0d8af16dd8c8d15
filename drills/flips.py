"""One bit flipped, a cut, a zeroed block, an emptied or removed file, in everything a run stores.

Most trials damage the newest checkpoint; others run.json, metrics.jsonl and an entry of a stage cache. What is read
must be what was stored, or the older checkpoint with a line, or a refusal; in the cache, damage must train anew. A line
of metrics carries no checksum: that another number is read there is said in the table and counted as no fault.
"""

from __future__ import annotations

import random
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drills.common import (
    SETTINGS,
    TASK,
    Answer,
    Drill,
    Outcome,
    ask,
    collect,
    guider,
    metrics,
    restored,
    same,
    succeed,
    training,
)
from drills.common import steps as checkpoints

KINDS = (*["checkpoint"] * 16, "run.json", "run.json", "metrics.jsonl", "cache")


@dataclass(frozen=True)
class Scene:
    """newest, older: what the run's two checkpoints hold; cached: an equal run, through whose cache its stages went."""

    data: Path
    run: Path
    cached: Path
    cache: Path
    spec: Any
    newest: Any
    older: Any


def prepare(folder: Path) -> Scene:
    from guider import runs

    data, run, cached, cache = collect(folder / "data.hdf5"), folder / "run", folder / "cached", folder / "cache"
    succeed(guider(training(data, run), folder, often=True))
    succeed(guider([*training(data, cached), "--stage-cache", str(cache)], folder))
    shutil.copytree(run, folder / "before")
    newest = checkpoints(folder / "before")[-1]
    shutil.rmtree(newest) if newest.is_dir() else newest.unlink()
    older = restored(folder / "before")
    if older is None or same(restored(run), older):
        raise RuntimeError("the run does not have two checkpoints")
    return Scene(data, run, cached, cache, runs.open_run(run).spec, restored(run), older)


def damage(path: Path, rng: random.Random) -> str:
    """Do one thing to a file and say what."""
    content = bytearray(path.read_bytes())
    place = rng.randrange(len(content)) if content else 0
    what = rng.choice(("flip", "flip", "flip", "cut", "zeros", "emptied", "removed")) if content else "removed"
    if what == "flip":
        content[place] ^= 1 << rng.randrange(8)
    elif what == "cut":
        del content[place:]
    elif what == "zeros":
        content[place : place + 64] = bytes(len(content[place : place + 64]))
    elif what == "emptied":
        content.clear()
    path.unlink() if what == "removed" else path.write_bytes(content)
    return f"{path.name} {what} at {place}"


def choose(folder: Path, rng: random.Random) -> Path:
    """A file below `folder`: every other time any, else large ones as often as they have bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else [folder]
    by_size = rng.random() < 0.5
    return rng.choices(files, [1 + path.stat().st_size if by_size else 1 for path in files])[0]


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    kind = KINDS[number % len(KINDS)]
    if kind == "cache":
        return _cache(scene, rng, folder)
    run = folder / "run"
    shutil.copytree(scene.run, run)
    what = damage(choose(checkpoints(run)[-1] if kind == "checkpoint" else run / kind, rng), rng)
    if kind == "checkpoint":
        return _judge(kind, what, ask(lambda: restored(run)), scene)
    return (_run_json if kind == "run.json" else _metrics)(scene, run, what)


def _judge(kind: str, what: str, answer: Answer, scene: Scene) -> Outcome:
    if fault := answer.fault():
        return Outcome(f"{kind}: trace", fault.fault, f"{what}: {fault.detail}")
    if answer.kind == "refused":
        return Outcome(f"{kind}: refused in a line")
    if same(answer.value, scene.newest):
        return Outcome(f"{kind}: equal to the newest")
    if same(answer.value, scene.older):
        warned = answer.warned
        return Outcome(
            f"{kind}: the older one, {'with' if warned else 'without'} a line", None if warned else "silent", what
        )
    return Outcome(f"{kind}: other parameters or position", "silent", what)


def _run_json(scene: Scene, run: Path, what: str) -> Outcome:
    from guider import runs

    answer = ask(lambda: runs.open_run(run).spec)
    if answer.kind == "value":
        equal = answer.value == scene.spec
        return Outcome("run.json: equal") if equal else Outcome("run.json: another run", "silent", what)
    return _judge("run.json", what, answer, scene)


def _metrics(scene: Scene, run: Path, what: str) -> Outcome:
    import guider

    answer = ask(lambda: restored(guider.resume(run, scene.data).directory))
    outcome = _judge("metrics.jsonl", what, answer, scene)
    if answer.kind != "value" or outcome.fault:
        return outcome
    read = ask(lambda: metrics(run))
    equal = read.kind == "value" and read.value == metrics(scene.run)
    return Outcome(f"metrics.jsonl: parameters equal, lines {'equal' if equal else 'other or fewer'}")


def _cache(scene: Scene, rng: random.Random, folder: Path) -> Outcome:
    import guider

    cache, run = folder / "cache", folder / "run"
    shutil.copytree(scene.cache, cache)
    what = damage(choose(cache, rng), rng)
    settings = {name: str(value) for name, value in SETTINGS.items()}
    answer = ask(lambda: guider.train(TASK, scene.data, settings=settings, out=run, stage_cache=cache))
    if answer.kind == "refused":
        return Outcome("cache: the run fails for it", "lost", f"{what}: {answer.text}")
    if answer.kind == "value":
        equal = same(restored(run), scene.newest) and metrics(run) == metrics(scene.cached)
        return Outcome("cache: equal to the bit") if equal else Outcome("cache: other parameters", "silent", what)
    return _judge("cache", what, answer, scene)


DRILL = Drill(trials=500, prepare=prepare, trial=trial)
