"""The robots that defaults for own data are measured on: their operators know the way, and equal seeds log alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robots import FLAT, ROBOTS, SEA, logs


@pytest.mark.parametrize("name", ROBOTS)
def test_operators_meet_their_goals_and_equal_seeds_log_alike(name):
    robot = replace(ROBOTS[name], episodes=6)
    found, again = logs(robot, 3), logs(robot, 3)
    assert found.fingerprint() == again.fingerprint() != logs(robot, 4).fingerprint()
    assert len(found.starts) == 6 and found.lengths.max() <= robot.rows
    moved = np.linalg.norm(found.achieved[found.ends] - found.achieved[found.starts], axis=1)
    assert (moved > robot.radius).sum() >= 4
    if robot.stops:
        assert (found.lengths < robot.rows).sum() >= 5  # it stopped, being there


@pytest.mark.parametrize("field", [FLAT, SEA])
def test_ways_lead_round_obstacles(field):
    """From one side of the first obstacle to the other, where straight ahead is blocked."""
    left, bottom, right, top = field.obstacles[0]
    middle = (bottom + top) / 2
    start, goal = (np.array([x, middle]) for x in (left - 3 * field.margin, right + 3 * field.margin))
    lengths = field.lengths_to(goal)
    straight = np.linalg.norm(goal - start)
    assert not field.blocked(start) and field.blocked(np.array([(left + right) / 2, middle]))
    assert np.isinf(lengths[~field.free]).all() and np.isfinite(lengths[field.free]).all()
    assert lengths[field.index(start)] > 1.5 * straight
    at, steps = start, 0
    while np.linalg.norm(goal - at) > field.cell and steps < 500:
        ahead = field.ahead(at, lengths, goal, 1)
        assert np.linalg.norm(ahead - at) <= 3 * field.cell and not field.blocked(ahead)
        at, steps = ahead, steps + 1
    assert steps * field.cell * 1.5 > straight and steps < 500
