"""Links out of the place: HDF5's external storage, external links and virtual datasets, symbolic links, member names.

Whatever a stranger's file or folder points at outside itself must not become data, nor be written, nor removed; where
it would have to be read, the link is refused in a line.
"""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from drills.common import GOAL, TASK, Drill, Outcome, ask, collect, d4rl, guider, succeed, training, walk
from drills.common import steps as checkpoints

SECRET = 1234.5
MAIN = "data/main_data.hdf5"


@dataclass(frozen=True)
class Scene:
    """run: with two checkpoints, at its end; minari: a dataset; cache: a stage cache that training fills."""

    data: Path
    run: Path
    minari: Path
    cache: Path


def prepare(folder: Path) -> Scene:
    scene = Scene(collect(folder / "data.hdf5"), folder / "run", folder / "minari", folder / "cache")
    succeed(guider(training(scene.data, scene.run), folder, often=True))
    succeed(guider(["evaluate", str(scene.run), "--episodes", "2"], folder))
    succeed(guider(["collect", TASK, "--steps", "200", "--out", str(scene.minari)], folder))
    succeed(guider([*training(scene.data, folder / "cached"), "--stage-cache", str(scene.cache)], folder))
    return scene


# HDF5: one dataset of a sound file comes from outside.


def point(file: h5py.File, key: str, way: str, outside: Path) -> None:
    """Replace `key` of the file by a link of this kind to numbers outside."""
    dataset = file[key]
    assert isinstance(dataset, h5py.Dataset)
    shape, kind = dataset.shape, dataset.dtype
    numbers = np.full(shape, SECRET if kind.kind == "f" else 1).astype(kind)
    outside.mkdir(exist_ok=True)
    numbers.tofile(outside / "numbers.raw")
    with h5py.File(outside / "numbers.hdf5", "w") as other:
        other["numbers"] = numbers
    del file[key]
    if way == "external storage":
        file.create_dataset(key, shape, kind, external=[(str(outside / "numbers.raw"), 0, numbers.nbytes)])
    elif way == "external link":
        file[key] = h5py.ExternalLink(str(outside / "numbers.hdf5"), "numbers")
    else:
        layout = h5py.VirtualLayout(shape, kind)
        layout[...] = h5py.VirtualSource(str(outside / "numbers.hdf5"), "numbers", shape)
        file.create_virtual_dataset(key, layout)


def hdf5(scene: Scene, folder: Path, key: str, way: str) -> Path:
    with h5py.File(folder / "in.hdf5", "w") as file:
        for name, array in d4rl(walk()).items():
            file[name] = array
        point(file, key, way, folder / "outside")
    return folder / "in.hdf5"


def minari(scene: Scene, folder: Path, key: str, way: str) -> Path:
    path = folder / "minari"
    shutil.copytree(scene.minari, path)
    with h5py.File(path / MAIN, "r+") as file:
        point(file, f"episode_0/{key}", way, folder / "outside")
    return path


def minari_link(scene: Scene, folder: Path, name: str) -> Path:
    path = folder / "minari"
    shutil.copytree(scene.minari, path)
    move_out(path / name, folder / "outside")
    return path


def members(scene: Scene, folder: Path, name: str) -> Path:
    arrays = walk() | {name: np.full(3, SECRET)}
    np.savez(folder / "in.npz", **arrays)  # pyright: ignore[reportArgumentType]
    return folder / "in.npz"


def read(path: Path) -> Outcome:
    from guider import data

    answer = ask(lambda: data.load(path, GOAL))
    if fault := answer.fault():
        return fault
    if answer.kind == "refused":
        return Outcome("refused in a line")
    arrays = (answer.value.observations, answer.value.actions, answer.value.goals)
    if any((array == SECRET).any() for array in arrays if array is not None):
        return Outcome("read from outside", "silent")
    return Outcome("read, nothing from outside") if path.suffix == ".npz" else Outcome("read through", "silent")


# Folders: one part of a run, or of a stage cache, is a symbolic link.


def move_out(path: Path, outside: Path) -> None:
    """Put what is at `path` outside, or promise it there if it does not exist, and leave a link in its place."""
    outside.mkdir(exist_ok=True)
    if path.exists():
        shutil.move(path, outside / path.name)
    path.symlink_to(outside / path.name)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run_link(scene: Scene, folder: Path, name: str, command: str, taken: bool) -> Outcome:
    """taken: whether doing it without a word means that something outside was read as the run's own."""
    run, outside = folder / "run", folder / "outside"
    shutil.copytree(scene.run, run)
    if command == "resume":  # which then has updates to do and lines to drop
        shutil.rmtree(newest) if (newest := checkpoints(run)[-1]).is_dir() else newest.unlink()
    path = run / name
    if name == "in a checkpoint":
        files = (each for each in sorted(checkpoints(run)[-1].rglob("*")) if each.is_file())
        path = max(files, key=lambda each: each.stat().st_size, default=checkpoints(run)[-1])
    elif name == "a checkpoint":
        path = checkpoints(run)[-1]
    move_out(path, outside)
    arguments = ["train", "--resume", str(run)] if command == "resume" else [command, str(run)]
    return untouched(arguments, folder, taken)


def cache_link(scene: Scene, folder: Path, name: str) -> Outcome:
    cache = folder / "cache"
    shutil.copytree(scene.cache, cache)
    entry = min(path for path in cache.iterdir() if path.is_dir())
    path = entry if name == "an entry" else min(entry.rglob("*"), key=lambda each: (name not in each.name, str(each)))
    move_out(cache if name == "itself" else path, folder / "outside")
    return untouched([*training(scene.data, folder / "run"), "--stage-cache", str(cache)], folder, taken=False)


def untouched(arguments: list[str], folder: Path, taken: bool) -> Outcome:
    before = contents(folder / "outside")
    ended = guider(arguments, folder)
    if contents(folder / "outside") != before:
        return Outcome("written or removed outside", "lost")
    if fault := ended.fault():
        return fault
    if ended.status:
        return Outcome("refused in a line")
    return Outcome("read through", "silent") if taken else Outcome("done, outside untouched")


WAYS = ("external storage", "external link", "virtual dataset")
CASES: dict[str, Callable[[Scene, Path], Outcome]] = {
    **{
        f"{key} by {way} in HDF5": lambda s, f, key=key, way=way: read(hdf5(s, f, key, way))
        for key in ("observations", "actions", "timeouts", "infos/goal")
        for way in WAYS
    },
    **{
        f"{key} by {way} in Minari": lambda s, f, key=key, way=way: read(minari(s, f, key, way))
        for key in ("observations/observation", "actions")
        for way in WAYS
    },
    **{
        f"{name} of a Minari dataset is a link": lambda s, f, name=name: read(minari_link(s, f, name))
        for name in ("data", MAIN, "data/metadata.json")
    },
    **{
        f"npz member {name}": lambda s, f, name=name: read(members(s, f, name))
        for name in ("../outside", "/tmp/guider-outside", "..\\outside", "a/../../outside")
    },
    **{
        f"{name} of a run is a link, {command}": lambda s, f, a=(name, command, taken): run_link(s, f, *a)
        for name, taken in (
            *(("run.json", True), ("checkpoints", True), ("a checkpoint", True), ("in a checkpoint", True)),
            *(("metrics.jsonl", False), ("evaluations.jsonl", False), ("evaluation.json", False), ("plots", False)),
        )
        for command in ("resume", "evaluate", "plot")
    },
    **{
        f"stage cache: {name} is a link": lambda s, f, name=name: cache_link(s, f, name)
        for name in ("an entry", "metrics", "manifest")
    },
}


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    name, case = list(CASES.items())[number % len(CASES)]
    outcome = case(scene, folder)
    return Outcome(outcome.what, outcome.fault, f"{name}: {outcome.detail}")


DRILL = Drill(trials=len(CASES), prepare=prepare, trial=trial, limit_s=60)
