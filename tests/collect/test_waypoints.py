"""Recording in a maze, on a point that goes where its actions say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from guider.collect import waypoints
from guider.collect.waypoints import Guide, Recipe, record
from guider.tasks.mazes import make_maze

MAZE = make_maze("umaze", 1.0)


class Point:
    """Copies that begin at the start, and move by their actions; keeps what it was told."""

    def __init__(self, count: int):
        self.count = count

    def reset(self, seeds):
        self.xy = np.zeros((self.count, 2), np.float32)
        self.told: list[np.ndarray] = []
        return self.xy, self.xy

    def step(self, actions, active):
        self.told.append(actions)
        self.xy = self.xy + actions
        return self.xy

    def close(self):
        pass


def towards(observations, aims):
    """Half a cell at a time, at most."""
    return np.clip(aims - observations[:, :2], -0.5, 0.5)


RECIPE = Recipe(
    MAZE, Point, towards, 2, 10, goal_cells=MAZE.free_cells, goal_offsets_m=((-0.1, 0.1),), goal_radius_m=0.2
)


def quietly(recipe: Recipe, steps: int, seed: int = 0) -> Any:
    return record(recipe, steps, seed, lambda done, total: None)


def test_offsets_are_of_waypoints_and_not_of_goals():
    """The goal is in cell (3, 1), up and round the bend: from (2, 3) the next cell lies in its row, two off."""
    positions, goals = np.array([[2.0, 1.0], [2.0, 2.0], [1.0, 2.0], [0.0, 2.0]]), np.tile([0.1, 1.9], (4, 1))
    offsets = np.full((4, 2), [0.2, -0.3])
    aims = Guide(MAZE).waypoints(positions, goals, offsets)
    np.testing.assert_allclose(aims, [[2.2, 1.7], [1.2, 1.7], [0.1, 1.9], [0.1, 1.9]])


def test_the_last_episode_is_cut_short():
    recording = quietly(RECIPE, 25)
    assert recording.lengths.tolist() == [10, 10, 5]
    assert len(recording.observations) == len(recording.actions) == len(recording.goals) == 25
    starts = recording.observations[[0, 10, 20]]
    assert not starts.any()
    inside = np.setdiff1d(np.arange(24), [9, 19])
    moved = recording.observations[inside] + recording.actions[inside]
    np.testing.assert_allclose(recording.observations[inside + 1], moved, atol=1e-6)


def test_logged_actions_are_those_taken_and_within_bounds():
    recording = quietly(replace(RECIPE, noise_spread=3.0), 1000)
    assert np.abs(recording.actions).max() == 1.0
    inside = np.setdiff1d(np.arange(999), np.arange(9, 1000, 10))
    moved = recording.observations[inside] + recording.actions[inside]
    np.testing.assert_allclose(recording.observations[inside + 1], moved, atol=1e-5)


@pytest.mark.parametrize("further", [True, False])
def test_a_goal_changes_when_it_is_reached_or_never(further):
    recording = quietly(replace(RECIPE, episode_steps=100, further_goals=further), 3000)
    inside = np.setdiff1d(np.arange(2999), np.arange(99, 3000, 100))
    distances = np.linalg.norm(recording.observations[inside + 1] - recording.goals[inside], axis=1)
    changed = (recording.goals[inside + 1] != recording.goals[inside]).any(axis=1)
    np.testing.assert_array_equal(changed, (distances <= 0.2) & further)
    assert (distances <= 0.2).sum() > 100


def test_bursts_hold_one_action_for_their_time():
    """Of the runs of steps with a burst on that no other burst followed, each has its 7 steps."""
    recipe = replace(RECIPE, episode_steps=20_000, burst_chance=0.005, burst_steps=7)
    _, _, noise, held, on = waypoints._draw_script(recipe, np.random.default_rng(0))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int))).reshape(-1, 2)
    lengths = np.diff(edges, axis=1)[:, 0]
    assert lengths.min() == np.median(lengths) == 7
    alone = edges[lengths == 7]
    assert all(len(np.unique(held[first:last], axis=0)) == 1 for first, last in alone)
    assert on.mean() == pytest.approx(1 - 0.995**7, rel=0.15)
    assert np.abs(held).max() <= 1 and not noise.any()
    quiet = waypoints._draw_script(replace(recipe, burst_chance=0.0), np.random.default_rng(0))
    assert not quiet[-1].any()


def test_a_burst_takes_the_place_of_what_the_controller_would_do():
    recipe = replace(RECIPE, controller=lambda observations, aims: np.zeros((len(aims), 2)), burst_chance=0.05)
    recording = quietly(replace(recipe, episode_steps=1000, burst_steps=2), 1000)
    moving = recording.actions.any(axis=1)
    assert moving.mean() == pytest.approx(1 - 0.95**2, abs=0.03)
