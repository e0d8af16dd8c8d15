"""How episodes in a maze ended, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from guider.evaluation.outcomes import ending, proposed, share_in_walls, share_off_data
from guider.evaluation.rollouts import Trace
from guider.tasks import find_task
from guider.tasks.antmaze import INITIAL_QPOS, on_its_back
from guider.tasks.mazes import make_maze

TASK = replace(find_task("antmaze-umaze-diverse"), horizon_steps=100)
MAZE = make_maze("umaze", 4.0)
UPRIGHT = np.array([*INITIAL_QPOS, *np.zeros(14)])


def trace(last_steps_m: float = 0.0, success: bool = False, state: np.ndarray = UPRIGHT) -> Trace:
    """80 steps far away, then 20 from (x, 0) = last_steps_m to 0."""
    x = np.concatenate([np.full(80, 8.0), np.linspace(last_steps_m, 0.0, 20)])
    achieved = np.stack([x, np.zeros(100)], axis=1)
    renewed = np.arange(100) % 50 == 0
    subgoals = np.stack([np.arange(100.0), np.ones(100)], axis=1)
    return Trace(achieved, subgoals, renewed, np.zeros(2), success, state)


def lying(degrees: float) -> np.ndarray:
    """The ant rolled about its x axis; its quaternion is not of unit length."""
    state = UPRIGHT.copy()
    state[3:7] = 3 * np.array([np.cos(np.radians(degrees) / 2), np.sin(np.radians(degrees) / 2), 0, 0])
    return state


@pytest.mark.parametrize(("degrees", "fallen"), [(0, False), (89, False), (91, True), (180, True), (271, False)])
def test_an_ant_has_fallen_once_its_up_axis_points_down(degrees, fallen):
    assert on_its_back(lying(degrees)) == fallen


@pytest.mark.parametrize(
    ("episode", "ended"),
    [
        (trace(success=True, state=lying(180)), "met"),
        (trace(state=lying(180)), "fell"),
        (trace(1.99), "stuck"),
        (trace(2.01), "time"),
    ],
)
def test_endings(episode, ended):
    assert ending(episode, TASK, MAZE) == ended


def test_a_robot_that_cannot_fall_never_does():
    assert ending(trace(state=lying(180)), replace(TASK, fallen=None), MAZE) == "stuck"


def test_subgoals_count_as_often_as_they_were_chosen():
    np.testing.assert_array_equal(proposed([trace(), trace()]), [[0, 1], [50, 1], [0, 1], [50, 1]])


def test_share_off_data_counts_subgoals_without_a_logged_place_in_reach():
    logged = np.array([[0.0, 0.0], [10.0, 0.0]])
    subgoals = np.array([[1.0, 0.0], [1.01, 0.0], [10.0, -0.5], [5.0, 0.0]])
    assert share_off_data(subgoals, logged, 1.0) == 0.5


def test_share_in_walls():
    """In umaze the cell (2, 1), at (0, 4), is wall; a free cell reaches 2 m from its centre."""
    assert share_in_walls(np.array([[0.0, 4.0], [0.0, 1.9], [0.0, 2.1], [8.0, 4.0]]), MAZE) == 0.5
