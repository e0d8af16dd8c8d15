"""The score of a finished run, with its protocol: what evaluation.json keeps."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from guider import runs
from guider.data.episodes import Episodes
from guider.errors import GuiderError, GuiderWarning
from guider.evaluation.fitted import fitted_value
from guider.evaluation.heldout import held_out_scores
from guider.evaluation.imagined import fit_model, imagined_scores
from guider.evaluation.outcomes import ending, subgoal_shares
from guider.evaluation.rollouts import Rollouts, rollout
from guider.evaluation.summary import summary
from guider.evaluation.trust import verdict
from guider.learning import processor
from guider.methods import find_method, preset_config
from guider.methods.policy import Policy
from guider.methods.view import data_use
from guider.runs import Run, RunSpec
from guider.runs.asked import problem_of
from guider.runs.source import same_data
from guider.support import files
from guider.support.config import differences
from guider.tasks import find_task


def score(
    run: str | Path | Run,
    *,
    episodes: int | None = None,
    first_seed: int | None = None,
    data: str | Path | Episodes | None = None,
    on_steps: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """The score of a finished run's last checkpoint.

    On a task: `episodes` episodes (100, or 50 for each of several goals) for every seed, environment seeds first_seed
    (0) + seed index * episodes + e.
    On one's own data: the episodes that training never saw (see guider.evaluation.heldout).
    Returns the score with its protocol: environment, data, preset and its departures, seeds, interval.
    """
    first = 0 if first_seed is None else first_seed
    if (episodes is not None and episodes < 1) or first < 0:
        raise GuiderError(f"--episodes must be 1 or more and --first-seed 0 or more, got {episodes} and {first}")
    run = runs.as_run(run)
    spec = run.spec
    policies, protocol = run.policies(), _protocol(run)
    if spec.task is None:
        if episodes is not None or first_seed is not None:
            raise GuiderError(
                "a run on one's own data is scored on held-out episodes; leave --episodes and --first-seed out"
            )
        return protocol | _held_out(run, policies, data)
    task = find_task(spec.task)
    count = episodes or (100 if task.goals == 1 else 50 * task.goals)
    if task.maze is None and data is not None:
        raise GuiderError(f"{spec.task} is scored in its environment; leave --data out")

    def rolled_out(index: int, policy: Policy) -> Rollouts:
        return rollout(
            policy,
            task,
            count,
            first + index * count,
            on_steps=lambda done, of: on_steps(index * of + done, len(policies) * of),
        )

    outcomes = [rolled_out(index, policy) for index, policy in enumerate(policies)]
    result = protocol | summary(task, outcomes, first)
    if task.maze is not None:
        guided = find_method(spec.method).subgoals is not None
        logged = _logged_places(run, data) if guided else None
        for scores, outcome in zip(result["per_seed"], outcomes, strict=True):
            scores["episodes"]["ending"] = [ending(trace, task, task.maze) for trace in outcome.traces]
            if guided:
                scores |= subgoal_shares(outcome.traces, task.maze, logged, spec.config.problem.reach_radius)
    return result


def keep_score(run: str | Path | Run, result: dict[str, Any]) -> None:
    """Write what `score` returned into the run's evaluation.json."""
    files.write_json(runs.as_run(run).directory / "evaluation.json", result)


def _protocol(run: Run) -> dict[str, Any]:
    """What is scored, and by what."""
    spec = run.spec
    return {
        "task": spec.task,
        "method": spec.method,
        "preset": spec.preset,
        "departures": departures(spec),
        "precision": spec.config.precision,
        "acts_by": find_method(spec.method).acts_by(spec.config),
        "period_steps": spec.config.problem.period_steps,
        "reach_radius": spec.config.problem.reach_radius,
        "data": spec.data,
        "fingerprint": spec.fingerprint,
        "training_seeds": list(spec.seeds),
        "updates": {stage.name: stage.updates for stage in run.stages},
        "checkpoint": "last",
        "versions": runs.versions(),
        "evaluated_on": processor.describe(),
    }


def _held_out(run: Run, policies: list[Policy], data: str | Path | Episodes | None) -> dict[str, Any]:
    """The scores of all seeds on the episodes that training never saw."""
    spec = run.spec
    logged = same_data(run, data)
    if spec.held_out == 0:
        raise GuiderError(f"{run.directory} held no episodes out; train with --held-out 0.1 to score it")
    training, unseen = logged.split(spec.held_out)
    model = fit_model(training)
    per_seed = [
        imagined_scores(policy, model, training, unseen)
        | {"fitted_value": fitted_value(policy, training, unseen)}
        | held_out_scores(policy, unseen)
        for policy in policies
    ]
    return {
        "held_out_episodes": len(unseen.starts),
        "held_out_use": str(data_use(spec.config.view, spec.config.problem, unseen)),
        "per_seed": per_seed,
        "verdicts": [verdict(scores) for scores in per_seed],
    }


def departures(spec: RunSpec) -> dict[str, Any]:
    """Where a run's settings depart from `paper` on its task; for one's own data radii and period are its own."""
    problem = spec.config.problem if spec.task is None else problem_of(find_task(spec.task))
    return differences(spec.config, preset_config(spec.method, "paper", problem))


def _logged_places(run: Run, data: str | Path | Episodes | None) -> np.ndarray | None:
    """s^G of the run's data, or None, with a warning, where that is not where it was and nobody says where it is."""
    try:
        return same_data(run, data).achieved
    except GuiderError as error:
        if data is not None:
            raise
        warnings.warn(GuiderWarning(f"how many subgoals lie off the data is not told: {error}"), stacklevel=2)
        return None
