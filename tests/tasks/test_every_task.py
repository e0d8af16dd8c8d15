"""Every task of `guider tasks`, end to end and tiny: record data, train, evaluate."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import tiny

import guider
from guider.data.write import write_d4rl
from guider.learning.problem import Problem
from guider.methods import preset_config
from guider.support.config import differences
from guider.tasks import TASKS

GUIDED = ("fetch-push-expert", "kitchen-complete")
"""Tasks trained with Guider (of mazes, test_cli.py has one); the others get a method that compiles in a second."""
OGBENCH = (
    "pointmaze-medium-stitch",
    "antmaze-medium-explore",
    "cube-double-noisy",
    "scene-play",
    "puzzle-3x3-noisy",
)
VARIANTS = [
    name
    for name in TASKS
    if name.endswith(("-everywhere", "-gymnasium")) or (name.startswith("ogbench-") and name[8:-3] not in OGBENCH)
]
"""Other data, another noise, or more of the same, than a task that is tried."""
PAPER_TASKS = [
    *(f"antmaze-{maze}-diverse" for maze in ("umaze", "medium", "large")),
    *(f"fetch-{task}-{data}" for task in ("reach", "push", "slide", "pick") for data in ("expert", "mixed")),
    *(f"kitchen-{data}" for data in ("complete", "partial", "mixed")),
]


def test_all_of_the_papers_tasks_are_there_with_its_scores():
    scores = [TASKS[name].paper_score for name in PAPER_TASKS]
    assert scores == [88.5, 87.3, 80.8, 48.0, 47.0, 39.9, 33.4, 7.6, 4.1, 40.9, 33.2, 68.8, 70.4, 67.1]


@pytest.mark.parametrize("name", [name for name, task in TASKS.items() if task.collector and name not in VARIANTS])
def test_record_train_and_evaluate(name, tmp_path, monkeypatch):
    task = TASKS[name]
    assert task.collector is not None
    monkeypatch.setattr("guider.tasks.simulation.available_cores", lambda: 1)  # more than one takes seconds to start
    recording = task.collector.record(110, 0, lambda done, total: None)
    assert np.isfinite(recording.observations).all() and len(recording.observations) == 110
    write_d4rl(tmp_path / "data.hdf5", recording, task.goal_indices, task.radius, task.goal_parts)
    method = "guider" if name in GUIDED else "gcsl"
    fast = preset_config(method, "fast", Problem(period_steps=task.period_steps, domain=task.domain))
    settings = differences(tiny(fast, updates=2, hidden=(8,), batch_size=4), fast)
    settings |= {"view.minimum_move": 0.0, "view.boundary": "clip"}  # as little as 110 rows may not move or be short
    run = guider.train(name, tmp_path / "data.hdf5", method=method, settings=settings, out=tmp_path / "run")
    monkeypatch.setattr("guider.evaluation.score.find_task", lambda _: replace(task, horizon_steps=3))
    result = guider.evaluate(run, episodes=2)
    assert result["environment"] == task.environment and result["task"] == name
    assert 0 <= result["score"] <= (3 if task.score == "return" else 100)
