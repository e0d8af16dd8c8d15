"""Break a copy of the package, one mutation at a time, and run the tests that are to notice. Nothing here is touched.

Exits with 1 where a mutation survives, or cannot be judged: its text is not in the file exactly once, or its tests fail
without it, cannot be run with it, or do not end.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from mutants.mutation import Mutation
from mutants.table import MUTATIONS

ROOT = Path(__file__).parent.parent
LIMIT_SECONDS = 300
OUTCOMES = {0: "survived", 1: "killed"}
"""By pytest's exit status; another says that it could not do its work."""


def stale(mutation: Mutation) -> bool:
    """Whether the text to replace does not stand exactly once in its file."""
    return (ROOT / mutation.file).read_text().count(mutation.old) != 1


def copy(folder: Path) -> Path:
    """A copy of the package, its tests and what they read, in a folder that is made."""
    for name in ("guider", "tests", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def run(tests: Sequence[str], folder: Path, *options: str) -> tuple[str, str]:
    """(outcome, pytest's output) of tests in a copy."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *options]
    command += ["--hypothesis-seed=0", "--hypothesis-profile=first example"]
    own = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}  # bytecode is told apart by size and second alone
    try:
        done = subprocess.run(
            [*command, *(f"tests/{test}" for test in tests)],
            cwd=folder,
            env=os.environ | own,
            capture_output=True,
            text=True,
            timeout=len(tests) * LIMIT_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return "did not end", ""
    return OUTCOMES.get(done.returncode, "could not be tested"), done.stdout + done.stderr


def try_out(mutation: Mutation, folder: Path) -> str:
    """The outcome of the mutation's tests in a copy, which is whole again afterwards."""
    path = folder / mutation.file
    whole = path.read_text()
    path.write_text(whole.replace(mutation.old, mutation.new))
    outcome, output = run(mutation.tests.split(), folder)
    path.write_text(whole)
    notice = [line.removeprefix("FAILED tests/") for line in output.splitlines() if line.startswith("FAILED")]
    print(f"{outcome}: {mutation}", *(notice if outcome in OUTCOMES.values() else [output]), sep="\n    ", flush=True)
    return outcome


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("only", nargs="*", help="parts of the names of files to mutate, without them all")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)), help="mutations at a time")
    asked = parser.parse_args()
    chosen = [m for m in MUTATIONS if not asked.only or any(part in m.file for part in asked.only)]
    if rotten := [m for m in chosen if stale(m)]:
        print("to be replaced, but not there exactly once:", *rotten, sep="\n    ")
        return 1
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="guider-mutants-") as root:
        copies = [copy(Path(root, str(number))) for number in range(asked.workers)]
        tests = sorted({test for mutation in chosen for test in mutation.tests.split()})
        outcome, output = run(tests, copies[0], f"--numprocesses={asked.workers}")
        if outcome != "survived":
            print(f"without a mutation, the tests: {outcome}\n{output}")
            return 1
        free: SimpleQueue[Path] = SimpleQueue()

        def judge(mutation: Mutation) -> str:
            folder = free.get()
            outcome = try_out(mutation, folder)
            free.put(folder)
            return outcome

        for folder in copies:
            free.put(folder)
        with ThreadPoolExecutor(asked.workers) as pool:
            outcomes = list(pool.map(judge, chosen))
    tally = ", ".join(f"{count} {outcome}" for outcome, count in Counter(outcomes).items())
    print(f"{len(chosen)} mutations: {tally}; {(time.monotonic() - began) / 60:.0f} minutes")
    lived = [(o, m) for o, m in zip(outcomes, chosen, strict=True) if o != "killed"]
    print(*(f"{outcome}: {mutation} ({mutation.tests})" for outcome, mutation in lived), sep="\n")
    return int(bool(lived))


if __name__ == "__main__":
    sys.exit(main())
