"""Scores on episodes that training never saw, for robots that have logs but no simulator."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from guider.episodes import Episodes
from guider.errors import GuiderError
from guider.methods import goal_policy
from guider.methods.guider import high_inputs, learned_windows, low_inputs, propose_subgoal
from guider.methods.latent_subgoals import encode, prior
from guider.methods.subgoal_policy import propose
from guider.networks import twin_values
from guider.policy import Policy

MAX_ROWS = 20_000
INSIDE_95 = 1.959964


def held_out_scores(policy: Policy, episodes: Episodes) -> dict[str, float | None]:
    """How the three parts of a Guider policy fare on held-out episodes. Rows are c-step windows such as
    the run learned from, at most 20,000.

    action_error:         mean squared error of the low level's action, bounds scaled to [-1, 1], when asked for
                          the state c steps on; `action_spread` is that of always answering with the mean action
    prior_coverage:       share of latent entries of true c-step outcomes within the prior's central 95 %
                          (0.95 if it fits; less: it has not seen such moves); `prior_coverage_shuffled` is the
                          same for outcomes taken from other places: it should be lower
    subgoal_distance:     median distance from proposed subgoals to the nearest logged goal-space state (goal units)
    subgoals_in_range:    share of proposed subgoals no further away than 99 % of true c-step outcomes
    value_rank:           mean over episodes of Spearman's correlation between time and the high level's value
                          of the episode's last state as goal: 1 where value rises all along
    """
    config, state = policy.config, policy.state
    last = episodes.last_rows
    rows = learned_windows(config, episodes)
    if len(rows) == 0:
        raise GuiderError(f"no held-out episode holds a window of {config.period_steps} steps to score")
    rng = np.random.default_rng(0)
    if len(rows) > MAX_ROWS:
        rows = np.sort(rng.choice(rows, MAX_ROWS, replace=False))
    later = np.minimum(rows + config.period_steps, last[rows])
    achieved, outcome, final = (jnp.asarray(episodes.achieved[r]) for r in (rows, later, last[rows]))
    observation = jnp.asarray(episodes.observations[rows])

    latent = encode(config.latent, state.latent.params, state.scale, achieved, outcome).mean
    seen = latent if config.low.subgoal_input == "latent" else outcome
    inputs = low_inputs(config, state, observation, achieved, seen, final)
    half_range = (episodes.action_high - episodes.action_low) / 2
    actions = (episodes.actions[rows] - (episodes.action_high + episodes.action_low) / 2) / half_range
    action_error = np.mean((np.asarray(goal_policy.act(state.low.params, inputs)) - actions) ** 2)

    reachable = prior(state.latent.params, state.scale, achieved)
    shuffled = rng.permutation(len(rows))
    elsewhere = encode(config.latent, state.latent.params, state.scale, achieved, outcome[shuffled]).mean

    def coverage(z):
        return float(jnp.mean(jnp.abs(z - reachable.mean) <= INSIDE_95 * jnp.exp(reachable.log_std)))

    subgoal, _ = propose_subgoal(config, state, achieved, final)
    travel = np.linalg.norm(outcome - achieved, axis=1)
    proposed_travel = np.linalg.norm(subgoal - achieved, axis=1)
    probes = rng.choice(len(rows), min(1000, len(rows)), replace=False)
    logged = episodes.achieved[rows]
    nearest = [np.linalg.norm(logged - point, axis=1).min() for point in np.asarray(subgoal)[probes]]

    high = high_inputs(state.scale, achieved, final)
    best = propose(state.high.params, high).mean
    value = np.asarray(twin_values(state.high.params.critic, high, best).min(axis=0))
    return {
        "action_error": float(action_error),
        "action_spread": float(np.mean(actions.var(axis=0))),
        "prior_coverage": coverage(latent),
        "prior_coverage_shuffled": coverage(elsewhere),
        "subgoal_distance": float(np.median(nearest)),
        "subgoals_in_range": float(np.mean(proposed_travel <= np.quantile(travel, 0.99))),
        "value_rank": _mean_rank_correlation(value, last[rows]),
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
