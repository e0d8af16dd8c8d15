"""Finished runs beside one another: what each scored, and whether one is better than another or luckier."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guider.errors import GuiderError
from guider.evaluation.statistics import RESAMPLES, probability_of_improvement
from guider.support import files

SAME = ("task", "environment", "unit", "radius", "horizon_steps", "episodes_per_seed", "checkpoint")
"""What scores must share to stand beside each other."""


def kept_score(run: Path) -> dict[str, Any]:
    """evaluation.json of a run. Raises GuiderError where it has none, or one that is damaged."""
    try:
        return files.read_json(run / "evaluation.json", f"score the run anew: guider evaluate {run}")
    except FileNotFoundError:
        raise GuiderError(f"{run} has not been scored; do so with `guider evaluate {run}`") from None


def compare(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """A row for each run: its score and interval, and, of all but the first, the difference from the first's with its
    95 % interval (see `difference_interval`) and how likely a training seed of it beats one of the first.

    Raises GuiderError where scores were not made alike.
    """
    if len(runs) < 2:
        raise GuiderError("name two runs or more to compare")
    results = [kept_score(run) for run in runs]
    first = results[0]
    if first["task"] is None:
        raise GuiderError(f"{runs[0]} is a run on one's own data, which has no score of its own to compare")
    for run, result in zip(runs, results, strict=True):
        if differing := [name for name in SAME if result.get(name) != first.get(name)]:
            name = differing[0]
            raise GuiderError(
                f"{run} and {runs[0]} were not scored alike: {name} is {result.get(name)} and {first.get(name)}"
            )
    rows, reference = [], _episodes(first)
    for run, result in zip(runs, results, strict=True):
        scores = _episodes(result)
        row = {
            "run": str(run),
            "method": result["method"],
            "preset": result["preset"],
            "fingerprint": result["fingerprint"],
            "seeds": len(scores),
            "score": result["score"],
            "interval_95": result["interval_95"],
        }
        if result is not first:
            low, high = difference_interval(scores, reference, result["episode_seeds"] == first["episode_seeds"])
            better = probability_of_improvement(scores.mean(axis=1)[:, None], reference.mean(axis=1)[:, None])
            row |= {
                "difference": result["score"] - first["score"],
                "difference_interval_95": [low, high],
                "probability_of_improvement": float(better),
            }
        rows.append(row)
    return rows


def difference_interval(ours: np.ndarray, theirs: np.ndarray, paired: bool) -> tuple[float, float]:
    """95 % percentile interval of the difference of means of [seeds, episodes]: training seeds are resampled with
    replacement, and episodes within them; with one seed each, and the same episodes (`paired`), the same ones of both.
    """
    rng = np.random.default_rng(0)
    if paired and len(ours) == len(theirs) == 1:
        gaps = ours[0] - theirs[0]
        means = gaps[rng.integers(len(gaps), size=(RESAMPLES, len(gaps)))].mean(axis=1)
    else:
        means = _resampled_means(ours, rng) - _resampled_means(theirs, rng)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def _resampled_means(scores: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[resamples] means, a few hundred resamples at a time."""
    seeds, episodes = scores.shape
    means = []
    for _ in range(RESAMPLES // 500):
        of_seed = rng.integers(seeds, size=(500, seeds, 1))
        means.append(scores[of_seed, rng.integers(episodes, size=(500, seeds, episodes))].mean(axis=(1, 2)))
    return np.concatenate(means)


def _episodes(result: dict[str, Any]) -> np.ndarray:
    """[seeds, episodes] scores."""
    return np.array([of_seed["episodes"]["score"] for of_seed in result["per_seed"]], float)
