"""OGBench's methods without subgoals (Park et al. 2025): a policy that a critic guides towards the final goal.

GCIVL, GCIQL, CRL and QRL are one policy and four critics (guider.critics). Preset `paper` is OGBench's code with its
settings for a domain's navigate and play sets; where it differs: goals are places instead of whole states, as
everywhere in this package; an episode of the value ends within the task's radius of the goal, instead of in its very
state; layer norms have no gains and shifts of their own; networks start as PyTorch's do; and what QRL's critic says in
its file. What OGBench sets by dataset is to be set:

    giant mazes     discount=0.995
    stitch          actor_random_goal_fraction=0.5
    explore         actor_random_goal_fraction=1, cloning=0.01 (gciql), 0.003 (crl), 0.001 (qrl)
    noisy           cloning=0.03 (gciql), 0.1 (crl), 0.03 (qrl)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from guider.critics import (
    ContrastiveConfig,
    CriticConfig,
    ImplicitQConfig,
    ImplicitVConfig,
    QuasimetricConfig,
    Steps,
    critic,
)
from guider.data.episodes import Spaces
from guider.errors import GuiderError
from guider.learning import losses
from guider.learning.networks import Layers, Precision, mlp, mlp_init
from guider.learning.optimisers import Moments, adam_init, adam_step, cosine_rate, trail
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.samplers import CriticBatch, sample_critic
from guider.learning.training import Metrics, Stage
from guider.learning.windows import Data
from guider.methods.flat import acts_by, initial_acting_state
from guider.methods.goal_value import state_inputs
from guider.methods.method import Method
from guider.methods.presets import MANIPULATION, fast
from guider.methods.view import Scale, ViewConfig
from guider.support.config import ByDomain, Changes, check_fraction, check_networks, check_positive, override

WEIGHT_CEILING = 100.0


@dataclass(frozen=True)
class CriticGuidedConfig:
    """Settings. Defaults are OGBench's (preset `paper`)."""

    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    updates: int = 1_000_000
    batch_size: int = 1024
    learning_rate: float = 3e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    hidden: tuple[int, ...] = (512, 512, 512)
    discount: float = 0.99
    """gamma per environment step; the critic's goals of the future lie 1 / (1 - gamma) steps ahead on average."""
    target_rate: float = 0.005
    current_goal_fraction: float = 0.2
    """Share of the critic's goals that are s^G_t itself."""
    random_goal_fraction: float = 0.3
    """Share of the critic's goals drawn from any trajectory; all others are geometric futures."""
    actor_random_goal_fraction: float = 0.0
    """Share of the policy's goals drawn from any trajectory; all others are uniform futures."""
    temperature: float = 0.1
    """Where logged actions are weighed (ivl): advantages, in steps, are divided by this before the exponential."""
    cloning: float = 0.3
    """Where the policy climbs the critic (all others): weight of keeping to logged actions."""
    critic: CriticConfig = field(default_factory=ImplicitVConfig)

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "temperature", "cloning")
        check_fraction(self, "action_scale", "discount", "target_rate")
        check_fraction(self, "current_goal_fraction", "random_goal_fraction", "actor_random_goal_fraction")
        if self.discount == 1:
            raise GuiderError("discount must be below 1: it also says how far ahead goals lie")
        if self.current_goal_fraction + self.random_goal_fraction > 1 + 1e-9:
            raise GuiderError("current_goal_fraction and random_goal_fraction add up to more than 1")


class Params(NamedTuple):
    actor: Layers
    critic: Any


class CriticGuidedState(NamedTuple):
    """target: trails the critic's parameters."""

    scale: Scale
    policy: PolicyState


class PolicyState(NamedTuple):
    params: Params
    target: Any
    optimiser: Moments


def init(config: CriticGuidedConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> CriticGuidedState:
    """Fresh state for one seed."""
    actor_key, critic_key = jax.random.split(key)
    wave_dim = 2 * config.view.position_waves * spaces.goal_dim
    state_dim, place_dim = spaces.state_dim + wave_dim, spaces.goal_dim + wave_dim
    params = Params(
        actor=mlp_init(actor_key, (state_dim + place_dim, *config.hidden, spaces.action_dim)),
        critic=critic(config.critic).init(
            critic_key, config.critic, config.hidden, state_dim, place_dim, spaces.action_dim
        ),
    )
    return CriticGuidedState(scale, PolicyState(params, params.critic, adam_init(params)))


def label(config: CriticGuidedConfig, scale: Scale, batch: CriticBatch, goal: jax.Array) -> Steps:
    """The batch as networks see it, towards one of its goals. r(s, g) is 0 where s meets g and -1 elsewhere."""
    problem = config.problem
    reward = losses.goal_reward(batch.achieved, goal, problem.radius, problem.goal_parts)
    return Steps(
        state=state_inputs(scale, batch.observation, batch.achieved),
        action=batch.action,
        next_state=state_inputs(scale, batch.next_observation, batch.next_achieved),
        place=scale.position(batch.achieved),
        goal=scale.position(goal),
        unmet=(reward < 0).astype(jnp.float32),
    )


def actor_loss(config: CriticGuidedConfig, params: Params, steps: Steps) -> tuple[jax.Array, Metrics]:
    """Of a Gaussian policy with spread 1: weighed regression on logged actions, exp(A / temperature), or minus the
    critic's value of the policy's own action, as a share of its size, and `cloning` times the regression."""
    found = critic(config.critic)
    judge = jax.lax.stop_gradient(params.critic)
    action = _actor(params.actor, steps.state, steps.goal)
    surprise = 0.5 * ((action - steps.action) ** 2).sum(axis=-1)
    metrics = {"action_error": ((action - steps.action) ** 2).mean()}
    if found.quality is None:
        assert found.advantage is not None
        weight = losses.advantage_weight(
            found.advantage(config.critic, judge, steps), config.temperature, WEIGHT_CEILING
        )
        return (weight * surprise).mean(), metrics | {"weight": weight.mean()}
    quality = found.quality(config.critic, judge, steps.state, jnp.clip(action, -1.0, 1.0), steps.goal)
    size = jax.lax.stop_gradient(jnp.abs(quality).mean() + 1e-6)
    return -quality.mean() / size + config.cloning * surprise.mean(), metrics | {"quality": quality.mean()}


def _actor(params: Layers, state: jax.Array, goal: jax.Array) -> jax.Array:
    return mlp(params, jnp.concatenate([state, goal], axis=-1), jax.nn.gelu)


def stages(config: CriticGuidedConfig) -> tuple[Stage, ...]:
    """One stage for the engine: critic and policy step together."""

    def update(state: CriticGuidedState, data: Data, key: jax.Array):
        old = state.policy
        batch = sample_critic(
            data,
            key,
            config.batch_size,
            1 / (1 - config.discount),
            config.current_goal_fraction,
            config.random_goal_fraction,
            config.actor_random_goal_fraction,
        )

        def loss(params: Params) -> tuple[jax.Array, Metrics]:
            steps = label(config, state.scale, batch, batch.goal)
            error, metrics = critic(config.critic).loss(
                config.critic, params.critic, old.target, steps, config.discount
            )
            climb, actor_metrics = actor_loss(config, params, label(config, state.scale, batch, batch.actor_goal))
            return error + climb, metrics | actor_metrics

        rate = cosine_rate(config.learning_rate, config.decay, config.updates, old.optimiser)
        gradients, metrics = jax.grad(loss, has_aux=True)(old.params)
        params, optimiser = adam_step(rate, old.params, gradients, old.optimiser)
        return PolicyState(params, trail(old.target, params.critic, config.target_rate), optimiser), metrics

    return (Stage("policy", "policy", config.updates, update),)


def act(
    config: CriticGuidedConfig,
    state: CriticGuidedState,
    goal_indices: tuple[int, ...],
    observation: jax.Array,
    goal: jax.Array,
    acting: tuple[()],
    reset_mask: jax.Array,
) -> tuple[jax.Array, tuple[()]]:
    """The most likely actions [B, A] in [-1, 1]. observation: [B, S]; goal: [B, G]."""
    achieved = observation[..., jnp.asarray(goal_indices)]
    seen = state_inputs(state.scale, observation, achieved)
    return jnp.clip(_actor(state.policy.params.actor, seen, state.scale.position(goal)), -1.0, 1.0), ()


FAST: Changes = {
    "updates": 40_000,
    "batch_size": 256,
    "learning_rate": 1e-3,
    "decay": True,
    "hidden": (256, 256),
    "target_rate": 0.02,
}
FAST_IN_DOMAIN: ByDomain = {
    "antmaze": {"discount": 0.995},
    "fetch": MANIPULATION,
    "kitchen": MANIPULATION | {"view.smallest_spread": 0.1},
}
_ARM = "ogbench-cube", "ogbench-scene", "ogbench-puzzle"


class Cloning(NamedTuple):
    """OGBench's weights by domain: of its point, its arm, its humanoid, and of all else, its ant above all."""

    point: float
    arm: float
    humanoid: float
    elsewhere: float

    def of(self, domain: str | None) -> float:
        known = {"ogbench-pointmaze": self.point, "humanoidmaze": self.humanoid} | dict.fromkeys(_ARM, self.arm)
        return known.get(domain or "", self.elsewhere)


def critic_guided_config(
    preset: Preset, problem: Problem, kind: CriticConfig, cloning: Cloning | None, goals: Changes
) -> CriticGuidedConfig:
    """Settings for a problem. cloning: None of a policy that does not climb; goals: the critic's."""
    paper = override(CriticGuidedConfig(problem=problem, critic=kind), goals)
    if cloning is not None:
        paper = replace(paper, cloning=cloning.of(problem.domain))
    if problem.domain == "humanoidmaze":
        paper = replace(paper, discount=0.995)
    if preset == "paper":
        return paper
    small = {"critic.representation_dim": 64} if hasattr(kind, "representation_dim") else {}
    return fast(paper, FAST | small, FAST_IN_DOMAIN)


def _method(label: str, kind: CriticConfig, cloning: Cloning | None = None, **goals: float) -> Method:
    config = partial(critic_guided_config, kind=kind, cloning=cloning, goals=goals)
    return Method(label, CriticGuidedConfig, config, init, stages, initial_acting_state, act, acts_by)


METHODS = {
    "gcivl": _method("GCIVL", ImplicitVConfig()),
    "gciql": _method("GCIQL", ImplicitQConfig(), Cloning(0.003, 1.0, 0.1, 0.3)),
    "crl": _method(
        "CRL",
        ContrastiveConfig(),
        Cloning(0.03, 3.0, 0.1, 0.1),
        current_goal_fraction=0.0,
        random_goal_fraction=0.0,
    ),
    "qrl": _method(
        "QRL",
        QuasimetricConfig(),
        Cloning(0.0003, 0.3, 0.001, 0.003),
        current_goal_fraction=0.0,
        random_goal_fraction=1.0,
    ),
}
