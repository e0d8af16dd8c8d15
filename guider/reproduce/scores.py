"""What came of a plan's runs, in numbers beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guider.evaluation.statistics import (
    interquartile_mean,
    mean_and_deviation,
    probability_of_improvement,
    stratified_bootstrap_interval,
)
from guider.reproduce.paper import PaperScore
from guider.reproduce.plans import Plan, PlannedRun, Variant
from guider.reproduce.runner import evaluation, state
from guider.support.files import read_lines
from guider.tasks.types import SCORE_UNITS


@dataclass(frozen=True)
class Cell:
    """A run in its place. result: its evaluation.json, None while it is unfinished."""

    task: str
    variant: Variant
    run: PlannedRun
    paper: PaperScore
    result: dict[str, Any] | None

    @property
    def scores(self) -> np.ndarray:
        """[seeds], in the task's unit."""
        assert self.result is not None
        return np.array([seed["score"] for seed in self.result["per_seed"]])


Grid = list[list[Cell]]


def cells(plan: Plan) -> Grid:
    """[task][variant] of a plan. Raises GuiderError where a directory holds another run, see runner.state."""
    return [
        [
            Cell(task, variant, run, paper, evaluation(plan, run) if state(plan, run) == "done" else None)
            for variant, run, paper in zip(plan.variants, runs, papers, strict=True)
        ]
        for task, runs, papers in zip(plan.tasks, plan.grid, plan.paper_scores, strict=True)
    ]


def summary(cell: Cell) -> dict[str, Any]:
    """A finished cell: mean and standard deviation over seeds, those of the paper, and what they come from."""
    assert cell.result is not None
    mean, deviation = mean_and_deviation(cell.scores)
    return {
        "variant": cell.variant.name,
        "label": cell.variant.label,
        "run": cell.run.name,
        "mean": mean,
        "deviation": deviation,
        "per_seed": cell.scores.tolist(),
        "interval_95": cell.result["interval_95"],
        "unit": cell.result["unit"],
        "paper": cell.paper,
    }


def aggregate(grid: Grid) -> dict[str, Any] | None:
    """Over the tasks that every variant with any result has finished; None where there is no such task.

    Per variant: interquartile mean and mean of normalised scores, with 95 % intervals, and how likely Guider beats it.
    """
    columns = [column for column in zip(*grid, strict=True) if any(cell.result for cell in column)]
    rows = [row for row in zip(*columns, strict=True) if all(cell.result for cell in row)]
    if not rows:
        return None
    scores = {
        column[0].variant.name: np.stack([_normalised(cell, cell.scores) for cell in column], axis=1)
        for column in zip(*rows, strict=True)
    }
    guider = scores.get("guider")
    variants = []
    for column in zip(*rows, strict=True):
        variant = column[0].variant
        ours = scores[variant.name]
        printed = [_normalised(cell, np.array(cell.paper[0])) for cell in column if cell.paper is not None]
        entry: dict[str, Any] = {
            "variant": variant.name,
            "label": variant.label,
            "interquartile_mean": float(interquartile_mean(ours)),
            "interval_95": stratified_bootstrap_interval(interquartile_mean, ours),
            "mean": float(ours.mean()),
            "paper_mean": float(np.mean(printed)) if len(printed) == len(column) else None,
        }
        if guider is not None and variant.name != "guider":
            entry["guider_improves"] = float(probability_of_improvement(guider, ours))
            entry["guider_improves_interval_95"] = stratified_bootstrap_interval(
                probability_of_improvement, guider, ours
            )
        variants.append(entry)
    return {"tasks": [row[0].task for row in rows], "variants": variants}


def protocol(plan: Plan, grid: Grid) -> dict[str, Any]:
    """How the finished runs were made and scored; what all of them share stands once."""
    finished = list({cell.run.name: cell for row in grid for cell in row if cell.result}.values())
    results = [cell.result for cell in finished if cell.result]
    departures = _shared([result["departures"] for result in results])
    versions = _shared([result["versions"] for result in results])
    asked = plan.protocol
    return {
        "preset": asked.preset,
        "training_seeds": [asked.first_seed, asked.first_seed + asked.seeds - 1],
        "episodes_per_seed": asked.episodes,
        "checkpoint": "last",
        "versions_of_all_runs": versions,
        "departures_of_all_runs": departures,
        "runs": [
            {
                "run": cell.run.name,
                "environment": result["environment"],
                "data": result["data"],
                "fingerprint": result["fingerprint"],
                "period_steps": result["period_steps"],
                "acts_by": result["acts_by"],
                "updates": result["updates"],
                "episode_seeds": result["episode_seeds"],
                "training_minutes": training_minutes(plan.directory(cell.run)),
                "other_departures": _without(result["departures"], departures),
                "other_versions": _without(result["versions"], versions),
            }
            for cell, result in zip(finished, results, strict=True)
        ],
    }


def training_minutes(directory: Path) -> float:
    """Minutes that a run's updates took, all seeds together; compilation and evaluation apart."""
    return sum(line["seconds"] for line in read_lines(directory / "metrics.jsonl")) / 60


def _normalised(cell: Cell, scores: np.ndarray) -> np.ndarray:
    """Scores as shares of the best there can be: every step of an episode with the goal met, or 100 %."""
    assert cell.result is not None
    counts_steps = cell.result["unit"] == SCORE_UNITS["return"]
    return scores / (cell.result["horizon_steps"] if counts_steps else 100)


def _shared(dicts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Entries that all of them have in common."""
    if not dicts:
        return {}
    return {name: value for name, value in dicts[0].items() if all(d.get(name, ...) == value for d in dicts)}


def _without(entries: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in entries.items() if name not in shared}
