"""Run drills: all, or the one that is named. docs/reliability.md reports the last run of each."""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from drills import pool
from drills.common import FAULTS, ROOT, Outcome

NAMES = ("strangers", "twice", "servers", "bombs", "pickles", "links", "flips", "stop", "kill", "mutants")
REPORT = ROOT / "docs" / "reliability.md"
KEPT = ROOT / ".drills.json"
FLAGS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16")
PACKAGES = ("guider-rl", "jax", "jaxlib", "orbax-checkpoint", "numpy", "h5py", "minari", "mujoco", "rich")


@dataclass
class Result:
    """A drill's tally. examples: the first faults, with how to repeat each."""

    name: str
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    seconds: float = 0.0
    date: str = ""

    def add(self, number: int, outcome: Outcome, seed: int) -> None:
        self.outcomes[outcome.what] += 1
        if outcome.fault:
            self.faults[outcome.fault] += 1
            again = f"python -m drills {self.name} --seed {seed} --trial {number}"
            self.examples.append(f"{outcome.fault}: {outcome.what}: {_short(outcome.detail)} (`{again}`)")


def run(name: str, seed: int, numbers: range, workers: int, root: Path, scenes: dict[Any, Any]) -> Result:
    """Run a drill in a folder of its own below `root` and say how it goes. scenes: what drills have prepared so far."""
    result, began = Result(name), time.monotonic()
    folder, prepare = root / name, pool.load(name).prepare
    folder.mkdir()
    try:
        if prepare not in scenes:
            print(f"{name}: preparing", file=sys.stderr)
            (folder / "shared").mkdir()
            scenes[prepare] = pool.prepare(name, folder / "shared")
        job = pool.Job(name, seed, folder, scenes[prepare])
        for done, (number, outcome) in enumerate(pool.trials(job, numbers, workers), start=1):
            result.add(number, outcome, seed)
            if outcome.fault and len(result.examples) <= 30:
                print(f"{name}: {result.examples[-1]}", file=sys.stderr)
            if done % max(1, len(numbers) // 20) == 0:
                faults, seconds = result.faults.total(), time.monotonic() - began
                print(f"{name}: {done} of {len(numbers)} trials, {faults} faults, {seconds:.0f} s", file=sys.stderr)
    except Exception as error:
        result.add(-1, Outcome("the drill itself broke", "traces", f"{type(error).__name__}: {error}"), seed)
        print(f"{name}: {result.examples[-1]}", file=sys.stderr)
    result.seconds, result.date = time.monotonic() - began, f"{datetime.now(UTC):%Y-%m-%d}"
    return result


def keep(result: Result) -> list[Result]:
    """Put a drill's result in the place of its last one, and return those of all drills."""
    kept: dict[str, Any] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    kept[result.name] = vars(result)
    KEPT.write_text(json.dumps(kept, indent=1))
    return [_result(kept[name]) for name in NAMES if name in kept]


def _result(kept: dict[str, Any]) -> Result:
    values = dict(kept)
    for name in ("outcomes", "faults"):
        values[name] = Counter(kept[name])
    return Result(**values)


def table(results: list[Result]) -> str:
    """One row per drill."""
    rows = [
        f"| drill | trials | outcomes | {' | '.join(FAULTS)} | seconds | day |",
        "|---|---|---|" + "---|" * (len(FAULTS) + 2),
    ]
    for result in results:
        outcomes = ", ".join(f"{count} {what}" for what, count in result.outcomes.most_common())
        faults = " | ".join(f"**{result.faults[kind]}**" if result.faults[kind] else "0" for kind in FAULTS)
        end = f"{result.seconds:.0f} | {result.date}"
        rows.append(f"| {result.name} | {result.outcomes.total()} | {outcomes} | {faults} | {end} |")
    return "\n".join(rows)


def report(results: list[Result], seed: int) -> str:
    """The page."""
    cpu = Path("/proc/cpuinfo").read_text().split()
    flags = ", ".join(flag for flag in FLAGS if flag in cpu) or "none of " + ", ".join(FLAGS)
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in PACKAGES)
    examples = [f"- {result.name}: {example}" for result in results for example in result.examples[:3]]
    missing = ", ".join(name for name in NAMES if name not in {result.name for result in results})
    parts = [
        "# Reliability",
        "What was done to Guider, and how it answered; each drill is a file in `drills/` that says what it does. "
        "Faults are counted in four kinds, and none is wanted: "
        + "; ".join(f"*{kind}*, {meaning}" for kind, meaning in FAULTS.items())
        + ".",
        table(results),
        f"`make drill` (seed {seed}), or a drill alone by its name; {_minutes(results)} minutes on {_cores()} cores "
        f"({platform.machine()}; {flags}), {platform.system()}, Python {platform.python_version()}, {versions}.",
    ]
    if missing:
        parts.append(f"Not run yet: {missing}.")
    if examples:
        parts.append("The first faults of each drill, and what repeats them:\n\n" + "\n".join(examples))
    return "\n\n".join(parts) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m drills", description=__doc__)
    parser.add_argument("name", nargs="?", choices=NAMES, help="one drill, without it all")
    parser.add_argument("--trials", type=int, help="how many, in place of the drill's own number")
    parser.add_argument("--trial", type=int, help="only this one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=min(2, _cores()), help="trials at a time")
    asked = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell runs in the background ignores it otherwise
    results: list[Result] = []
    scenes: dict[Any, Any] = {}
    with tempfile.TemporaryDirectory(prefix="guider-drills-", ignore_cleanup_errors=True) as root:
        os.environ |= {  # programs are compiled once for all trials; the loopback server is reached without a proxy
            "JAX_COMPILATION_CACHE_DIR": f"{root}/compiled",
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "no_proxy": "*",
        }
        for name in (asked.name,) if asked.name else NAMES:
            numbers = range(asked.trials or pool.load(name).trials)
            if asked.trial is not None:
                numbers = range(asked.trial, asked.trial + 1)
            workers = min(asked.workers, len(numbers))
            results.append(run(name, asked.seed, numbers, workers, Path(root), scenes))
            if asked.trial is None:
                REPORT.write_text(report(keep(results[-1]), asked.seed))
    print(table(results))
    return int(any(result.faults for result in results))


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 200 else text[:200] + " ..."


def _minutes(results: list[Result]) -> int:
    return round(sum(result.seconds for result in results) / 60)


def _cores() -> int:
    return len(os.sched_getaffinity(0))


if __name__ == "__main__":
    sys.exit(main())
