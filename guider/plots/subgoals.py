"""What a policy holds for reachable and proposes, as numbers in goal units, and what the data did."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes
from guider.methods import find_method
from guider.methods.method import Subgoals
from guider.methods.policy import Policy
from guider.methods.view import learned_windows


def subgoals_of(policy: Policy) -> Subgoals:
    """Of a method that has subgoals in goal space."""
    found = find_method(policy.method).subgoals
    assert found is not None
    return found


def proposals(policy: Policy, observations: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Subgoals that are proposed, and what being there is worth, see guider.methods.method.Subgoals.

    observations: [B, S]; goal: [G] or [B, G]. Returns ([B, G], [B]).
    """
    goals = np.broadcast_to(goal, (len(observations), policy.goal_dim))
    subgoals, worth = _proposals(policy, jnp.asarray(observations, jnp.float32), jnp.asarray(goals, jnp.float32))
    return np.asarray(subgoals), np.asarray(worth)


@jax.jit
def _proposals(policy: Policy, observation: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    achieved = observation[..., jnp.asarray(policy.goal_indices)]
    return subgoals_of(policy).propose(policy.config, policy.state, observation, achieved, goal)


def reachable(policy: Policy, achieved: np.ndarray, count: int) -> np.ndarray:
    """[B, count, G]: samples of where c steps may lead from achieved [B, G]; none without `Subgoals.reachable`."""
    if subgoals_of(policy).reachable is None:
        return np.zeros((len(achieved), 0, achieved.shape[1]))
    return np.asarray(_reachable(policy, jnp.asarray(achieved, jnp.float32), count)).swapaxes(0, 1)


@partial(jax.jit, static_argnums=2)
def _reachable(policy: Policy, achieved: jax.Array, count: int) -> jax.Array:
    samples = subgoals_of(policy).reachable
    assert samples is not None
    return samples(policy.config, policy.state, achieved, count)


def states_at(logged: Episodes, places: np.ndarray) -> np.ndarray:
    """[P, S]: at each of places [P, G], the logged state that lies nearest, moved there."""
    nearest = [int(np.linalg.norm(logged.achieved - place, axis=1).argmin()) for place in places]
    states = np.array(logged.observations[nearest])
    states[:, list(logged.goal_indices)] = places
    return states


def data_outcomes(logged: Episodes, config: Any) -> tuple[np.ndarray, np.ndarray]:
    """s^G at both ends of every c-step window that training draws from, [W, G] each."""
    rows = learned_windows(config.view, config.problem, logged)
    later = np.minimum(rows + config.problem.period_steps, logged.last_rows[rows])
    return logged.achieved[rows], logged.achieved[later]
