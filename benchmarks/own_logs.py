"""What a newcomer gets: six robots' logs, nothing said but goal and radius, and then the robot itself.

python -m benchmarks.own_logs [ROBOT ...] [--methods M ...] [--period-steps C] [--set NAME=VALUE ...]
    [--seed N] [--episodes N] [--first-seed N] [--out FILE]

Each method trains on the same logs (data seed N) with the defaults for one's own data, two training seeds, and then
drives the simulated robot from starts and to goals that the operator would meet. The named baseline is the best of bc,
gcsl and hiql. Printed are the episodes in which the goal was met (%), the steps that the robot was at its goal, and how
far from it it is at the end (median, goal units).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import guider
from benchmarks.common import print_table
from benchmarks.robots import ROBOTS, Logged, logs
from guider.commands.options import assignments
from guider.data.episodes import Episodes
from guider.evaluation.rollouts import rollout
from guider.support import files
from guider.tasks import find_task

METHODS = ("guider", "guider-routes", "bc", "gcsl", "hiql")
SEEDS = 0, 1


def driven(robot: Logged, data: Episodes, method: str, folder: Path, starts: range, **options: Any) -> dict[str, Any]:
    """Train on the robot's logs, then drive it from `starts`, seeds of episodes: met (%), at_goal (steps) and distance
    (median, at the end), each per training seed."""
    run = guider.train(data=data, radius=robot.radius, method=method, seeds=SEEDS, out=folder / "run", **options)
    task = find_task(f"gym:{robot.env}")
    found: dict[str, Any] = {"met": [], "at_goal": [], "distance": []}
    for policy in run.policies():
        done = rollout(policy, task, len(starts), starts.start)
        found["met"].append(100 * float(done.success.mean()))
        found["at_goal"].append(float(done.score.mean()))
        ends = [np.linalg.norm(trace.last_state[list(task.goal_indices)] - trace.goal) for trace in done.traces]
        found["distance"].append(float(np.median(ends)))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), metavar="ROBOT", help=", ".join(ROBOTS))
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--period-steps", type=int, help="another c than the one that is chosen")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="other settings than the defaults")
    parser.add_argument("--seed", type=int, default=1, help="of the data")
    parser.add_argument("--episodes", type=int, default=60, help="that each policy drives")
    parser.add_argument("--first-seed", type=int, default=3_000_000, help="of the episodes")
    parser.add_argument("--out", type=Path, help="a JSON file that results are added to as they come")
    arguments = parser.parse_args()
    options: dict[str, Any] = {"period_steps": arguments.period_steps} if arguments.period_steps else {}
    if settings := assignments(tuple(arguments.set)):
        options["settings"] = settings
    rows: list[dict[str, Any]] = (
        json.loads(arguments.out.read_text()) if arguments.out and arguments.out.exists() else []
    )
    for name in arguments.robots:
        data = logs(ROBOTS[name], arguments.seed)
        starts = range(arguments.first_seed, arguments.first_seed + arguments.episodes)
        said = {"robot": name, "seed": arguments.seed, "episodes": len(starts), "first_seed": starts.start}
        for method in arguments.methods:
            with tempfile.TemporaryDirectory() as folder:
                found = driven(ROBOTS[name], data, method, Path(folder), starts, **options)
            rows.append(said | {"method": method} | options | found)
            print(json.dumps(rows[-1]), flush=True)
            if arguments.out:
                files.write_text(arguments.out, json.dumps(rows, indent=1))
    print_table(
        "two training seeds each",
        ("robot, method", "goals met, %", "steps at the goal", "median distance at the end"),
        [
            (
                f"{row['robot']}, {row['method']}",
                *(", ".join(f"{v:.3g}" for v in row[key]) for key in ("met", "at_goal", "distance")),
            )
            for row in rows
        ],
    )


if __name__ == "__main__":
    main()
