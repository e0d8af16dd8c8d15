"""Guider (Algorithm 1): the latent model, the subgoal policy and the goal policy put together.

Nothing couples the high and the low updates, so Algorithm 1's interleaved loop runs as stages in sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.goals import largest_distance
from guider.learners import (
    AwrConfig,
    CqlConfig,
    GcslConfig,
    LearnerConfig,
    Transitions,
    WgcslConfig,
    fast_learner,
    learner,
)
from guider.learning import losses
from guider.learning.networks import Precision
from guider.learning.optimisers import cosine_rate
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.samplers import HighBatch, LowBatch, sample_high, sample_low, sample_windows
from guider.learning.training import Stage
from guider.learning.windows import Data
from guider.methods import goal_policy, latent_subgoals, routes, subgoal_policy
from guider.methods.goal_policy import GoalPolicyConfig
from guider.methods.guider_fast import FAST, FAST_IN_DOMAIN, ROUTES_FAST_IN_DOMAIN
from guider.methods.latent_subgoals import LatentState, LatentSubgoalsConfig
from guider.methods.method import Method, Subgoals
from guider.methods.presets import fast
from guider.methods.routes import RoutesConfig
from guider.methods.subgoal_policy import SubgoalPolicyConfig
from guider.methods.view import Scale, ViewConfig
from guider.support.config import check_fraction, check_positive, override

Planner = Literal["policy", "routes"]


@dataclass(frozen=True)
class GuiderConfig:
    """All of Guider's settings. Defaults are the preset `paper`; `fast` (guider_fast.py) departs from it."""

    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    planner: Planner = "policy"
    """Who chooses subgoals: pi_h (Eq. 4), or the graph over logged places in its stead (departure, see routes.py)."""
    replan: Literal["period", "reached", "step"] = "period"
    """New subgoal every c steps (paper), or also as soon as the current one is reached (authors' code), or at every
    step (departure)."""
    candidates: int = 1
    """Acting: 1 takes the mean of pi_h; more take the best, by the critic, of so many samples of rho, or of pi_h where
    `high.prior` is off: where several things may come next, a mean lies between them (departure)."""
    final_goal_substitution: bool = False
    """Pursue the final goal itself where state or subgoal lie within reach_radius of it (authors' code: subgoal)."""
    final_goal_within_reach: bool = False
    """And where rho holds it for a place that c steps may lead to (departure; needs the above)."""
    latent: LatentSubgoalsConfig = field(default_factory=LatentSubgoalsConfig)
    high: SubgoalPolicyConfig = field(default_factory=SubgoalPolicyConfig)
    routes: RoutesConfig = field(default_factory=RoutesConfig)
    low: GoalPolicyConfig = field(default_factory=GoalPolicyConfig)

    def __post_init__(self) -> None:
        check_positive(self, "candidates")
        check_fraction(self, "action_scale")


class GuiderState(NamedTuple):
    """Everything that training changes or acting needs. high: SubgoalPolicyState, or Routes where they choose subgoals;
    low: the state of its learner."""

    scale: Scale
    latent: LatentState
    high: Any
    low: Any


def init(config: GuiderConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> GuiderState:
    """Fresh state for one seed."""
    latent_key, high_key, low_key = jax.random.split(key, 3)
    goal_dim, latent_dim, low = spaces.goal_dim, config.latent.latent_dim, config.low
    subgoal_dim = latent_dim if low.subgoal_input == "latent" else goal_dim
    wave_dim = 2 * config.view.position_waves * goal_dim
    position_dim = goal_dim + wave_dim
    low_input_dim = spaces.state_dim + wave_dim + subgoal_dim + goal_dim
    return GuiderState(
        scale=scale,
        latent=latent_subgoals.init(latent_key, config.latent, goal_dim, position_dim),
        high=routes.init(config.routes, goal_dim)
        if config.planner == "routes"
        else subgoal_policy.init(high_key, config.high, 2 * position_dim, latent_dim),
        low=learner(low.learner).init(low_key, low.learner, low.hidden, low_input_dim, spaces.action_dim),
    )


def relabel_high(
    config: GuiderConfig, state: GuiderState, batch: HighBatch, key: jax.Array
) -> subgoal_policy.Transitions:
    """Algorithm 1, lines 8-10: z ~ q(. | s^G_t, s^G_{t+c}) takes the action's place; Eq. 1 gives the reward."""
    params = state.latent.params
    posterior = latent_subgoals.encode(config.latent, params, state.scale, batch.achieved, batch.later)
    return subgoal_policy.Transitions(
        state=subgoal_policy.inputs(state.scale, batch.achieved, batch.goal),
        latent=posterior.sample(key),
        reward=losses.goal_reward(batch.later, batch.goal, config.problem.radius, config.problem.goal_parts),
        next_state=subgoal_policy.inputs(state.scale, batch.later, batch.goal),
        prior=latent_subgoals.prior(params, state.scale, batch.achieved),
        next_prior=latent_subgoals.prior(params, state.scale, batch.later),
    )


def relabel_low(config: GuiderConfig, state: GuiderState, batch: LowBatch, key: jax.Array) -> Transitions:
    """Algorithm 1, line 16. Without decoder, z is encoded where the subgoal was chosen, as it is when acting."""
    subgoal = batch.subgoal
    if config.low.subgoal_input == "latent":
        params = state.latent.params
        subgoal = latent_subgoals.encode(config.latent, params, state.scale, batch.chosen_at, batch.subgoal).sample(key)
    return goal_policy.relabel(config.low, config.problem, state.scale, batch, subgoal)


def stages(config: GuiderConfig) -> tuple[Stage, ...]:
    """Algorithm 1 as three stages for the engine."""
    period_steps = config.problem.period_steps

    def update_latent(state: GuiderState, data: Data, key: jax.Array):
        sample_key, update_key = jax.random.split(key)
        batch = sample_windows(data, sample_key, config.latent.batch_size, period_steps)
        return latent_subgoals.update(config.latent, state.latent, state.scale, batch, update_key)

    def update_high(state: GuiderState, data: Data, key: jax.Array):
        sample_key, relabel_key, update_key = jax.random.split(key, 3)
        settings = config.high
        batch = sample_high(
            data,
            sample_key,
            settings.batch_size,
            period_steps,
            settings.goal_offset,
            settings.relabel_fraction,
            settings.random_goal_fraction,
        )
        transitions = relabel_high(config, state, batch, relabel_key)
        return subgoal_policy.update(settings, state.high, transitions, update_key)

    def update_low(state: GuiderState, data: Data, key: jax.Array):
        sample_key, relabel_key, update_key = jax.random.split(key, 3)
        settings = config.low
        batch = sample_low(
            data,
            sample_key,
            settings.batch_size,
            period_steps + settings.subgoal_slack_steps,
            period_steps if settings.subgoal_input == "latent" else 1,
            settings.ahead,
            settings.future,
            settings.relabel_fraction,
            settings.random_goal_fraction,
        )
        transitions = relabel_low(config, state, batch, relabel_key)
        rate = cosine_rate(settings.learning_rate, settings.decay, settings.updates, state.low.optimiser)
        return learner(settings.learner).update(settings.learner, state.low, transitions, update_key, rate)

    return (
        Stage("latent subgoals", "latent", config.latent.updates, update_latent),
        Stage("routes", "high", 1, lambda state, data, key: routes.build(config.routes, data, config.problem))
        if config.planner == "routes"
        else Stage("subgoal policy", "high", config.high.updates, update_high),
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


def acts_by(config: GuiderConfig) -> str:
    """How a subgoal is chosen, and for how long."""
    chosen = "mean of the subgoal policy"
    if config.planner == "routes":
        chosen = "logged place nearest to the goal by logged steps"
    elif config.candidates > 1:
        chosen = f"best of {config.candidates} samples of the {'prior' if config.high.prior else 'subgoal policy'}"
    if config.replan == "step":
        return f"{chosen}, a new one at every step"
    until = " or once it is reached" if config.replan == "reached" else ""
    return f"{chosen}, a new one every {config.problem.period_steps} steps{until}"


def _propose_latent(config: GuiderConfig, state: GuiderState, achieved: jax.Array, goal: jax.Array) -> jax.Array:
    """The mean of pi_h, or the best of `candidates`, which are the same quantiles of rho, or of pi_h, at every step.

    achieved, goal: [B, G] -> [B, Z].
    """
    seen = subgoal_policy.inputs(state.scale, achieved, goal)
    policy = subgoal_policy.propose(state.high.params, seen)
    if config.candidates == 1:
        return policy.mean
    source = latent_subgoals.prior(state.latent.params, state.scale, achieved) if config.high.prior else policy
    latents = source.sample(jax.random.key(0), (config.candidates,)).swapaxes(0, 1)
    return subgoal_policy.best(state.high.params, seen, latents)


def propose_subgoal(
    config: GuiderConfig, state: GuiderState, achieved: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where to go next, (subgoal [B, G], latent [B, Z]): what pi_h's mean or the best of `candidates` decodes to, or
    the next place of the routes; the final goal where `final_goal_substitution` says so."""
    parts, reach_radius, latents = config.problem.goal_parts, config.problem.reach_radius, state.latent.params
    if config.planner == "routes":
        subgoal, _ = routes.next_place(
            state.high, achieved, goal, routes.within_steps(config.routes, config.problem), config.problem
        )
        latent = latent_subgoals.encode(config.latent, latents, state.scale, achieved, subgoal).mean
    else:
        latent = _propose_latent(config, state, achieved, goal)
        subgoal = latent_subgoals.decode(config.latent, latents, state.scale, achieved, latent)
    if config.final_goal_substitution:
        distance = jnp.minimum(largest_distance(subgoal, goal, parts), largest_distance(achieved, goal, parts))
        near = distance <= reach_radius
        if config.final_goal_within_reach:
            near |= latent_subgoals.within_reach(
                config.latent, latents, state.scale, achieved, goal, reach_radius, parts
            )
        subgoal = jnp.where(near[..., None], goal, subgoal)
        if config.low.subgoal_input == "latent":
            final = latent_subgoals.encode(config.latent, latents, state.scale, achieved, goal).mean
            latent = jnp.where(near[..., None], final, latent)
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
    """One step of the hierarchy, by the means of both policies: (actions [B, A] in [-1, 1], the new acting state).

    observation: [B, S]; goal: [B, G]; reset_mask: [B] bool, True where an episode begins. A new subgoal is chosen
    there, after c steps, and, with replan == "reached", once the current one lies within reach_radius; with "step" at
    every step.
    """
    problem = config.problem
    achieved = observation[..., jnp.asarray(goal_indices)]
    renew = reset_mask | (acting.steps_left <= 0)
    if config.replan == "reached":
        renew |= largest_distance(achieved, acting.subgoal, problem.goal_parts) <= problem.reach_radius
    if config.replan == "step":
        renew = jnp.ones_like(renew)
    subgoal, latent = propose_subgoal(config, state, achieved, goal)
    subgoal = jnp.where(renew[:, None], subgoal, acting.subgoal)
    latent = jnp.where(renew[:, None], latent, acting.latent)
    steps_left = jnp.where(renew, problem.period_steps, acting.steps_left) - 1
    seen = latent if config.low.subgoal_input == "latent" else subgoal
    inputs = goal_policy.inputs(config.low, state.scale, observation, achieved, seen, goal)
    actions = learner(config.low.learner).act(config.low.learner, state.low, inputs)
    return actions, ActingState(subgoal, latent, steps_left)


def pursued(config: GuiderConfig, acting: ActingState) -> tuple[jax.Array, jax.Array]:
    """What was pursued in the step just taken: (subgoal [B, G], whether it was new [B])."""
    return acting.subgoal, acting.steps_left == config.problem.period_steps - 1


def _propose(
    config: GuiderConfig, state: GuiderState, observation: jax.Array, achieved: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Worth is the critic's value of the subgoal's latent, or minus the steps that the routes count."""
    subgoal, latent = propose_subgoal(config, state, achieved, goal)
    if config.planner == "routes":
        return subgoal, -routes.next_place(
            state.high, achieved, goal, routes.within_steps(config.routes, config.problem), config.problem
        )[1]
    seen = subgoal_policy.inputs(state.scale, achieved, goal)
    return subgoal, subgoal_policy.values(state.high.params, seen, latent)


def _dead_end(
    config: GuiderConfig, state: GuiderState, achieved: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array] | None:
    if config.planner != "routes":
        return None
    way = routes.way(state.high, achieved, goal, routes.within_steps(config.routes, config.problem), config.problem)
    return ~way.arrives, state.high.places[way.there]


def _reach(
    config: GuiderConfig,
    state: GuiderState,
    observation: jax.Array,
    achieved: jax.Array,
    subgoal: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    if config.low.subgoal_input == "latent":
        subgoal = latent_subgoals.encode(config.latent, state.latent.params, state.scale, achieved, subgoal).mean
    inputs = goal_policy.inputs(config.low, state.scale, observation, achieved, subgoal, goal)
    return learner(config.low.learner).act(config.low.learner, state.low, inputs)


SUBGOALS = Subgoals(
    pursued=pursued,
    propose=_propose,
    worth=lambda config: "minus the steps that are left" if config.planner == "routes" else "critic value",
    reach=_reach,
    periodic=lambda config: replace(config, replan="period", final_goal_substitution=False),
    reachable=lambda config, state, achieved, count: latent_subgoals.reachable(
        config.latent, state.latent.params, state.scale, achieved, count
    ),
    fit=lambda config, state, achieved, outcome: latent_subgoals.coverage(
        config.latent, state.latent.params, state.scale, achieved, outcome
    ),
    dead_end=_dead_end,
)


def metric_labels(config: GuiderConfig) -> dict[str, str]:
    unit = "c-step spreads" if config.latent.error_in_spreads and config.view.normalise else "goal units"
    return {
        "squared_error": f"squared error per entry ({unit}²)",
        "kl": "KL of posterior and prior (nats per entry)",
        "divergence": "KL of policy and prior (nats per entry)" if config.high.prior else "log density of policy",
    }


def guider_config(
    preset: Preset,
    problem: Problem,
    low: LearnerConfig | None = None,
    low_updates: float = 1.0,
    planner: Planner = "policy",
) -> GuiderConfig:
    """Settings for a problem, with another learner for the low level where one is given (Figure 4), which `fast` trains
    for `low_updates` times as many updates: dear ones take no longer than Guider's own."""
    goal_learner = low or AwrConfig()
    latent = LatentSubgoalsConfig(latent_dim=latent_subgoals.latent_dim(problem))
    level = GoalPolicyConfig(learner=goal_learner)
    paper = GuiderConfig(problem=problem, planner=planner, latent=latent, low=level)
    if preset == "paper":
        return paper
    paper = replace(paper, low=replace(paper.low, learner=fast_learner(goal_learner, problem.domain)))
    config = fast(paper, FAST, FAST_IN_DOMAIN)
    if planner == "routes":
        config = override(config, ROUTES_FAST_IN_DOMAIN.get(problem.domain, {}))
    return replace(config, low=replace(config.low, updates=round(config.low.updates * low_updates)))


def _method(label: str, **departures: Any) -> Method:
    config = partial(guider_config, **departures)
    return Method(
        label, GuiderConfig, config, init, stages, initial_acting_state, act, acts_by, SUBGOALS, metric_labels
    )


METHODS = {
    "guider": _method("Guider"),
    "guider-routes": _method("Guider + routes", planner="routes"),
    "guider-gcsl": _method("Guider + GCSL", low=GcslConfig()),
    "guider-wgcsl": _method("Guider + WGCSL", low=WgcslConfig()),
    "guider-cql": _method("Guider + CQL", low=CqlConfig(), low_updates=0.3),
}
