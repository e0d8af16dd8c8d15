"""Recording data in a maze: a controller is led from cell to cell, with noise, and every step is logged."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from guider.errors import GuiderError

if TYPE_CHECKING:  # guider.tasks imports this module
    from guider.tasks.mazes import Maze
    from guider.tasks.types import VectorEnv

EPISODES_AT_ONCE = 256


@dataclass(frozen=True)
class Recipe:
    """How to record data in a maze.

    An episode starts where `make_env` puts it and aims at a point in a uniformly drawn free cell; as soon as
    it comes within `goal_radius_m`, another is drawn, so that no episode idles. The controller's actions get
    Gaussian noise, and now and then a burst replaces them: one random action, held for some steps.

    make_env:      number of copies -> environment; an observation begins with (x, y) in metres
    controller:    (observations [n, state_dim], waypoints [n, 2]) -> actions [n, action_dim]; without memory
    episode_steps: rows of an episode
    goal_offset_m: a goal lies within this distance of its cell's centre, along each axis
    noise_spread:  standard deviation of the noise on every action entry
    burst_chance:  probability that a burst begins at a step
    burst_steps:   how long a burst lasts
    """

    maze: Maze
    make_env: Callable[[int], VectorEnv]
    controller: Callable[[np.ndarray, np.ndarray], np.ndarray]
    action_dim: int
    episode_steps: int
    goal_offset_m: float
    goal_radius_m: float
    noise_spread: float
    burst_chance: float
    burst_steps: int


@dataclass(frozen=True)
class Guide:
    """Knows a waypoint for every position and goal in a maze."""

    maze: Maze

    @cached_property
    def _next_cells(self) -> np.ndarray:
        """[rows, columns, rows, columns, 2]: goal cell, current cell -> the cell to enter next."""
        table = np.zeros((*self.maze.walls.shape, *self.maze.walls.shape, 2), int)
        for row, column in self.maze.free_cells:
            table[row, column] = self.maze.next_cells_to((row, column))
        return table

    def waypoints(self, xy: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """[n, 2] positions, [n, 2] goals in free cells -> [n, 2] where to head, all in metres.

        The centre of the next cell on a shortest way, or the goal itself once the next cell is the goal's.
        """
        goal_cells = self.maze.cell_of(goals)
        following = self._next_cells[(*goal_cells.T, *self.maze.cell_of(xy).T)]
        arriving = np.all(following == goal_cells, axis=-1)
        return np.where(arriving[:, None], goals, self.maze.cell_centre(following))


def record(recipe: Recipe, steps: int, seed: int, path: Path, report: Callable[[int, int], None]) -> None:
    """Record `steps` rows by `recipe` into `path`, an HDF5 file laid out as D4RL's.

    observations [steps, state_dim], actions [steps, action_dim] in [-1, 1] and infos/goal [steps, 2] are
    float32; rewards [steps] are 1 where the step comes within `goal_radius_m` of its goal, else 0; terminals
    are all False; timeouts are True in the last row of each episode. The last episode is cut short if `steps`
    is no multiple of `episode_steps`.

    Equal arguments give equal bytes, whatever the number of cores. The file appears only when it is complete.
    report: called with (rows done, rows in all). Raises GuiderError if `steps` is below 2.
    """
    if steps < 2:
        raise GuiderError(f"cannot record {steps} steps: an episode needs at least two")
    episodes = -(-steps // recipe.episode_steps)
    seeds = np.random.SeedSequence(seed).generate_state(episodes, np.uint64)
    guide = Guide(recipe.maze)
    batches = []
    report(0, steps)
    for first in range(0, episodes, EPISODES_AT_ONCE):
        batches.append(_record_episodes(recipe, guide, seeds[first : first + EPISODES_AT_ONCE]))
        report(min((first + EPISODES_AT_ONCE) * recipe.episode_steps, steps), steps)
    arrays = {key: np.concatenate([batch[key] for batch in batches])[:steps] for key in batches[0]}
    arrays["terminals"] = np.zeros(steps, bool)
    arrays["timeouts"] = np.arange(1, steps + 1) % recipe.episode_steps == 0
    arrays["timeouts"][-1] = True
    _write(path, arrays)


def _record_episodes(recipe: Recipe, guide: Guide, seeds: np.ndarray) -> dict[str, np.ndarray]:
    """Whole episodes, laid end to end; episode i is wholly determined by seeds[i]."""
    scripts = [_draw_script(recipe, np.random.default_rng([int(seed), 1])) for seed in seeds]
    goals, noise, bursts, in_burst = (np.stack(parts) for parts in zip(*scripts, strict=True))
    rows = np.arange(len(seeds))
    everyone = np.ones(len(seeds), bool)
    goal_number = np.zeros(len(seeds), int)
    log: dict[str, list[np.ndarray]] = {"observations": [], "actions": [], "rewards": [], "infos/goal": []}

    env = recipe.make_env(len(seeds))
    try:
        observations, _ = env.reset(seeds)
        for t in range(recipe.episode_steps):
            goal = goals[rows, goal_number]
            waypoints = guide.waypoints(observations[:, :2], goal)
            noisy = recipe.controller(observations, waypoints) + noise[:, t]
            actions = np.where(in_burst[:, t, None], bursts[:, t], np.clip(noisy, -1.0, 1.0)).astype(np.float32)
            log["observations"].append(observations)
            log["actions"].append(actions)
            log["infos/goal"].append(goal)
            observations = env.step(actions, everyone)
            reached = np.linalg.norm(observations[:, :2] - goal, axis=1) <= recipe.goal_radius_m
            log["rewards"].append(reached)
            goal_number += reached
    finally:
        env.close()
    stacked = {key: np.stack(parts, axis=1).astype(np.float32) for key, parts in log.items()}
    return {key: array.reshape(-1, *array.shape[2:]) for key, array in stacked.items()}


def _draw_script(recipe: Recipe, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """All the randomness of one episode but its start, drawn ahead.

    Returns goals [T, 2] in the order they are taken up, action noise [T, action_dim], burst actions
    [T, action_dim] and whether a burst is on [T], with T = episode_steps.
    """
    length = recipe.episode_steps
    cells = recipe.maze.free_cells[rng.integers(len(recipe.maze.free_cells), size=length)]
    goals = recipe.maze.cell_centre(cells) + rng.uniform(-recipe.goal_offset_m, recipe.goal_offset_m, (length, 2))
    noise = recipe.noise_spread * rng.standard_normal((length, recipe.action_dim))
    steps = np.arange(length)
    begins = rng.random(length) < recipe.burst_chance
    latest = np.maximum.accumulate(np.where(begins, steps, -recipe.burst_steps))
    held = rng.uniform(-1.0, 1.0, (length, recipe.action_dim))[np.maximum(latest, 0)]
    return goals, noise, held, steps - latest < recipe.burst_steps


def _write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with h5py.File(partial, "w") as file:
            for key, array in arrays.items():
                file.create_dataset(key, data=array)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
