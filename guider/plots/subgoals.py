"""What a policy holds for reachable and proposes, as numbers in goal units, and what the data did."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes
from guider.methods import guider, latent_subgoals
from guider.methods.policy import Policy
from guider.methods.view import learned_windows


def proposals(policy: Policy, achieved: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Subgoals that are proposed, and the value of being there, see guider.methods.guider.value.

    achieved: [B, G]; goal: [G] or [B, G]. Returns ([B, G], [B]).
    """
    goals = np.broadcast_to(goal, achieved.shape)
    subgoals, values = _proposals(policy, jnp.asarray(achieved, jnp.float32), jnp.asarray(goals, jnp.float32))
    return np.asarray(subgoals), np.asarray(values)


@jax.jit
def _proposals(policy: Policy, achieved: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    subgoal, latent = guider.propose_subgoal(policy.config, policy.state, achieved, goal)
    return subgoal, guider.value(policy.config, policy.state, achieved, goal, latent)


def prior_samples(policy: Policy, achieved: np.ndarray, count: int) -> np.ndarray:
    """[B, count, G]: subgoals z ~ rho(. | s^G), decoded, for each of achieved [B, G]."""
    return np.asarray(_prior_samples(policy, jnp.asarray(achieved, jnp.float32), count)).swapaxes(0, 1)


@partial(jax.jit, static_argnums=2)
def _prior_samples(policy: Policy, achieved: jax.Array, count: int) -> jax.Array:
    """[count, B, G]."""
    state: guider.GuiderState = policy.state
    params = state.latent.params
    reachable = latent_subgoals.prior(params, state.scale, achieved)
    latents = reachable.sample(jax.random.key(0), (count,))
    origins = jnp.broadcast_to(achieved, (count, *achieved.shape))
    return latent_subgoals.decode(policy.config.latent, params, state.scale, origins, latents)


def data_outcomes(logged: Episodes, config: guider.GuiderConfig) -> tuple[np.ndarray, np.ndarray]:
    """s^G at both ends of every c-step window that training draws from, [W, G] each."""
    rows = learned_windows(config.view, config.problem, logged)
    later = np.minimum(rows + config.problem.period_steps, logged.last_rows[rows])
    return logged.achieved[rows], logged.achieved[later]
