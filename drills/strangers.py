"""What happens on other people's machines: full disks, read-only places, closed pipes, narrow or ASCII-only terminals,
a missing graphics library, no home. Each command succeeds or says in one line why not, and the last good state is kept.
"""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drills.common import (
    SETS,
    TASK,
    Drill,
    Ended,
    Outcome,
    collect,
    environment,
    guider,
    restored,
    same,
    succeed,
    training,
    walk,
)

MOUNT = 'mount -t tmpfs -o size="$1"k none "$2" && shift 2 && exec "$@"'
READ_ONLY = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && cd "$1" && shift && exec "$@"'
OTHER_LETTERS = "Läufe-Ω"


@dataclass(frozen=True)
class Scene:
    """run: finished and evaluated; may_mount: whether this user may have a file system of their own."""

    data: Path
    run: Path
    logs: Path
    sizes_kb: dict[str, int]
    may_mount: bool


def prepare(folder: Path) -> Scene:
    data, run, logs = collect(folder / "data.hdf5"), folder / "run", folder / f"{OTHER_LETTERS}.npz"
    succeed(guider(training(data, run), folder))
    np.savez(logs, **walk())  # pyright: ignore[reportArgumentType]
    (folder / "mount").mkdir()
    tried = subprocess.run(
        ["unshare", "-m", "sh", "-c", MOUNT, "sh", "100", str(folder / "mount"), "true"], capture_output=True
    )
    minari = folder / "minari"
    succeed(guider(["collect", TASK, "--steps", "500", "--out", str(minari)], folder))
    sizes_kb = {what: pages(path) for what, path in (("train", run), ("collect", data), ("minari", minari))}
    return Scene(data, run, logs, sizes_kb, tried.returncode == 0)


def pages(path: Path) -> int:
    """kB that files take on a disk of 4 kB pages."""
    files = [path, *path.rglob("*")]
    return sum(4 * -(-max(each.stat().st_size, 1) // 4096) for each in files)


def run_in(words: list[str], folder: Path, **more: str) -> Ended:
    """Any command, as `guider` runs one."""
    done = subprocess.run(words, cwd=folder, env=environment(**more), capture_output=True, text=True, errors="replace")
    return Ended(done.returncode, done.stdout, done.stderr)


def program(arguments: list[str]) -> list[str]:
    return [sys.executable, "-m", "guider", *arguments]


def judge(ended: Ended, done: str = "done") -> Outcome:
    if fault := ended.fault():
        return fault
    return Outcome("one line" if ended.status else done)


def plain(scene: Scene, folder: Path, arguments: list[str], **more: str) -> Outcome:
    """A command in an odd environment."""
    shutil.copytree(scene.run, folder / "run")
    return judge(guider(arguments, folder, False, **more))


def full(scene: Scene, folder: Path, share: float, what: str) -> Outcome:
    """A command on a disk too small for it; a run that could not be finished there goes on where there is room."""
    if not scene.may_mount:
        return Outcome("skipped: mounting is not permitted here")
    disk, after = folder / "disk", folder / "after"
    disk.mkdir()
    arguments = {
        "train": training(scene.data, disk / "run"),
        "collect": ["collect", TASK, "--steps", "3000", "--out", str(disk / "c.hdf5")],
        "minari": ["collect", TASK, "--steps", "500", "--out", str(disk / "c")],
    }[what]
    # The disk is gone with the command: what it left is copied out first.
    keep = f'"$@"; status=$?; cp -r {disk} {after}; exit $status'
    words = [
        "sh",
        "-c",
        MOUNT,
        "sh",
        str(int(share * scene.sizes_kb[what])),
        str(disk),
        "sh",
        "-c",
        keep,
        "sh",
        *program(arguments),
    ]
    ended = run_in(["unshare", "-m", *words], folder)
    outcome = judge(ended)
    if outcome.fault or what != "train" or ended.status == 0:
        return outcome
    if not (run := after / "run").exists():
        return outcome
    again = guider(["train", "--resume", str(run)], folder)
    if fault := again.fault():
        return Outcome(f"{fault.what} on going on", fault.fault, fault.detail)
    if again.status:
        return Outcome("does not go on", "lost", again.lines()[0])
    return (
        Outcome("one line, then equal")
        if same(restored(run), restored(scene.run))
        else Outcome("goes on otherwise", "silent")
    )


def read_only(scene: Scene, folder: Path, arguments: list[str]) -> Outcome:
    """A command in a folder that nobody may write to."""
    if not scene.may_mount:
        return Outcome("skipped: mounting is not permitted here")
    shutil.copytree(scene.run, folder / "run")
    (folder / "cache").mkdir()
    return judge(run_in(["unshare", "-m", "sh", "-c", READ_ONLY, "sh", str(folder), *program(arguments)], folder))


def closed_pipe(scene: Scene, folder: Path, arguments: list[str], lines: int) -> Outcome:
    """Whoever reads the output goes away after some lines; the status is then nobody's business."""
    return judge(run_in(["sh", "-c", f'"$@" | head -n {lines}', "sh", *program(arguments)], folder))


INSPECT, TASKS, LIST = ["data", "inspect", "{logs}"], ["tasks"], ["data", "fetch"]
EVALUATE, PLOT, RESUME = ["evaluate", "run", "--episodes", "2"], ["plot", "run"], ["train", "--resume", "run"]
TRAIN = ["train", TASK, "--data", "{data}", *SETS, "--out", OTHER_LETTERS]
NOTHING = ["data", "inspect", f"no-{OTHER_LETTERS}.npz"]
COMMANDS = (INSPECT, LIST, TRAIN, EVALUATE, PLOT, NOTHING, ["train", "--help"])
ODD: dict[str, dict[str, str]] = {
    "20 columns": {"COLUMNS": "20"},
    "ASCII only": {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "latin-1": {"PYTHONIOENCODING": "latin-1"},
    "MUJOCO_GL=osmesa": {"MUJOCO_GL": "osmesa"},
    "MUJOCO_GL=nonsense": {"MUJOCO_GL": "nonsense"},
    "no home": {"HOME": ""},
    "a home that is not there": {"HOME": "/nowhere", "XDG_CACHE_HOME": "/nowhere", "MPLCONFIGDIR": "/nowhere"},
    "a cache that is a file": {
        "GUIDER_DATA": "/dev/null",
        "MINARI_DATASETS_PATH": "/dev/null",
        "MPLCONFIGDIR": "/dev/null",
    },
}


def _named(arguments: list[str], scene: Scene) -> list[str]:
    places = {"{logs}": str(scene.logs), "{data}": str(scene.data)}
    return [places.get(word, word) for word in arguments]


CASES: dict[str, Callable[[Scene, Path], Outcome]] = {
    **{
        f"guider {' '.join(words[:3])}, {name}": lambda s, f, w=words, more=more: plain(s, f, _named(w, s), **more)
        for name, more in ODD.items()
        for words in COMMANDS
    },
    **{
        f"{what} on a disk of {share} of its size": lambda s, f, share=share, what=what: full(s, f, share, what)
        for what, shares in (
            ("train", (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0, 1.1)),
            ("collect", (0.05, 0.5, 0.9)),
            ("minari", (0.05, 0.5, 0.9)),
        )
        for share in shares
    },
    **{
        f"{words[0]} in a read-only place: {words[-1]}": lambda s, f, w=words: read_only(s, f, _named(w, s))
        for words in (
            *(EVALUATE, PLOT, RESUME, TRAIN),
            ["collect", TASK, "--steps", "50", "--out", "new.hdf5"],
            ["collect", TASK, "--steps", "50", "--out", "new"],
            ["reproduce", "table1", "--tasks", TASK, "--out", "out", "--data", "data"],
            ["data", "fetch", "antmaze-umaze", "--out", "cache", "--mirror", "http://127.0.0.1:9"],
            [*TRAIN, "--stage-cache", "cache"],
        )
    },
    **{
        f"guider {' '.join(words)} | head -n {lines}": lambda s, f, w=words, n=lines: closed_pipe(s, f, _named(w, s), n)
        for words in (TASKS, LIST, INSPECT, ["--help"], [*LIST, "--json"])
        for lines in (0, 1)
    },
}


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    name, case = list(CASES.items())[number % len(CASES)]
    outcome = case(scene, folder)
    return Outcome(outcome.what, outcome.fault, f"{name}: {outcome.detail}")


DRILL = Drill(trials=len(CASES), prepare=prepare, trial=trial, limit_s=120)
