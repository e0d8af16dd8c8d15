"""What rollouts of all trained seeds come to: the score that evaluation.json keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from guider.evaluation.rollouts import Rollouts, bootstrap_interval, success_interval
from guider.tasks.types import SCORE_UNITS, Task


def summary(task: Task, outcomes: list[Rollouts], first_seed: int) -> dict[str, Any]:
    """The task's score, per seed and over seeds, with its protocol.

    outcomes: one of each trained seed, all of as many episodes; first_seed: of the first one's episodes.
    """
    scores = np.stack([outcome.score for outcome in outcomes])
    means, count = scores.mean(axis=1), scores.shape[1]

    def interval(of_seeds: np.ndarray) -> list[float]:
        bounds = success_interval(of_seeds > 0) if task.score == "success" else bootstrap_interval(of_seeds)
        return [round(bound, 1) for bound in bounds]

    goals = (first_seed + np.arange(scores.size)).reshape(scores.shape) % task.goals

    def per_goal(of_seeds: np.ndarray, aimed: np.ndarray) -> dict[str, Any]:
        """The means over the episodes of each goal, where there are several; None of one that no episode had."""
        if task.goals == 1:
            return {}
        of_goals = [of_seeds[aimed == goal] for goal in range(task.goals)]
        return {"per_goal": [float(some.mean()) if some.size else None for some in of_goals]}

    per_seed = [
        {
            "score": float(outcome.score.mean()),
            "interval_95": interval(outcome.score[None]),
            "goal_met_percent": float(100 * outcome.success.mean()),
            "median_steps_when_met": float(np.median(outcome.steps[outcome.success]))
            if outcome.success.any()
            else None,
            "episodes": {
                "score": outcome.score.tolist(),
                "met": outcome.success.tolist(),
                "steps": outcome.steps.tolist(),
            },
        }
        | per_goal(outcome.score, aimed)
        for outcome, aimed in zip(outcomes, goals, strict=True)
    ]
    return {
        "environment": task.environment,
        "horizon_steps": task.horizon_steps,
        "radius": task.radius,
        "episodes_per_seed": count,
        "episode_seeds": [first_seed, first_seed + scores.size - 1],
        "unit": SCORE_UNITS[task.score],
        "score": float(means.mean()),
        **per_goal(scores, goals),
        "score_std_over_seeds": float(means.std()),  # of these seeds, ddof 0
        "interval_95": interval(scores),
        "per_seed": per_seed,
        "paper_score": task.paper_score,
    }
