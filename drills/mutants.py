"""Files changed at random, in their bytes or in what they say, given to every reader.

Each is refused in a line, or read. Where numbers were changed nothing can tell, so other values are no fault; nor is
other structure where names or shapes were changed: both are counted. Traces, deaths, hangs and memory are faults.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from drills.common import GOAL, Answer, Drill, Outcome, ask, collect, d4rl, guider, succeed, training, walk
from drills.layouts import LAYOUTS

Arrays = dict[str, np.ndarray]
KINDS = ("npz", "ogbench", "d4rl", "hdf5", "minari", "wgcsl2", "wgcsl4", *LAYOUTS, "run.json", "maze")
MAZE = "########\n#S.#...#\n#.##.#.#\n#....#.#\n#.##.#G#\n########\n"


@dataclass(frozen=True)
class Scene:
    """files: a sound file, or a folder, of each kind; read: what each reads as."""

    files: dict[str, Path]
    read: dict[str, Any]


def prepare(folder: Path) -> Scene:
    files = {kind: folder / kind for kind in KINDS}
    for kind in WRITERS:
        WRITERS[kind](files[kind], sound(kind))
    for kind, write in LAYOUTS.items():
        write(files[kind])
    minari = collect_minari(folder / "collected")
    minari.rename(files["minari"])
    data = collect(folder / "data.hdf5", 2000)
    succeed(guider(training(data, folder / "run"), folder))
    files["run.json"] = folder / "run"
    shutil.rmtree(folder / "run" / "checkpoints")
    files["maze"].write_text(MAZE)
    return Scene(files, {kind: read(kind, path) for kind, path in files.items()})


def collect_minari(path: Path) -> Path:
    """A dataset of a few short episodes, cut from one that `guider collect` made."""
    succeed(guider(["collect", "pointmaze-umaze", "--steps", "200", "--out", str(path)], path.parent))
    return path


def sound(kind: str) -> Arrays:
    """The arrays of a file of this kind."""
    arrays = walk()
    if kind in ("d4rl", "ogbench"):
        flat = d4rl(arrays)
        return flat if kind == "d4rl" else {**_only(flat, "observations", "actions"), "terminals": flat["timeouts"]}
    if kind.startswith("wgcsl"):
        o, u = arrays["observations"].reshape(12, 20, 4), arrays["actions"].reshape(12, 20, 2)
        return {"o": o, "u": u[:, :-1], "g": o[:, 1:, :2].copy(), "ag": o[:, :, :2].copy()}
    return arrays | {"goals": np.zeros((240, 2)), "action_low": np.full(2, -1.0), "action_high": np.full(2, 1.0)}


def _only(arrays: Arrays, *keys: str) -> Arrays:
    return {key: arrays[key] for key in keys}


def write_npz(path: Path, arrays: Arrays) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def write_hdf5(path: Path, arrays: Arrays, **options: Any) -> None:
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            known = array.astype("S") if array.dtype.kind in "UO" else array  # HDF5 has neither of these
            file.create_dataset(key, data=known, **(options if np.ndim(array) else {}))


WRITERS: dict[str, Callable[[Path, Arrays], object]] = {
    "npz": write_npz,
    "ogbench": write_npz,
    "d4rl": write_hdf5,
    "hdf5": lambda path, arrays: write_hdf5(path, arrays, chunks=True, compression="gzip"),
    "wgcsl2": lambda path, arrays: path.write_bytes(pickle.dumps(arrays, 2)),
    "wgcsl4": lambda path, arrays: path.write_bytes(pickle.dumps(arrays, 4)),
}


def read(kind: str, path: Path) -> Any:
    """What a file says, as something that can be compared."""
    from guider import data, runs
    from guider.tasks import find_task

    if kind == "run.json":
        return runs.open_run(path).spec
    if kind == "maze":
        task = find_task(f"pointmaze:{path}")
        return task.name.rpartition("(")[2] + task.summary, task.horizon_steps
    episodes = data.load(path, GOAL)
    return episodes.lengths.tolist(), episodes.observations.shape[1], episodes.actions.shape[1], episodes.fingerprint()


def mutate_arrays(arrays: Arrays, rng: random.Random) -> str:
    """Change one array, or its name, and say how."""
    key = rng.choice(sorted(arrays))
    array = arrays.pop(key)
    odd = rng.choice((np.nan, np.inf, -1, 0, 1e300, 2**40, -(2**63), 0.5))
    ways: dict[str, Callable[[], Any]] = {
        "removed": lambda: None,
        "renamed": lambda: arrays.update({rng.choice((key.upper(), key + "s", "infos/" + key, "next_" + key)): array}),
        "type": lambda: array.astype(rng.choice(("f2", "i1", "u8", "?", "c8", "S5", "U3", "O", ">f8", "i8"))),
        "cut": lambda: array[: rng.randrange(len(array))],
        "longer": lambda: np.concatenate([array, array[:1]]),
        "transposed": lambda: array.T,
        "flat": lambda: array.reshape(-1),
        "deeper": lambda: array[None] if rng.random() < 0.5 else array[..., None],
        "scalar": lambda: np.asarray(array.reshape(-1)[0]),
        "odd": lambda: _with(array, rng, odd),
        "all odd": lambda: np.full(array.shape, odd),
        "text": lambda: np.array("some text"),
        "records": lambda: np.zeros(len(array), [("a", "f4"), ("b", "i4")]),
        "swapped": lambda: arrays[rng.choice(sorted(arrays))],
    }
    way = rng.choice(sorted(ways))
    with np.errstate(all="ignore"):
        changed = ways[way]()
    if isinstance(changed, np.ndarray):
        arrays[key] = changed
    return f"{key} {way}"


def _with(array: np.ndarray, rng: random.Random, odd: float) -> np.ndarray:
    changed = array.astype(np.float64)
    changed.reshape(-1)[rng.randrange(changed.size)] = odd
    return changed


def mutate_bytes(content: bytearray, rng: random.Random) -> str:
    """Change bytes, near the beginning or the end half the time, and say how."""
    size = len(content)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        place = rng.choice(
            (rng.randrange(size), rng.randrange(min(size, 512)), size - 1 - rng.randrange(min(size, 512)))
        )
        length = rng.choice((1, 2, 4, 8, 64, 1000))
        way = rng.choice(("flip", "flip", "byte", "cut", "zeros", "ones", "noise", "insert", "remove", "double"))
        block = content[place : place + length]
        new = {
            "flip": bytes([content[place] ^ 1 << rng.randrange(8)]) + block[1:],
            "byte": bytes([rng.randrange(256)]) + block[1:],
            "zeros": bytes(len(block)),
            "ones": b"\xff" * len(block),
            "noise": rng.randbytes(len(block)),
            "insert": rng.randbytes(length) + block,
            "remove": b"",
            "double": block + block,
        }
        content[place : None if way == "cut" else place + length] = new.get(way, b"")
        if not content:
            return "emptied"
        size = len(content)
    return "bytes"


def mutate_json(value: Any, rng: random.Random) -> Any:
    """The document with one node changed."""
    if isinstance(value, (dict, list)) and value and rng.random() < 0.85:
        copy = value.copy()
        key = rng.choice(sorted(copy) if isinstance(copy, dict) else range(len(copy)))
        if rng.random() < 0.15:
            del copy[key]
        else:
            copy[key] = mutate_json(copy[key], rng)
        return copy
    return rng.choice(
        (None, True, -1, 0, 10**30, 1.5, "", "text", [], {}, [value], {"a": value}, "9" * 5000, 2**31, -0.1)
    )


def mutate_hdf5(path: Path, rng: random.Random) -> str:
    """Change an object or attribute of a sound HDF5 file and say how."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        attributes = file[name].attrs
        way = rng.choice(("remove", "rename", "attribute", "no attribute", "replace"))
        if way == "remove":
            del file[name]
        elif way == "rename":
            file.move(name, rng.choice((name + "s", "x")))
        elif way == "replace":
            del file[name]
            file[name] = rng.choice((np.zeros(0), np.zeros((3, 2)), "text", 1, np.full((5, 4), np.nan)))
        elif len(attributes):
            key = rng.choice(sorted(attributes))
            del attributes[key]
            if way == "attribute":
                attributes[key] = rng.choice((-1, 10**12, "text", 0.5, [1, 2], np.nan))
    return f"{name} {way}"


def mutant(scene: Scene, kind: str, rng: random.Random, folder: Path) -> tuple[Path, str]:
    """A changed copy of the kind's sound file, and what was changed."""
    sound_file, path = scene.files[kind], folder / kind
    if kind in WRITERS and rng.random() < 0.5:
        arrays = sound(kind)
        what = mutate_arrays(arrays, rng)
        WRITERS[kind](path, arrays)
        return path, what
    if sound_file.is_dir():
        shutil.copytree(sound_file, path)
    else:
        shutil.copy(sound_file, path)
    if kind == "run.json":
        target = path / "run.json"
    else:
        target = rng.choice(sorted(filter(Path.is_file, path.rglob("*")))) if path.is_dir() else path
    if h5py.is_hdf5(target) and rng.random() < 0.5:
        return path, mutate_hdf5(target, rng)
    if target.suffix == ".json" and rng.random() < 0.7:
        target.write_text(json.dumps(mutate_json(json.loads(target.read_text()), rng)))
        return path, "json"
    content = bytearray(target.read_bytes())
    what = mutate_bytes(content, rng)
    target.write_bytes(content)
    return path, what


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    kind = KINDS[number % len(KINDS)]
    path, what = mutant(scene, kind, rng, folder)
    return judge(kind, what, ask(lambda: read(kind, path)), scene.read[kind])


def judge(kind: str, what: str, answer: Answer, expected: Any) -> Outcome:
    if fault := answer.fault():
        return Outcome(f"{kind}: trace", fault.fault, f"{what}: {fault.detail}")
    if answer.kind == "refused":
        return Outcome("refused in a line")
    if answer.value == expected:
        return Outcome("read equal")
    if kind not in ("run.json", "maze") and answer.value[:-1] == expected[:-1]:
        return Outcome("read with other values")
    return Outcome(f"read with other structure, {'with' if answer.warned else 'without'} a line")


DRILL = Drill(trials=10_000, prepare=prepare, trial=trial, memory=2 * 2**30)
