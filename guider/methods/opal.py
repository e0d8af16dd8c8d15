"""OPAL (Ajay et al. 2021, "OPAL: Offline Primitive Discovery for Accelerating Offline Reinforcement Learning").

A variational autoencoder of c steps of states and actions finds skills z and learns to carry them out; above it,
conservative Q-learning chooses among skills instead of actions, here with goals taken in hindsight. There is no public
code: what the text leaves open is said where it is settled. Where it differs: the mean of actions is squashed into the
bounds; networks start as PyTorch's do; the authors fit the decoder once more to the z of the high level's data, which
is the data it was trained on here, and is left out. Skills act by their mean, and pi_h by its own (Guider's
`candidates` has no counterpart here).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.learners.regression import FROM_DEMONSTRATIONS, RegressionConfig
from guider.learning import losses
from guider.learning.networks import Gaussian, Gru, Layers, Precision, gaussian_head, gru, gru_init, mlp, mlp_init
from guider.learning.optimisers import Moments, adam_init, adam_step, cosine_rate
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.samplers import SkillBatch, Trajectories, sample_skills, sample_trajectories
from guider.learning.training import Metrics, Stage
from guider.learning.windows import Data
from guider.methods import subgoal_policy
from guider.methods.method import Method
from guider.methods.presets import MANIPULATION, fast
from guider.methods.subgoal_policy import STEADY_CRITIC, SubgoalPolicyConfig, SubgoalPolicyState
from guider.methods.view import Scale, ViewConfig
from guider.support.config import ByDomain, Changes, check_fraction, check_networks, check_positive, under


@dataclass(frozen=True)
class SkillsConfig:
    """Settings of the autoencoder. Defaults are the authors' for antmaze, but for `updates`, which they count in passes
    over their data.

    beta weighs the KL (nats, sum over latent dimensions) against the log-likelihood of the window's actions (nats, sum
    over steps and action dimensions).
    """

    updates: int = 500_000
    batch_size: int = 50
    learning_rate: float = 1e-3
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    latent_dim: int = 8
    hidden: tuple[int, ...] = (200, 200)
    """Of the decoder and the prior."""
    encoder_hidden: int = 200
    """Units of the encoder's gated recurrent unit, in either direction."""
    encoder_stride: int = 1
    """Steps that the encoder takes in at a time, side by side (departure; 1 is the paper)."""
    beta: float = 0.1
    regression: RegressionConfig = field(default_factory=RegressionConfig)
    """Of the actions, by the decoder."""

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "latent_dim", "encoder_hidden", "encoder_stride", "beta")


@dataclass(frozen=True)
class OpalConfig:
    """All of OPAL's settings. Defaults are the preset `paper`."""

    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    skill_steps: int = 10
    """c of a skill, the authors'. (c of `problem` only serves `view`.)"""
    relative: bool = False
    """Show goals as displacements from s^G_t instead of positions (departure)."""
    skills: SkillsConfig = field(default_factory=SkillsConfig)
    high: SubgoalPolicyConfig = field(default_factory=lambda: SubgoalPolicyConfig(prior=False))
    """Conservative Q-learning on z. `prior=False` is the paper's reading: plain CQL(H), its policy held up by entropy
    alone. `prior=True` holds the policy to rho(z | s) by a tuned KL, as Guider's is (departure)."""

    def __post_init__(self) -> None:
        check_positive(self, "skill_steps")
        check_fraction(self, "action_scale")


class SkillParams(NamedTuple):
    """forward, backward, summary: q(z | window), a GRU in each direction and a linear layer on both of their last
    states; prior: rho(z | s); decoder: pi(a | s, z)."""

    forward: Gru
    backward: Gru
    summary: Layers
    prior: Layers
    decoder: Layers


class SkillState(NamedTuple):
    params: SkillParams
    optimiser: Moments


class OpalState(NamedTuple):
    """Everything that training changes or acting needs."""

    scale: Scale
    skills: SkillState
    high: SubgoalPolicyState


def init(config: OpalConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> OpalState:
    """Fresh state for one seed."""
    forward_key, backward_key, summary_key, prior_key, decoder_key, high_key = jax.random.split(key, 6)
    settings = config.skills
    state_dim, latent = spaces.state_dim, settings.latent_dim
    entry_dim = settings.encoder_stride * (state_dim + spaces.action_dim)
    params = SkillParams(
        forward=gru_init(forward_key, entry_dim, settings.encoder_hidden),
        backward=gru_init(backward_key, entry_dim, settings.encoder_hidden),
        summary=mlp_init(summary_key, (2 * settings.encoder_hidden, 2 * latent)),
        prior=mlp_init(prior_key, (state_dim, *settings.hidden, 2 * latent)),
        decoder=mlp_init(decoder_key, (state_dim + latent, *settings.hidden, 2 * spaces.action_dim)),
    )
    high_dim = state_dim + spaces.goal_dim + 4 * config.view.position_waves * spaces.goal_dim
    return OpalState(
        scale=scale,
        skills=SkillState(params, adam_init(params)),
        high=subgoal_policy.init(high_key, config.high, high_dim, latent),
    )


def encode(config: SkillsConfig, params: SkillParams, scale: Scale, window: Trajectories) -> Gaussian:
    """q(z | s_t, a_t, ..., s_{t+c-1}, a_{t+c-1}), [B, Z]. Nothing from the episode's end on is read."""
    entries = jnp.concatenate([scale.state(window.observations), window.actions], axis=-1)
    entries = jnp.where(window.valid[..., None], entries, 0.0)
    padding = -entries.shape[1] % config.encoder_stride
    entries = jnp.pad(entries, ((0, 0), (0, padding), (0, 0)))
    valid = jnp.pad(window.valid, ((0, 0), (0, padding)))
    entries = entries.reshape(len(entries), -1, config.encoder_stride * entries.shape[-1])
    valid = valid[:, :: config.encoder_stride]  # a window's valid steps come first
    ends = [gru(params.forward, entries, valid), gru(params.backward, entries, valid, reverse=True)]
    return gaussian_head(mlp(params.summary, jnp.concatenate(ends, axis=-1)))


def prior(params: SkillParams, scale: Scale, observation: jax.Array) -> Gaussian:
    """rho(z | s). observation: [..., S]."""
    return gaussian_head(mlp(params.prior, scale.state(observation)))


def decode(params: SkillParams, scale: Scale, observation: jax.Array, latent: jax.Array) -> jax.Array:
    """Mean of pi(a | s, z), [..., A] in [-1, 1]."""
    return _actions(params.decoder, decoder_inputs(scale, observation, latent)).mean


def _actions(decoder: Layers, inputs: jax.Array, dropout: float = 0.0, key: jax.Array | None = None) -> Gaussian:
    """pi(a | s, z): a mean within the bounds, and a spread of its own everywhere."""
    mean, log_std = gaussian_head(mlp(decoder, inputs, dropout=dropout, key=key))
    return Gaussian(jnp.tanh(mean), log_std)


def decoder_inputs(scale: Scale, observation: jax.Array, latent: jax.Array) -> jax.Array:
    """What the decoder sees: scaled s and z, [..., S + Z]."""
    return jnp.concatenate([scale.state(observation), latent], axis=-1)


def skills_loss(
    config: SkillsConfig, params: SkillParams, scale: Scale, window: Trajectories, key: jax.Array
) -> tuple[jax.Array, Metrics]:
    """The evidence lower bound negated, mean over the batch: -log pi of the actions + beta * KL(q || rho).

    The decoder is a Gaussian of learned mean and spread (or a Laplace distribution, see `regression`); -log pi is
    summed over action dimensions and the window's steps within the episode, the KL over latent dimensions, all in nats.
    """
    sample_key, dropout_key = jax.random.split(key)
    posterior = encode(config, params, scale, window)
    latent = jnp.repeat(posterior.sample(sample_key)[:, None], window.valid.shape[1], axis=1)
    seen = decoder_inputs(scale, window.observations, latent)
    policy = _actions(params.decoder, seen, config.regression.dropout, dropout_key)
    surprise = losses.surprise(policy, window.actions, config.regression.error)
    missing = jnp.where(window.valid, surprise, 0.0).sum(axis=-1)
    kl = losses.gaussian_kl(posterior, prior(params, scale, window.observations[:, 0])).sum(axis=-1)
    squared = jnp.where(window.valid, ((policy.mean - window.actions) ** 2).mean(axis=-1), 0.0)
    metrics = {"action_error": squared.sum() / window.valid.sum(), "surprise": missing.mean(), "kl": kl.mean()}
    return (missing + config.beta * kl).mean(), metrics


def high_inputs(
    config: OpalConfig, scale: Scale, observation: jax.Array, achieved: jax.Array, goal: jax.Array
) -> jax.Array:
    """What the high level sees: scaled (s, g), [..., inputs]. With `relative`, g is a displacement from s^G."""
    seen = (goal - achieved) / scale.goal_std if config.relative else scale.goal(goal)
    return jnp.concatenate([scale.state(observation), scale.waves(achieved), seen, scale.waves(goal)], axis=-1)


def relabel(config: OpalConfig, state: OpalState, batch: SkillBatch, key: jax.Array) -> subgoal_policy.Transitions:
    """z ~ q(. | window) takes the actions' place; the reward is 0 if the goal is met at the window's end, else -1."""
    problem, scale, params = config.problem, state.scale, state.skills.params
    observation = batch.trajectories.observations[:, 0]
    return subgoal_policy.Transitions(
        state=high_inputs(config, scale, observation, batch.achieved, batch.goal),
        latent=encode(config.skills, params, scale, batch.trajectories).sample(key),
        reward=losses.goal_reward(batch.later, batch.goal, problem.radius, problem.goal_parts),
        next_state=high_inputs(config, scale, batch.later_observation, batch.later, batch.goal),
        prior=prior(params, scale, observation),
        next_prior=prior(params, scale, batch.later_observation),
    )


def stages(config: OpalConfig) -> tuple[Stage, ...]:
    """Skills, then the policy over them."""
    skill_steps = config.skill_steps

    def update_skills(state: OpalState, data: Data, key: jax.Array):
        sample_key, update_key = jax.random.split(key)
        settings, old = config.skills, state.skills
        window = sample_trajectories(data, sample_key, settings.batch_size, skill_steps)
        rate = cosine_rate(settings.learning_rate, settings.decay, settings.updates, old.optimiser)
        gradients, metrics = jax.grad(
            lambda params: skills_loss(settings, params, state.scale, window, update_key), has_aux=True
        )(old.params)
        return SkillState(*adam_step(rate, old.params, gradients, old.optimiser)), metrics

    def update_high(state: OpalState, data: Data, key: jax.Array):
        sample_key, relabel_key, update_key = jax.random.split(key, 3)
        settings = config.high
        batch = sample_skills(
            data,
            sample_key,
            settings.batch_size,
            skill_steps,
            settings.goal_offset,
            settings.relabel_fraction,
            settings.random_goal_fraction,
        )
        return subgoal_policy.update(settings, state.high, relabel(config, state, batch, relabel_key), update_key)

    return (
        Stage("skills", "skills", config.skills.updates, update_skills),
        Stage("skill policy", "high", config.high.updates, update_high),
    )


class ActingState(NamedTuple):
    """What the policy remembers between steps, per environment. latent: [B, Z]; steps_left: [B] int32."""

    latent: jax.Array
    steps_left: jax.Array


def initial_acting_state(config: OpalConfig, goal_dim: int, batch_size: int) -> ActingState:
    return ActingState(jnp.zeros((batch_size, config.skills.latent_dim)), jnp.zeros(batch_size, jnp.int32))


def acts_by(config: OpalConfig) -> str:
    """How it chooses what it does."""
    return f"mean of the skill policy, a new one every {config.skill_steps} steps"


def act(
    config: OpalConfig,
    state: OpalState,
    goal_indices: tuple[int, ...],
    observation: jax.Array,
    goal: jax.Array,
    acting: ActingState,
    reset_mask: jax.Array,
) -> tuple[jax.Array, ActingState]:
    """One step of the hierarchy, by the means of both policies, with a new skill at resets and after c steps.

    observation: [B, S]; goal: [B, G]; reset_mask: [B] bool, True where an episode begins.
    Returns actions [B, A] in [-1, 1] and the new acting state.
    """
    renew = reset_mask | (acting.steps_left <= 0)
    achieved = observation[..., jnp.asarray(goal_indices)]
    chosen = subgoal_policy.propose(
        state.high.params, high_inputs(config, state.scale, observation, achieved, goal)
    ).mean
    latent = jnp.where(renew[:, None], chosen, acting.latent)
    steps_left = jnp.where(renew, config.skill_steps, acting.steps_left) - 1
    return decode(state.skills.params, state.scale, observation, latent), ActingState(latent, steps_left)


FAST: Changes = under("high", STEADY_CRITIC) | {
    "relative": True,
    "skills.updates": 20_000,
    "skills.batch_size": 20,
    "skills.decay": True,
    "skills.hidden": (256, 256),
    "skills.encoder_hidden": 128,
    "skills.encoder_stride": 5,
    "skills.beta": 0.02,
    "high.updates": 10_000,
    "high.batch_size": 128,
    "high.learning_rate": 1e-3,
    "high.hidden": (256, 256),
    "high.relabel_fraction": 0.7,
    "high.random_goal_fraction": 0.3,
    "high.prior": True,
    "high.target_divergence": 0.4,
}
FAST_IN_DOMAIN: ByDomain = {
    # A skill is the mean of many ways to walk, and gentle already; ten steps of walking lead nowhere (docs/results.md).
    "antmaze": {"action_scale": 1.0, "skill_steps": 50, "skills.updates": 40_000, "high.updates": 15_000},
    "fetch": MANIPULATION,
    "kitchen": MANIPULATION | {"view.smallest_spread": 0.1} | under("skills.regression", FROM_DEMONSTRATIONS),
}


def opal_config(preset: Preset, problem: Problem) -> OpalConfig:
    """Settings for a problem."""
    paper = OpalConfig(problem=problem)
    return paper if preset == "paper" else fast(paper, FAST, FAST_IN_DOMAIN)


METHODS = {"opal": Method("OPAL", OpalConfig, opal_config, init, stages, initial_acting_state, act, acts_by)}
