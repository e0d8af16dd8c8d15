"""Hostile pickles wherever a file may hold bytes: in every reader and in run folders. Nothing they ask for is done."""

from __future__ import annotations

import io
import os
import pickle
import random
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from drills.common import GOAL, Answer, Drill, Outcome, ask, collect, d4rl, guider, restored, succeed, training, walk
from drills.common import steps as checkpoints


@dataclass(frozen=True)
class Call:
    """Unpickles as the result of a call."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.function, self.arguments


def _text(value: str) -> bytes:
    return b"X" + len(value.encode()).to_bytes(4, "little") + value.encode()


def _log() -> dict[str, Any]:
    arrays = walk()
    o, u = arrays["observations"].reshape(12, 20, 4), arrays["actions"].reshape(12, 20, 2)
    return {"o": o, "u": u[:, :-1], "g": o[:, 1:, :2].copy(), "ag": o[:, :, :2].copy()}


# Each is given the file it must try to make, and the Python code that makes it.
PAYLOADS: dict[str, Callable[[str, str], bytes]] = {
    **{
        f"system, protocol {protocol}": lambda path, code, p=protocol: pickle.dumps(
            Call(os.system, (f"touch {path}",)), p
        )
        for protocol in range(6)
    },
    "process": lambda path, code: pickle.dumps(Call(subprocess.call, (["touch", path],)), 4),
    "eval": lambda path, code: pickle.dumps(Call(eval, (code,)), 2),
    "exec": lambda path, code: pickle.dumps(Call(exec, (code,)), 5),
    "getattr": lambda path, code: (
        b"\x80\2cbuiltins\ngetattr\ncbuiltins\n__dict__\n"
        + _text("get")
        + b"\x86R"
        + _text("eval")
        + b"\x85R"
        + _text(code)
        + b"\x85R."
    ),
    "numpy writes": lambda path, code: pickle.dumps(Call(np.savetxt, (path, [1.0])), 2),
    "numpy maps": lambda path, code: pickle.dumps(Call(np.memmap, (path, "f8", "w+", 0, (1,))), 4),
    "beside a log": lambda path, code: pickle.dumps(_log() | {"extra": Call(eval, (code,))}, 4),
    "as an array of a log": lambda path, code: pickle.dumps(_log() | {"u": Call(eval, (code,))}, 2),
    "in a type": lambda path, code: pickle.dumps(
        _log() | {"u": Call(np.dtype, (Call(eval, (f"{code} or 'f8'",)),))}, 3
    ),
    "in a shape": lambda path, code: pickle.dumps(
        _log() | {"u": Call(np.ndarray, (Call(eval, (f"{code} or 2",)),))}, 5
    ),
    "nested lists": lambda path, code: pickle.dumps([[[{1: (Call(eval, (code,)),)}]]], 4),
    "dotted name": lambda path, code: (
        b"\x80\4" + _text("os") + _text("path.os.system") + b"\x93" + _text(f"touch {path}") + b"\x85R."
    ),
    "instance": lambda path, code: b"\x80\2(" + _text(code) + b"ibuiltins\neval\n.",
    "object": lambda path, code: b"\x80\2(cbuiltins\neval\n" + _text(code) + b"o.",
    "copyreg": lambda path, code: b"\x80\2ccopyreg\n__newobj__\n0" + pickle.dumps(Call(eval, (code,)), 2)[2:],
    "after a log": lambda path, code: pickle.dumps(_log(), 2)[:-1] + b"cbuiltins\neval\n" + _text(code) + b"\x85R0.",
}


def _npy(content: bytes, shape: tuple[int, ...] = (1,)) -> bytes:
    """An npy file of Python objects."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": shape})
    return stream.getvalue() + content


def _header(code: str) -> bytes:
    """An npy file whose header calls."""
    text = f"{{'descr': {code} or '<f4', 'fortran_order': False, 'shape': (240, 4)}}".ljust(501) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(240 * 16)


def _archive(path: Path, key: str, content: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in d4rl(walk()).items():
            if name != key:
                stream = io.BytesIO()
                np.save(stream, array)
                archive.writestr(f"{name}.npy", stream.getvalue())
        archive.writestr(f"{key}.npy", content)


def _hdf5(path: Path, content: bytes) -> None:
    with h5py.File(path, "w") as file:
        for name, array in d4rl(walk()).items():
            file[name] = array
        del file["timeouts"]
        file["timeouts"] = np.void(content)
        file.attrs["pickle"] = np.void(content)


# Each puts the payload (or the code) into a file.
CARRIERS: dict[str, Callable[[Path, bytes, str], object]] = {
    "a pickle": lambda path, content, code: path.write_bytes(content),
    "an npy file": lambda path, content, code: path.write_bytes(_npy(content)),
    **{
        f"{key} of an npz, as objects": lambda path, content, code, key=key: _archive(path, key, _npy(content))
        for key in ("observations", "timeouts", "goals")
    },
    "a member of an npz": lambda path, content, code: _archive(path, "actions", content),
    "the header of an npz's array": lambda path, content, code: _archive(path, "observations", _header(code)),
    "HDF5's bytes": lambda path, content, code: _hdf5(path, content),
}
RUN_PARTS = ("run.json", "metrics.jsonl", "evaluation.json", "a checkpoint", "all of a checkpoint")
CASES = [(payload, place) for payload in PAYLOADS for place in (*CARRIERS, *RUN_PARTS)]


def prepare(folder: Path) -> Path:
    """A run; and every payload must work where it is unpickled, or the drill would show nothing."""
    for name, make in PAYLOADS.items():
        sprung = folder / "sprung"
        try:
            pickle.loads(make(str(sprung), _code(sprung)))
        except Exception as error:
            if not sprung.exists():
                raise RuntimeError(f"the payload {name} does nothing: {error}") from error
        sprung.unlink()
    data, run = collect(folder / "data.hdf5"), folder / "run"
    succeed(guider(training(data, run), folder, often=True))
    return run


def _code(sprung: Path) -> str:
    return f"open({str(sprung)!r}, 'w').close()"


def trial(run: Path, number: int, rng: random.Random, folder: Path) -> Outcome:
    payload, place = CASES[number % len(CASES)]
    sprung = folder / "sprung"
    content = PAYLOADS[payload](str(sprung), _code(sprung))
    if place in CARRIERS:
        CARRIERS[place](folder / "file", content, _code(sprung))
        answers = _read(folder / "file")
    else:
        shutil.copytree(run, folder / "run")
        answers = _restore(folder / "run", place, content, rng)
    if sprung.exists():
        return Outcome("EXECUTED", "silent", f"{payload} in {place}")
    for answer in answers:
        if fault := answer.fault():
            return Outcome(fault.what, fault.fault, f"{payload} in {place}: {fault.detail}")
    return Outcome("refused in a line" if answers[0].kind == "refused" else "the rest is read")


def _read(path: Path) -> list[Answer]:
    from guider import data

    return [ask(lambda each=each: data.load(path, GOAL, format=each)) for each in (None, *data.FORMATS)]


def _restore(run: Path, place: str, content: bytes, rng: random.Random) -> list[Answer]:
    import guider

    files = [run / place]
    if place.endswith("a checkpoint"):
        newest = checkpoints(run)[-1]
        files = sorted(path for path in newest.rglob("*") if path.is_file()) or [newest]
        files = files if place.startswith("all") else [rng.choice(files)]
    for path in files:
        path.write_bytes(content)
    asked = [ask(lambda: restored(run))]
    return [*asked, ask(lambda: guider.resume(run))] if place == "metrics.jsonl" else asked


DRILL = Drill(trials=len(CASES), prepare=prepare, trial=trial)
