"""Scores of episodes, worked out by hand on a scripted environment."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from guider.evaluation.rollouts import Rollouts, bootstrap_interval, rollout, success_interval, wilson_interval
from guider.evaluation.summary import summary
from guider.tasks import find_task

PATHS = np.array(
    [
        [[0, 9], [0, 9], [5, 0.5], [5, 5]],  # object 1 in place for two steps, then object 2 for one: never both
        [[9, 9], [0, 0], [0, 9], [0, 0]],  # both in place at steps 2 and 4
    ],
    np.float32,
)


class Scripted:
    """Two copies that follow PATHS whatever they are told; both goals are at 0. Keeps the seeds it is given."""

    count = 2

    def __init__(self):
        self.seeds = []

    def reset(self, seeds):
        self.seeds.extend(seeds)
        self.steps = np.zeros(2, int)
        return np.full((2, 2), 9, np.float32), np.zeros((2, 2), np.float32)

    def step(self, actions, active):
        self.steps += active
        return PATHS[np.arange(2), np.maximum(self.steps, 1) - 1]

    def close(self):
        pass


def scored(score, parts, monkeypatch, episodes=2, part_radii=()):
    """(outcome, environment, whether the policy was told that episodes begin, a step an entry)."""
    env, begins = Scripted(), []

    def act(policy, observation, goal, state, reset_mask):
        begins.append(reset_mask.tolist())
        return jnp.zeros(2), state

    monkeypatch.setattr("guider.evaluation.rollouts.compiled_act", act)
    monkeypatch.setattr("guider.evaluation.rollouts.initial_state", lambda policy, count: None)
    task = replace(
        find_task("pointmaze-umaze"),
        goal_indices=(0, 1),
        goal_parts=parts,
        part_radii=part_radii,
        radius=0.5,
        horizon_steps=4,
        score=score,
        make_env=lambda count: env,
        copies=2,
    )
    policy: Any = SimpleNamespace(method="gcsl")  # what it would answer stands above
    return rollout(policy, task, episodes, 7), env, begins


@pytest.mark.parametrize(
    ("score", "parts", "scores", "success", "steps", "taken"),
    [
        ("success", (), [0, 100], [False, True], [4, 2], [4, 2]),
        ("return", (), [0, 2], [False, True], [4, 2], [4, 4]),
        ("subtasks", ((0,), (1,)), [100, 100], [True, True], [3, 2], [3, 2]),
        ("return", ((0,),), [2, 3], [True, True], [1, 2], [4, 4]),
        ("return", ((0,), (1,)), [0, 2], [False, True], [4, 2], [4, 4]),
    ],
)
def test_scores_by_hand(score, parts, scores, success, steps, taken, monkeypatch):
    """The third step of the first copy ends at 0.5, the radius, which counts as met."""
    outcome, env, _ = scored(score, parts, monkeypatch)
    assert outcome.score.tolist() == scores
    assert outcome.success.tolist() == success
    assert outcome.steps.tolist() == steps
    assert env.steps.tolist() == taken, "an episode that has ended is left alone"


def test_a_part_may_be_judged_by_a_radius_of_its_own(monkeypatch):
    """The third step of the first copy ends at (5, 0.5)."""
    for radius, score in (5.0, 100), (4.9, 0):
        outcome, *_ = scored("success", ((0,), (1,)), monkeypatch, part_radii=(radius, 0.5))
        assert outcome.score.tolist() == [score, 100]


def test_episodes_have_their_own_seeds_and_beginnings(monkeypatch):
    """Three episodes on two copies: the fourth is run, and left out."""
    outcome, env, begins = scored("success", (), monkeypatch, episodes=3)
    assert env.seeds == [7, 8, 9, 10]
    assert outcome.score.tolist() == [0, 100, 0] and len(outcome.success) == len(outcome.steps) == 3
    assert begins == [[True, True], *[[False, False]] * 3] * 2


@pytest.mark.parametrize(("score", "lengths"), [("success", [4, 2, 4]), ("return", [4, 4, 4])])
def test_traces_end_with_their_episodes(score, lengths, monkeypatch):
    """Without subgoals the goal is the only one, pursued from the first step on."""
    traces = scored(score, (), monkeypatch, episodes=3)[0].traces
    assert [len(trace.achieved) for trace in traces] == lengths
    for trace, path, success in zip(traces, PATHS[[0, 1, 0]], [False, True, False], strict=True):
        length = len(trace.achieved)
        np.testing.assert_array_equal(trace.achieved, np.array([[9, 9], *path[: length - 1]]))
        np.testing.assert_array_equal(trace.last_state, path[length - 1])
        assert trace.renewed.tolist() == [True, *[False] * (length - 1)] and trace.success == success
        assert len(trace.subgoals) == length and not trace.subgoals.any() and not trace.goal.any()


def test_wilson_interval_is_that_of_published_tables():
    """Newcombe 1998, Table I: 81 of 263, 15 of 148, 0 of 20 and 1 of 29."""
    published = {
        (81, 263): (0.2553, 0.3662),
        (15, 148): (0.0624, 0.1605),
        (0, 20): (0, 0.1611),
        (1, 29): (0.0061, 0.1718),
    }
    for counts, interval in published.items():
        assert wilson_interval(*counts) == pytest.approx(interval, abs=5e-5)


def test_success_interval_resamples_seeds_and_never_claims_certainty():
    """Twenty of twenty by Wilson: 20 / (20 + 1.96^2) = 83.9 % at least."""
    assert success_interval(np.ones((2, 10), bool)) == pytest.approx((83.89, 100), abs=0.01)
    assert success_interval(np.zeros((2, 10), bool)) == pytest.approx((0, 16.11), abs=0.01)
    one = np.array([[True] * 3 + [False]])
    assert success_interval(one) == pytest.approx(tuple(100 * bound for bound in wilson_interval(3, 4)))
    assert success_interval(np.array([[False] * 30, [True] * 30])) == (0, 100)  # Wilson's would be 38 to 62


def test_bootstrap_interval_is_that_of_the_mean():
    """Of one seed with n episodes of spread s, mean +- 1.96 s / sqrt(n)."""
    scores = np.random.default_rng(0).normal(40.0, 10.0, (1, 400))
    low, high = bootstrap_interval(scores)
    assert (low + high) / 2 == pytest.approx(scores.mean(), abs=0.15)
    assert (high - low) / 2 == pytest.approx(1.96 * scores.std() / 20, rel=0.08)


def test_bootstrap_interval_resamples_seeds_before_episodes():
    """Two seeds of episodes all alike: means are 0, 50 and 100 a quarter, a half and a quarter of the time."""
    assert bootstrap_interval(np.array([[0.0] * 30, [100.0] * 30])) == (0, 100)
    seeds = np.random.default_rng(1).normal(40.0, 10.0, (30, 1))
    low, high = bootstrap_interval(seeds)
    assert (high - low) / 2 == pytest.approx(1.96 * seeds.std() / 30**0.5, rel=0.08)


def test_several_goals_are_told_apart():
    """Of three trained seeds, two episodes each, from seed 4 on; three goals."""
    outcomes = [
        Rollouts(np.array(score, float), np.array(score) > 0, np.full(2, 3), ())
        for score in ([100, 0], [100, 100], [0, 0])
    ]
    task = replace(find_task("pointmaze-umaze"), goals=3)
    result = summary(task, outcomes, 4)
    assert result["per_goal"] == [50.0, 100.0, 0.0]  # seeds 6 and 9; 4 and 7; 5 and 8
    each = [seed["per_goal"] for seed in result["per_seed"]]
    assert each == [[None, 100.0, 0.0], [100.0, 100.0, None], [0.0, None, 0.0]]
    assert "per_goal" not in summary(replace(task, goals=1), outcomes, 4)
