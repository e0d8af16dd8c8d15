"""Methods without subgoals: one learner (guider.learners) of a policy that pursues the final goal itself."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.errors import GuiderError
from guider.learners import (
    CqlConfig,
    GcslConfig,
    IqlConfig,
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
from guider.learning.samplers import FlatBatch, Future, sample_flat
from guider.learning.training import Stage
from guider.learning.windows import Data
from guider.methods.method import Method
from guider.methods.presets import MANIPULATION, fast
from guider.methods.view import Scale, ViewConfig
from guider.support.config import ByDomain, Changes, check_fraction, check_networks, check_shares, override


@dataclass(frozen=True)
class FlatConfig:
    """Settings of all methods without subgoals."""

    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    updates: int = 500_000
    batch_size: int = 512
    learning_rate: float = 5e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates`."""
    hidden: tuple[int, ...] = (256, 256, 256)
    relabel_fraction: float = 1.0
    """Share of goals relabelled with a future state; the rest are recorded goals, where data has them."""
    random_goal_fraction: float = 0.0
    """Share of goals drawn from any trajectory."""
    future: Future = "uniform"
    """Which future state becomes the goal: any, nearer ones rather (geometric), or the episode's last."""
    mean_goal_steps: float = 100.0
    """How far ahead geometric goals lie on average."""
    relative: bool = False
    """Show goals as displacements from s^G_t instead of positions."""
    learner: LearnerConfig = field(default_factory=GcslConfig)
    """How the policy is learned."""

    def __post_init__(self) -> None:
        check_networks(self)
        check_fraction(self, "action_scale", "relabel_fraction", "random_goal_fraction")
        check_shares(self)
        if self.mean_goal_steps < 1:
            raise GuiderError(f"mean_goal_steps must be 1 or more, got {self.mean_goal_steps}")


class FlatState(NamedTuple):
    """policy: the learner's state."""

    scale: Scale
    policy: Any


def init(config: FlatConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> FlatState:
    """Fresh state for one seed."""
    goal_dim = spaces.goal_dim
    input_dim = spaces.state_dim + 2 * config.view.position_waves * goal_dim + goal_dim
    if not config.relative:
        input_dim += 2 * config.view.position_waves * goal_dim
    policy = learner(config.learner).init(key, config.learner, config.hidden, input_dim, spaces.action_dim)
    return FlatState(scale, policy)


def inputs(config: FlatConfig, scale: Scale, observation: jax.Array, achieved: jax.Array, goal: jax.Array) -> jax.Array:
    """What the networks see: scaled state and goal, [..., inputs]. With `relative`, the goal is a displacement."""
    seen = (goal - achieved) / scale.goal_std if config.relative else scale.position(goal)
    return jnp.concatenate([scale.state(observation), scale.waves(achieved), seen], axis=-1)


def label(config: FlatConfig, scale: Scale, batch: FlatBatch) -> Transitions:
    """The batch as the networks see it; Eq. 1 gives the reward."""
    problem = config.problem
    return Transitions(
        state=inputs(config, scale, batch.observation, batch.achieved, batch.goal),
        action=batch.action,
        reward=losses.goal_reward(batch.next_achieved, batch.goal, problem.radius, problem.goal_parts),
        next_state=inputs(config, scale, batch.next_observation, batch.next_achieved, batch.goal),
        steps=batch.steps,
    )


def stages(config: FlatConfig) -> tuple[Stage, ...]:
    """One stage for the engine."""

    def update(state: FlatState, data: Data, key: jax.Array):
        sample_key, update_key = jax.random.split(key)
        batch = sample_flat(
            data,
            sample_key,
            config.batch_size,
            config.future,
            config.mean_goal_steps,
            config.relabel_fraction,
            config.random_goal_fraction,
        )
        rate = cosine_rate(config.learning_rate, config.decay, config.updates, state.policy.optimiser)
        transitions = label(config, state.scale, batch)
        return learner(config.learner).update(config.learner, state.policy, transitions, update_key, rate)

    return (Stage("policy", "policy", config.updates, update),)


def initial_acting_state(config: Any, goal_dim: int, batch_size: int) -> tuple[()]:
    """Nothing is remembered between steps."""
    return ()


def acts_by(config: Any) -> str:
    """How it chooses what it does."""
    return "most likely action towards the final goal"


def act(
    config: FlatConfig,
    state: FlatState,
    goal_indices: tuple[int, ...],
    observation: jax.Array,
    goal: jax.Array,
    acting: tuple[()],
    reset_mask: jax.Array,
) -> tuple[jax.Array, tuple[()]]:
    """The most likely actions [B, A] in [-1, 1]. observation: [B, S]; goal: [B, G]."""
    achieved = observation[..., jnp.asarray(goal_indices)]
    seen = inputs(config, state.scale, observation, achieved, goal)
    return learner(config.learner).act(config.learner, state.policy, seen), ()


FAST: Changes = {"batch_size": 256, "learning_rate": 1e-3, "decay": True, "relative": True}
FAST_IN_DOMAIN: ByDomain = {
    "fetch": MANIPULATION,
    "kitchen": MANIPULATION | {"view.smallest_spread": 0.1},
}
_UPDATES = {"antmaze": 2.5, "fetch": 4 / 3, "kitchen": 1 / 2}
"""How much longer or shorter `fast` trains, by domain: about what Guider takes, or less."""


def flat_config(preset: Preset, problem: Problem, learner: LearnerConfig, updates: int, changes: Changes) -> FlatConfig:
    """Settings for a problem. updates: in `fast`, before `_UPDATES`; changes: in both presets, from the defaults."""
    paper = override(FlatConfig(problem=problem, view=ViewConfig(normalise=True), learner=learner), changes)
    if preset == "paper":
        return paper
    updates = round(updates * _UPDATES.get(problem.domain or "", 1))
    paper = replace(paper, learner=fast_learner(learner, problem.domain), updates=updates)
    return fast(paper, FAST, FAST_IN_DOMAIN)


def _method(label: str, learner: LearnerConfig, updates: int, **changes: Any) -> Method:
    config = partial(flat_config, learner=learner, updates=updates, changes=changes)
    return Method(label, FlatConfig, config, init, stages, initial_acting_state, act, acts_by)


METHODS = {
    "bc": _method("BC", GcslConfig(), 40_000, relabel_fraction=0.0, future="last"),
    "gcsl": _method("GCSL", GcslConfig(), 40_000),
    "wgcsl": _method("WGCSL", WgcslConfig(), 25_000, relabel_fraction=0.8),
    "cql-her": _method("CQL+HER", CqlConfig(), 12_000, relabel_fraction=0.8),
    "iql": _method("IQL", IqlConfig(), 25_000, relabel_fraction=0.8),
}
