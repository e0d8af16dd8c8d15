"""Scores of episodes, worked out by hand on a scripted environment."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from guider.evaluation import bootstrap_interval, rollout
from guider.tasks import find_task

PATHS = np.array(
    [
        [[0, 9], [0, 9], [5, 0], [5, 5]],  # object 1 in place for two steps, then object 2 for one: never both
        [[9, 9], [0, 0], [0, 9], [0, 0]],  # both in place at steps 2 and 4
    ],
    np.float32,
)


class Scripted:
    """Two copies that follow PATHS whatever they are told; both objects' goals are at 0."""

    count = 2

    def reset(self, seeds):
        self.steps = np.zeros(2, int)
        return np.full((2, 2), 9, np.float32), np.zeros((2, 2), np.float32)

    def step(self, actions, active):
        self.steps += active
        return PATHS[np.arange(2), np.maximum(self.steps, 1) - 1]

    def close(self):
        pass


def scored(score, parts, monkeypatch):
    monkeypatch.setattr("guider.evaluation.compiled_act", lambda policy, obs, goal, state, mask: (jnp.zeros(2), state))
    monkeypatch.setattr("guider.evaluation.initial_state", lambda policy, count: None)
    task = replace(
        find_task("pointmaze-umaze"),
        goal_indices=(0, 1),
        goal_parts=parts,
        radius=0.5,
        horizon_steps=4,
        score=score,
        make_env=lambda count: Scripted(),
    )
    policy: Any = SimpleNamespace(method="gcsl")  # what it would answer stands above
    return rollout(policy, task, 2, 0)


@pytest.mark.parametrize(
    ("score", "parts", "scores", "success", "steps"),
    [
        ("success", (), [0, 100], [False, True], [4, 2]),
        ("return", (), [0, 2], [False, True], [4, 2]),
        ("subtasks", ((0,), (1,)), [100, 100], [True, True], [3, 2]),
        ("return", ((0,),), [2, 3], [True, True], [1, 2]),
    ],
)
def test_scores_by_hand(score, parts, scores, success, steps, monkeypatch):
    outcome = scored(score, parts, monkeypatch)
    assert outcome.score.tolist() == scores
    assert outcome.success.tolist() == success
    assert outcome.steps.tolist() == steps
    lengths = [4, 4] if score == "return" else steps
    for trace, path, length in zip(outcome.traces, PATHS, lengths, strict=True):
        before = [[9, 9], *path.tolist()][:length]
        assert trace.achieved.tolist() == before and trace.last_state.tolist() == path[length - 1].tolist()
        assert trace.renewed.tolist() == [True] + [False] * (length - 1), "without subgoals the goal is the only one"


def test_bootstrap_interval_is_that_of_the_mean():
    """Of one seed with n episodes of spread s, mean +- 1.96 s / sqrt(n)."""
    scores = np.random.default_rng(0).normal(40.0, 10.0, (1, 400))
    low, high = bootstrap_interval(scores)
    assert (low + high) / 2 == pytest.approx(scores.mean(), abs=0.15)
    assert (high - low) / 2 == pytest.approx(1.96 * scores.std() / 20, rel=0.08)
