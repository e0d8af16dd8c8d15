"""Files of a few kB that declare up to 1e12 rows, unpack to gigabytes or nest 3,000 deep, for every reader.

Each is refused in a line, in under a second and without taking a gigabyte.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import random
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from drills.common import GOAL, TASK, Drill, Outcome, ask, d4rl, guider, succeed, walk

MOST_SECONDS = 1.0
ROWS = (10**9, 10**10, 10**12)


def header(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    """The beginning of an npy file that promises an array of this shape."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def npz(path: Path, promised: dict[str, bytes], zeros: int = 0) -> None:
    """An archive of sound members but for those promised, which have `zeros` bytes of zeros behind them, deflated."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for key, array in d4rl(walk()).items():
            if key not in promised:
                stream = io.BytesIO()
                np.save(stream, array)
                archive.writestr(f"{key}.npy", stream.getvalue())
        for key, beginning in promised.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as file:
                file.write(beginning)
                for _ in range(zeros // 2**24):
                    file.write(bytes(2**24))


def hdf5(path: Path, promised: dict[str, tuple[tuple[int, ...], str]], **options: Any) -> None:
    """A file of sound arrays but for those promised, whose shapes are declared and never written."""
    with h5py.File(path, "w") as file:
        for key, array in d4rl(walk()).items():
            if key in promised:
                shape, kind = promised[key]
                file.create_dataset(key, shape, kind, **options)
            else:
                file[key] = array


def nested(path: Path, depth: int = 3000) -> None:
    with h5py.File(path, "w") as file:
        group = file
        for _ in range(depth):
            group = group.create_group("g")
        for key, array in d4rl(walk()).items():
            group[key] = array


def many(path: Path) -> None:
    """An archive with many names."""
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(5000):
            archive.writestr(f"{number}.npy", b"")


def wgcsl(path: Path, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """A log whose observations' shape is declared otherwise than its bytes."""
    content = pickle.dumps({"o": array, "u": array, "g": array, "ag": array}, 2)
    old, new = (pickle.dumps(size, 2)[2:-1] for size in (array.shape[0], shape[0]))
    path.write_bytes(content.replace(old, new))


def declare(path: Path, sound: Path, rows: int) -> None:
    """A Minari dataset whose first episode declares so many actions."""
    shutil.copytree(sound, path)
    with h5py.File(path / "data" / "main_data.hdf5", "r+") as file:
        del file["episode_0/actions"]
        file.create_dataset("episode_0/actions", (rows, 2), "f4", chunks=(1024, 2))


def claim(path: Path, sound: Path, key: str, number: int) -> None:
    """A Minari dataset that claims so many episodes, or steps, in all."""
    shutil.copytree(sound, path)
    metadata = path / "data" / "metadata.json"
    metadata.write_text(json.dumps(json.loads(metadata.read_text()) | {key: number}))


BOMBS: dict[str, Callable[[Path, Path], object]] = {
    **{f"npz declares {n:.0e} rows": lambda p, _, n=n: npz(p, {"observations": header((n, 4))}) for n in ROWS},
    **{
        f"npz declares {n:.0e} flags": lambda p, _, n=n: npz(p, {"timeouts": header((n,), "|b1")})
        for n in (3 * 10**9, *ROWS)
    },
    "npz unpacks to 2 GB": lambda p, _: npz(p, {"observations": header((2**27, 4))}, 2**31),
    "npz has 5,000 members": lambda p, _: many(p),
    "npz header of an endless shape": lambda p, _: npz(p, {"observations": header((1,) * 5000)}),
    "npz header of negative shape": lambda p, _: npz(p, {"observations": header((-1, 4))}),
    **{
        f"HDF5 declares {n:.0e} rows, {word}": lambda p, _, n=n, o=o: hdf5(p, {"observations": ((n, 4), "f4")}, **o)
        for n in ROWS
        for word, o in (
            ("contiguous", {}),
            ("chunked", {"chunks": (1024, 4)}),
            ("deflated", {"chunks": (4096, 4), "compression": "gzip"}),
        )
    },
    "HDF5 declares 3e9 flags": lambda p, _: hdf5(p, {"timeouts": ((3 * 10**9,), "?")}, chunks=(4096,)),
    "HDF5 declares 3e9 rows and flags": lambda p, _: hdf5(
        p, {key: ((3 * 10**9, 4)[: 1 + (key != "timeouts")], "f4") for key in ("observations", "actions", "timeouts")}
    ),
    "HDF5 declares 1e12 columns": lambda p, _: hdf5(p, {"observations": ((240, 10**12), "f4")}),
    "HDF5 nests 3,000 groups": lambda p, _: nested(p),
    **{
        f"pickle declares {n:.0e} episodes": lambda p, _, n=n: wgcsl(p, np.zeros((77, 5, 2)), (n,))
        for n in (2**30, 2**40)
    },
    **{
        f"pickle declares {2**40:.0e} {word}": lambda p, _, o=o: p.write_bytes(
            b"\x80\5" + o + (2**40).to_bytes(8, "little") + b"few."
        )
        for word, o in (("bytes", b"\x8e"), ("letters", b"\x8d"), ("bytes of an array", b"\x96"))
    },
    "pickle of a million objects": lambda p, _: p.write_bytes(b"\x80\2" + b"}" * 10**6 + b"."),
    "pickle of doubled tuples": lambda p, _: p.write_bytes(b"\x80\2})" + b"q\0h\0\x86" * 60 + b"Ns."),
    **{f"Minari declares {n:.0e} actions": lambda p, s, n=n: declare(p, s, n) for n in ROWS},
    **{
        f"Minari claims {n:.0e} {key}": lambda p, s, n=n, key=key: claim(p, s, key, n)
        for n in ROWS
        for key in ("total_steps", "total_episodes")
    },
}


def prepare(folder: Path) -> Path:
    path = folder / "minari"
    succeed(guider(["collect", TASK, "--steps", "200", "--out", str(path)], folder))
    return path


def trial(sound: Path, number: int, rng: random.Random, folder: Path) -> Outcome:
    import minari  # noqa: F401 - its start is not counted

    from guider import data

    name, make = list(BOMBS.items())[number % len(BOMBS)]
    path = folder / "bomb"
    make(path, sound)
    before = os.times()
    answer = ask(lambda: data.load(path, GOAL))
    seconds = sum(now - then for now, then in zip(os.times()[:4], before[:4], strict=True))  # of work, not of waiting
    if fault := answer.fault():
        return Outcome(fault.what, fault.fault, f"{name}: {fault.detail}")
    if seconds > MOST_SECONDS:
        return Outcome("slow", "hangs", f"{name}: {seconds:.1f} s: {answer.text}")
    if answer.kind == "value":
        equal = answer.value.fingerprint() == data.load(sound, GOAL).fingerprint()
        return Outcome("the rest is read equal") if equal else Outcome("read", "silent", name)
    return Outcome("refused in a line", detail=f"{name}: {answer.text}")


DRILL = Drill(trials=len(BOMBS), prepare=prepare, trial=trial, limit_s=30, memory=2**30)
