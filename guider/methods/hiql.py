"""HIQL (Park et al. 2023, "HIQL: Offline Goal-Conditioned RL with Latent States as Actions").

One goal-conditioned value function, learned without actions, weighs two regressions: of the high level, which names a
state k steps ahead by its representation z = phi(s, .), and of the low level, which goes there. Goals are places in
goal space as everywhere in this package, so phi takes a state and a place. Preset `paper` is OGBench's HIQL with its
settings for antmaze, in networks, goals, temperature and all; where it differs: goals are places instead of whole
states; value, high and low level are trained in sequence, for neither actor changes the value; layer norms have no
gains and shifts of their own; networks start as PyTorch's do; the value's episode ends within the task's radius of the
goal, instead of in its very state. With `subgoal="place"` it is another method, `hiql-places`, which no one published.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig
from guider.learning import losses
from guider.learning.networks import Layers, Precision, mlp, mlp_init
from guider.learning.optimisers import Moments, adam_init, adam_step, cosine_rate
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.samplers import WaypointBatch, sample_waypoints
from guider.learning.training import Metrics, Stage
from guider.learning.windows import Data
from guider.methods import goal_value
from guider.methods.goal_value import (
    ValueConfig,
    ValueParams,
    ValueState,
    goal_inputs,
    normalised,
    represent,
    state_inputs,
    values,
)
from guider.methods.method import Method, Subgoals
from guider.methods.presets import MANIPULATION, fast
from guider.methods.view import Scale, ViewConfig
from guider.support.config import ByDomain, Changes, check_fraction, check_networks, check_positive, override, under


@dataclass(frozen=True)
class ActorConfig:
    """Settings of either level's policy. Defaults are the authors' (preset `paper`)."""

    updates: int = 1_000_000
    batch_size: int = 1024
    learning_rate: float = 3e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    hidden: tuple[int, ...] = (512, 512, 512)
    temperature: float = 1 / 3
    """Advantages, in environment steps, are divided by this before the exponential."""
    weight_ceiling: float = 100.0
    regression: RegressionConfig = field(default_factory=RegressionConfig)

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "temperature", "weight_ceiling")


@dataclass(frozen=True)
class HiqlConfig:
    """All of HIQL's settings. Defaults are the preset `paper`."""

    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    subgoal_steps: int = 25
    """k: environment steps to the state that the high level names. (c of `problem` only serves `view`.)"""
    squash: bool = False
    """Whether tanh keeps the low level's actions within the bounds, or they are clipped when acting."""
    random_goal_fraction: float = 0.0
    """Share of the high level's goals drawn from any trajectory; all others are uniform futures."""
    subgoal: Literal["representation", "place"] = "representation"
    """What the high level names: phi(s, s_{t+k}), or the displacement s^G_{t+k} - s^G_t itself (`hiql-places`): with
    little training, phi knows how far a place is, and hardly in which direction."""
    relative: bool = False
    """Show goals as displacements from s^G_t instead of positions (departure)."""
    value: ValueConfig = field(default_factory=ValueConfig)
    high: ActorConfig = field(default_factory=ActorConfig)
    low: ActorConfig = field(default_factory=ActorConfig)

    def __post_init__(self) -> None:
        check_positive(self, "subgoal_steps")
        check_fraction(self, "action_scale", "random_goal_fraction")


class ActorState(NamedTuple):
    params: Layers
    optimiser: Moments


class HiqlState(NamedTuple):
    """Everything that training changes or acting needs."""

    scale: Scale
    value: ValueState
    high: ActorState
    low: ActorState


def init(config: HiqlConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> HiqlState:
    """Fresh state for one seed."""
    phi_key, twins_key, high_key, low_key = jax.random.split(key, 4)
    wave_dim = 2 * config.view.position_waves * spaces.goal_dim
    state_dim, place_dim = spaces.state_dim + wave_dim, spaces.goal_dim + wave_dim
    z_dim = config.value.representation_dim if config.subgoal == "representation" else spaces.goal_dim
    high = mlp_init(high_key, (state_dim + place_dim, *config.high.hidden, z_dim))
    low = mlp_init(low_key, (state_dim + z_dim, *config.low.hidden, spaces.action_dim))
    return HiqlState(
        scale=scale,
        value=goal_value.init(phi_key, twins_key, config.value, state_dim, place_dim),
        high=ActorState(high, adam_init(high)),
        low=ActorState(low, adam_init(low)),
    )


def control_inputs(scale: Scale, observation: jax.Array, achieved: jax.Array, z: jax.Array) -> jax.Array:
    """What the low level sees: scaled s and z, [..., inputs]."""
    return jnp.concatenate([state_inputs(scale, observation, achieved), z], axis=-1)


def name_subgoal(
    config: HiqlConfig,
    params: ValueParams,
    scale: Scale,
    observation: jax.Array,
    achieved: jax.Array,
    place: jax.Array,
) -> jax.Array:
    """z, by which a place in goal space is named to the low level: [..., Z]."""
    if config.subgoal == "place":
        return (place - achieved) / scale.step_std
    return represent(config, params, scale, observation, achieved, place)


def place_of(scale: Scale, achieved: jax.Array, z: jax.Array) -> jax.Array:
    """The place that z names, [..., G] in goal units, where z names places: what `name_subgoal` makes z of."""
    return achieved + z * scale.step_std


def _actor(params: Layers, inputs: jax.Array, dropout: float = 0.0, key: jax.Array | None = None) -> jax.Array:
    return mlp(params, inputs, jax.nn.gelu, dropout, key)


def _regression(
    settings: ActorConfig, advantage: jax.Array, predicted: jax.Array, target: jax.Array
) -> tuple[jax.Array, Metrics]:
    weight = losses.advantage_weight(advantage, settings.temperature, settings.weight_ceiling)
    metrics = {
        "advantage": advantage.mean(),
        "advantage_std": advantage.std(),
        "weight": weight.mean(),
        "error": ((predicted - target) ** 2).mean(),
    }
    return losses.weighted_regression(weight, predicted, target, settings.regression.error).mean(), metrics


def high_loss(
    config: HiqlConfig, params: Layers, value: ValueParams, scale: Scale, batch: WaypointBatch, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Regression of pi_h(s, g) on z of s_{t+k} (`name_subgoal`), weighted by exp(A / temperature),
    A = V(s_{t+k}, g) - V(s, g).

    A goal nearer than k steps is its own subgoal: the sampler's row ahead ends there. `key` is for dropout.
    """
    begin = values(config, value, scale, batch.observation, batch.achieved, batch.goal).mean(axis=0)
    end = values(config, value, scale, batch.ahead_observation, batch.ahead, batch.goal).mean(axis=0)
    target = name_subgoal(config, value, scale, batch.observation, batch.achieved, batch.ahead)
    seen = goal_inputs(config, scale, batch.observation, batch.achieved, batch.goal)
    predicted = _actor(params, seen, config.high.regression.dropout, key)
    return _regression(config.high, end - begin, predicted, target)


def low_loss(
    config: HiqlConfig, params: Layers, value: ValueParams, scale: Scale, batch: WaypointBatch, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """Regression of pi_l(s, z) on the logged action, z that of s_{t+k}, weighted by exp(A / temperature),
    A = V(s', s_{t+k}) - V(s, s_{t+k}). `key` is for dropout."""
    begin = values(config, value, scale, batch.observation, batch.achieved, batch.ahead).mean(axis=0)
    end = values(config, value, scale, batch.next_observation, batch.next_achieved, batch.ahead).mean(axis=0)
    z = name_subgoal(config, value, scale, batch.observation, batch.achieved, batch.ahead)
    seen = control_inputs(scale, batch.observation, batch.achieved, z)
    predicted = _bounded(config, _actor(params, seen, config.low.regression.dropout, key))
    return _regression(config.low, end - begin, predicted, batch.action)


def _bounded(config: HiqlConfig, outputs: jax.Array) -> jax.Array:
    return jnp.tanh(outputs) if config.squash else outputs


def propose(
    config: HiqlConfig, params: Layers, scale: Scale, observation: jax.Array, achieved: jax.Array, goal: jax.Array
) -> jax.Array:
    """Mean of pi_h(z | s, g), [..., Z]; its length is not sqrt(Z) yet."""
    return _actor(params, goal_inputs(config, scale, observation, achieved, goal))


def control(
    config: HiqlConfig, params: Layers, scale: Scale, observation: jax.Array, achieved: jax.Array, z: jax.Array
) -> jax.Array:
    """Mean of pi_l(a | s, z), [..., A] in [-1, 1]."""
    outputs = _actor(params, control_inputs(scale, observation, achieved, z))
    return jnp.clip(_bounded(config, outputs), -1.0, 1.0)


def stages(config: HiqlConfig) -> tuple[Stage, ...]:
    """Value, high level and low level as three stages for the engine."""

    def update_value(state: HiqlState, data: Data, key: jax.Array):
        return goal_value.update(config, state.value, state.scale, data, key)

    def actor_update(settings: ActorConfig, old: ActorState, loss):
        rate = cosine_rate(settings.learning_rate, settings.decay, settings.updates, old.optimiser)
        gradients, metrics = jax.grad(loss, has_aux=True)(old.params)
        return ActorState(*adam_step(rate, old.params, gradients, old.optimiser)), metrics

    def update_high(state: HiqlState, data: Data, key: jax.Array):
        sample_key, dropout_key = jax.random.split(key)
        settings, value = config.high, state.value.params
        batch = sample_waypoints(
            data, sample_key, settings.batch_size, config.subgoal_steps, config.random_goal_fraction
        )
        return actor_update(
            settings, state.high, lambda params: high_loss(config, params, value, state.scale, batch, dropout_key)
        )

    def update_low(state: HiqlState, data: Data, key: jax.Array):
        sample_key, dropout_key = jax.random.split(key)
        settings, value = config.low, state.value.params
        # No goal ends the way to s_{t+k} early.
        batch = sample_waypoints(data, sample_key, settings.batch_size, config.subgoal_steps, random_goal_fraction=1.0)
        return actor_update(
            settings, state.low, lambda params: low_loss(config, params, value, state.scale, batch, dropout_key)
        )

    return (
        Stage("value", "value", config.value.updates, update_value),
        Stage("high level", "high", config.high.updates, update_high),
        Stage("low level", "low", config.low.updates, update_low),
    )


def initial_acting_state(config: HiqlConfig, goal_dim: int, batch_size: int) -> jax.Array | None:
    """The place last named [B, G], which only pictures ask for; a representation is no place."""
    return jnp.zeros((batch_size, goal_dim)) if config.subgoal == "place" else None


def acts_by(config: HiqlConfig) -> str:
    """How it chooses what it does."""
    return "mean of the high level, a new one at every step"


def act(
    config: HiqlConfig,
    state: HiqlState,
    goal_indices: tuple[int, ...],
    observation: jax.Array,
    goal: jax.Array,
    acting: jax.Array | None,
    reset_mask: jax.Array,
) -> tuple[jax.Array, jax.Array | None]:
    """The most likely actions [B, A] in [-1, 1], for a subgoal that is new at every step, as the authors' code acts.

    observation: [B, S]; goal: [B, G].
    """
    achieved = observation[..., jnp.asarray(goal_indices)]
    z = propose(config, state.high.params, state.scale, observation, achieved, goal)
    place = None
    if config.subgoal == "representation":
        z = normalised(z)
    else:
        place = place_of(state.scale, achieved, z)
    return control(config, state.low.params, state.scale, observation, achieved, z), place


def _propose(
    config: HiqlConfig, state: HiqlState, observation: jax.Array, achieved: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Of `hiql-places`. Worth is V(s, g), the twins' mean."""
    z = propose(config, state.high.params, state.scale, observation, achieved, goal)
    value = values(config, state.value.params, state.scale, observation, achieved, goal).mean(axis=0)
    return place_of(state.scale, achieved, z), value


def _reach(
    config: HiqlConfig,
    state: HiqlState,
    observation: jax.Array,
    achieved: jax.Array,
    subgoal: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    z = name_subgoal(config, state.value.params, state.scale, observation, achieved, subgoal)
    return control(config, state.low.params, state.scale, observation, achieved, z)


PLACES_NAMED = Subgoals(
    pursued=lambda config, acting: (acting, jnp.ones(len(acting), bool)),
    propose=_propose,
    worth=lambda config: "value",
    reach=_reach,
)


PLACES: Changes = {
    "subgoal": "place",
    "squash": True,
    "random_goal_fraction": 0.3,
    "value.backup_steps": 5,
    "high.temperature": 1.0,
    "low.temperature": 1.0,
}
"""What makes HIQL `hiql-places`, in both presets."""

_LEVEL: Changes = {"batch_size": 256, "learning_rate": 1e-3, "decay": True, "hidden": (256, 256)}
FAST: Changes = (
    under("value", _LEVEL | {"updates": 20_000, "discount": 0.995, "target_rate": 0.02})
    | under("high", _LEVEL | {"updates": 8_000})
    | under("low", _LEVEL | {"updates": 25_000, "hidden": (256, 256, 256)})
    | {"relative": True}
)
FAST_IN_DOMAIN: ByDomain = {
    "antmaze": {"low.updates": 100_000},
    "fetch": MANIPULATION | {"random_goal_fraction": 0.0, "subgoal_steps": 10},
    "kitchen": MANIPULATION
    | {"view.smallest_spread": 0.1, "random_goal_fraction": 0.0}
    | under("low.regression", FROM_DEMONSTRATIONS),
}


def hiql_config(preset: Preset, problem: Problem, variant: Changes | None = None) -> HiqlConfig:
    """Settings for a problem. variant: in both presets, from HIQL's."""
    paper = override(HiqlConfig(problem=problem), variant or {})
    return paper if preset == "paper" else fast(paper, FAST, FAST_IN_DOMAIN)


def _method(label: str, variant: Changes, subgoals: Subgoals | None = None) -> Method:
    config = partial(hiql_config, variant=variant)
    return Method(label, HiqlConfig, config, init, stages, initial_acting_state, act, acts_by, subgoals)


METHODS = {"hiql": _method("HIQL", {}), "hiql-places": _method("HIQL on places", PLACES, PLACES_NAMED)}
