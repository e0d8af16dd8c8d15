"""Small ragged data and tiny networks shared by the tests."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

# Compiled programs are kept between test runs and shared by the processes that tests run in; what limits the size of
# the folder also locks it (by `filelock`), so that none reads what another has half written.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent.parent / ".jax_cache"))
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(2 * 10**9))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
# Nearly all of a test's time goes into compiling programs that run for moments: optimise them less.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1")

from guider.data.episodes import Episodes, make_episodes
from guider.learning.problem import Problem
from guider.methods.guider import GuiderConfig, guider_config
from guider.support.config import flatten, override, to_dict

C = TypeVar("C")


def tiny(config: C, updates: int = 10, hidden: tuple[int, ...] = (16, 16), batch_size: int = 32) -> C:
    """Any method's settings with networks and budgets small enough for a test."""
    small = {"updates": updates, "hidden": hidden, "batch_size": batch_size, "samples": 2}
    names = flatten(to_dict(config))
    return override(config, {name: small[last] for name in names if (last := name.split(".")[-1]) in small})


def make_ragged(lengths=(7, 30, 2, 12, 55), recorded_goals: bool = True, seed: int = 0) -> Episodes:
    """Random walks in the plane with two further state entries; entry 3 counts episodes, entry 2 steps."""
    rng = np.random.default_rng(seed)
    blocks = []
    for episode, length in enumerate(lengths):
        steps = np.full((length, 1), 0.0) + np.arange(length)[:, None]
        position = np.cumsum(rng.normal(size=(length, 2)), axis=0)
        blocks.append(np.hstack([position, steps, np.full((length, 1), float(episode))]))
    observations = np.concatenate(blocks)
    rows = len(observations)
    return make_episodes(
        observations,
        rng.uniform(-1, 1, (rows, 2)),
        lengths,
        goal_indices=(0, 1),
        goals=np.full((rows, 2), 1000.0) if recorded_goals else None,
        source="ragged test data",
    )


@pytest.fixture(scope="session")
def ragged() -> Episodes:
    return make_ragged()


@pytest.fixture(scope="session")
def fast_config() -> GuiderConfig:
    return tiny(guider_config("fast", Problem(radius=0.5, reach_radius=1.0, period_steps=5)))
