"""Distances in goal space by hand, and which state entries hold the goal."""

import jax.numpy as jnp
import numpy as np
import pytest

from guider.goals import goal_entries, largest_distance, part_distances

ACHIEVED, GOAL = np.array([[3.0, 0.0, 4.0], [1.0, 2.0, 2.0]]), np.zeros((2, 3))


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray])
@pytest.mark.parametrize(
    ("parts", "distances", "largest"),
    [
        ((), [[5], [3]], [5, 3]),
        (((0,), (1, 2)), [[3, 4], [1, 8**0.5]], [4, 8**0.5]),
        (((2, 0), (1,)), [[5, 0], [5**0.5, 2]], [5, 5**0.5]),
    ],
)
def test_distances_by_hand(array, parts, distances, largest):
    achieved, goal = array(ACHIEVED), array(GOAL)
    np.testing.assert_allclose(part_distances(achieved, goal, parts), distances, rtol=1e-6)
    np.testing.assert_allclose(largest_distance(achieved, goal, parts), largest, rtol=1e-6)


def test_entries_of_the_goal_are_found_each_once():
    """Entries 0 and 2 are alike; 1 differs from 3 by more than rounding, and from row 100 on alone."""
    states = np.random.default_rng(0).normal(size=(150, 4))
    states[:, 2], states[:, 1] = states[:, 0], states[:, 3]
    states[120, 1] += 1e-3
    assert goal_entries(states, states[:, [0]]) == (0,)
    assert goal_entries(states, states[:, [3, 0, 0]]) == (3, 0, 2)
    assert goal_entries(states, states[:, [3]] + 1e-6) == (3,)
    assert goal_entries(states, states[:, [0, 0, 0]]) is None
    assert goal_entries(states, states[:, [3]] + 1e-3) is None
