"""Peak memory of a training run on a million steps of antmaze-shaped data.

python -m benchmarks.memory [--json]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

TARGET_GB = 2.0
EPISODES, EPISODE_ROWS = 1000, 1000
UPDATES = 20
"""Updates of every stage: compiled, run, checkpointed."""


def write_data(path: Path) -> None:
    """An HDF5 file with D4RL's keys and a million rows, an episode at a time: this process stays small, because a
    child's recorded peak cannot fall below its parent's memory when it was started."""
    from benchmarks.common import ACTION_DIM, STATE_DIM, random_walk

    rng = np.random.default_rng(0)
    rows = EPISODES * EPISODE_ROWS
    with h5py.File(path, "w") as file:
        observations = file.create_dataset("observations", (rows, STATE_DIM), np.float32)
        actions = file.create_dataset("actions", (rows, ACTION_DIM), np.float32)
        goals = file.create_dataset("infos/goal", (rows, 2), np.float64)
        file.create_dataset("rewards", (rows,), np.float32)
        file.create_dataset("terminals", (rows,), bool)
        timeouts = file.create_dataset("timeouts", (rows,), bool)
        for first in range(0, rows, EPISODE_ROWS):
            block = slice(first, first + EPISODE_ROWS)
            observations[block], actions[block] = random_walk(EPISODE_ROWS, rng)
            goals[block] = rng.uniform(0, 20, 2)
            timeouts[first + EPISODE_ROWS - 1] = True


def train(data: Path) -> dict[str, float]:
    """Load, train all stages and checkpoint in this process. Peaks in GB: after imports, and at the end."""
    import guider.api

    imported = peak_gb()
    settings = {f"{part}.updates": str(UPDATES) for part in ("latent", "high", "low")}
    guider.api.train("antmaze-large-diverse", data, settings=settings, out=data.parent / "run")
    return {"imports_gb": imported, "peak_gb": peak_gb()}


def peak_gb() -> float:
    """Largest resident memory this process has had, in GB (1e9 bytes)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e9


def measure() -> dict[str, float]:
    """`train` in a child process, on data that is made and removed here."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data.hdf5"
        write_data(data)
        command = [sys.executable, "-m", "benchmarks.memory", "--train", str(data)]
        child = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        file_gb = data.stat().st_size / 1e9
    peaks = json.loads(child.stdout.splitlines()[-1])
    return peaks | {"training_gb": peaks["peak_gb"] - peaks["imports_gb"], "file_gb": file_gb, "target_gb": TARGET_GB}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    parser.add_argument("--train", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.train:
        print(json.dumps(train(options.train)))
        return
    result = measure()
    if options.json:
        print(json.dumps(result))
        return
    met = "met" if result["peak_gb"] <= TARGET_GB else "missed"
    print(f"file                {result['file_gb']:.2f} GB")
    print(f"after imports       {result['imports_gb']:.2f} GB")
    print(f"peak                {result['peak_gb']:.2f} GB  (target {TARGET_GB:g} GB: {met})")
    print(f"peak minus imports  {result['training_gb']:.2f} GB")


if __name__ == "__main__":
    main()
