"""What the score without a simulator is worth: nine policies of different quality, ranked by it and by the simulator.

python -m benchmarks.judging [--scale S] [--seed N] [--json]

On each of two tasks, policies are trained as on one's own data, with budgets from far too few updates on, and judged
by what sees logs alone, `imagined_success` and `fitted_value`, and by success in the simulator on starts and goals such
as the logs have. The named baseline is the favourite of imitation, `action_error`. Printed is Spearman's rank
correlation of each with the simulator.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

import guider
from benchmarks.common import print_table
from guider.data.write import write_d4rl
from guider.evaluation.fitted import fitted_value
from guider.evaluation.heldout import held_out_scores
from guider.evaluation.imagined import fit_model, imagined_scores
from guider.evaluation.rollouts import rollout
from guider.tasks import find_task, pointmaze
from guider.tasks.simulation import MujocoVectorEnv, Start
from guider.tasks.types import Task

TASKS = {"pointmaze-umaze": 40_000, "fetch-reach-mixed": 40_000}
"""Steps of data recorded for each."""
SCORES = {"imagined_success": 1, "fitted_value": 1, "action_error": -1}
"""What ranks policies, and whether more of it is better."""
HELD_OUT, EPISODES, FIRST_SEED = 0.1, 60, 3_000_000


def _guider(latent: int, high: int, low: int) -> dict[str, Any]:
    return {"latent.updates": latent, "high.updates": high, "low.updates": low}


POLICIES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("bc", {"updates": 20}),
    ("bc", {"updates": 2_000}),
    ("gcsl", {"updates": 40}),
    ("gcsl", {"updates": 150}),
    ("gcsl", {"updates": 4_000}),
    ("guider", _guider(100, 50, 150)),
    ("guider", _guider(500, 100, 1_000)),
    ("guider", _guider(2_000, 500, 4_000)),
    ("guider-routes", {"latent.updates": 1_000, "low.updates": 3_000}),
)


def as_logged(task: Task) -> Task:
    """The task with starts and goals such as its logs have: in mazes between any two cells."""
    maze = task.maze
    if maze is None:
        return task

    def start(rng: np.random.Generator) -> Start:
        begin, end = (pointmaze.sample_start_anywhere(maze, rng) for _ in range(2))
        return replace(begin, goal=end.qpos)

    model = pointmaze.point_model(maze)
    return replace(task, make_env=lambda count: MujocoVectorEnv(model, pointmaze.FRAME_SKIP, start, count))


def judged(name: str, steps: int, seed: int, scale: float, folder: Path) -> list[dict[str, Any]]:
    """A row for each policy: what logs say of it, and what the simulator does."""
    task = as_logged(find_task(name))
    path = folder / f"{name}.hdf5"
    assert task.collector is not None
    write_d4rl(path, task.collector.record(steps, seed, lambda done, total: None), task.goal_indices, task.radius)
    logs = guider.load_data(path, task.goal_indices)
    training, unseen = logs.split(HELD_OUT)
    model = fit_model(training)
    rows = []
    for number, (method, settings) in enumerate(POLICIES):
        run = guider.train(
            data=path,
            goal_indices=task.goal_indices,
            radius=task.radius,
            method=method,
            settings={setting: max(1, int(value * scale)) for setting, value in settings.items()},
            held_out=HELD_OUT,
            out=folder / f"{name}-{number}",
        )
        (policy,) = run.policies()
        rows.append(
            {
                "task": name,
                "policy": f"{method} {' '.join(map(str, settings.values()))}",
                "success": float(rollout(policy, task, EPISODES, FIRST_SEED).success.mean()),
                **imagined_scores(policy, model, training, unseen),
                "fitted_value": fitted_value(policy, training, unseen),
                "action_error": held_out_scores(policy, unseen)["action_error"],
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def _rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Spearman's, which shares ranks among equals."""
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="of all budgets")
    parser.add_argument("--seed", type=int, default=8, help="of the data")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    summary = []
    with tempfile.TemporaryDirectory() as folder:
        for name, steps in TASKS.items():
            rows = judged(name, steps, arguments.seed, arguments.scale, Path(folder))
            success = [row["success"] for row in rows]
            ranks = {
                score: _rank_correlation([sign * row[score] for row in rows], success) for score, sign in SCORES.items()
            }
            summary.append({"task": name, "policies": len(rows)} | ranks)
    if arguments.json:
        print(json.dumps(summary))
        return
    print_table(
        "rank correlation with success in the simulator",
        ("task", "policies", *(f"by {score}" for score in SCORES)),
        [(row["task"], str(row["policies"]), *(f"{row[score]:.2f}" for score in SCORES)) for row in summary],
    )


if __name__ == "__main__":
    main()
