"""The ant walker that records antmaze data."""

from dataclasses import replace

import numpy as np

from guider.collect.ant_walker import VIEW_DIM, rotations, walk, walker_view
from guider.collect.waypoints import record
from guider.tasks.antmaze import GOAL_RADIUS_M, INITIAL_QPOS, diverse, sample_start_anywhere
from guider.tasks.mazes import make_maze


def test_rotations_by_hand():
    half = np.sqrt(0.5)
    quarter_turns = np.array([[half, 0, 0, half], [2 * half, 2 * half, 0, 0]])  # about z; about x, not of unit length
    about_z, about_x = rotations(quarter_turns)
    np.testing.assert_allclose(about_z @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(about_x @ [0, 1, 0], [0, 0, 1], atol=1e-12)


def test_the_walker_sees_its_direction_and_speed_in_its_own_frame():
    """An ant turned a quarter to the left that moves along world y, told to go along world y: straight ahead."""
    states = np.zeros((1, 29))
    states[0, :15] = INITIAL_QPOS
    states[0, 3:7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    states[0, 15:18] = [0.0, 2.0, 0.5]
    view = walker_view(states, np.array([[0.0, 7.0]]))[0]
    assert view.shape == (VIEW_DIM,)
    np.testing.assert_allclose(view[:4], [0.55, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(view[12:15], [2, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(view[-3:], [1, 0, 0], atol=1e-12)


def test_turning_the_world_does_not_change_the_action():
    rng = np.random.default_rng(0)
    states = rng.standard_normal((5, 29))
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    waypoints = states[:, :2] + rng.standard_normal((5, 2))
    turned = states.copy()
    w, x, y, z = states[:, 3:7].T
    turned[:, 3:7] = np.stack([-z, -y, x, w], axis=1)  # (0, 0, 0, 1) * q: half a turn about z
    turned[:, 15:17] *= -1
    turned[:, :2] *= -1
    np.testing.assert_allclose(walk(states, waypoints), walk(turned, -waypoints), atol=1e-6)


def test_recordings_start_in_every_cell():
    maze = make_maze("umaze", 4.0)
    rng = np.random.default_rng(0)
    xy = np.array([sample_start_anywhere(maze, rng).qpos[:2] for _ in range(700)])
    cells, counts = np.unique(maze.cell_of(xy), axis=0, return_counts=True)
    np.testing.assert_array_equal(cells, maze.free_cells)
    assert counts.min() > 60  # of 100 expected in each of 7 cells


def test_the_walker_reaches_its_goals():
    """Measured over 100 episodes of 1000 steps in each maze: 97 %; here are shorter ones in the smallest."""
    recipe = replace(diverse(make_maze("umaze", 4.0)), episode_steps=300)
    recording = record(recipe, 20 * 300, 0, lambda done, total: None)
    assert recording.goals is not None
    distances = np.linalg.norm(recording.observations[:, :2] - recording.goals, axis=1).reshape(20, 300)
    assert (distances.min(axis=1) <= GOAL_RADIUS_M).mean() >= 0.8
    assert recording.actions.min() >= -1 and recording.actions.max() <= 1
    assert np.all(recording.goals.reshape(20, 300, 2) == recording.goals.reshape(20, 300, 2)[:, :1]), "one goal each"
