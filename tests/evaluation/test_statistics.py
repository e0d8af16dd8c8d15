"""Statistics over seeds and tasks: by hand, by exact distributions, and as rliable computes them."""

from __future__ import annotations

import numpy as np
import pytest

from guider.evaluation.statistics import (
    interquartile_mean,
    mean_and_deviation,
    probability_of_improvement,
    stratified_bootstrap_interval,
)

# 4 and 3 runs of 5 tasks, with ties between the two in tasks 1 and 3.
FIRST = np.array(
    [
        [0.6, 0.66, 0.55, 0.42, 0.51],
        [0.4, 0.61, 0.87, 0.5, 0.48],
        [0.7, 0.67, 0.62, 0.41, 0.59],
        [0.74, 0.33, 0.51, 0.22, 0.34],
    ]
)
SECOND = np.array([[0.13, 0.67, 0.25, 0.55, 0.53], [0.46, 0.67, 0.39, 0.49, 0.52], [0.19, 0.4, 0.3, 0.42, 0.71]])


def task_means(scores: np.ndarray) -> np.ndarray:
    return scores.mean(axis=(-2, -1))


def test_mean_and_deviation_by_hand():
    assert mean_and_deviation(np.array([70.0, 80.0, 80.0, 90.0])) == (80.0, pytest.approx(50**0.5))


def test_interquartile_mean_by_hand():
    runs = np.array([[-1000.0, 1, 2, 3], [4, 5, 6, 1000]])
    assert interquartile_mean(runs) == (2 + 3 + 4 + 5) / 4  # 2 of 8 are left out at each end
    assert interquartile_mean(np.array([[0.0, 1, 2, 3, 4, 50]])) == (1 + 2 + 3 + 4) / 4  # a quarter of 6 is 1
    assert interquartile_mean(np.array([[1.0, 2, 6]])) == 3  # and of 3 none
    np.testing.assert_array_equal(interquartile_mean(np.stack([runs, 2 * runs])), [3.5, 7])


def test_probability_of_improvement_by_hand():
    """Task 0: 3 beats 1 and 2, 1 ties with 1 and loses to 2: 2.5 of 4. Task 1: never."""
    ours, theirs = np.array([[1.0, 0], [3, 0]]), np.array([[1.0, 5], [2, 5]])
    assert probability_of_improvement(ours, theirs) == (2.5 / 4 + 0) / 2
    assert probability_of_improvement(theirs, ours) == (1.5 / 4 + 1) / 2
    assert probability_of_improvement(ours, ours[:1]) == (0.75 + 0.5) / 2


def test_point_estimates_are_those_of_rliable():
    """Constants computed by rliable 1.2.0 (with SciPy 1.17.1) from the arrays above."""
    assert interquartile_mean(FIRST) == pytest.approx(0.539, abs=1e-12)
    assert interquartile_mean(SECOND) == pytest.approx(0.4511111111111111, abs=1e-12)
    assert task_means(FIRST) == pytest.approx(0.5365, abs=1e-12)
    assert probability_of_improvement(FIRST, SECOND) == pytest.approx(0.525, abs=1e-12)
    assert probability_of_improvement(SECOND, FIRST) == pytest.approx(0.475, abs=1e-12)
    assert probability_of_improvement(FIRST, FIRST) == 0.5


def test_the_interval_is_that_of_the_exact_bootstrap_distribution():
    """Resampled means of sixteen runs, half of them 1, are Binomial(16, 1/2) / 16; 1.1 % of it lies below 4, 3.8 % up
    to 4."""
    runs = np.repeat([0.0, 1.0], 8)[:, None]
    assert stratified_bootstrap_interval(task_means, runs) == (4 / 16, 12 / 16)


def test_runs_are_resampled_within_their_task_and_each_method_apart():
    """Tasks whose runs are all alike cannot move the mean; runs drawn across tasks would."""
    alike = np.array([[0.0, 1, 5]] * 4)
    assert stratified_bootstrap_interval(task_means, alike) == (2, 2)
    # The better of two runs is drawn by both, one or no draw; each draw pairs with any of the other method's.
    low, high = stratified_bootstrap_interval(probability_of_improvement, *[np.array([[0.0], [1.0]])] * 2)
    assert (low, high) == (0, 1)
    # A task's runs are compared with that task's.
    tasks = np.tile(np.arange(5.0), (3, 1))
    assert stratified_bootstrap_interval(probability_of_improvement, tasks + 0.5, tasks) == (1, 1)


def test_the_interval_of_many_tasks_is_narrower_by_their_root():
    """The mean over 16 independent tasks has a quarter of one task's spread."""
    runs = np.random.default_rng(1).normal(size=(30, 1))
    (low, high), (many_low, many_high) = (
        stratified_bootstrap_interval(task_means, np.repeat(runs, tasks, axis=1)) for tasks in (1, 16)
    )
    assert (many_high - many_low) / (high - low) == pytest.approx(0.25, rel=0.05)
