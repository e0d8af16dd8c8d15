"""Break a copy of the package, one mutation at a time, and run the tests that are to notice. The checkout is not touched.

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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from mutants.table import MUTATIONS, Mutation

ROOT = Path(__file__).parent.parent
COPIED = ("guider", "tests", "pyproject.toml")
LIMIT_SECONDS = 300
OUTCOMES = {0: "survived", 1: "killed"}
"""By pytest's exit status; others say that it could not do its work."""


def stale(mutation: Mutation, root: Path = ROOT) -> bool:
    """Whether the text to replace does not stand exactly once in its file."""
    return (root / mutation.file).read_text().count(mutation.old) != 1


def copy(folder: Path) -> Path:
    """A copy of the package and its tests, in a folder that is made."""
    folder.mkdir()
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder)
    return folder


def run(tests: list[str], folder: Path, *options: str) -> tuple[str, str]:
    """(outcome, output) of tests in a copy. No bytecode is kept: it is told apart by size and second alone."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", *options]
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*command, *(f"tests/{test}" for test in tests)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=None if options else LIMIT_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return "did not end", ""
    return OUTCOMES.get(done.returncode, "could not be tested"), done.stdout + done.stderr


def try_out(mutation: Mutation, folder: Path) -> tuple[str, str]:
    """(outcome, output) of the mutation's tests in a copy, which is whole again afterwards."""
    path = folder / mutation.file
    whole = path.read_text()
    path.write_text(whole.replace(mutation.old, mutation.new))
    try:
        return run(mutation.tests.split(), folder)
    finally:
        path.write_text(whole)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("only", nargs="*", help="parts of the names of files to mutate, without them all")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)), help="mutations at a time")
    asked = parser.parse_args()
    chosen = [m for m in MUTATIONS if not asked.only or any(part in m.file for part in asked.only)]
    if rotten := [m for m in chosen if stale(m)]:
        print("to be replaced, but not there exactly once:", *rotten, sep="\n  ")
        return 1
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="guider-mutants-") as root:
        folders: SimpleQueue[Path] = SimpleQueue()
        for number in range(asked.workers):
            folders.put(copy(Path(root, str(number))))
        whole = folders.get()
        outcome, output = run(
            sorted({test for m in chosen for test in m.tests.split()}), whole, f"--numprocesses={asked.workers}"
        )
        folders.put(whole)
        if outcome != "survived":
            print(f"the tests fail without a mutation:\n{output}")
            return 1

        def judge(mutation: Mutation) -> str:
            folder = folders.get()
            outcome, output = try_out(mutation, folder)
            folders.put(folder)
            print(f"{outcome}: {mutation}" + ("" if outcome in OUTCOMES.values() else f"\n{output}"), flush=True)
            return outcome

        with ThreadPoolExecutor(asked.workers) as pool:
            outcomes = list(pool.map(judge, chosen))
    tally = ", ".join(f"{count} {outcome}" for outcome, count in Counter(outcomes).items())
    print(f"{len(chosen)} mutations: {tally}; {(time.monotonic() - began) / 60:.0f} minutes")
    for outcome, mutation in zip(outcomes, chosen, strict=True):
        if outcome != "killed":
            print(f"{outcome}: {mutation} (by {mutation.tests})")
    return int(any(outcome != "killed" for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
