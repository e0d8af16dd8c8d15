"""Scores on held-out logs by hand: of any method, and of one that has subgoals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError
from guider.evaluation import heldout
from guider.evaluation.heldout import held_out_scores
from guider.learning.problem import Problem
from guider.methods import METHODS
from guider.methods.flat import FlatConfig
from guider.methods.view import ViewConfig


def line(positions, lengths, actions=None) -> Episodes:
    positions = np.asarray(positions, float)[:, None]
    taken = np.zeros_like(positions) if actions is None else np.asarray(actions, float)[:, None]
    return make_episodes(positions, taken, lengths, (0,), action_low=0, action_high=4)


def a_tenth(config, state, goal_indices, observation, goal, acting, reset_mask):
    return (goal - observation) / 10, acting


def test_action_error_by_hand(monkeypatch):
    """Asked for the state two steps on, 3, 5, 7 and (the episode ends) 4 away, it answers a tenth of that."""
    method = SimpleNamespace(act=a_tenth, initial_acting_state=lambda config, goal_dim, count: (), subgoals=None)
    monkeypatch.setitem(METHODS, "a tenth", method)
    policy: Any = SimpleNamespace(
        method="a tenth", config=FlatConfig(Problem(period_steps=2)), state=(), goal_indices=(0,), goal_dim=1
    )
    scores = held_out_scores(policy, line([0, 1, 3, 6, 10], [5], actions=[0, 1, 2, 4, 0]))
    scaled = np.array([-1, -0.5, 0, 1])
    answers = np.array([0.3, 0.5, 0.7, 0.4])
    assert scores == {
        "action_error": pytest.approx(np.mean((answers - scaled) ** 2)),
        "action_spread": pytest.approx(np.mean(scaled**2) - scaled.mean() ** 2),
    }
    with pytest.raises(GuiderError, match="no held-out episode holds a window of 2 steps"):
        policy.config = FlatConfig(Problem(period_steps=2), ViewConfig("drop"))
        held_out_scores(policy, line([0, 1], [2]))


@pytest.fixture
def guided(monkeypatch) -> Any:
    """A policy that holds moves below 4 for likely, proposes a state 0.25 beyond the final goal, and values being far
    from it."""
    subgoals = SimpleNamespace(
        fit=lambda config, state, achieved, outcome: jnp.mean(jnp.abs(outcome - achieved) < 4),
        propose=lambda config, state, observation, achieved, goal: (goal + 0.25, jnp.abs(goal - achieved)[:, 0]),
        reach=lambda config, state, observation, achieved, subgoal, goal: (subgoal - achieved) / 10,
    )
    monkeypatch.setitem(METHODS, "guided", SimpleNamespace(subgoals=subgoals))
    return SimpleNamespace(method="guided", config=FlatConfig(Problem(period_steps=1)), state=())


def test_scores_of_parts_by_hand(guided):
    """Moves of 3.5 are likely, those of 5 are not; 1000 apart, places have little to do with each other."""
    positions = [0, 1, 4.5, 9.5, 1000, 1003.5, 1007, 1012]
    scores = held_out_scores(guided, line(positions, [4, 4]))
    assert scores["prior_coverage"] == pytest.approx(4 / 6)
    shuffled = scores["prior_coverage_shuffled"]
    assert shuffled is not None and shuffled < 0.5
    # Proposed are 9.75 and 1012.25; the windows that start nearest do so at 4.5 and at 1007.
    assert scores["subgoal_distance"] == pytest.approx(5.25)
    assert scores["value_rank"] == pytest.approx(-1), "the value falls on the way"
    assert scores["action_error"] == pytest.approx(np.mean([(move / 10 + 1) ** 2 for move in (1, 3.5, 5, 3.5, 3.5, 5)]))


def test_subgoals_in_range_are_those_no_further_than_nearly_all_moves(guided):
    """Six moves of 1 and one of 6, of which 5.7 is the 99 % quantile; proposed are moves of 1.25 to 6.25, and 6.25."""
    scores = held_out_scores(guided, line([0, 1, 2, 3, 4, 5, 6, 0, 6], [7, 2]))
    assert scores["subgoals_in_range"] == pytest.approx(5 / 7)


def test_rank_correlation_by_hand():
    """Spearman's: 1 - 6 sum(d^2) / (n (n^2 - 1)). Short episodes, and values that never change, say nothing."""
    rank = heldout._mean_rank_correlation
    assert rank(np.array([1.0, 5, 7, 100]), np.zeros(4)) == pytest.approx(1)
    assert rank(np.array([1.0, 9, 5]), np.zeros(3)) == pytest.approx(1 - 6 * 2 / 24)
    two = np.array([1.0, 9, 5, 3, 2, 1, 4, 3]), np.array([0, 0, 0, 1, 1, 1, 2, 2])
    assert rank(*two) == pytest.approx((0.5 - 1) / 2)
    assert rank(np.array([1.0, 2, 3, 3, 3, 3]), np.array([0, 0, 1, 1, 1, 1])) is None
