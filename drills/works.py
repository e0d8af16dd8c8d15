"""Work to be interrupted: what is begun, how it is taken up again, and whether it came to what it should have."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import h5py

from drills.common import (
    SETS,
    TASK,
    Ended,
    Outcome,
    collect,
    d4rl,
    digest,
    guider,
    metrics,
    restored,
    same,
    succeed,
    walk,
)
from drills.common import training as train
from tests.loopback import Site, serve

KINDS = (
    "train",
    "train",
    "fetch",
    "train with a cache",
    "evaluate",
    "reproduce",
    "collect",
    "train",
    "minari",
    "fetch",
)
FETCHED = "antmaze-large-diverse"


@dataclass(frozen=True)
class Scene:
    """data, content: what is trained on and fetched; whole, seconds: for each kind, uninterrupted work and its time."""

    data: Path
    content: bytes
    run: Path
    whole: dict[str, Path]
    seconds: dict[str, float]


def prepare(folder: Path) -> Scene:
    """Do every kind of work once without interrupting it."""
    data = collect(folder / f"{TASK}.hdf5")
    run = folder / "run"
    succeed(guider(train(data, run), folder))
    with h5py.File(folder / "fetched.hdf5", "w") as file:
        for key, array in d4rl(walk(200, 20, 8)).items():
            file[key] = array
    scene = Scene(data, (folder / "fetched.hdf5").read_bytes(), run, {}, {})
    for kind in set(KINDS):
        whole = folder / kind
        whole.mkdir()
        for _ in range(2 if "train" in kind else 1):  # the first compiles
            began = time.monotonic()
            shutil.rmtree(whole)
            whole.mkdir()
            with begin(scene, kind, whole) as site:
                succeed(go_on(scene, kind, whole, site))
            scene.seconds[kind] = time.monotonic() - began
        if kind.startswith("train"):
            succeed(guider(["train", "--resume", str(whole / "run")], whole))
        scene.whole[kind] = whole
    return scene


@contextmanager
def begin(scene: Scene, kind: str, folder: Path) -> Iterator[Site | None]:
    """Put what the work needs into `folder`; a slow server stands by while it lasts."""
    if kind == "evaluate":
        shutil.copytree(scene.run, folder / "run")
    if kind != "fetch":
        yield None
        return
    with serve() as site:
        site.replies = [lambda handler: _drip(handler, scene.content)]
        yield site


def command(scene: Scene, kind: str, folder: Path, site: Site | None) -> tuple[list[str], bool]:
    """(arguments that begin the work or go on with it, whether with frequent checkpoints)."""
    run = folder / "run"
    if kind.startswith("train"):
        cache = ["--stage-cache", str(folder / "cache")] if "cache" in kind else []
        return [*(["train", "--resume", str(run)] if run.exists() else train(scene.data, run)), *cache], True
    if kind == "evaluate":
        return ["evaluate", str(run), "--episodes", "40"], False
    if kind == "reproduce":
        places = ["--data", str(scene.data.parent), "--out", str(folder / "out")]
        small = ["--tasks", TASK, "--methods", "guider", "--seeds", "1", "--episodes", "3"]
        return ["reproduce", "table1", *small, *places, *SETS], False
    if kind == "fetch":
        return ["data", "fetch", FETCHED, "--mirror", site.url if site else "", "--out", str(folder / "fetched")], False
    out = folder / ("collected.hdf5" if kind == "collect" else "collected")
    return ["collect", TASK, "--steps", "20000", "--out", str(out)], False


def finished(kind: str, folder: Path) -> bool:
    """Whether the work's result has its name already: recording is not asked for twice."""
    return kind in ("collect", "minari") and bool(list(folder.glob("collected*")))


def go_on(scene: Scene, kind: str, folder: Path, site: Site | None) -> Ended:
    """Give the same command again, three times at most."""
    ended = Ended(0, "", "")
    for _ in range(3):
        if finished(kind, folder):
            break
        arguments, often = command(scene, kind, folder, site)
        ended = guider(arguments, folder, often)
        if ended.status == 0:
            break
    return ended


def verdict(scene: Scene, kind: str, folder: Path, ended: Ended) -> Outcome:
    """Compare with the work that nothing interrupted."""
    if fault := ended.fault():
        return Outcome(f"{kind}: {fault.what} on going on", fault.fault, fault.detail)
    if ended.status:
        return Outcome(f"{kind}: does not go on", "lost", ended.lines()[0])
    whole = scene.whole[kind]
    expected, found = _names(whole), _names(folder)
    # A stage cache may lack what was interrupted between a stage's end and its entry.
    if missing := {name for name in expected - found if not _is_digest(name)}:
        return Outcome(f"{kind}: something is missing", "lost", ", ".join(sorted(missing)))
    for path in sorted(whole.rglob("run.json")):
        ours, theirs = folder / path.parent.relative_to(whole), path.parent
        if not same(restored(ours), restored(theirs)):
            return Outcome(f"{kind}: other parameters", "silent", str(ours))
        if fault := _lines_fault(metrics(ours), metrics(theirs)):
            return Outcome(f"{kind}: other metrics", "lost", fault)
    for path in (path for path in whole.rglob("*") if path.suffix == ".hdf5" or path.name == "evaluation.json"):
        if digest(path) != digest(folder / path.relative_to(whole)):
            return Outcome(f"{kind}: {path.name} differs", "silent")
    if left := found - expected:
        return Outcome(f"{kind}: leftovers", "lost", ", ".join(sorted(left)))
    return Outcome("equal to the bit")


def _names(folder: Path) -> set[str]:
    """Every path in `folder`, but for checkpoints, which come as time passes, and what commands printed."""
    found = set()
    for path in folder.rglob("*"):
        parts = path.relative_to(folder).parts
        inside = [part for part in parts[:-1] if part.isdigit() or _is_digest(part) or part == "logs"]
        if not inside and not (parts[-1].isdigit() and parts[-2:-1] == ("checkpoints",)):
            found.add("/".join(parts))
    return found


def _is_digest(name: str) -> bool:
    return len(name.rpartition("/")[2]) == 32


def _drip(handler: BaseHTTPRequestHandler, content: bytes) -> None:
    """All of `content`, or the range asked for, in forty pieces over a second."""
    first = int(handler.headers.get("Range", "bytes=0-").removeprefix("bytes=").rstrip("-"))
    handler.send_response(206 if first else 200)
    handler.send_header("Content-Length", str(len(content) - first))
    handler.send_header("ETag", '"1"')
    if first:
        handler.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
    handler.end_headers()
    size = len(content) // 40
    for place in range(first, len(content), size):
        try:
            handler.wfile.write(content[place : place + size])
        except OSError:
            return  # whoever fetched was killed
        time.sleep(0.025)


def _lines_fault(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> str | None:
    """What is wrong with the lines of a run that was interrupted. Where it stopped within a stretch of updates, that
    stretch has a line for each of its parts."""
    done, wanted = ([line["total_updates"] for line in lines] for lines in (ours, theirs))
    if len(set(done)) < len(done) or not set(wanted) <= set(done):
        return f"lines up to updates {done}, not {wanted}"
    return "other numbers" if len(done) == len(wanted) and ours != theirs else None
