"""Recording data in a maze: a controller is led from cell to cell, with noise, and every step is logged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from guider.collect import check_steps
from guider.data.ends import lengths_from_ends
from guider.data.store import Recording

if TYPE_CHECKING:  # guider.tasks imports this module
    from guider.tasks.mazes import Maze
    from guider.tasks.types import VectorEnv

EPISODES_AT_ONCE = 256


@dataclass(frozen=True)
class Recipe:
    """How to record data in a maze.

    An episode starts where `make_env` puts it and aims at a point in a cell drawn uniformly from `goal_cells`. The
    controller's actions get Gaussian noise, and now and then a burst replaces them: one random action, held for some
    steps.

    make_env:      number of copies -> environment; an observation begins with (x, y) in metres
    controller:    (observations [n, state_dim], waypoints [n, 2]) -> actions [n, action_dim]; without memory
    episode_steps: rows of an episode
    goal_cells:    [cells, 2] (row, column) that goals are drawn in
    goal_offsets_m: (least, greatest) of each uniform draw whose sum is a goal's distance from its cell's centre, along
                   each axis
    goal_radius_m: within this distance of its goal an episode has reached it
    further_goals: whether an episode that reaches its goal is given another, so that it does not idle
    waypoint_offset_m: (least, greatest) distance of a waypoint from its cell's centre, uniform, along each axis
    centre_to_centre: see Guide
    noise_spread:  standard deviation of the noise on every action entry
    burst_chance:  probability that a burst begins at a step
    burst_steps:   how long a burst lasts
    """

    maze: Maze
    make_env: Callable[[int], VectorEnv]
    controller: Callable[[np.ndarray, np.ndarray], np.ndarray]
    action_dim: int
    episode_steps: int
    goal_cells: np.ndarray
    goal_offsets_m: tuple[tuple[float, float], ...]
    goal_radius_m: float
    further_goals: bool = True
    waypoint_offset_m: tuple[float, float] = (0.0, 0.0)
    centre_to_centre: bool = False
    noise_spread: float = 0.0
    burst_chance: float = 0.0
    burst_steps: int = 1


@dataclass(frozen=True)
class Guide:
    """Knows a waypoint for every position and goal in a maze.

    centre_to_centre: take a cell to reach from its centre to the next one's, and a wall entered so to lead to its free
        neighbour nearest to the goal, as D4RL's guide does: one heads for a cell until past its centre on its way to
        greater x or y, and turns early on the way back. Without, cells are as they are drawn.
    """

    maze: Maze
    centre_to_centre: bool = False

    @cached_property
    def _next_cells(self) -> np.ndarray:
        """[rows, columns, rows, columns, 2]: goal cell, current cell -> the cell to enter next."""
        table = np.zeros((*self.maze.walls.shape, *self.maze.walls.shape, 2), int)
        for row, column in self.maze.free_cells:
            table[row, column] = self.maze.next_cells_to((row, column), across_walls=self.centre_to_centre)
        return table

    def _cell_of(self, xy: np.ndarray) -> np.ndarray:
        if self.centre_to_centre:
            xy = np.maximum(xy, 0.0) - self.maze.cell_size_m / 2
        return self.maze.cell_of(xy)

    def waypoints(self, xy: np.ndarray, goals: np.ndarray, offsets: np.ndarray | float = 0.0) -> np.ndarray:
        """[n, 2] positions, [n, 2] goals in free cells, [n, 2] offsets -> [n, 2] where to head, all in metres.

        The offset from the centre of the next cell on a shortest way, or the goal itself once the next cell is its own.
        """
        goal_cells = self._cell_of(goals)
        following = self._next_cells[(*goal_cells.T, *self._cell_of(xy).T)]
        arriving = np.all(following == goal_cells, axis=-1)
        return np.where(arriving[:, None], goals, self.maze.cell_centre(following) + offsets)


def record(recipe: Recipe, steps: int, seed: int, report: Callable[[int, int], None]) -> Recording:
    """Record `steps` rows by `recipe`. The last episode is cut short if that is no multiple of `episode_steps`.

    Equal arguments give equal recordings, whatever the number of cores. report: called with (rows done, rows in all).
    Raises GuiderError if `steps` is below 2.
    """
    check_steps(steps)
    episodes = -(-steps // recipe.episode_steps)
    seeds = np.random.SeedSequence(seed).generate_state(episodes, np.uint64)
    guide = Guide(recipe.maze, recipe.centre_to_centre)
    batches = []
    report(0, steps)
    for first in range(0, episodes, EPISODES_AT_ONCE):
        batches.append(_record_episodes(recipe, guide, seeds[first : first + EPISODES_AT_ONCE]))
        report(min((first + EPISODES_AT_ONCE) * recipe.episode_steps, steps), steps)
    observations, actions, goals = (np.concatenate(parts)[:steps] for parts in zip(*batches, strict=True))
    lengths = lengths_from_ends(np.arange(1, steps + 1) % recipe.episode_steps == 0)
    bound = np.ones(recipe.action_dim, np.float32)
    return Recording(observations, actions, lengths, goals, -bound, bound)


def _record_episodes(recipe: Recipe, guide: Guide, seeds: np.ndarray) -> tuple[np.ndarray, ...]:
    """Observations, actions and goals of whole episodes, laid end to end; episode i is determined by seeds[i]."""
    scripts = [_draw_script(recipe, np.random.default_rng([int(seed), 1])) for seed in seeds]
    goals, offsets, noise, bursts, in_burst = (np.stack(parts) for parts in zip(*scripts, strict=True))
    rows = np.arange(len(seeds))
    everyone = np.ones(len(seeds), bool)
    goal_number = np.zeros(len(seeds), int)
    log: list[tuple[np.ndarray, ...]] = []

    env = recipe.make_env(len(seeds))
    try:
        observations, _ = env.reset(seeds)
        for t in range(recipe.episode_steps):
            goal = goals[rows, goal_number]
            waypoints = guide.waypoints(observations[:, :2], goal, offsets[:, t])
            noisy = recipe.controller(observations, waypoints) + noise[:, t]
            actions = np.where(in_burst[:, t, None], bursts[:, t], np.clip(noisy, -1.0, 1.0)).astype(np.float32)
            log.append((observations, actions, goal))
            observations = env.step(actions, everyone)
            reached = np.linalg.norm(observations[:, :2] - goal, axis=1) <= recipe.goal_radius_m
            goal_number += reached & recipe.further_goals
    finally:
        env.close()
    stacked = (np.stack(parts, axis=1).astype(np.float32) for parts in zip(*log, strict=True))
    return tuple(array.reshape(-1, array.shape[2]) for array in stacked)


def _draw_script(recipe: Recipe, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """All the randomness of one episode but its start, drawn ahead.

    Returns goals [T, 2] in the order they are taken up, offsets of waypoints [T, 2], action noise [T, action_dim],
    burst actions [T, action_dim] and whether a burst is on [T], with T = episode_steps.
    """
    length = recipe.episode_steps
    cells = recipe.goal_cells[rng.integers(len(recipe.goal_cells), size=length)]
    offsets = sum(rng.uniform(*bounds, (length, 2)) for bounds in recipe.goal_offsets_m)
    goals = recipe.maze.cell_centre(cells) + offsets
    noise = recipe.noise_spread * rng.standard_normal((length, recipe.action_dim))
    steps = np.arange(length)
    begins = rng.random(length) < recipe.burst_chance
    latest = np.maximum.accumulate(np.where(begins, steps, -recipe.burst_steps))
    held = rng.uniform(-1.0, 1.0, (length, recipe.action_dim))[np.maximum(latest, 0)]
    waypoint_offsets = rng.uniform(*recipe.waypoint_offset_m, (length, 2))
    return goals, waypoint_offsets, noise, held, steps - latest < recipe.burst_steps
