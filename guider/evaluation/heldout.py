"""Scores on episodes that training never saw, for robots that have logs but no simulator."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes
from guider.errors import GuiderError
from guider.methods import find_method
from guider.methods.method import Subgoals
from guider.methods.policy import Policy, initial_state
from guider.methods.view import learned_windows

MAX_ROWS = 20_000


def held_out_scores(policy: Policy, episodes: Episodes) -> dict[str, float | None]:
    """How a policy fares on held-out episodes. Rows are c-step windows such as the run learned from, at most 20,000.

    action_error:         mean squared error of the action, bounds scaled to [-1, 1], when asked for the state c steps
                          on; `action_spread` is that of always answering with the mean action
    and, of a method that learns what c steps lead to (see Subgoals.fit),
    prior_coverage:       share of true c-step outcomes that it holds for likely (0.95 if it fits; less: it has not seen
                          such moves); `prior_coverage_shuffled` is the same for outcomes taken from other places: it
                          should be lower
    and of one that names places to go to,
    subgoal_distance:     median distance (goal units) from subgoals proposed towards the episode's last state to the
                          nearest goal-space state that starts one of these windows
    subgoals_in_range:    share of proposed subgoals no further away than 99 % of true c-step outcomes
    value_rank:           mean over episodes of Spearman's correlation between time and what being there is worth (see
                          Subgoals.propose) with the episode's last state as goal: 1 where it rises
    """
    config = policy.config
    period_steps = config.problem.period_steps
    last = episodes.last_rows
    rows = learned_windows(config.view, config.problem, episodes)
    if len(rows) == 0:
        raise GuiderError(f"no held-out episode holds a window of {period_steps} steps to score")
    rng = np.random.default_rng(0)
    if len(rows) > MAX_ROWS:
        rows = np.sort(rng.choice(rows, MAX_ROWS, replace=False))
    later = np.minimum(rows + period_steps, last[rows])
    seen = _Seen(
        observation=jnp.asarray(episodes.observations[rows]),
        achieved=jnp.asarray(episodes.achieved[rows]),
        outcome=jnp.asarray(episodes.achieved[later]),
        final=jnp.asarray(episodes.achieved[last[rows]]),
    )
    half_range = (episodes.action_high - episodes.action_low) / 2
    actions = (episodes.actions[rows] - (episodes.action_high + episodes.action_low) / 2) / half_range
    subgoals = find_method(policy.method).subgoals
    answers = _actions(policy, seen) if subgoals is None else _low_level_actions(policy, subgoals, seen)
    scores: dict[str, float | None] = {
        "action_error": float(np.mean((answers - actions) ** 2)),
        "action_spread": float(np.mean(actions.var(axis=0))),
    }
    return scores if subgoals is None else scores | _scores_of_subgoals(policy, subgoals, seen, last[rows], rng)


class _Seen(NamedTuple):
    """Held-out windows: observation [W, S]; s^G at their start, c steps on, and at their episode's end, [W, G]."""

    observation: jax.Array
    achieved: jax.Array
    outcome: jax.Array
    final: jax.Array


def _actions(policy: Policy, seen: _Seen) -> np.ndarray:
    """[W, A] in [-1, 1], towards the state c steps on."""
    count = len(seen.achieved)
    act = find_method(policy.method).act
    begins, acting = jnp.ones(count, bool), initial_state(policy, count)
    answers, _ = act(policy.config, policy.state, policy.goal_indices, seen.observation, seen.outcome, acting, begins)
    return np.asarray(answers)


def _low_level_actions(policy: Policy, subgoals: Subgoals, seen: _Seen) -> np.ndarray:
    """[W, A] in [-1, 1], with the state c steps on as the subgoal."""
    return np.asarray(
        subgoals.reach(policy.config, policy.state, seen.observation, seen.achieved, seen.outcome, seen.final)
    )


def _scores_of_subgoals(
    policy: Policy, subgoals: Subgoals, seen: _Seen, episode: np.ndarray, rng: np.random.Generator
) -> dict[str, float | None]:
    """episode: [W] equal for windows of one episode."""
    config, state = policy.config, policy.state
    count, achieved, outcome = len(seen.achieved), seen.achieved, seen.outcome
    shuffled, scores = rng.permutation(count), {}
    if subgoals.fit is not None:
        scores["prior_coverage"] = float(subgoals.fit(config, state, achieved, outcome))
        scores["prior_coverage_shuffled"] = float(subgoals.fit(config, state, achieved, outcome[shuffled]))

    subgoal, worth = subgoals.propose(config, state, seen.observation, achieved, seen.final)
    travel = np.linalg.norm(outcome - achieved, axis=1)
    proposed_travel = np.linalg.norm(subgoal - achieved, axis=1)
    probes = rng.choice(count, min(1000, count), replace=False)
    logged = np.asarray(achieved)
    nearest = [np.linalg.norm(logged - point, axis=1).min() for point in np.asarray(subgoal)[probes]]
    return scores | {
        "subgoal_distance": float(np.median(nearest)),
        "subgoals_in_range": float(np.mean(proposed_travel <= np.quantile(travel, 0.99))),
        "value_rank": _mean_rank_correlation(np.asarray(worth), episode),
    }


def _mean_rank_correlation(values: np.ndarray, episode: np.ndarray) -> float | None:
    """Mean over episodes of Spearman's correlation of row order and value; those of < 3 rows are left out."""
    correlations = []
    for label in np.unique(episode):
        chosen = values[episode == label]
        if len(chosen) >= 3 and np.ptp(chosen) > 0:
            ranks = np.argsort(np.argsort(chosen))
            correlations.append(np.corrcoef(np.arange(len(chosen)), ranks)[0, 1])
    return float(np.mean(correlations)) if correlations else None
