"""A policy that has left (`guider export`) against the same one here: milliseconds a step, and how far actions differ.

python -m benchmarks.exporting [--episodes N] [--rounds N] [--json]

Full-size policies of antmaze, with pi_h and with routes, for one robot: `Agent.act`, the NumPy actor, onnxruntime on
one core. Actions are compared on 10,000 random inputs, and step by step over whole episodes of the ant.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.acting import with_routes
from benchmarks.common import antmaze_config, print_table, ratios, show_ratio
from benchmarks.evaluation import untrained_policy
from guider.exporting import export_policy
from guider.exporting.actor import Actor
from guider.methods.policy import Agent, Policy
from guider.tasks import find_task

TASK = find_task("antmaze-umaze-diverse")
INPUTS, DIFFERENCE = 10_000, 1e-5
ABOUT = {"goal_dim": 2, "state_dim": TASK.state_dim, "goal_indices": [0, 1], "goal_names": ["x", "y"]}


class Session:
    """An exported policy in onnxruntime, on one core."""

    def __init__(self, path: Path):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(str(path), options)
        self._outputs = [output.name for output in self._session.get_outputs()]
        types = {"tensor(float)": np.float32, "tensor(int32)": np.int32}
        memory = [given for given in self._session.get_inputs() if given.name.startswith("memory_")]
        self._first = {given.name: np.zeros(given.shape, types[given.type]) for given in memory}
        self.reset()

    def reset(self) -> None:
        self._memory, self._begins = self._first, np.array(True)

    def act(self, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
        given = {"observation": observation, "goal": goal, "begins": self._begins, **self._memory}
        results = dict(zip(self._outputs, self._session.run(None, given), strict=True))
        self._memory, self._begins = {name: results[f"next_{name}"] for name in self._memory}, np.array(False)
        return np.asarray(results["action"])


def contenders(policy: Policy, folder: Path) -> dict[str, Any]:
    export_policy(policy, ABOUT, folder / "policy.npz")
    export_policy(policy, ABOUT, folder / "policy.onnx")
    return {
        "JAX": Agent(policy),
        "NumPy": Actor(folder / "policy.npz"),
        "onnxruntime": Session(folder / "policy.onnx"),
    }


def milliseconds(act: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: int = 500) -> float:
    observation, goal = np.zeros(TASK.state_dim, np.float32), np.full(2, 20.0, np.float32)
    act(observation, goal)
    began = time.perf_counter()
    for _ in range(steps):
        act(observation, goal)
    return 1000 * (time.perf_counter() - began) / steps


class Differences:
    """The largest difference of an action of each of `others` to `ours`, who has the same inputs."""

    def __init__(self, ours: Any, others: dict[str, Any]):
        self._ours, self._others = ours, others
        self.largest = dict.fromkeys(others, 0.0)

    def reset(self) -> None:
        for actor in (self._ours, *self._others.values()):
            actor.reset()

    def act(self, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
        action = self._ours.act(observation, goal)
        for name, other in self._others.items():
            difference = float(np.abs(action - other.act(observation, goal)).max())
            self.largest[name] = max(self.largest[name], difference)
        return action


def on_random_inputs(ours: Any, others: dict[str, Any]) -> dict[str, float]:
    """Each input begins an episode."""
    rng, compared = np.random.default_rng(0), Differences(ours, others)
    for _ in range(INPUTS):
        observation = rng.normal(0, 3, TASK.state_dim).astype(np.float32)
        observation[:2] = rng.uniform(0, 36, 2)
        compared.reset()
        compared.act(observation, rng.uniform(0, 36, 2).astype(np.float32))
    return compared.largest


def over_episodes(ours: Any, others: dict[str, Any], episodes: int) -> dict[str, float]:
    """Over whole episodes, which `ours` drives; the memory of each is its own."""
    env, compared = TASK.make_env(1), Differences(ours, others)
    for seed in range(episodes):
        compared.reset()
        observation, goal = env.reset(np.array([seed]))
        for _ in range(TASK.horizon_steps):
            action = compared.act(observation[0], goal[0])
            observation = env.step(action[None], np.ones(1, bool))
    env.close()
    return compared.largest


def measure(episodes: int, rounds: int) -> dict[str, Any]:
    by_policy = replace(untrained_policy(TASK), config=antmaze_config("fast"))
    results = {}
    for planner, policy in {"pi_h": by_policy, "routes": with_routes(by_policy)}.items():
        with tempfile.TemporaryDirectory() as folder:
            acting = contenders(policy, Path(folder))
            times: dict[str, list[float]] = {name: [] for name in acting}
            for _ in range(rounds):
                for name, actor in acting.items():
                    times[name].append(milliseconds(actor.act))
            ours = acting.pop("JAX")
            results[planner] = {
                "ms": times,
                "ratio": {name: ratios(times[name], times["JAX"]) for name in acting},
                "difference_on_random_inputs": on_random_inputs(ours, acting),
                "difference_over_episodes": over_episodes(ours, acting, episodes),
            }
    return results


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exporting", description=__doc__)
    parser.add_argument("--episodes", type=int, default=100, help="whole episodes to compare actions over")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender, in alternation")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    options = parser.parse_args()
    results = measure(options.episodes, options.rounds)
    if options.json:
        print(json.dumps(results))
        return
    rows = []
    for planner, result in results.items():
        for name, times in result["ms"].items():
            compared = name in result["ratio"]
            differences = [result[f"difference_{kind}"].get(name) for kind in ("on_random_inputs", "over_episodes")]
            rows.append(
                (
                    f"{name}, {planner}",
                    f"{statistics.median(times):.3f}",
                    show_ratio(result["ratio"][name]) if compared else "",
                    *(f"{difference:.1e}" if compared else "" for difference in differences),
                )
            )
    heads = ("acting", "ms a step", "to JAX", f"{INPUTS} random inputs", f"{options.episodes} episodes")
    print_table("Milliseconds a step, and the largest difference of an action", heads, rows)


if __name__ == "__main__":
    main()
