"""Environment steps per second of an evaluation, against stepping the same environments alone.

python -m benchmarks.evaluation [--rounds N] [--steps N] [--json]
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.common import print_table, ratios, show_ratio, verdict
from guider.data.episodes import Spaces
from guider.evaluation.rollouts import rollout
from guider.learning.problem import Problem
from guider.methods import guider
from guider.methods.guider import guider_config
from guider.methods.policy import Policy
from guider.methods.view import unit_scale
from guider.tasks import Task, find_task
from guider.tasks.types import VectorEnv

TASKS = ("antmaze-large-diverse", "pointmaze-large")
TARGET = 0.8
"""Least acceptable share of the environments' own speed."""


class Recorder:
    """A VectorEnv that notes the actions it is given."""

    def __init__(self, env: VectorEnv):
        self.env, self.count = env, env.count
        self.actions: list[np.ndarray] = []

    def reset(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.env.reset(seeds)

    def step(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        self.actions.append(actions)
        return self.env.step(actions, active)

    def close(self) -> None:
        self.env.close()


def untrained_policy(task: Task) -> Policy:
    """The preset `fast` at full size, fresh from its initial draw."""
    config = guider_config("fast", Problem(task.radius, task.reach_radius, task.period_steps))
    spaces = Spaces(task.state_dim, task.goal_indices, (-1.0,) * task.action_dim, (1.0,) * task.action_dim)
    state = guider.init(config, spaces, unit_scale(config.view, spaces), jax.random.key(0))
    bounds = jnp.asarray(spaces.action_low), jnp.asarray(spaces.action_high)
    return Policy(state, *bounds, "guider", config, task.goal_indices, task.state_dim)


def recorded_actions(policy: Policy, task: Task) -> np.ndarray:
    """[steps, copies, A] what the policy does in a rollout; copies never stop, for no goal is ever met."""
    recorders: list[Recorder] = []

    def make_env(count: int) -> Recorder:
        recorders.append(Recorder(task.make_env(count)))
        return recorders[-1]

    rollout(policy, replace(task, make_env=make_env), task.copies, 0)
    return np.stack(recorders[0].actions)


def rollout_rate(policy: Policy, task: Task) -> float:
    """Environment steps per second of `rollout`, all of it: making the environments, resets, the policy."""
    began = time.perf_counter()
    outcome = rollout(policy, task, task.copies, 0)
    return int(outcome.steps.sum()) / (time.perf_counter() - began)


def stepping_rate(actions: np.ndarray, task: Task) -> float:
    """Environment steps per second without policy or bookkeeping. actions: [steps, copies, A]."""
    began = time.perf_counter()
    env = task.make_env(actions.shape[1])
    env.reset(np.arange(actions.shape[1]))
    active = np.ones(actions.shape[1], bool)
    for action in actions:
        env.step(action, active)
    env.close()
    return actions.shape[0] * actions.shape[1] / (time.perf_counter() - began)


def measure(name: str, steps: int, rounds: int) -> dict[str, Any]:
    """One task, every episode cut to `steps`. Goals cannot be met (radius 0), so that all copies step throughout."""
    full = find_task(name)
    task = replace(full, horizon_steps=min(steps, full.horizon_steps), radius=0.0)
    policy = untrained_policy(full)
    replayed = recorded_actions(policy, task)
    drawn = np.random.default_rng(0).uniform(-1, 1, replayed.shape)
    rates: dict[str, list[float]] = {"rollout": [], "random actions": [], "same actions": []}
    for _ in range(rounds):
        rates["rollout"].append(rollout_rate(policy, task))
        rates["random actions"].append(stepping_rate(drawn, task))
        rates["same actions"].append(stepping_rate(replayed, task))
    return {
        "copies": full.copies,
        "steps": task.horizon_steps,
        "rates": rates,
        "median_rates": {contender: statistics.median(values) for contender, values in rates.items()},
        "to_random_actions": ratios(rates["rollout"], rates["random actions"]),
        "to_same_actions": ratios(rates["rollout"], rates["same actions"]),
        "target": TARGET,
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.evaluation", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender, in alternation")
    parser.add_argument("--steps", type=int, default=180, help="steps an episode is cut to")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    options = parser.parse_args()
    results = {name: measure(name, options.steps, options.rounds) for name in TASKS}
    if options.json:
        print(json.dumps(results))
        return
    rows = [
        (
            name,
            *(f"{rate:.0f}" for rate in result["median_rates"].values()),
            show_ratio(result["to_random_actions"]),
            show_ratio(result["to_same_actions"]),
            verdict(result["to_random_actions"]["median"], TARGET),
        )
        for name, result in results.items()
    ]
    header = ("task", "rollout /s", "random actions /s", "same actions /s", "to random", "to same", "")
    print_table("Environment steps per second, all copies", header, rows)


if __name__ == "__main__":
    main()
