"""Guider (Algorithm 1): the latent model, the subgoal policy and the goal policy put together.

Nothing couples the high and the low updates, so Algorithm 1's interleaved loop runs as stages in sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from guider import losses
from guider.config import check_not_negative, check_positive
from guider.episodes import Episodes, Spaces
from guider.errors import GuiderError
from guider.goals import Parts, largest_distance
from guider.methods import goal_policy, latent_subgoals, scaling, subgoal_policy
from guider.methods.goal_policy import GoalPolicyConfig, GoalPolicyState
from guider.methods.latent_subgoals import LatentState, LatentSubgoalsConfig
from guider.methods.scaling import Scale, make_scale
from guider.methods.subgoal_policy import SubgoalPolicyConfig, SubgoalPolicyState
from guider.samplers import (
    Boundary,
    Data,
    HighBatch,
    LowBatch,
    MoveWithin,
    device_data,
    sample_high,
    sample_low,
    sample_windows,
    window_starts,
)
from guider.training import Stage


@dataclass(frozen=True)
class GuiderConfig:
    """All of Guider's settings. Defaults are the preset `paper`; see `guider.presets` for `fast`."""

    period_steps: int = 50
    """c: environment steps between subgoals."""
    radius: float = 0.5
    """A goal or subgoal is met, and rewarded, within this distance (Eq. 1's epsilon, goal units)."""
    reach_radius: float = 1.0
    """Acting: a subgoal counts as reached within this distance (goal units)."""
    goal_parts: Parts = ()
    """Entries of the goal that must each be within the radius (kitchen: one part per object); () is all as one part."""
    boundary: Boundary = "clip"
    """c-step windows that would leave their episode end at its last state (clip), or are not used (drop)."""
    minimum_move: float = 0.0
    """Learn, at both levels, only where s^G moves this far or further (goal units), so that idle stretches do not shape
    prior and policies (departure; 0 keeps all)."""
    move_within: MoveWithin = "period"
    """Where it has to: from here to c steps on, or from the episode's first state to any other of it."""
    replan: Literal["period", "reached"] = "period"
    """New subgoal every c steps (paper), or also as soon as the current one is reached (authors' code)."""
    final_goal_substitution: bool = False
    """Pursue the final goal itself where state or subgoal lie within reach_radius of it (authors' code: subgoal)."""
    normalise: bool = False
    """Standardise what the networks see by the data's mean and spread (departure)."""
    position_waves: int = 0
    """Show places (s^G, g_final at the high level) also as sines and cosines at this many frequencies, so that small
    networks can tell the two sides of a wall apart (departure; needs `normalise`)."""
    latent: LatentSubgoalsConfig = field(default_factory=LatentSubgoalsConfig)
    high: SubgoalPolicyConfig = field(default_factory=SubgoalPolicyConfig)
    low: GoalPolicyConfig = field(default_factory=GoalPolicyConfig)

    def __post_init__(self) -> None:
        check_positive(self, "period_steps", "radius", "reach_radius")
        check_not_negative(self, "minimum_move", "position_waves")
        if self.position_waves and not self.normalise:
            raise GuiderError("position_waves needs normalise: wavelengths are counted in spreads of the data")


class GuiderState(NamedTuple):
    """Everything that training changes or acting needs."""

    scale: Scale
    latent: LatentState
    high: SubgoalPolicyState
    low: GoalPolicyState


def prepare(config: GuiderConfig, episodes: Episodes) -> tuple[Data, Scale]:
    """Data on the device and the scaling it implies."""
    data = device_data(episodes, config.period_steps, config.boundary, config.minimum_move, config.move_within)
    if not config.normalise:
        return data, unit_scale(config, episodes.spaces)
    return data, make_scale(episodes, np.asarray(data.window_rows), config.period_steps, config.position_waves)


def learned_windows(config: GuiderConfig, episodes: Episodes) -> np.ndarray:
    """[W] rows of `episodes` that start a c-step window which training draws from."""
    return window_starts(episodes, config.period_steps, config.boundary, config.minimum_move, config.move_within)


def unit_scale(config: GuiderConfig, spaces: Spaces) -> Scale:
    """Raw inputs, and the shapes of any scale."""
    return scaling.unit_scale(spaces, config.position_waves)


def init(config: GuiderConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> GuiderState:
    """Fresh state for one seed."""
    latent_key, high_key, low_key = jax.random.split(key, 3)
    goal_dim, latent_dim = spaces.goal_dim, config.latent.latent_dim
    subgoal_dim = latent_dim if config.low.subgoal_input == "latent" else goal_dim
    wave_dim = 2 * config.position_waves * goal_dim
    position_dim = goal_dim + wave_dim
    low_input_dim = spaces.state_dim + wave_dim + subgoal_dim + goal_dim
    return GuiderState(
        scale=scale,
        latent=latent_subgoals.init(latent_key, config.latent, goal_dim, position_dim),
        high=subgoal_policy.init(high_key, config.high, 2 * position_dim, latent_dim),
        low=goal_policy.init(low_key, config.low, low_input_dim, spaces.action_dim),
    )


def high_inputs(scale: Scale, achieved: jax.Array, goal: jax.Array) -> jax.Array:
    """What the high level sees: scaled (s^G, g_final), [..., inputs]."""
    return jnp.concatenate([scale.position(achieved), scale.position(goal)], axis=-1)


def low_inputs(
    config: GuiderConfig,
    state: GuiderState,
    observation: jax.Array,
    achieved: jax.Array,
    subgoal: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    """What the low level sees: scaled (s, g_sub, g_final), [..., inputs].

    With `relative`, goals are displacements from s^G. Without decoder, g_sub is a latent already.
    """
    scale = state.scale
    if config.low.relative:
        seen_goal = (goal - achieved) / scale.goal_std
        seen_subgoal = (subgoal - achieved) / scale.step_std if config.low.subgoal_input == "goal" else subgoal
    else:
        seen_goal = scale.goal(goal)
        seen_subgoal = scale.goal(subgoal) if config.low.subgoal_input == "goal" else subgoal
    return jnp.concatenate([scale.state(observation), scale.waves(achieved), seen_subgoal, seen_goal], axis=-1)


def relabel_high(
    config: GuiderConfig, state: GuiderState, batch: HighBatch, key: jax.Array
) -> subgoal_policy.Transitions:
    """Algorithm 1, lines 8-10: z ~ q(. | s^G_t, s^G_{t+c}) takes the action's place; Eq. 1 gives the reward."""
    params = state.latent.params
    posterior = latent_subgoals.encode(config.latent, params, state.scale, batch.achieved, batch.later)
    return subgoal_policy.Transitions(
        state=high_inputs(state.scale, batch.achieved, batch.goal),
        latent=posterior.sample(key),
        reward=losses.goal_reward(batch.later, batch.goal, config.radius, config.goal_parts),
        next_state=high_inputs(state.scale, batch.later, batch.goal),
        prior=latent_subgoals.prior(params, state.scale, batch.achieved),
    )


def relabel_low(config: GuiderConfig, state: GuiderState, batch: LowBatch, key: jax.Array) -> goal_policy.Transitions:
    """Algorithm 1, line 16. The reward is for meeting the subgoal (Eq. 1), in goal space always."""
    subgoal = batch.subgoal
    if config.low.subgoal_input == "latent":
        params = state.latent.params
        subgoal = latent_subgoals.encode(config.latent, params, state.scale, batch.achieved, batch.subgoal).sample(key)
    return goal_policy.Transitions(
        state=low_inputs(config, state, batch.observation, batch.achieved, subgoal, batch.goal),
        action=batch.action,
        reward=losses.goal_reward(batch.next_achieved, batch.subgoal, config.radius, config.goal_parts),
        next_state=low_inputs(config, state, batch.next_observation, batch.next_achieved, subgoal, batch.goal),
    )


def stages(config: GuiderConfig) -> tuple[Stage, ...]:
    """Algorithm 1 as three stages for the engine."""

    def update_latent(state: GuiderState, data: Data, key: jax.Array):
        sample_key, update_key = jax.random.split(key)
        batch = sample_windows(data, sample_key, config.latent.batch_size, config.period_steps)
        return latent_subgoals.update(config.latent, state.latent, state.scale, batch, update_key)

    def update_high(state: GuiderState, data: Data, key: jax.Array):
        sample_key, relabel_key, update_key = jax.random.split(key, 3)
        settings = config.high
        batch = sample_high(
            data,
            sample_key,
            settings.batch_size,
            config.period_steps,
            settings.goal_offset,
            settings.relabel_fraction,
            settings.random_goal_fraction,
        )
        transitions = relabel_high(config, state, batch, relabel_key)
        return subgoal_policy.update(settings, state.high, transitions, update_key)

    def update_low(state: GuiderState, data: Data, key: jax.Array):
        sample_key, relabel_key = jax.random.split(key)
        settings = config.low
        batch = sample_low(
            data,
            sample_key,
            settings.batch_size,
            config.period_steps + settings.subgoal_slack_steps,
            settings.relabel_fraction,
            settings.random_goal_fraction,
        )
        transitions = relabel_low(config, state, batch, relabel_key)
        return goal_policy.update(settings, state.low, transitions)

    return (
        Stage("latent subgoals", "latent", config.latent.updates, update_latent),
        Stage("subgoal policy", "high", config.high.updates, update_high),
        Stage("goal policy", "low", config.low.updates, update_low),
    )


class ActingState(NamedTuple):
    """What the policy remembers between steps, per environment.

    subgoal: [B, G] in goal units; latent: [B, Z] the z it was decoded from; steps_left: [B] int32.
    """

    subgoal: jax.Array
    latent: jax.Array
    steps_left: jax.Array


def initial_acting_state(config: GuiderConfig, goal_dim: int, batch_size: int) -> ActingState:
    latent = jnp.zeros((batch_size, config.latent.latent_dim))
    return ActingState(jnp.zeros((batch_size, goal_dim)), latent, jnp.zeros(batch_size, jnp.int32))


def propose_subgoal(
    config: GuiderConfig, state: GuiderState, achieved: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where to go next: (subgoal [..., G], latent [..., Z]), the latent being the mean of pi_h and the subgoal what it
    decodes to, or the final goal where `final_goal_substitution` says so."""
    latent = subgoal_policy.propose(state.high.params, high_inputs(state.scale, achieved, goal)).mean
    subgoal = latent_subgoals.decode(config.latent, state.latent.params, state.scale, achieved, latent)
    if config.final_goal_substitution:
        near = jnp.minimum(
            largest_distance(subgoal, goal, config.goal_parts), largest_distance(achieved, goal, config.goal_parts)
        )[..., None]
        subgoal = jnp.where(near <= config.reach_radius, goal, subgoal)
        if config.low.subgoal_input == "latent":
            params = state.latent.params
            final = latent_subgoals.encode(config.latent, params, state.scale, achieved, goal).mean
            latent = jnp.where(near <= config.reach_radius, final, latent)
    return subgoal, latent


def act(
    config: GuiderConfig,
    state: GuiderState,
    goal_indices: tuple[int, ...],
    observation: jax.Array,
    goal: jax.Array,
    acting: ActingState,
    reset_mask: jax.Array,
) -> tuple[jax.Array, ActingState]:
    """One step of the hierarchy, by the means of both policies.

    observation: [B, S]; goal: [B, G]; reset_mask: [B] bool, True where an episode begins.
    Returns actions [B, A] in [-1, 1] and the new acting state. A new subgoal is chosen at resets, after c
    steps, and, with replan == "reached", once the current one lies within reach_radius.
    """
    achieved = observation[..., jnp.asarray(goal_indices)]
    renew = reset_mask | (acting.steps_left <= 0)
    if config.replan == "reached":
        renew |= largest_distance(achieved, acting.subgoal, config.goal_parts) <= config.reach_radius
    subgoal, latent = propose_subgoal(config, state, achieved, goal)
    subgoal = jnp.where(renew[:, None], subgoal, acting.subgoal)
    latent = jnp.where(renew[:, None], latent, acting.latent)
    steps_left = jnp.where(renew, config.period_steps, acting.steps_left) - 1
    seen = latent if config.low.subgoal_input == "latent" else subgoal
    inputs = low_inputs(config, state, observation, achieved, seen, goal)
    return goal_policy.act(state.low.params, inputs), ActingState(subgoal, latent, steps_left)
