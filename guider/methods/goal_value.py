"""V(s, g): minus the discounted steps to a goal, learned without actions by expectile regression (IQL's, conditioned on
goals, as HIQL learns it: Park et al. 2023), and phi(s, g), the representation of a goal that both its twins see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from guider.errors import GuiderError
from guider.learning import losses
from guider.learning.networks import Layers, layer_norm_mlp, mlp_init, twin_init
from guider.learning.optimisers import Moments, adam_init, adam_step, cosine_rate, trail
from guider.learning.problem import Problem
from guider.learning.samplers import ValueBatch, sample_value
from guider.learning.training import Metrics
from guider.learning.windows import Data
from guider.methods.view import Scale
from guider.support.config import check_fraction, check_networks, check_positive


@dataclass(frozen=True)
class ValueConfig:
    """Settings of V(s, g) and phi(s, g). Defaults are the authors' (preset `paper`)."""

    updates: int = 1_000_000
    batch_size: int = 1024
    learning_rate: float = 3e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    hidden: tuple[int, ...] = (512, 512, 512)
    representation_dim: int = 10
    discount: float = 0.99
    """gamma per environment step; goals of the future lie 1 / (1 - gamma) steps ahead on average."""
    target_rate: float = 0.005
    backup_steps: int = 1
    """Logged steps between a state and the one it takes its target from. More steps carry values to far states in fewer
    updates, and count what the data did in between as its best (departure)."""
    expectile: float = 0.7
    current_goal_fraction: float = 0.2
    """Share of goals that are s^G_t itself."""
    random_goal_fraction: float = 0.3
    """Share of goals drawn from any trajectory; all others are geometric futures."""

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "representation_dim", "backup_steps")
        check_fraction(self, "discount", "target_rate", "expectile", "current_goal_fraction", "random_goal_fraction")
        if self.discount == 1:
            raise GuiderError("discount must be below 1: it also says how far ahead goals lie")
        if self.current_goal_fraction + self.random_goal_fraction > 1 + 1e-9:
            raise GuiderError("current_goal_fraction and random_goal_fraction add up to more than 1")


class LearnsValue(Protocol):
    """Settings of a method that learns V."""

    @property
    def problem(self) -> Problem: ...

    @property
    def relative(self) -> bool: ...

    @property
    def value(self) -> ValueConfig: ...


class ValueParams(NamedTuple):
    """representation: phi, shared by the twins of V."""

    representation: Layers
    twins: Layers


class ValueState(NamedTuple):
    params: ValueParams
    target: ValueParams
    optimiser: Moments


def init(phi_key: jax.Array, twins_key: jax.Array, config: ValueConfig, state_dim: int, place_dim: int) -> ValueState:
    """state_dim, place_dim: entries of a state and of a goal as the networks see them."""
    params = ValueParams(
        representation=mlp_init(phi_key, (state_dim + place_dim, *config.hidden, config.representation_dim)),
        twins=twin_init(twins_key, (state_dim + config.representation_dim, *config.hidden, 1)),
    )
    return ValueState(params, params, adam_init(params))


def state_inputs(scale: Scale, observation: jax.Array, achieved: jax.Array) -> jax.Array:
    """What all networks see of a state, scaled: [..., inputs]."""
    return jnp.concatenate([scale.state(observation), scale.waves(achieved)], axis=-1)


def goal_inputs(
    config: LearnsValue, scale: Scale, observation: jax.Array, achieved: jax.Array, goal: jax.Array
) -> jax.Array:
    """What phi and the high level see: scaled (s, g), [..., inputs]. With `relative`, g is a displacement from s^G, in
    spreads of the data's c-step moves: what lies k steps ahead must be told apart."""
    seen = (goal - achieved) / scale.step_std if config.relative else scale.goal(goal)
    return jnp.concatenate([state_inputs(scale, observation, achieved), seen, scale.waves(goal)], axis=-1)


def normalised(vector: jax.Array) -> jax.Array:
    """At length sqrt(Z), so that entries are of size 1. [..., Z] -> [..., Z]."""
    length = jnp.sqrt(jnp.sum(vector**2, axis=-1, keepdims=True) + 1e-12)
    return vector / length * vector.shape[-1] ** 0.5


def represent(
    config: LearnsValue,
    params: ValueParams,
    scale: Scale,
    observation: jax.Array,
    achieved: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    """phi(s, g): [..., Z] of length sqrt(Z). goal: [..., G] in goal units."""
    seen = goal_inputs(config, scale, observation, achieved, goal)
    return normalised(layer_norm_mlp(params.representation, seen))


def values(
    config: LearnsValue,
    params: ValueParams,
    scale: Scale,
    observation: jax.Array,
    achieved: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    """Both estimates of V(s, g): [2, B], minus the discounted steps to the goal."""
    z = represent(config, params, scale, observation, achieved, goal)
    seen = jnp.concatenate([state_inputs(scale, observation, achieved), z], axis=-1)
    return jax.vmap(lambda layers: layer_norm_mlp(layers, seen)[..., 0])(params.twins)


def logged_return(config: LearnsValue, batch: ValueBatch) -> tuple[jax.Array, jax.Array]:
    """What a stretch of n steps earns, r_t + gamma * r_{t+1} + ..., and what V of the state after it counts for.

    r(s, g) is 0 where s meets g, which ends the episode, and -1 elsewhere. Returns (earned [B], carried [B]): carried
    is gamma^n, gamma^m where the data ends after m steps, and 0 where the goal is met on the way.
    """
    problem, discount = config.problem, config.value.discount
    reward = jax.vmap(lambda place: losses.goal_reward(place, batch.goal, problem.radius, problem.goal_parts), 1, 1)(
        batch.achieved
    )
    on_the_way = jnp.cumprod(reward < 0, axis=1)  # 1 until the goal is met
    factor = discount ** jnp.arange(reward.shape[1])
    earned = jnp.where(batch.valid, factor * on_the_way * reward, 0.0).sum(axis=1)
    return earned, discount ** batch.valid.sum(axis=1) * on_the_way[:, -1]


def value_loss(
    config: LearnsValue, params: ValueParams, target_params: ValueParams, scale: Scale, batch: ValueBatch
) -> tuple[jax.Array, Metrics]:
    """Expectile regression of V(s, g) on r(s, g) + gamma * V_target(s', g), with no action in it; sum over the twins.

    Each twin regresses on its own target, but which side of the expectile a row is on is the same for both: the sign
    of A = r + gamma * min V_target(s', g) minus the mean of V_target(s, g).
    """
    settings = config.value
    earned, carried = logged_return(config, batch)
    begin = batch.achieved[:, 0]
    following = values(config, target_params, scale, batch.end_observation, batch.end, batch.goal)
    current = values(config, target_params, scale, batch.observation, begin, batch.goal).mean(axis=0)
    advantage = earned + carried * following.min(axis=0) - current
    target = jax.lax.stop_gradient(earned + carried * following)
    estimate = values(config, params, scale, batch.observation, begin, batch.goal)
    weight = losses.expectile_weight(advantage, settings.expectile)
    error = jax.lax.stop_gradient(weight) * (target - estimate) ** 2
    metrics = {"value_error": error.mean(), "value": estimate.mean(), "advantage": advantage.mean()}
    return error.mean(axis=-1).sum(), metrics


def update(
    config: LearnsValue, old: ValueState, scale: Scale, data: Data, key: jax.Array
) -> tuple[ValueState, Metrics]:
    """One step."""
    settings = config.value
    batch = sample_value(
        data,
        key,
        settings.batch_size,
        settings.backup_steps,
        1 / (1 - settings.discount),
        settings.current_goal_fraction,
        settings.random_goal_fraction,
    )
    rate = cosine_rate(settings.learning_rate, settings.decay, settings.updates, old.optimiser)
    gradients, metrics = jax.grad(lambda params: value_loss(config, params, old.target, scale, batch), has_aux=True)(
        old.params
    )
    params, optimiser = adam_step(rate, old.params, gradients, old.optimiser)
    return ValueState(params, trail(old.target, params, settings.target_rate), optimiser), metrics
