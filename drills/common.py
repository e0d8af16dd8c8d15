"""What drills share: outcomes, how to judge an answer, and small data and runs to do things to."""

from __future__ import annotations

import hashlib
import json
import os
import random
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from guider.errors import GuiderError, GuiderWarning

Fault = Literal["lost", "silent", "traces", "hangs"]
FAULTS: dict[Fault, str] = {
    "lost": "what was done is gone, doubled, overwritten or left lying about",
    "silent": "something else than what was stored was taken, or work ended, without a word",
    "traces": "a stack trace reached the user, more than one line, or the program died",
    "hangs": "over the time or memory that the answer may take, or something went on running",
}
ROOT = Path(__file__).parent.parent
TASK = "pointmaze-umaze"
GOAL = (0, 1)
SETTINGS = {
    **{f"{stage}.updates": updates for stage, updates in (("latent", 40), ("high", 40), ("low", 80))},
    **{f"{stage}.hidden": "(8,)" for stage in ("latent", "high", "low")},
    **{f"{stage}.batch_size": 16 for stage in ("latent", "high", "low")},
    "high.samples": 2,
}
SETS = ["--set", *(f"{name}={value}" for name, value in SETTINGS.items())]

# The command line with a checkpoint every few updates instead of every minute.
OFTEN = """
import sys
from functools import partial
from guider import api, cli, runs
pace = runs.Pace(4, 0.0)
api.train, api.resume = partial(api.train, pace=pace), partial(api.resume, pace=pace)
sys.exit(cli.main())
"""


@dataclass(frozen=True)
class Outcome:
    """What a trial came to. what: in a few words, counted in the table; detail: for whoever repeats it."""

    what: str
    fault: Fault | None = None
    detail: str = ""


@dataclass(frozen=True)
class Drill:
    """prepare: folder -> what all trials share; trial: (that, number, its own randomness, its own folder) -> Outcome.

    limit_s: a trial that takes longer hangs; memory: bytes that the trial's process may take, None where not watched.
    """

    trials: int
    prepare: Callable[[Path], Any]
    trial: Callable[[Any, int, random.Random, Path], Outcome]
    limit_s: float = 20.0
    memory: int | None = None


@dataclass(frozen=True)
class Answer:
    """What calling into the package gave: a value, a refusal in a line, or a trace (any other exception)."""

    kind: Literal["value", "refused", "trace"]
    value: Any
    text: str
    warned: bool

    def fault(self) -> Outcome | None:
        return Outcome("trace", "traces", self.text) if self.kind == "trace" else None


def ask(action: Callable[[], Any]) -> Answer:
    """Call `action` and sort what comes out."""
    kind, value, text = "value", None, ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value = action()
        except GuiderError as error:
            text = str(error)
            kind = "refused" if text and len(text.splitlines()) == 1 else "trace"
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            kind, text = "trace", f"{type(error).__name__}: {error}"
    warned = any(issubclass(warning.category, GuiderWarning) for warning in caught)
    return Answer(kind, value, text, warned)


@dataclass(frozen=True)
class Ended:
    """A command that has ended. status: minus the signal's number if it was killed by one."""

    status: int
    out: str
    err: str

    def lines(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("guider:")]

    def fault(self) -> Outcome | None:
        """A trace, a death or an end without its one line; None for success and for a proper refusal."""
        last = next((line for line in reversed(self.err.splitlines()) if line.strip()), "")
        if "Traceback" in self.err + self.out or "Exception ignored" in self.err:
            return Outcome("trace", "traces", last)
        if self.status < 0:
            return Outcome(f"died of signal {-self.status}", "traces", last)
        if self.status and len(self.lines()) != 1:
            return Outcome("ended without its line", "traces", f"status {self.status}: {last}")
        return None


def environment(**more: str) -> dict[str, str]:
    """The trial's, in which commands run this checkout's package."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return os.environ | {"PYTHONPATH": path} | more


def start(arguments: list[str], folder: Path, often: bool = False, **more: str) -> subprocess.Popen[str]:
    """Begin `guider ARGUMENTS` in `folder`, as the head of a process group of its own."""
    command = [sys.executable, *(("-c", OFTEN) if often else ("-m", "guider")), *arguments]
    return subprocess.Popen(
        command,
        cwd=folder,
        env=environment(**more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        process_group=0,
    )


def end(process: subprocess.Popen[str], timeout: float | None = None) -> Ended:
    out, err = process.communicate(timeout=timeout)
    return Ended(process.returncode, out, err)


def guider(arguments: list[str], folder: Path, often: bool = False, **more: str) -> Ended:
    """Run `guider ARGUMENTS` in `folder` to its end; a trial that takes too long is ended with all its processes."""
    return end(start(arguments, folder, often, **more))


def succeed(ended: Ended) -> None:
    """For preparing: raise where a command that must succeed did not."""
    if ended.status:
        raise RuntimeError(f"preparing failed: {ended.err.strip()[-300:]}")


def walk(episodes: int = 12, length: int = 20, state_dim: int = 4, seed: int = 0) -> dict[str, np.ndarray]:
    """observations [rows, state_dim], actions [rows, 2] and lengths [episodes] of a point that wanders."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(size=(episodes, length, state_dim))
    observations[..., :2] = rng.uniform(-9, 9, (episodes, 1, 2)) + np.cumsum(
        rng.normal(0, 0.3, (episodes, length, 2)), 1
    )
    rows = episodes * length
    return {
        "observations": observations.reshape(rows, state_dim).astype(np.float32),
        "actions": rng.uniform(-1, 1, (rows, 2)).astype(np.float32),
        "lengths": np.full(episodes, length),
    }


def d4rl(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same laid out as D4RL's antmaze."""
    rows, lengths = len(arrays["observations"]), arrays["lengths"]
    timeouts = np.zeros(rows, bool)
    timeouts[np.cumsum(lengths) - 1] = True
    rest = {key: value for key, value in arrays.items() if key != "lengths"}
    goals = {"rewards": np.zeros(rows, np.float32), "infos/goal": np.zeros((rows, 2), np.float32)}
    return rest | goals | {"terminals": np.zeros(rows, bool), "timeouts": timeouts}


def collect(path: Path, steps: int = 3000) -> Path:
    """Data of TASK, at `path`."""
    succeed(guider(["collect", TASK, "--steps", str(steps), "--out", str(path)], path.parent))
    return path


def training(data: Path, out: Path) -> list[str]:
    """Arguments that train a tiny run."""
    return ["train", TASK, "--data", str(data), "--out", str(out), *SETS]


def steps(run: Path) -> list[Path]:
    """The checkpoints of a run, oldest first, whatever each is made of."""

    def number(path: Path) -> int:
        return int("0" + "".join(filter(str.isdigit, path.stem)))

    return sorted((path for path in (run / "checkpoints").iterdir() if path.name[0] != "."), key=number)


def restored(run: Path) -> tuple[Any, list[np.ndarray]] | None:
    """(position, all arrays) of a run's newest checkpoint."""
    import jax

    from guider import runs

    found = runs.open_run(run).restore()
    return found and (found[0], [np.asarray(leaf) for leaf in jax.tree.leaves(found[1])])


def same(first: tuple[Any, list[np.ndarray]] | None, second: tuple[Any, list[np.ndarray]] | None) -> bool:
    """Whether position and every array are equal to the bit."""
    if first is None or second is None or first[0] != second[0] or len(first[1]) != len(second[1]):
        return False
    return all(a.dtype == b.dtype and a.tobytes() == b.tobytes() for a, b in zip(first[1], second[1], strict=True))


def metrics(run: Path) -> list[dict[str, Any]]:
    """The lines of metrics.jsonl without the time they took; ValueError where one is broken."""
    lines = (run / "metrics.jsonl").read_text().splitlines()
    return [{name: value for name, value in json.loads(line).items() if name != "seconds"} for line in lines]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
