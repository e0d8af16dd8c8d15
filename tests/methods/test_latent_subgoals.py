"""The latent model of subgoals, against hand-worked cases and where the answer is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import plain_scale, tiny

from guider.data.episodes import make_episodes
from guider.learning import losses
from guider.learning.networks import Gaussian
from guider.learning.problem import Problem
from guider.learning.samplers import Windows
from guider.learning.training import init_seeds, train
from guider.methods import guider as method
from guider.methods import latent_subgoals
from guider.methods.guider import GuiderConfig, guider_config
from guider.methods.latent_subgoals import LatentSubgoalsConfig
from guider.methods.view import prepare


def test_coverage_is_the_share_within_the_priors_central_95_percent(monkeypatch):
    """Of moves named by their length, where N(0, 2^2) is expected: |z| <= 1.96 * 2."""
    monkeypatch.setattr(latent_subgoals, "encode", lambda c, p, s, here, later: Gaussian(later - here, 0 * here))
    monkeypatch.setattr(latent_subgoals, "prior", lambda p, s, here: Gaussian(0 * here, 0 * here + jnp.log(2.0)))
    moves = jnp.array([[1.0], [3.5], [-3.9], [3.95], [-5.0]])
    config, state = GuiderConfig().latent, jnp.zeros(0)
    covered = latent_subgoals.coverage(config, cast(Any, state), plain_scale(), jnp.ones((5, 1)), 1 + moves)
    assert float(covered) == pytest.approx(3 / 5)


def test_within_reach_is_what_the_prior_holds_for_likely_and_decodes_to(monkeypatch):
    """Two latents, N(0, 2^2) and N(0, 1); what is decoded stops 1.5 away from where it starts, in the first entry."""
    monkeypatch.setattr(latent_subgoals, "encode", lambda c, p, s, here, later: Gaussian(later - here, 0 * here))
    spread = jnp.log(jnp.array([2.0, 1.0]))
    monkeypatch.setattr(latent_subgoals, "prior", lambda p, s, here: Gaussian(0 * here, 0 * here + spread))

    def decode(config, params, scale, here, latent):
        return here + jnp.stack([jnp.clip(latent[:, 0], -1.5, 1.5), latent[:, 1]], axis=1)

    monkeypatch.setattr(latent_subgoals, "decode", decode)
    moves = jnp.array([[1.0, 0.0], [1.0, 1.9], [1.0, 2.0], [1.9, 0.0], [2.1, 0.0], [-4.0, 0.0]])
    config, state = GuiderConfig().latent, cast(Any, jnp.zeros(0))
    found = latent_subgoals.within_reach(config, state, plain_scale(), jnp.ones((6, 2)), 1 + moves, 0.5)
    assert found.tolist() == [True, True, False, True, False, False]


def test_latent_model_learns_what_is_reachable():
    """Displacements of +-3 m along one axis: the decoder spans both, the prior covers them, the error is small."""
    rng = np.random.default_rng(1)
    way = rng.choice([-3.0, 3.0], 4000)
    start = rng.uniform(-5, 5, 4000)
    positions = np.stack([start, start + way], axis=1).reshape(-1, 1)
    episodes = make_episodes(positions, np.zeros((8000, 1)), [2] * 4000, (0,))
    config = tiny(guider_config("fast", Problem(0.5, 1.0, period_steps=1)), updates=1500)
    config = replace(config, latent=replace(config.latent, latent_dim=1, learning_rate=3e-3))
    data, scale = prepare(config.view, config.problem, episodes)
    state = init_seeds(lambda key: method.init(config, episodes.spaces, scale, key), (0,))
    state = jax.tree.map(lambda leaf: leaf[0], train(method.stages(config)[:1], state, data, (0,)))
    at = jnp.zeros((2, 1))
    posterior = latent_subgoals.encode(config.latent, state.latent.params, state.scale, at, jnp.array([[-3.0], [3.0]]))
    decoded = latent_subgoals.decode(config.latent, state.latent.params, state.scale, at, posterior.mean)
    np.testing.assert_allclose(decoded[:, 0], [-3.0, 3.0], atol=0.3)
    prior = latent_subgoals.prior(state.latent.params, state.scale, at)
    assert bool(jnp.all(jnp.abs(posterior.mean - prior.mean) <= 2.5 * jnp.exp(prior.log_std)))
    assert bool(jnp.all(losses.gaussian_kl(posterior, prior) > 0.2)), "the latent tells the ways apart"


def test_in_spreads_the_latent_loss_does_not_depend_on_the_goal_units():
    config = LatentSubgoalsConfig(hidden=(8,), decoder_dropout=0.0, relative=True, error_in_spreads=True)
    params = latent_subgoals.init(jax.random.key(0), config, 2, 2).params
    achieved, later = jax.random.normal(jax.random.key(1), (2, 16, 2))

    def loss(config, unit):
        ones = unit * jnp.ones(2)
        scale = plain_scale()._replace(goal_std=ones, step_std=0.3 * ones)
        return latent_subgoals.loss(config, params, scale, Windows(unit * achieved, unit * later), jax.random.key(2))[0]

    assert jnp.allclose(loss(config, 1.0), loss(config, 100.0), rtol=1e-5)
    in_units = replace(config, error_in_spreads=False)
    assert loss(in_units, 100.0) > 100 * loss(in_units, 1.0)
