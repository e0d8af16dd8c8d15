"""Small runs on plain logs, to be killed, resumed and spoiled."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from conftest import make_ragged

import guider
from guider import runs

SETTINGS = {
    "latent.updates": "6",
    "high.updates": "6",
    "low.updates": "12",
    "latent.hidden": "(8,)",
    "high.hidden": "(8,)",
    "low.hidden": "(8,)",
    "high.samples": "2",
    "latent.batch_size": "16",
    "high.batch_size": "16",
    "low.batch_size": "16",
}
OWN: dict[str, Any] = {
    "goal_indices": (0, 1),
    "radius": 0.5,
    "period_steps": 4,
    "seeds": 2,
    "held_out": 0.4,
    "settings": SETTINGS,
}
"""Always the same settings, so that all tests train by the same few compiled programs."""


BC: dict[str, Any] = {
    "goal_indices": (0, 1),
    "radius": 0.5,
    "method": "bc",
    "settings": {"updates": 12, "hidden": (8,), "batch_size": 16},
}


def write_plain(path: Path, seed: int = 0) -> Path:
    episodes = make_ragged(lengths=(7, 30, 6, 12, 55), seed=seed)
    np.savez(path, observations=episodes.observations, actions=episodes.actions, lengths=episodes.lengths)
    return path


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    return write_plain(tmp_path / "logs.npz")


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, runs.Run]:
    """(logs, a run of twelve updates with checkpoints after 9 and 12)."""
    folder = tmp_path_factory.mktemp("finished")
    logs = write_plain(folder / "logs.npz")
    return logs, guider.train(data=logs, out=folder / "run", pace=runs.Pace(3, 0.0), **BC)


@pytest.fixture
def copy(finished, tmp_path) -> runs.Run:
    """A copy of that run, to be spoiled."""
    shutil.copytree(finished[1].directory, tmp_path / "copy")
    return runs.open_run(tmp_path / "copy")


def final_state(run: runs.Run):
    restored = run.restore()
    assert restored is not None
    return jax.tree.leaves(restored[1])


def assert_bit_equal(first: runs.Run, second: runs.Run) -> None:
    for a, b in zip(final_state(first), final_state(second), strict=True):
        np.testing.assert_array_equal(a, b)
