"""Trained policies: a pure batched core for evaluation and export, and a thin object for one robot."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from guider.data.goal_spaces import extended
from guider.errors import GuiderError, GuiderWarning
from guider.methods import find_method

PyTree = Any


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["state", "action_low", "action_high", "state_low", "state_high"],
    meta_fields=["method", "config", "goal_indices", "state_dim", "computed", "computed_entries"],
)
@dataclass(frozen=True)
class Policy:
    """One seed's trained policy: a pytree whose leaves are arrays and whose settings are static.

    state: the method's trained state; action_low, action_high: [A] bounds of the actions it returns;
    goal_indices: entries of a state that form the goal space; state_dim: S;
    computed: what the last `computed_entries` of those are computed by, see guider.data.goal_spaces;
    state_low, state_high: [S] what the networks may be shown of each state entry, None for anything (see `act`).
    """

    state: PyTree
    action_low: jax.Array
    action_high: jax.Array
    method: str
    config: Any
    goal_indices: tuple[int, ...]
    state_dim: int
    state_low: jax.Array | None = None
    state_high: jax.Array | None = None
    computed: tuple[str, ...] = ()
    computed_entries: int = 0

    @property
    def logged_dim(self) -> int:
        """Entries of a state that a robot sees."""
        return self.state_dim - self.computed_entries

    @property
    def action_dim(self) -> int:
        return self.action_low.shape[0]

    @property
    def goal_dim(self) -> int:
        return len(self.goal_indices)


def initial_state(policy: Policy, batch_size: int) -> PyTree:
    """Acting state for `batch_size` environments; `reset_mask` must be True on their first step."""
    return find_method(policy.method).initial_acting_state(policy.config, policy.goal_dim, batch_size)


def act(
    policy: Policy, observation: jax.Array, goal: jax.Array, state: PyTree, reset_mask: jax.Array
) -> tuple[jax.Array, PyTree]:
    """One step for a batch, pure and jittable.

    observation: [B, S]; goal: [B, G]; state: see `initial_state`; reset_mask: [B] bool, True where an episode
    begins. Returns actions [B, A] within the action bounds, and the next acting state. Actions are scaled by the
    setting `action_scale` towards the resting action (see `resting_action`): below 1, what was learned is done more
    gently. State entries and goals far outside what the data holds are taken for its limits: an entry that hardly
    varied there has taught the networks nothing, and must not overrule the others.
    """
    if policy.state_low is not None and policy.state_high is not None:
        observation = jnp.clip(observation, policy.state_low, policy.state_high)
        entries = jnp.asarray(policy.goal_indices)
        goal = jnp.clip(goal, policy.state_low[entries], policy.state_high[entries])
    actions, state = find_method(policy.method).act(
        policy.config, policy.state, policy.goal_indices, observation, goal, state, reset_mask
    )
    centre = (policy.action_high + policy.action_low) / 2
    half_range = (policy.action_high - policy.action_low) / 2
    rest = resting_action(policy.action_low, policy.action_high)
    return rest + policy.config.action_scale * (centre + half_range * actions - rest), state


def resting_action(low: jax.Array, high: jax.Array) -> jax.Array:
    """[A] the action that does nothing: 0, or where the bounds leave 0 out, the bound nearest to it."""
    return jnp.clip(0.0, low, high)


compiled_act = jax.jit(act)


class Agent:
    """A policy for one environment or robot, with the memory it needs between steps.

    agent.reset() before each episode; agent.act(observation [S], goal [G]) -> action [A]. Of entries that are computed
    (`Policy.computed`) an observation has none, a goal all: of an angle its cosine and sine.
    """

    def __init__(self, policy: Policy):
        self.policy = policy
        self._told = False
        self._aim = np.full(policy.goal_dim, np.nan, np.float32)
        self.reset()

    def reset(self) -> None:
        """Forget the current subgoal: a new episode begins."""
        self._state = initial_state(self.policy, 1)
        self._begins = True

    def act(self, observation: ArrayLike, goal: ArrayLike) -> np.ndarray:
        """The action for this step. Raises GuiderError if shapes or values do not fit the policy. Warns where it knows
        of no way to the goal, and heads for the place nearest to it that one leads to."""
        seen = _vector(observation, self.policy.logged_dim, "observation")
        if self.policy.computed:
            complete = extended(seen, self.policy.computed)
            seen = _vector(complete, self.policy.state_dim, "what is computed of the observation")
        aim = _vector(goal, self.policy.goal_dim, "goal")
        self._tell_of_what_is_far_off(seen, aim)
        self._tell_of_a_dead_end(seen, aim)
        actions, self._state = compiled_act(
            self.policy, seen[None], aim[None], self._state, jnp.asarray([self._begins])
        )
        self._begins = False
        return np.asarray(actions[0])

    def _tell_of_what_is_far_off(self, observation: np.ndarray, goal: np.ndarray) -> None:
        """Warn, once, of a state or goal that `act` takes for the limits of the data."""
        low, high = self.policy.state_low, self.policy.state_high
        if self._told or low is None or high is None:
            return
        low, high = np.asarray(low), np.asarray(high)
        entries = list(self.policy.goal_indices)
        for name, values, least, most in (
            ("state", observation, low, high),
            ("goal", goal, low[entries], high[entries]),
        ):
            outside = (values < least) | (values > most)
            if outside.any():
                self._told = True
                entry = int(np.argmax(outside))
                warnings.warn(
                    GuiderWarning(
                        f"{name} entry {entry} is {values[entry]:g}, far from anything in the data (taken for the "
                        f"limit of {least[entry]:g} to {most[entry]:g}); is it in the data's units and frame?"
                    ),
                    stacklevel=3,
                )

    def _tell_of_a_dead_end(self, observation: np.ndarray, goal: np.ndarray) -> None:
        """Warn, once for a goal, where no way leads to it."""
        if np.array_equal(goal, self._aim):
            return
        self._aim = goal
        subgoals = find_method(self.policy.method).subgoals
        if subgoals is None or subgoals.dead_end is None:
            return
        here = observation[list(self.policy.goal_indices)]
        found = subgoals.dead_end(self.policy.config, self.policy.state, jnp.asarray(here[None]), goal[None])
        if found is not None and bool(found[0][0]):
            place = np.asarray(found[1][0])
            warnings.warn(
                GuiderWarning(
                    f"no logged way leads from {_listed(here)} to the goal {_listed(goal)}; heading for "
                    f"{_listed(place)}, the place nearest to it that one leads to"
                ),
                stacklevel=3,
            )

    @property
    def subgoal(self) -> np.ndarray:
        """[G] the subgoal now pursued, in goal units. Raises GuiderError if the method has none."""
        subgoals = find_method(self.policy.method).subgoals
        if subgoals is None:
            raise GuiderError(f"{self.policy.method} has no subgoals in goal space")
        return np.asarray(subgoals.pursued(self.policy.config, self._state)[0][0])


def _listed(place: np.ndarray) -> str:
    return f"({', '.join(f'{entry:.4g}' for entry in place)})"


def _vector(values: ArrayLike, size: int, name: str) -> np.ndarray:
    vector = np.asarray(values, np.float32)
    if vector.shape != (size,):
        raise GuiderError(f"{name} has shape {vector.shape}; this policy was trained on {name}s of shape ({size},)")
    if not np.isfinite(vector).all():
        raise GuiderError(f"{name} holds NaN or inf: {vector}")
    return vector
