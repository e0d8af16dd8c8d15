"""A goal is met where the environment says so, or there is no such task."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

from guider.errors import GuiderError
from guider.tasks import find_task
from guider.tasks.goal_measure import environments_rule, first_disagreement, radius_of

ANYWHERE = Box(-np.inf, np.inf, (3,), np.float64)
GOALS = np.array([[1.0, 2.0, 3.0], [-1.0, 0.0, 0.5]])


def distance(achieved, desired):
    return np.linalg.norm(achieved - desired)


def env(compute_reward) -> Any:
    return SimpleNamespace(unwrapped=SimpleNamespace(compute_reward=compute_reward))


@pytest.mark.parametrize("missed, met", [(-1, 0), (0, 1), (-0.0, 10)])
def test_a_sparse_reward_of_any_convention_says_what_is_met(missed, met):
    rule = environments_rule(env(lambda a, d, info: met if distance(a, d) <= 0.2 else missed), GOALS)
    assert rule is not None
    near, far = GOALS[0] + [0.19, 0, 0], GOALS[0] + [0.21, 0, 0]
    assert rule(near, GOALS[0]) and not rule(far, GOALS[0])
    assert first_disagreement(rule, ANYWHERE, GOALS, 0.2) is None
    assert radius_of(rule, ANYWHERE, GOALS) == 0.2


def test_a_radius_has_three_digits():
    def met(achieved, desired) -> bool:
        return bool(distance(achieved, desired) <= 0.125)

    assert radius_of(met, ANYWHERE, GOALS) == 0.125


def dense(achieved, desired, info):
    return -distance(achieved, desired)


def with_info(achieved, desired, info):
    return info["contact"]


def missing(achieved, desired, info):
    raise NotImplementedError


@pytest.mark.parametrize("compute_reward", [dense, with_info, missing, None])
def test_what_cannot_say_what_is_met_is_told_apart(compute_reward):
    assert environments_rule(env(compute_reward), GOALS) is None


def in_parts(achieved, desired):
    return distance(achieved[:2], desired[:2]) < 0.2 and abs(achieved[2] - desired[2]) < 0.2


def with_a_turn(achieved, desired) -> bool:
    away = achieved - desired
    away[2] = (away[2] + np.pi) % (2 * np.pi) - np.pi
    return bool(np.linalg.norm(away) < 0.2)


@pytest.mark.parametrize(
    "met",
    [
        in_parts,
        with_a_turn,
        lambda a, d: distance(a[:2], d[:2]) < 0.2,
        lambda a, d: True,
        lambda a, d: max(a - d) < 0.2,
    ],
)
def test_other_measures_are_found_out(met):
    away = first_disagreement(met, ANYWHERE, GOALS, 0.2)
    assert away is not None and met(GOALS[0] + away, GOALS[0]) != (np.linalg.norm(away) <= 0.2)
    assert radius_of(met, ANYWHERE, GOALS) is None


def test_only_what_can_be_achieved_counts():
    """An angle within half a turn never comes round, but at the ends of its range it does."""
    half, little = Box(-1, 4, (3,), np.float64), Box(-np.pi, np.pi, (3,), np.float64)
    assert first_disagreement(with_a_turn, half, np.array([[1.0, 2.0, 1.5]]), 0.2) is None
    away = first_disagreement(with_a_turn, little, np.array([[1.0, 2.0, 0.0]]), 0.2)
    assert away is not None
    np.testing.assert_allclose(away, [0, 0, -2 * np.pi])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("HandManipulateBlock-v1", r"0.0101, 0, 0, 0\], which is 0.0101 off, .* missed, .* met; .*--goal-indices"),
        ("HandManipulateEggRotate-v1", r"otherwise than within 0.01: at desired_goal \+ \[0.0101, 0, 0, 0, 0, 0, 0\]"),
        ("PointMaze_UMaze-v3?radius=0.5", "0.495 off, .* met, .* missed; its own radius is 0.45: .*radius=0.45$"),
        ("PointMaze_UMaze-v3", r"does not say its radius; add it: gym:PointMaze_UMaze-v3\?radius=0.45$"),
    ],
)
def test_goals_that_gymnasium_robotics_measures_otherwise_are_refused(name, message):
    pytest.importorskip("gymnasium_robotics")
    with pytest.raises(GuiderError, match=message) as caught:
        find_task(f"gym:{name}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["FetchSlide-v4", "HandReach-v3", "AntMaze_UMaze-v5?radius=0.45"])
def test_goals_measured_by_a_distance_are_taken(name):
    pytest.importorskip("gymnasium_robotics")
    assert find_task(f"gym:{name}").summary == f"the goal environment {name.partition('?')[0]}"


def test_a_radius_that_a_dense_reward_cannot_confirm_is_marked():
    pytest.importorskip("gymnasium_robotics")
    assert "compute_reward cannot say" in find_task("gym:FetchReachDense-v4").summary
