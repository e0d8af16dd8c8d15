"""Statistics of scores over training seeds and tasks, as Agarwal et al. 2021 recommend for few seeds ("Deep
Reinforcement Learning at the Edge of the Statistical Precipice"; their package is rliable).

Scores are [..., seeds, tasks]; leading axes, if any, are kept. One seed of one task is one run.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

RESAMPLES = 10_000


def mean_and_deviation(scores: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation of scores [seeds]; the deviation of these seeds, ddof 0."""
    return float(np.mean(scores)), float(np.std(scores))


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """[...] mean of the middle half of all runs: the lowest and the highest quarter, rounded down, are left out.

    Less at the mercy of single runs than the mean, and of more use of them than the median.
    """
    runs = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = runs.shape[-1] // 4
    return runs[..., cut : runs.shape[-1] - cut].mean(axis=-1)


def probability_of_improvement(scores: np.ndarray, others: np.ndarray) -> np.ndarray:
    """[...] how likely a run of `scores` beats a run of `others` on the same task, mean over tasks; a tie is half.

    The two may have different numbers of seeds.
    """
    ours, theirs = scores[..., :, None, :], others[..., None, :, :]
    return ((ours > theirs) + 0.5 * (ours == theirs)).mean(axis=(-3, -2, -1))


def stratified_bootstrap_interval(statistic: Callable[..., np.ndarray], *scores: np.ndarray) -> tuple[float, float]:
    """95 % percentile interval of statistic(*scores), runs resampled with replacement within each task.

    scores: [seeds, tasks] each, resampled apart; statistic: of [resamples, seeds, tasks] each -> [resamples].
    """
    rng = np.random.default_rng(0)
    values = statistic(*(_resampled(runs, rng) for runs in scores))
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _resampled(scores: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[resamples, seeds, tasks]."""
    seeds, tasks = scores.shape
    return scores[rng.integers(seeds, size=(RESAMPLES, seeds, tasks)), np.arange(tasks)]
