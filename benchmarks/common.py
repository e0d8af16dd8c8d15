"""What the benchmarks share: data like antmaze's, a trainer of one stage, timing in alternation, tables."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes, make_episodes
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.processor import settled
from guider.learning.training import compile_chunk, init_seeds, no_sums, seed_keys
from guider.methods import guider
from guider.methods.guider import GuiderConfig, guider_config
from guider.methods.view import prepare

STAGES = ("latent", "high", "low")
"""Short names of the method's stages, in its order."""

STATE_DIM, ACTION_DIM, GOAL_INDICES = 29, 8, (0, 1)
RADIUS_M, REACH_RADIUS_M, PERIOD_STEPS = 0.5, 1.0, 50

Run = Callable[[int], None]
"""Does so many units of work and returns once they are done."""


def antmaze_config(preset: Preset) -> GuiderConfig:
    """A preset as antmaze gets it."""
    return guider_config(preset, Problem(RADIUS_M, REACH_RADIUS_M, PERIOD_STEPS))


def random_walk(rows: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One episode shaped like antmaze's: [rows, 29] states that drift 0.2 a step, [rows, 8] actions in [-1, 1]."""
    steps = 0.2 * rng.standard_normal((rows, STATE_DIM), np.float32)
    return np.cumsum(steps, axis=0), rng.uniform(-1, 1, (rows, ACTION_DIM)).astype(np.float32)


def antmaze_episodes(episodes: int = 200, rows: int = 1001) -> Episodes:
    """Random walks shaped like antmaze's data, with recorded goals."""
    rng = np.random.default_rng(0)
    observations, actions = zip(*(random_walk(rows, rng) for _ in range(episodes)), strict=True)
    goals = np.repeat(rng.uniform(0, 20, (episodes, 2)), rows, axis=0)
    return make_episodes(
        np.concatenate(observations), np.concatenate(actions), [rows] * episodes, GOAL_INDICES, goals=goals
    )


def trainer(config: GuiderConfig, stage: str, episodes: Episodes, seeds: Sequence[int] = (0,)) -> Run:
    """run(updates): the stage's next updates for all seeds, in the compiled loop that training uses."""
    index = STAGES.index(stage)
    data, scale = prepare(config.view, config.problem, episodes)
    keys = seed_keys(seeds)
    state = init_seeds(lambda key: guider.init(config, episodes.spaces, scale, key), seeds)
    trained = guider.stages(config)[index]
    with jax.default_matmul_precision(settled(config.precision)):
        sums = no_sums(trained, state, data, keys)
        chunk = compile_chunk(trained, index).lower(state, sums, data, keys, jnp.asarray(0), jnp.asarray(1)).compile()
    done = 0

    def run(updates: int) -> None:
        nonlocal state, sums, done
        first, last = jnp.asarray(done), jnp.asarray(done + updates)
        state, sums = jax.block_until_ready(chunk(state, sums, data, keys, first, last))
        done += updates

    return run


def alternate(contenders: Mapping[str, Run], rounds: int, seconds: float) -> dict[str, list[float]]:
    """Rates in units of work per second, one per round: in every round each contender runs for about `seconds`.

    Whatever disturbs the machine for longer than a round disturbs all contenders alike.
    """
    counts = {name: _units_for(run, seconds) for name, run in contenders.items()}
    rates: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            began = time.perf_counter()
            run(counts[name])
            rates[name].append(counts[name] / (time.perf_counter() - began))
    return rates


def _units_for(run: Run, seconds: float) -> int:
    """How many units of work take about `seconds`; warms the contender up on the way."""
    units = 1
    run(1)
    while True:
        began = time.perf_counter()
        run(units)
        elapsed = time.perf_counter() - began
        if elapsed > seconds / 5:
            return max(1, round(units * seconds / elapsed))
        units *= 2


def ratios(rates: Sequence[float], reference: Sequence[float]) -> dict[str, float]:
    """Median, least and greatest ratio of rates measured in the same rounds."""
    each = [a / b for a, b in zip(rates, reference, strict=True)]
    return {"median": statistics.median(each), "min": min(each), "max": max(each)}


def show_ratio(ratio: Mapping[str, float]) -> str:
    return f"{ratio['median']:.2f} ({ratio['min']:.2f}-{ratio['max']:.2f})"


def verdict(value: float, target: float) -> str:
    """A median ratio against its least acceptable value."""
    return f"target {target}: {'met' if value >= target else 'missed'}"


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Columns as wide as their widest cell; the first is a name, the others are numbers."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    print(f"\n{title}")
    for row in (header, *rows):
        cells = (cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        print("  ".join((row[0].ljust(widths[0]), *cells)))
