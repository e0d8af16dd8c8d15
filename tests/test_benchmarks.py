# pyright: reportMissingImports=false
# (PyTorch is optional)
"""The PyTorch baseline is the same update: same parameters, batch and noise give the same losses."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import make_ragged

from benchmarks.common import STAGES
from benchmarks.updates import update_flops
from guider.learners import Transitions, awr
from guider.learning.networks import Gaussian, gaussian_head, mlp
from guider.learning.problem import Problem
from guider.learning.samplers import Windows
from guider.methods import guider as method
from guider.methods import latent_subgoals, subgoal_policy
from guider.methods.guider import GuiderConfig, GuiderState, guider_config
from guider.methods.view import prepare, unit_scale

EPISODES = make_ragged()
SPACES = EPISODES.spaces


def paper(**high) -> GuiderConfig:
    """The preset without dropout, whose noise the two libraries cannot share."""
    config = guider_config("paper", Problem(0.5, 1.0, 5))
    return replace(
        config,
        latent=replace(config.latent, batch_size=32, decoder_dropout=0.0),
        high=replace(config.high, batch_size=32, samples=4, **high),
        low=replace(config.low, batch_size=32),
    )


def state_of(config: GuiderConfig) -> GuiderState:
    return method.init(config, SPACES, unit_scale(config.view, SPACES), jax.random.key(0))


def normal(seed: int, *shape: int) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), shape)


@pytest.fixture
def baseline():
    """benchmarks.torch_updates; the tests that need it are skipped where PyTorch is not installed."""
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install -e '.[bench]'")
    from benchmarks import torch_updates

    return torch_updates


def tensor(array):
    import torch

    return torch.from_numpy(np.array(array))


def test_latent_losses_agree(baseline):
    config = paper()
    state = state_of(config)
    torch_model = baseline.LatentModel(config, SPACES.goal_dim)
    for network, layers in zip(torch_model.networks, state.latent.params, strict=True):
        baseline.copy_layers(network, layers)
    batch = Windows(3 * normal(1, 32, 2), 3 * normal(2, 32, 2))
    key = jax.random.key(3)
    noise = jax.random.normal(jax.random.split(key)[0], (32, config.latent.latent_dim))
    ours, _ = latent_subgoals.loss(config.latent, state.latent.params, state.scale, batch, key)
    theirs = torch_model.loss(tensor(batch.achieved), tensor(batch.later), tensor(noise))
    assert theirs.item() == pytest.approx(float(ours), rel=1e-4)


def low_batch() -> Transitions:
    inputs = SPACES.state_dim + 2 * SPACES.goal_dim
    reward = jnp.where(normal(3, 32) > 1, 0.0, -1.0)
    action, steps = jnp.tanh(normal(2, 32, 2)), jnp.ones(32, jnp.int32)
    return Transitions(normal(1, 32, inputs), action, reward, normal(4, 32, inputs), steps)


def test_low_level_updates_agree(baseline):
    """Losses of the first update, and of a second one after both have stepped: gradients, Adam, targets agree too."""
    config = paper()
    learner = config.low.learner
    assert isinstance(learner, awr.AwrConfig)
    state = state_of(config).low
    policy = baseline.GoalPolicy(config, SPACES.state_dim, SPACES.goal_dim, SPACES.action_dim)
    baseline.copy_layers(policy.actor, state.params.actor)
    baseline.copy_twins(policy.critics, state.params.critic)
    baseline.copy_twins(policy.targets, jax.tree.map(lambda leaf: 0.9 * leaf, state.target_critic))
    state = state._replace(target_critic=jax.tree.map(lambda leaf: 0.9 * leaf, state.target_critic))
    batch = low_batch()
    torch_batch = baseline.GoalBatch(*map(tensor, batch[:4]))
    for _ in range(2):
        weighted_loss = _low_level_loss(config, state, batch)
        loss = policy.loss(torch_batch, *map(tensor, low_noise(state)))
        assert loss.item() == pytest.approx(weighted_loss, rel=1e-4)
        baseline.minimise(loss, policy.networks, policy.optimisers)
        baseline.move_targets(policy.targets, policy.critics, learner.target_rate)
        state, _ = update_low(config, state, batch)


def update_low(config: GuiderConfig, state: awr.AwrState, batch: Transitions):
    assert isinstance(config.low.learner, awr.AwrConfig)
    return awr.update(config.low.learner, state, batch, jax.random.key(0), config.low.learning_rate)


def low_noise(state: awr.AwrState) -> list[jax.Array]:
    """What `update_low` draws for pi_l(s') and pi_l(s), [B, A] each."""
    key, layers = jax.random.key(0), len(state.params.actor)
    keys = jax.random.fold_in(jax.random.fold_in(key, layers + 1), layers), jax.random.fold_in(key, layers)
    return [jax.random.normal(key, (32, SPACES.action_dim)) for key in keys]


def _low_level_loss(config: GuiderConfig, state: awr.AwrState, batch: Transitions) -> float:
    """TD error as `update` reports it, plus the regression of Eq. 6 from its definition."""
    learner = config.low.learner
    assert isinstance(learner, awr.AwrConfig)
    _, metrics = update_low(config, state, batch)
    next_action, action = (
        gaussian_head(mlp(state.params.actor, inputs)).mean
        + jnp.exp(gaussian_head(mlp(state.params.actor, inputs)).log_std) * noise
        for inputs, noise in zip((batch.next_state, batch.state), low_noise(state), strict=True)
    )
    next_value = awr.twin_values(state.params.critic, batch.next_state, next_action)[0]
    ahead = jnp.where(batch.reward < 0, batch.reward + learner.discount * next_value, 0.0)
    advantage = ahead - awr.twin_values(state.params.critic, batch.state, action)[0]
    weight = jnp.minimum(jnp.exp(advantage / learner.temperature), learner.weight_ceiling)
    return float(metrics["td_error"] + (weight * ((action - batch.action) ** 2).mean(axis=-1)).mean())


def test_high_level_losses_agree(baseline):
    config = paper()
    settings, samples = config.high, config.high.samples
    state = state_of(config).high
    policy = baseline.SubgoalPolicy(config, SPACES.goal_dim)
    baseline.copy_layers(policy.actor, state.params.actor)
    baseline.copy_twins(policy.critics, state.params.critic)
    target = jax.tree.map(lambda leaf: 0.9 * leaf, state.target_critic)
    baseline.copy_twins(policy.targets, target)
    prior = Gaussian(normal(5, 32, 2), 0.1 * normal(6, 32, 2))  # of both states: CQL's backup asks none
    reward = jnp.where(normal(3, 32) > 1, 0.0, -1.0)
    batch = subgoal_policy.Transitions(normal(1, 32, 4), normal(2, 32, 2), reward, normal(4, 32, 4), prior, prior)
    critic_key, actor_key = jax.random.split(jax.random.key(7))
    next_key, now_key, uniform_key = jax.random.split(critic_key, 3)
    draws = (samples, 32, 2)
    noise = baseline.SubgoalNoise(
        next=tensor(jax.random.normal(next_key, draws).swapaxes(0, 1)),
        now=tensor(jax.random.normal(now_key, draws).swapaxes(0, 1)),
        uniform=tensor(jax.random.uniform(uniform_key, (32, samples, 2))),
        actor=tensor(jax.random.normal(actor_key, (32, 2))),
    )
    torch_batch = baseline.SubgoalBatch(*map(tensor, batch[:4]), prior=baseline.Gaussian(*map(tensor, prior)))
    critic, actor, lagrange = policy.losses(torch_batch, noise)
    ours, _ = subgoal_policy._cql_critic_loss(settings, state.params, target, batch, critic_key)
    ours_actor, _ = subgoal_policy._actor_loss(settings, state.params, batch, actor_key)
    assert (critic + lagrange).item() == pytest.approx(float(ours), rel=1e-4)
    assert actor.item() == pytest.approx(float(ours_actor), rel=1e-4)


@pytest.mark.parametrize("stage", STAGES)
def test_counted_operations_are_those_compiled(stage):
    """XLA's own count also holds activations, losses and Adam, and shares a few products."""
    config = paper()
    data, scale = prepare(config.view, config.problem, EPISODES)
    state = method.init(config, SPACES, scale, jax.random.key(0))
    update = jax.jit(method.stages(config)[STAGES.index(stage)].update)
    cost = update.lower(state, data, jax.random.key(0)).compile().cost_analysis()
    assert cost is not None
    assert update_flops(config, stage, SPACES) == pytest.approx(cost["flops"], rel=0.1)
