"""Milliseconds a step of acting takes: subgoals by routes against subgoals by pi_h, one robot and 100 copies.

python -m benchmarks.acting [--rounds N] [--steps N] [--json]
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

from benchmarks.common import antmaze_config, print_table, ratios, show_ratio
from benchmarks.evaluation import untrained_policy
from guider.methods.policy import Agent, Policy, act, initial_state
from guider.methods.routes import Routes, shortest_steps
from guider.tasks import find_task

TARGET = 2.0
"""At most so many times as long as with pi_h."""


def with_routes(policy: Policy) -> Policy:
    """The same policy with a full graph: places all over the maze, an edge wherever two lie within 3 m."""
    config = replace(policy.config, planner="routes")
    places = jnp.asarray(np.random.default_rng(0).uniform(0, 36, (config.routes.places, 2)), jnp.float32)
    apart = jnp.linalg.norm(places[:, None] - places, axis=-1)
    edges = jnp.where(apart <= 3, 8 * apart, jnp.inf)
    routes = Routes(places, edges, jax.jit(shortest_steps)(edges))
    return replace(policy, config=config, state=policy.state._replace(high=routes))


def one_robot(policy: Policy, steps: int) -> float:
    """Milliseconds a step of Agent.act, what a robot calls."""
    agent, observation, goal = Agent(policy), np.zeros(policy.state_dim, np.float32), np.full(2, 20.0, np.float32)
    agent.act(observation, goal)
    began = time.perf_counter()
    for _ in range(steps):
        agent.act(observation, goal)
    return 1000 * (time.perf_counter() - began) / steps


def hundred_copies(policy: Policy, steps: int) -> float:
    """Milliseconds a step of `act` for 100 copies at once."""
    rng = np.random.default_rng(0)
    observation = jnp.asarray(rng.uniform(0, 36, (100, policy.state_dim)), jnp.float32)
    goal = jnp.asarray(rng.uniform(0, 36, (100, 2)), jnp.float32)
    acting, compiled = initial_state(policy, 100), jax.jit(act)
    jax.block_until_ready(compiled(policy, observation, goal, acting, jnp.ones(100, bool)))
    began = time.perf_counter()
    for step in range(steps):
        actions, acting = compiled(policy, observation, goal, acting, jnp.full(100, step == 0))
        jax.block_until_ready(actions)
    return 1000 * (time.perf_counter() - began) / steps


def measure(steps: int, rounds: int) -> dict[str, Any]:
    """Both, in alternation."""
    by_policy = replace(untrained_policy(find_task("antmaze-large-diverse")), config=antmaze_config("fast"))
    by_routes = with_routes(by_policy)
    results = {}
    for name, timed in {"one robot": one_robot, "100 copies": hundred_copies}.items():
        times: dict[str, list[float]] = {"policy": [], "routes": []}
        for _ in range(rounds):
            times["policy"].append(timed(by_policy, steps))
            times["routes"].append(timed(by_routes, steps))
        medians = {planner: statistics.median(values) for planner, values in times.items()}
        results[name] = {"ms": times, "median_ms": medians, "ratio": ratios(times["routes"], times["policy"])}
    return results


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.acting", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender, in alternation")
    parser.add_argument("--steps", type=int, default=300, help="steps a run acts for")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    options = parser.parse_args()
    results = measure(options.steps, options.rounds)
    if options.json:
        print(json.dumps(results))
        return
    rows = [
        (
            name,
            *(f"{median:.2f}" for median in result["median_ms"].values()),
            show_ratio(result["ratio"]),
            f"target {TARGET}: {'met' if result['ratio']['median'] <= TARGET else 'missed'}",
        )
        for name, result in results.items()
    ]
    print_table("Milliseconds a step of acting", ("acting", "pi_h", "routes", "routes to pi_h", ""), rows)


if __name__ == "__main__":
    main()
