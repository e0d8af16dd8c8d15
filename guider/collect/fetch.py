"""Recording data of the Fetch tasks: episodes of a noisy expert among episodes of random actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import gymnasium
import numpy as np

from guider.collect import check_steps
from guider.collect.fetch_experts import ACTION_DIM, Expert
from guider.collect.processes import map_in_processes
from guider.data.ends import lengths_from_ends
from guider.data.store import Recording

EPISODE_STEPS = 50
NOISE_SPREAD = 0.1
EPISODES_AT_ONCE = 50
"""Episodes that a worker process records before it reports: a few seconds."""


@dataclass(frozen=True)
class Recipe:
    """How to record data of a Fetch task.

    An episode is an expert's, whose actions get Gaussian noise of standard deviation NOISE_SPREAD and are clipped to
    [-1, 1], or it takes actions drawn uniformly from [-1, 1].

    make_env:     -> the environment; called in worker processes
    expert_share: of the episodes, the expert's, which are spread evenly at random
    """

    make_env: Callable[[], gymnasium.Env]
    expert: Expert
    expert_share: float


def record(recipe: Recipe, steps: int, seed: int, report: Callable[[int, int], None], cores: int) -> Recording:
    """Record `steps` rows by `recipe` in `cores` worker processes. Episodes have 51 rows; the last is cut short where
    they are full. The action in an episode's last row, which nothing reads, is 0.

    What happens in episode n is determined by (seed, n) and by whether it is the expert's: equal recipes, steps and
    seeds give equal recordings, whatever the number of cores. report: called with (rows done, rows in all).
    Raises GuiderError if `steps` is below 2.
    """
    check_steps(steps)
    rows = EPISODE_STEPS + 1
    episodes = -(-steps // rows)
    batches = np.array_split(np.arange(episodes), -(-episodes // EPISODES_AT_ONCE))
    by_expert = experts_episodes(episodes, recipe.expert_share, seed)
    recorded = []
    done = 0
    report(0, steps)
    with map_in_processes(min(cores, len(batches))) as map_batches:
        for batch in map_batches(partial(_record_episodes, recipe, seed), batches, [by_expert[b] for b in batches]):
            recorded.append(batch)
            done += len(batch[0])
            report(min(done, steps), steps)
    observations, actions, goals = (np.concatenate(parts)[:steps] for parts in zip(*recorded, strict=True))
    lengths = lengths_from_ends(np.arange(1, steps + 1) % rows == 0)
    bound = np.ones(ACTION_DIM, np.float32)
    return Recording(observations, actions, lengths, goals, -bound, bound)


def experts_episodes(episodes: int, share: float, seed: int) -> np.ndarray:
    """[episodes] bool: which are the expert's. `share` of them, rounded, in an order shuffled by the seed."""
    return np.random.default_rng(seed).permutation(np.arange(episodes) < round(share * episodes))


def _record_episodes(recipe: Recipe, seed: int, numbers: np.ndarray, by_expert: np.ndarray) -> tuple[np.ndarray, ...]:
    """Observations, actions and goals, [rows, ...] float32, of the numbered episodes laid end to end."""
    env = recipe.make_env()
    try:
        episodes = [
            _record_episode(env, recipe.expert if expert else None, np.random.default_rng([seed, number]))
            for number, expert in zip(numbers, by_expert, strict=True)
        ]
    finally:
        env.close()
    return tuple(np.concatenate(parts) for parts in zip(*episodes, strict=True))


def _record_episode(env: gymnasium.Env, expert: Expert | None, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """One episode, of random actions without an expert. The first thing drawn from `rng` is the environment's seed."""
    seen, _ = env.reset(seed=int(rng.integers(2**31)))
    goal = seen["desired_goal"]
    observations, actions = [seen["observation"]], []
    for _ in range(EPISODE_STEPS):
        if expert is None:
            action = rng.uniform(-1.0, 1.0, ACTION_DIM)
        else:
            noise = NOISE_SPREAD * rng.standard_normal(ACTION_DIM)
            action = np.clip(expert(seen["observation"], goal) + noise, -1.0, 1.0)
        actions.append(action.astype(np.float32))
        seen = env.step(actions[-1])[0]
        observations.append(seen["observation"])
    actions.append(np.zeros(ACTION_DIM, np.float32))
    goals = np.tile(goal, (len(observations), 1))
    return np.array(observations, np.float32), np.array(actions), goals.astype(np.float32)
