"""A policy's episodes in a model of the robot that is learned from its logs: for robots without a simulator.

The model is an ensemble of networks, each of which says how a state changes in a step under an action. A policy is let
act in it from where held-out episodes begin, to where other ones end. Where an imagined robot comes to places far from
any that was logged, the model knows nothing, and the episode counts as failed: this is also how walls are felt.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from guider.data.episodes import SMALLEST_SPREAD, Episodes
from guider.data.findings import wrapping_entries
from guider.evaluation.rollouts import Trace
from guider.goals import largest_distance
from guider.learning.networks import Layers, mlp, mlp_init
from guider.learning.optimisers import adam_init, adam_step, cosine_rate
from guider.methods import find_method
from guider.methods.policy import Policy, act, initial_state

MEMBERS, UPDATES, BATCH, HIDDEN, LEARNING_RATE = 3, 6_000, 256, (256, 256), 1e-3
PAIRS = 100
"""Of a start and a goal, for each member of the ensemble."""
_LONGEST_STEPS, _EPISODE_LENGTHS = 1_000, 3
_LARGEST_CHANGE = 10.0  # spreads of a step


class Model(NamedTuple):
    """How a robot moves. members: [K, ...] networks; mean, spread: [S] of states; change, change_spread: [S] of their
    steps; low, period: [S] of entries that wrap, period 0 where they do not; centre, half_range: [A] of actions."""

    members: Layers
    mean: jax.Array
    spread: jax.Array
    change: jax.Array
    change_spread: jax.Array
    low: jax.Array
    period: jax.Array
    centre: jax.Array
    half_range: jax.Array


def fit_model(episodes: Episodes) -> Model:
    """A model of the steps in `episodes`; the same every time. Little data is learned by heart soon."""
    updates = min(UPDATES, max(1_000, len(episodes.observations)))
    rows = np.delete(np.arange(len(episodes.observations) - 1), episodes.starts[1:] - 1)
    states, later = (jnp.asarray(episodes.observations[rows + offset]) for offset in (0, 1))
    wraps = np.zeros(states.shape[1], bool)
    wraps[wrapping_entries(episodes)] = True
    low, high = states.min(axis=0), states.max(axis=0)
    period = jnp.where(jnp.asarray(wraps), high - low, 0.0)
    changes = _shortest(later - states, period)
    centre, half_range = (
        jnp.asarray(values) / 2
        for values in (episodes.action_high + episodes.action_low, episodes.action_high - episodes.action_low)
    )
    key, init_key = jax.random.split(jax.random.key(0))
    sizes = (states.shape[1] + episodes.actions.shape[1], *HIDDEN, states.shape[1])
    model = Model(
        members=jax.vmap(lambda member: mlp_init(member, sizes))(jax.random.split(init_key, MEMBERS)),
        mean=states.mean(axis=0),
        spread=jnp.maximum(states.std(axis=0), SMALLEST_SPREAD),
        change=changes.mean(axis=0),
        change_spread=jnp.maximum(changes.std(axis=0), 1e-6 * jnp.maximum(states.std(axis=0), SMALLEST_SPREAD)),
        low=low,
        period=period,
        centre=centre,
        half_range=half_range,
    )
    inputs = _inputs(model, states, jnp.asarray(episodes.actions[rows]))
    targets = jnp.clip((changes - model.change) / model.change_spread, -_LARGEST_CHANGE, _LARGEST_CHANGE)
    return model._replace(members=_fit(model.members, inputs, targets, key, updates))


@partial(jax.jit, static_argnames="updates")
def _fit(members: Layers, inputs: jax.Array, targets: jax.Array, key: jax.Array, updates: int) -> Layers:
    def update(carry: Any, key: jax.Array) -> tuple[Any, None]:
        members, moments = carry
        rows = jax.random.randint(key, (MEMBERS, BATCH), 0, len(inputs))

        def loss(members: Layers) -> jax.Array:
            predicted = jax.vmap(lambda member, x: mlp(member, x, jax.nn.silu))(members, inputs[rows])
            return MEMBERS * jnp.mean((predicted - targets[rows]) ** 2)

        rate = cosine_rate(LEARNING_RATE, True, updates, moments)
        return adam_step(rate, members, jax.grad(loss)(members), moments), None

    (members, _), _ = jax.lax.scan(update, (members, adam_init(members)), jax.random.split(key, updates))
    return members


def step(model: Model, states: jax.Array, actions: jax.Array) -> jax.Array:
    """[K, B, S] the states that follow, for each member's. states: [K, B, S]; actions: [K, B, A], within their
    bounds."""
    outputs = jax.vmap(lambda member, x: mlp(member, x, jax.nn.silu))(model.members, _inputs(model, states, actions))
    later = states + model.change + model.change_spread * outputs
    return jnp.where(model.period > 0, model.low + jnp.mod(later - model.low, jnp.maximum(model.period, 1e-30)), later)


def _inputs(model: Model, states: jax.Array, actions: jax.Array) -> jax.Array:
    return jnp.concatenate([(states - model.mean) / model.spread, (actions - model.centre) / model.half_range], axis=-1)


def _shortest(changes: jax.Array, period: jax.Array) -> jax.Array:
    """Changes the short way round, of entries that wrap."""
    around = jnp.maximum(period, 1e-30)
    return jnp.where(period > 0, changes - around * jnp.round(changes / around), changes)


@partial(jax.jit, static_argnames="steps")
def imagine(
    policy: Policy, model: Model, starts: jax.Array, goals: jax.Array, steps: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What the policy does in each member's world. starts: [B, S]; goals: [B, G].

    Returns where it comes after each step, the subgoal it then pursued (the goal, where it has none), [steps, K, B, G],
    and whether that was new, [steps, K, B].
    """
    members, count = len(model.members[0][0]), len(starts)
    entries = jnp.asarray(policy.goal_indices)
    aims = jnp.tile(goals, (members, 1))
    subgoals = find_method(policy.method).subgoals

    def one(carry: Any, index: jax.Array) -> tuple[Any, Any]:
        states, acting = carry
        begins = jnp.full(members * count, index == 0)
        actions, acting = act(policy, states.reshape(members * count, -1), aims, acting, begins)
        pursued, renewed = subgoals.pursued(policy.config, acting) if subgoals else (aims, begins)
        states = step(model, states, actions.reshape(members, count, -1))
        shape = members, count
        return (states, acting), (states[..., entries], pursued.reshape(*shape, -1), renewed.reshape(shape))

    begin = jnp.broadcast_to(starts, (members, *starts.shape)), initial_state(policy, members * count)
    return jax.lax.scan(one, begin, jnp.arange(steps))[1]


@dataclass(frozen=True, eq=False)
class Imagined:
    """Imagined episodes. starts: [B, S]; goals: [B, G]; places, subgoals: [steps, K, B, G]; renewed: [steps, K, B];
    first_met, first_off: [K, B] steps until the goal is met, and until the logged places are left; `steps` if never."""

    starts: np.ndarray
    goals: np.ndarray
    places: np.ndarray
    subgoals: np.ndarray
    renewed: np.ndarray
    first_met: np.ndarray
    first_off: np.ndarray

    @property
    def success(self) -> np.ndarray:
        """[K, B] bool: the goal was met, and nowhere before was nothing logged."""
        return self.first_met < self.first_off

    def traces(self, count: int) -> tuple[Trace, ...]:
        """The first episodes in the first member's world, failures in front."""
        order = np.argsort(self.success[0], kind="stable")[:count]
        ends = np.where(self.success, self.first_met + 1, np.minimum(self.first_off + 1, len(self.places)))[0]
        return tuple(
            Trace(
                achieved=self.places[: ends[e], 0, e],
                subgoals=self.subgoals[: ends[e], 0, e],
                renewed=self.renewed[: ends[e], 0, e],
                goal=self.goals[e],
                success=bool(self.success[0, e]),
                last_state=self.starts[e],
            )
            for e in order
        )


def imagined_episodes(policy: Policy, model: Model, training: Episodes, unseen: Episodes) -> Imagined:
    """A policy's episodes in the model of the episodes `training`, on starts and goals of `unseen`.

    They last three times the longest episode, 1,000 steps at the most. Places are off the data where no logged one lies
    within the reach radius, or within what separates all but a thousandth of unseen states from the logged ones, if
    that is more.
    """
    problem = policy.config.problem
    logged = KDTree(training.achieved)
    apart = float(np.quantile(logged.query(unseen.achieved)[0], 0.999))
    starts, goals = starts_and_goals(unseen, 2 * problem.radius, problem.goal_parts)
    steps = min(_LONGEST_STEPS, _EPISODE_LENGTHS * int(training.lengths.max()))
    found = imagine(policy, model, jnp.asarray(starts), jnp.asarray(goals), steps)
    places, subgoals, renewed = (np.asarray(part) for part in found)
    met = largest_distance(places, goals, problem.goal_parts) <= problem.radius
    flat = np.nan_to_num(places.reshape(-1, places.shape[-1]), nan=1e30, posinf=1e30, neginf=-1e30)
    off = (logged.query(flat)[0] > max(problem.reach_radius, apart)).reshape(met.shape)
    first = (np.where(happens.any(axis=0), happens.argmax(axis=0), steps) for happens in (met, off))
    return Imagined(starts, goals, places, subgoals, renewed, *first)


def imagined_scores(policy: Policy, model: Model, training: Episodes, unseen: Episodes) -> dict[str, float | None]:
    """How a policy's imagined episodes go, see `imagined_episodes`.

    imagined_success:   share that meets the goal without leaving what was logged
    imagined_steps:     median steps until then
    imagined_left_data: share that left it first
    model_error:        error of the model after c logged actions from an unseen state, as a share of the way that c
                        steps go, both in the root of the mean square: above a half, the model says little
    """
    seen = imagined_episodes(policy, model, training, unseen)
    success = seen.success
    return {
        "imagined_success": float(success.mean()),
        "imagined_steps": float(np.median(seen.first_met[success] + 1)) if success.any() else None,
        "imagined_left_data": float(((seen.first_off < len(seen.places)) & ~success).mean()),
        "model_error": model_error(model, unseen, policy.config.problem.period_steps),
    }


def model_error(model: Model, unseen: Episodes, period_steps: int) -> float | None:
    """See `imagined_scores`; None where no unseen episode is as long as c steps."""
    rows = np.flatnonzero(np.arange(len(unseen.observations)) + period_steps <= unseen.last_rows)
    if len(rows) == 0:
        return None
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), 1000)).astype(int)]
    members = len(model.members[0][0])
    states = jnp.broadcast_to(unseen.observations[rows], (members, len(rows), unseen.observations.shape[1]))
    logged = jnp.asarray(unseen.actions[rows[:, None] + np.arange(period_steps)].swapaxes(0, 1))

    def one(states: jax.Array, actions: jax.Array) -> tuple[jax.Array, None]:
        return step(model, states, jnp.broadcast_to(actions, (members, *actions.shape))), None

    states, _ = jax.lax.scan(one, states, logged)
    goal = list(unseen.goal_indices)
    began, ended = unseen.achieved[rows], unseen.achieved[rows + period_steps]
    error, way = np.asarray(states)[..., goal] - ended, ended - began
    return float(np.sqrt(np.mean(error**2) / max(float(np.mean(way**2)), 1e-30)))


def starts_and_goals(unseen: Episodes, least: float, goal_parts: Any) -> tuple[np.ndarray, np.ndarray]:
    """(starts [B, S], goals [B, G]): where episodes begin, and where others end, further off than `least`; where there
    are none such, those that are furthest."""
    rng = np.random.default_rng(0)
    first, last = (rng.integers(len(unseen.starts), size=20 * PAIRS) for _ in range(2))
    starts, goals = unseen.observations[unseen.starts[first]], unseen.achieved[unseen.ends[last]]
    distance = np.asarray(largest_distance(starts[:, list(unseen.goal_indices)], goals, goal_parts))
    chosen = np.flatnonzero(distance > least)[:PAIRS]
    if len(chosen) == 0:
        chosen = np.argsort(-distance)[:PAIRS]
    return starts[chosen], goals[chosen]
