"""Recording data in the kitchen: scripted demonstrations, one after the other, each of a chain of four subtasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from guider.collect import check_steps
from guider.collect.kitchen_demos import EPISODE_STEPS, Chain, demonstrate
from guider.collect.processes import map_in_processes
from guider.data.ends import lengths_from_ends
from guider.data.store import Recording
from guider.goals import Parts, part_distances

DEMOS_AT_ONCE = 8
"""Demonstrations that a worker process makes before it reports: half a minute at most."""

WHOLE: Chain = ("microwave", "kettle", "light switch", "slide cabinet")
_OTHERS = """
    kettle, bottom burner, hinge cabinet, slide cabinet
    kettle, bottom burner, light switch, hinge cabinet
    kettle, bottom burner, light switch, slide cabinet
    kettle, light switch, hinge cabinet, slide cabinet
    kettle, top burner, bottom burner, hinge cabinet
    kettle, top burner, bottom burner, light switch
    kettle, top burner, bottom burner, slide cabinet
    kettle, top burner, light switch, slide cabinet
    microwave, bottom burner, hinge cabinet, slide cabinet
    microwave, bottom burner, light switch, slide cabinet
    microwave, kettle, bottom burner, hinge cabinet
    microwave, kettle, bottom burner, slide cabinet
    microwave, kettle, hinge cabinet, slide cabinet
    microwave, kettle, light switch, hinge cabinet
    microwave, kettle, top burner, hinge cabinet
    microwave, kettle, top burner, light switch
    microwave, light switch, hinge cabinet, slide cabinet
    microwave, top burner, bottom burner, hinge cabinet
    microwave, top burner, bottom burner, light switch
    microwave, top burner, bottom burner, slide cabinet
    microwave, top burner, light switch, hinge cabinet
    top burner, bottom burner, light switch, slide cabinet
"""
OTHER_CHAINS: tuple[Chain, ...] = tuple(tuple(line.strip().split(", ")) for line in _OTHERS.strip().splitlines())
"""The chains that people were asked for besides WHOLE (Relay Policy Learning, Gupta et al. 2019)."""

PLAY_DECK: tuple[Chain, ...] = (WHOLE,) * 19 + tuple(OTHER_CHAINS[i % len(OTHER_CHAINS)] for i in range(582))
"""D4RL's 601 demonstrations of kitchen-partial and kitchen-mixed: 19 of them are WHOLE; none does all of the microwave,
the kettle, the bottom burner and the light switch."""


@dataclass(frozen=True)
class Recipe:
    """How to record data in the kitchen.

    make_env:     -> a KitchenEnv; called in worker processes
    deck:         demonstrations are of these chains, in an order shuffled by the seed, over and over
    goal:         [21] goal recorded with every row
    goal_indices, goal_parts, radius: when subtasks of the goal are done, see guider.tasks.types.Task
    solved_only:  keep the demonstrations that do all parts of the goal, each as far as the row that does the last one;
                  otherwise all are kept whole
    """

    make_env: Callable[[], Any]
    deck: tuple[Chain, ...]
    goal: tuple[float, ...]
    goal_indices: tuple[int, ...]
    goal_parts: Parts
    radius: float
    solved_only: bool


def record(recipe: Recipe, steps: int, seed: int, report: Callable[[int, int], None], cores: int) -> Recording:
    """Record `steps` rows by `recipe` in `cores` worker processes. The last episode is cut short where they are full.

    Demonstration n is determined by (seed, n): equal recipes, steps and seeds give equal recordings, whatever the
    number of cores. report: called with (rows done, rows in all).
    Raises GuiderError if `steps` is below 2.
    """
    check_steps(steps)
    make = partial(_demonstrations, recipe, seed)
    demos: list[tuple[np.ndarray, np.ndarray]] = []
    number, rows = 0, 0
    report(0, steps)
    with map_in_processes(cores) as map_batches:
        while rows < steps:
            missing = -(-(steps - rows) // (EPISODE_STEPS + 1))  # demonstrations, at least: none is made in vain
            batches = np.array_split(number + np.arange(missing), max(cores, -(-missing // DEMOS_AT_ONCE)))
            for batch in map_batches(make, [batch for batch in batches if len(batch) > 0]):
                demos += batch
                rows += sum(len(states) for states, _ in batch)
                report(min(rows, steps), steps)
            number += missing
    return _join(demos, steps, recipe.goal)


def _demonstrations(recipe: Recipe, seed: int, numbers: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """States and actions of those of the numbered demonstrations that the recipe keeps."""
    order = np.random.default_rng(seed).permutation(len(recipe.deck))
    env = recipe.make_env()
    try:
        kept = []
        for number in numbers:
            chain = recipe.deck[order[number % len(order)]]
            states, actions = demonstrate(env, chain, np.random.default_rng([seed, number]))
            length = solved_rows(recipe, states) if recipe.solved_only else len(states)
            if length > 0:
                kept.append((states[:length], actions[: length - 1]))
        return kept
    finally:
        env.close()


def solved_rows(recipe: Recipe, states: np.ndarray) -> int:
    """[T, 30] states -> rows up to the one that does the last part of the goal; 0 if a part is never done."""
    distances = part_distances(states[:, list(recipe.goal_indices)], np.array(recipe.goal), recipe.goal_parts)
    done = distances <= recipe.radius
    return int(done.argmax(axis=0).max()) + 1 if done.any(axis=0).all() else 0


def _join(demos: list[tuple[np.ndarray, np.ndarray]], steps: int, goal: tuple[float, ...]) -> Recording:
    """The first `steps` rows; the action in an episode's last row, which nothing reads, is 0."""
    states = np.concatenate([states for states, _ in demos])[:steps]
    actions = np.concatenate([np.pad(actions, ((0, 1), (0, 0))) for _, actions in demos])[:steps]
    ends = np.concatenate([np.arange(len(states)) == len(states) - 1 for states, _ in demos])[:steps]
    goals = np.tile(np.array(goal, np.float32), (steps, 1))
    bound = np.ones(actions.shape[1], np.float32)
    return Recording(states, actions, lengths_from_ends(ends), goals, -bound, bound)
