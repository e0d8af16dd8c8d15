"""Seeded rollouts of a policy in many environments at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from guider.goals import part_distances
from guider.methods import find_method
from guider.methods.policy import Policy, compiled_act, initial_state
from guider.tasks.types import Task, VectorEnv


@dataclass(frozen=True, eq=False)
class Trace:
    """One episode as it went. achieved, subgoals: [steps, G]; goal: [G]; renewed: [steps] bool, True where the policy
    chose a new subgoal; success: the goal was met; last_state: [S] the state it ended in. Without subgoals, the goal is
    the only one."""

    achieved: np.ndarray
    subgoals: np.ndarray
    renewed: np.ndarray
    goal: np.ndarray
    success: bool
    last_state: np.ndarray


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Outcomes of E episodes. score: [E], see guider.tasks.types.Score; success: [E] bool, the whole goal was met
    after some step; steps: [E] until it was first, or the horizon; traces: E of them."""

    score: np.ndarray
    success: np.ndarray
    steps: np.ndarray
    traces: tuple[Trace, ...]


Watch = Callable[[VectorEnv, np.ndarray, np.ndarray, np.ndarray, bool], None]
"""watch(env, achieved, subgoals, goals, over), each [copies, G]: called before each step, and once it is over with the
last subgoals."""


def _look_away(env: VectorEnv, achieved: np.ndarray, subgoals: np.ndarray, goals: np.ndarray, over: bool) -> None:
    """Nobody watches."""


def rollout(
    policy: Policy,
    task: Task,
    episodes: int,
    first_seed: int,
    *,
    on_steps: Callable[[int, int], None] = lambda done, total: None,
    watch: Watch = _look_away,
) -> Rollouts:
    """Run `episodes` episodes, episode e from seed first_seed + e.

    Equal arguments give equal episodes. Another number of episodes changes the batch the policy is computed in, and
    with it the rounding of its actions; in contact-rich simulations single episodes may then go another way.

    A goal is met where each of its parts is within task.radius, or a radius of its own, after a step; task.score says
    what that is worth.
    on_steps(done, total) reports progress; watch sees the copies as they go.
    """
    copies = min(episodes, task.copies)
    env = task.make_env(copies)
    try:
        batches = []
        for first in range(0, episodes, copies):
            seeds = first_seed + first + np.arange(copies)
            batch = _rollout_batch(
                policy,
                task,
                env,
                seeds,
                lambda t, f=first: on_steps(
                    f * task.horizon_steps // copies + t, -(-episodes // copies) * task.horizon_steps
                ),
                watch,
            )
            batches.append(batch)
    finally:
        env.close()
    return Rollouts(
        score=np.concatenate([b.score for b in batches])[:episodes],
        success=np.concatenate([b.success for b in batches])[:episodes],
        steps=np.concatenate([b.steps for b in batches])[:episodes],
        traces=tuple(t for b in batches for t in b.traces)[:episodes],
    )


def _rollout_batch(policy, task, env, seeds, on_step, watch) -> Rollouts:
    goal_indices = list(task.goal_indices)
    observation, goal = env.reset(seeds)
    device_goal = jnp.asarray(goal)
    acting = initial_state(policy, env.count)
    parts = max(1, len(task.goal_parts))
    radii = np.array(task.part_radii or [task.radius])
    active = np.ones(env.count, bool)
    parts_met = np.zeros((env.count, parts), bool)
    steps_met = np.zeros(env.count, int)
    steps = np.full(env.count, task.horizon_steps)
    reset_mask = jnp.ones(env.count, bool)
    no_reset = jnp.zeros(env.count, bool)
    history = []
    for step in range(task.horizon_steps):
        actions, acting = compiled_act(policy, observation, device_goal, acting, reset_mask)
        seen = (observation[:, goal_indices], *_pursued(policy, acting, goal, reset_mask))
        history.append([np.array(part) for part in seen])
        watch(env, history[-1][0], history[-1][1], goal, False)
        observation = env.step(np.asarray(actions), active)
        distances = part_distances(observation[:, goal_indices], goal, task.goal_parts)
        met = active[:, None] & (distances <= radii)
        parts_met |= met
        steps_met += met.all(axis=1)
        done = met.all(axis=1) if task.score != "subtasks" else active & parts_met.all(axis=1)
        steps[done] = np.minimum(steps[done], step + 1)
        if task.score != "return":
            active &= ~done
        reset_mask = no_reset
        on_step(step + 1)
        if not active.any():
            break
    watch(env, observation[:, goal_indices], history[-1][1], goal, True)
    success = np.all(parts_met, axis=1) if task.score == "subtasks" else np.asarray(steps_met > 0)
    score = {"success": 100.0 * success, "return": 1.0 * steps_met, "subtasks": 100.0 * parts_met.mean(axis=1)}
    lengths = np.full(env.count, task.horizon_steps) if task.score == "return" else steps
    traces = _traces(history, success, lengths, goal, observation)
    return Rollouts(score[task.score], success, steps, traces)


def _pursued(policy, acting, goal, begins):
    """(subgoals, whether each is new), both [count, ...]; without subgoals, the goal from the first step on."""
    subgoals = find_method(policy.method).subgoals
    return subgoals.pursued(policy.config, acting) if subgoals else (goal, begins)


def _traces(history, success, steps, goal, last_states) -> tuple[Trace, ...]:
    achieved, subgoals, renewed = (np.stack(arrays, axis=1) for arrays in zip(*history, strict=True))
    return tuple(
        Trace(
            achieved=achieved[e, : steps[e]],
            subgoals=subgoals[e, : steps[e]],
            renewed=renewed[e, : steps[e]],
            goal=goal[e],
            success=bool(success[e]),
            last_state=last_states[e],
        )
        for e in range(len(achieved))
    )


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % score interval of a success rate (Wilson 1927), as fractions."""
    z = 1.959964
    rate = successes / trials
    centre = (rate + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z / (1 + z**2 / trials) * np.sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def bootstrap_interval(scores: np.ndarray, resamples: int = 2000) -> tuple[float, float]:
    """95 % percentile interval of the mean over seeds; seeds, then episodes within them, are resampled.

    scores: [seeds, episodes].
    """
    rng = np.random.default_rng(0)
    seeds, episodes = scores.shape
    chosen = rng.integers(seeds, size=(resamples, seeds, 1))
    means = scores[chosen, rng.integers(episodes, size=(resamples, seeds, episodes))].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def success_interval(success: np.ndarray) -> tuple[float, float]:
    """95 % interval of a success rate over seeds, in percent: bootstrap's, which knows that seeds differ.

    Wilson's where there is nothing to resample: one seed, or outcomes that are all alike, whose bootstrap has no width.
    success: [seeds, episodes] bool.
    """
    if len(success) > 1 and 0 < success.mean() < 1:
        return bootstrap_interval(100.0 * success)
    low, high = wilson_interval(int(success.sum()), success.size)
    return 100 * low, 100 * high
