"""Fitted Q evaluation: what a policy is worth by logged steps alone, without a model of how the robot moves.

Le, Voloshin and Yue, "Batch Policy Learning under Constraints" (ICML 2019), section 4, here with goals. Q(s, a, g) is
the chance, discounted by the steps until then, that g is met after a in s if the policy acts from there on. It is 1
where the step meets g, and elsewhere the discounted Q of where the step led and of what the policy would do there. A
policy that pursues subgoals is asked anew at every step.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import SMALLEST_SPREAD, Episodes
from guider.evaluation.imagined import starts_and_goals
from guider.goals import largest_distance
from guider.learning.networks import Layers, mlp, mlp_init
from guider.learning.optimisers import adam_init, adam_step, cosine_rate, trail
from guider.methods.policy import Policy, compiled_act, initial_state

MEMBERS, UPDATES, BATCH, HIDDEN, LEARNING_RATE, TARGET_RATE = 2, 8_000, 256, (128, 128), 1e-3, 0.05
DISCOUNT = 0.97
_FIRST_LOGIT = -4.0
"""Nothing is worth much before anything is learned: who never arrives is not taken for one who arrives late."""
_ASKED, _TIMES = 2_000, 20
"""How many steps a policy is asked about at a time, and how often."""


class Steps(NamedTuple):
    """Logged steps, each with a goal. now: [N, inputs] the state, what was done, the goal, and the way there; then:
    [N, inputs] the next state, what the policy does there, and so on; met: [N] whether the step met the goal."""

    now: jax.Array
    then: jax.Array
    met: jax.Array


class Values(NamedTuple):
    """Q of all members. members: [K, ...] networks; mean, spread: [inputs] of what they see."""

    members: Layers
    mean: jax.Array
    spread: jax.Array


def fitted_value(policy: Policy, training: Episodes, unseen: Episodes) -> float:
    """What the policy is worth (0 to 1) where episodes of `unseen` begin, towards where others of them end, by the
    steps in `training`; the mean of the members' Q."""
    problem = policy.config.problem
    values = fit(logged_steps(policy, training), DISCOUNT, UPDATES)
    starts, goals = starts_and_goals(unseen, 2 * problem.radius, problem.goal_parts)
    return float(value(values, _seen(policy, starts, _actions(policy, starts, goals), goals)).mean())


def logged_steps(policy: Policy, episodes: Episodes) -> Steps:
    """Steps drawn with replacement; a goal is where their episode comes later, or, for half, where another one ends."""
    rng = np.random.default_rng(0)
    last_rows = episodes.last_rows
    steps = np.delete(np.arange(len(last_rows)), episodes.ends)
    rows = rng.choice(steps, _ASKED * _TIMES)
    later = rng.integers(rows + 1, last_rows[rows] + 1)
    ends = rng.choice(episodes.ends, len(rows))
    goals = episodes.achieved[np.where(rng.random(len(rows)) < 0.5, later, ends)]
    problem = policy.config.problem
    met = largest_distance(episodes.achieved[rows + 1], goals, problem.goal_parts) <= problem.radius
    states, next_states = (episodes.observations[rows + offset] for offset in (0, 1))
    return Steps(
        now=_seen(policy, states, episodes.actions[rows], goals),
        then=_seen(policy, next_states, _actions(policy, next_states, goals), goals),
        met=jnp.asarray(met),
    )


def _seen(policy: Policy, states: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> jax.Array:
    ways = goals - states[:, list(policy.goal_indices)]
    return jnp.concatenate([jnp.asarray(part) for part in (states, actions, goals, ways)], axis=-1)


def _actions(policy: Policy, states: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """[N, A] what the policy begins with in each state."""
    found: list[np.ndarray] = []
    for first in range(0, len(states), _ASKED):
        asked = jnp.asarray(states[first : first + _ASKED]), jnp.asarray(goals[first : first + _ASKED])
        count = len(asked[0])
        found.append(np.asarray(compiled_act(policy, *asked, initial_state(policy, count), jnp.ones(count, bool))[0]))
    return np.concatenate(found)


def fit(steps: Steps, discount: float, updates: int) -> Values:
    """Q of the policy that is in `steps`; the same every time."""
    mean, spread = steps.now.mean(axis=0), jnp.maximum(steps.now.std(axis=0), SMALLEST_SPREAD)
    key, init_key = jax.random.split(jax.random.key(0))
    sizes = steps.now.shape[1], *HIDDEN, 1
    *hidden, (weights, biases) = jax.vmap(lambda member: mlp_init(member, sizes))(jax.random.split(init_key, MEMBERS))
    values = Values((*hidden, (0.1 * weights, biases + _FIRST_LOGIT)), mean, spread)
    return values._replace(members=_fit(values, steps, key, discount, updates))


@partial(jax.jit, static_argnames="updates")
def _fit(values: Values, steps: Steps, key: jax.Array, discount: float, updates: int) -> Layers:
    def update(carry: Any, key: jax.Array) -> tuple[Any, None]:
        members, target, moments = carry
        chosen = jax.tree.map(lambda part: part[jax.random.randint(key, (BATCH,), 0, len(steps.met))], steps)
        worth = jnp.where(chosen.met, 1.0, discount * value(values._replace(members=target), chosen.then))

        def loss(members: Layers) -> jax.Array:
            logits = _logits(values._replace(members=members), chosen.now)
            return jnp.sum(jnp.mean(jax.nn.softplus(logits) - worth * logits, axis=-1))  # cross entropy

        rate = cosine_rate(LEARNING_RATE, True, updates, moments)
        members, moments = adam_step(rate, members, jax.grad(loss)(members), moments)
        return (members, trail(target, members, TARGET_RATE), moments), None

    begin = values.members, values.members, adam_init(values.members)
    (members, _, _), _ = jax.lax.scan(update, begin, jax.random.split(key, updates))
    return members


def value(values: Values, seen: jax.Array) -> jax.Array:
    """[K, N] Q of each member. seen: [N, inputs]."""
    return jax.nn.sigmoid(_logits(values, seen))


def _logits(values: Values, seen: jax.Array) -> jax.Array:
    inputs = (seen - values.mean) / values.spread
    return jax.vmap(lambda member: mlp(member, inputs, jax.nn.silu)[..., 0])(values.members)
