"""What tests share: small ragged data, tiny networks, and ways to compare."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import hypothesis
import numpy as np
import pytest

# Compiled programs are kept between test runs and shared by the processes that tests run in; what limits the size of
# the folder also locks it (by `filelock`), so that none reads what another has half written.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent.parent / ".jax_cache"))
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(2 * 10**9))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
# Nearly all of a test's time goes into compiling programs that run for moments: optimise them little, or, where a test
# trains for a while (`optimised`), less.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "true")

import jax
import jax.numpy as jnp

from guider.data.episodes import Episodes, make_episodes
from guider.evaluation import fitted, imagined
from guider.learning.problem import Problem
from guider.learning.training import init_seeds, train
from guider.methods import METHODS
from guider.methods.guider import GuiderConfig, GuiderState, guider_config
from guider.methods.view import Scale, prepare
from guider.support.config import flatten, override, to_dict
from guider.tasks import Task

MODEL_UPDATES, imagined.UPDATES, fitted.UPDATES = imagined.UPDATES, 20, 20
"""Held-out scores learn a model of the robot and a value, which takes a while; what they are worth, their tests say."""

_PHASES = hypothesis.Phase.explicit, hypothesis.Phase.reuse, hypothesis.Phase.generate
hypothesis.settings.register_profile("first example", phases=_PHASES)
"""For whoever wants to know only that a test fails: no simpler example is looked for."""

pytest_plugins = ["recordings", "served", "small_runs"]
"""Where fixtures stand that several files use."""

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


def plain_scale() -> Scale:
    """States of 4 entries and goals of 2, shown as they are."""
    return Scale(jnp.zeros(4), jnp.ones(4), jnp.zeros(2), jnp.ones(2), jnp.ones(2), jnp.zeros(0))


def labelled(lengths: list[int] | np.ndarray, recorded: bool = False) -> Episodes:
    """Episodes whose states and goal space are (episode number, step) and whose actions grow with the row: a sample
    tells which row it came from."""
    episode = np.repeat(np.arange(len(lengths)), lengths)
    step = np.concatenate([np.arange(n) for n in lengths])
    observations = np.stack([episode, step], axis=1).astype(float)
    goals = np.full_like(observations, -7.0) if recorded else None
    actions = np.linspace(-1, 1, len(episode))[:, None]
    return make_episodes(observations, actions, lengths, (0, 1), goals=goals)


def shares(values: Any, size: int) -> np.ndarray:
    """[size] how often each of 0, 1, ... is among the values."""
    return np.bincount(np.asarray(values, int), minlength=size) / len(values)


def equal(first: Any, second: Any) -> bool:
    """Whether two trees hold the same, to the bit."""
    leaves = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in leaves)


def train_guider(config: GuiderConfig, episodes: Episodes, seeds: tuple[int, ...], **settings: Any) -> GuiderState:
    """All of its stages, without a run on disk."""
    method = METHODS["guider"]
    data, scale = prepare(config.view, config.problem, episodes)
    state = init_seeds(lambda key: method.init(config, episodes.spaces, scale, key), seeds)
    return jax.device_get(train(method.stages(config), state, data, seeds, **settings))


def dead_pid() -> int:
    """Of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.fixture(scope="session")
def ragged() -> Episodes:
    return make_ragged()


@pytest.fixture(scope="session")
def fast_config() -> GuiderConfig:
    return tiny(guider_config("fast", Problem(radius=0.5, reach_radius=1.0, period_steps=5)))


@contextmanager
def compiled_for_long() -> Iterator[None]:
    """Within, programs are compiled to run for a while; none is left over, as JAX does not tell these from the others,
    and what is compared with another process to the bit must be compiled as it is there."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)
        jax.clear_caches()


@pytest.fixture
def optimised() -> Iterator[None]:
    """See `compiled_for_long`."""
    with compiled_for_long():
        yield


def roll(task: Task, seeds: np.ndarray, steps: int) -> tuple[Episodes, np.ndarray]:
    """Random actions in the task's environment: the episodes [len(seeds)], and their goals."""
    rng = np.random.default_rng(0)
    env = task.make_env(len(seeds))
    first, goals = env.reset(seeds)
    everyone = np.ones(len(seeds), bool)
    actions = rng.uniform(-1, 1, (steps, len(seeds), task.action_dim)).astype(np.float32)
    observations = np.stack([first, *(env.step(action, everyone) for action in actions[:-1])])
    env.close()
    observations, actions = (np.swapaxes(array, 0, 1).reshape(-1, array.shape[2]) for array in (observations, actions))
    lengths = [steps] * len(seeds)
    return make_episodes(observations, actions, lengths, task.goal_indices, source="random.hdf5"), goals
