"""Runs of a plan, made up or small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from guider.reproduce.plans import Plan, PlannedRun, Protocol
from guider.support import files

SETTINGS = {
    "latent.updates": "4",
    "high.updates": "4",
    "low.updates": "2000",
    "latent.hidden": "(8,)",
    "high.hidden": "(8,)",
    "low.hidden": "(8,)",
    "latent.batch_size": "16",
    "high.batch_size": "16",
    "low.batch_size": "16",
}


def protocol_in(folder: Path, **changes: Any) -> Protocol:
    asked = {"seeds": 2, "episodes": 3, "settings": SETTINGS, "data": folder / "data", "out": folder / "out"}
    return Protocol(**(asked | changes))


def fake(plan: Plan, run: PlannedRun, scores: list[float], curve: tuple[float, ...] = (1.0,), **facts: Any) -> None:
    """Put a finished run on disk that scored `scores`, a seed each."""
    directory = plan.directory(run)
    directory.mkdir(parents=True)
    files.write_json(directory.with_name(f"{directory.name}.json"), run.request())
    first = run.seeds[0] * plan.protocol.episodes
    result = {
        "task": run.task,
        "method": run.method,
        "preset": run.preset,
        "departures": {"high.samples": 2, "low.updates": len(run.variant)},
        "period_steps": 50,
        "acts_by": "mean of the policy",
        "data": "somewhere",
        "fingerprint": "0123456789abcdef",
        "training_seeds": list(run.seeds),
        "updates": {"goal policy": 1000},
        "versions": {"python": "3.11"},
        "environment": "an ant",
        "horizon_steps": 1000,
        "episodes_per_seed": plan.protocol.episodes,
        "episode_seeds": [first, first + len(scores) * plan.protocol.episodes - 1],
        "unit": "success (%)",
        "score": float(np.mean(scores)),
        "interval_95": [0.0, 100.0],
        "per_seed": [{"score": score} for score in scores],
    }
    files.write_json(directory / "evaluation.json", result | facts)
    for seconds in (30.0, 60.0):
        line = {"stage": "goal policy", "update": 500, "total_updates": 500, "seconds": seconds, "metrics": {}}
        files.append_line(directory / "metrics.jsonl", line)
    for index, share in enumerate(curve, start=1):
        line = {"total_updates": 500 * index, "score": [share * score for score in scores], "episodes": 20}
        files.append_line(directory / "evaluations.jsonl", line)
