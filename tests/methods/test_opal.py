"""OPAL's parts against hand-worked cases."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import labelled, make_ragged

from guider.errors import GuiderError
from guider.learning import losses
from guider.learning.networks import Gru, gru, gru_init
from guider.learning.problem import Problem
from guider.learning.samplers import SkillBatch, Trajectories, sample_skills, sample_trajectories
from guider.learning.windows import device_data
from guider.methods import opal as method
from guider.methods.opal import OpalConfig, opal_config
from guider.methods.policy import Policy, compiled_act, initial_state
from guider.methods.view import Scale
from guider.support.config import Changes, from_dict, override, to_dict

SMALL: Changes = {
    "skills.updates": 10,
    "skills.hidden": (16, 16),
    "skills.encoder_hidden": 16,
    "skills.encoder_stride": 2,
    "skills.latent_dim": 3,
    "skills.batch_size": 32,
    "high.updates": 10,
    "high.hidden": (16, 16),
    "high.batch_size": 32,
    "high.samples": 2,
}


def small(changes: Changes) -> OpalConfig:
    return override(opal_config("paper", Problem(0.5, 1.0, period_steps=5)), SMALL | changes)


def unit() -> Scale:
    return Scale(jnp.zeros(4), jnp.ones(4), jnp.zeros(2), jnp.ones(2), jnp.ones(2), jnp.zeros(0))


def fresh(config: OpalConfig) -> method.OpalState:
    return jax.jit(lambda key: method.init(config, make_ragged().spaces, unit(), key))(jax.random.key(0))


def test_paper_settings_and_faults():
    paper = opal_config("paper", Problem())
    assert paper == OpalConfig() and from_dict(OpalConfig, to_dict(paper)) == paper
    assert not paper.high.prior and opal_config("fast", Problem()).high.prior
    assert (paper.skills.latent_dim, paper.skills.beta, paper.skills.encoder_stride) == (8, 0.1, 1)
    with pytest.raises(GuiderError, match="encoder_stride must be above 0"):
        override(paper, {"skills.encoder_stride": 0})


def test_gru_step_by_hand():
    """One unit, one input x = 2, from a state of 0.5 that a first entry left there."""
    weights = Gru(jnp.array([[0.1, 0.2, 0.3]]), jnp.array([[0.4, 0.5, 0.6]]), jnp.array([0.7, 0.8, 0.9]), jnp.ones(1))

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    def step(h, x):
        reset, update = sigmoid(0.1 * x + 0.4 * h + 0.7), sigmoid(0.2 * x + 0.5 * h + 0.8)
        return update * h + (1 - update) * np.tanh(0.3 * x + 0.9 + reset * (0.6 * h + 1.0))

    first, second = step(0.0, -1.0), step(step(0.0, -1.0), 2.0)
    inputs = jnp.array([[[-1.0], [2.0]]] * 2)
    ends = gru(weights, inputs, jnp.array([[True, True], [True, False]]))
    np.testing.assert_allclose(ends[:, 0], [second, first], rtol=1e-6)
    backward = gru(weights, inputs, jnp.ones((2, 2), bool), reverse=True)
    np.testing.assert_allclose(backward[:, 0], step(step(0.0, 2.0), -1.0), rtol=1e-6)


def test_gru_passes_over_what_is_not_valid():
    weights, inputs = gru_init(jax.random.key(0), 3, 4), jax.random.normal(jax.random.key(1), (2, 6, 3))
    valid = jnp.arange(6) < jnp.array([[6], [4]])
    for reverse in (False, True):
        both = gru(weights, inputs, valid, reverse)
        alone = gru(weights, inputs[1:, :4], jnp.ones((1, 4), bool), reverse)
        np.testing.assert_allclose(both[1:], alone, rtol=1e-5)


def window(steps: int = 5) -> Trajectories:
    """Two windows, the second ending after three steps."""
    observations = jax.random.normal(jax.random.key(5), (2, steps, 4))
    actions = jax.random.uniform(jax.random.key(6), (2, steps, 2), minval=-1.0)
    return Trajectories(observations, actions, jnp.arange(steps) < jnp.array([[steps], [3]]))


@pytest.mark.parametrize("stride", [1, 2, 7])
def test_nothing_beyond_the_episode_gets_in(stride):
    """Neither the encoding nor the loss changes with what stands beyond, and every step within matters."""
    config = small({"skills.encoder_stride": stride})
    params, given = fresh(config).skills.params, window()
    beyond = (~given.valid)[..., None]
    other = Trajectories(
        jnp.where(beyond, 99.0, given.observations), jnp.where(beyond, -99.0, given.actions), given.valid
    )

    @jax.jit
    def look(window):
        loss, _ = method.skills_loss(config.skills, params, unit(), window, jax.random.key(2))
        return method.encode(config.skills, params, unit(), window).mean, loss

    for first, second in zip(look(given), look(other), strict=True):
        np.testing.assert_array_equal(first, second)
    for step in range(3):
        moved, _ = look(given._replace(actions=given.actions.at[:, step].add(0.5)))
        assert float(jnp.abs(moved - look(given)[0]).min()) > 0


@pytest.mark.parametrize(
    ("counted", "surprise"),
    [("squared", (0.25 + 1) / 2 + np.log(2 * np.pi)), ("absolute", 0.5 + 1 + 2 * np.log(2))],
)
def test_evidence_lower_bound_by_hand(counted, surprise):
    """A decoder that answers a mean of 0.5 and a spread of 1, and actions of (0, -0.5): -log pi, summed over both, is
    the same at every step, five in one window and three in the other; q = N(0, 1) and rho = N(1, 1) in three dimensions
    are 1.5 nats apart."""
    config = small({"skills.beta": 0.2, "skills.regression.error": counted})
    params = jax.tree.map(jnp.zeros_like, fresh(config).skills.params)
    *hidden, (weight, bias) = params.prior
    params = params._replace(prior=(*hidden, (weight, bias.at[:3].set(1.0))))
    *hidden, (weight, bias) = params.decoder
    params = params._replace(decoder=(*hidden, (weight, bias.at[:2].set(jnp.arctanh(0.5)))))
    given = window()._replace(actions=jnp.broadcast_to(jnp.array([0.0, -0.5]), (2, 5, 2)))
    loss, metrics = method.skills_loss(config.skills, params, unit(), given, jax.random.key(0))
    assert float(loss) == pytest.approx((5 + 3) * surprise / 2 + 0.2 * 1.5)
    assert float(metrics["kl"]) == pytest.approx(1.5)
    assert float(metrics["action_error"]) == pytest.approx(0.625)


def test_the_spread_of_actions_is_learned():
    """A wider spread makes far actions less surprising, a narrower one near ones."""
    config = small({})
    params = jax.tree.map(jnp.zeros_like, fresh(config).skills.params)

    def loss(action, log_std):
        *hidden, (weight, bias) = params.decoder
        moved = params._replace(decoder=(*hidden, (weight, bias.at[2:].set(log_std))))
        given = window()._replace(actions=jnp.full((2, 5, 2), action))
        return float(method.skills_loss(config.skills, moved, unit(), given, jax.random.key(0))[0])

    assert loss(1.0, -1.0) > loss(1.0, 0.0) and loss(0.1, -1.0) < loss(0.1, 0.0)


@pytest.mark.parametrize(("dropout", "alike"), [(0.0, True), (0.5, False)])
def test_dropout_is_of_the_decoder_while_learning(dropout, alike):
    """With a decoder blind to z, the loss differs between keys by dropout alone."""
    config = small({"skills.regression.dropout": dropout})
    params = fresh(config).skills.params
    (weight, bias), *rest = params.decoder
    params = params._replace(decoder=((weight.at[4:].set(0.0), bias), *rest))
    seen = [method.skills_loss(config.skills, params, unit(), window(), jax.random.key(k))[0] for k in (1, 2)]
    assert (float(seen[0]) == float(seen[1])) is alike


def test_high_transitions_by_hand():
    """z is drawn from the window's posterior; the goal is met or not where the window ends, whatever lies between."""
    config = small({})
    state, given = fresh(config), window()
    batch = SkillBatch(
        trajectories=given,
        later_observation=jnp.full((2, 4), 3.0),
        achieved=given.observations[:, 0, :2],
        later=jnp.full((2, 2), 3.0),
        goal=jnp.array([[3.3, 3.3], [3.4, 3.4]]),
    )
    seen = method.relabel(config, state, batch, jax.random.key(1))
    assert seen.reward.tolist() == [0.0, -1.0], "0.42 and 0.57 from the goal"
    np.testing.assert_array_equal(seen.state, jnp.concatenate([given.observations[:, 0], batch.goal], axis=1))
    np.testing.assert_array_equal(seen.next_state, jnp.concatenate([batch.later_observation, batch.goal], axis=1))
    posterior = method.encode(config.skills, state.skills.params, unit(), given)
    np.testing.assert_allclose(seen.latent, posterior.sample(jax.random.key(1)), rtol=1e-6)
    prior = method.prior(state.skills.params, unit(), given.observations[:, 0])
    assert float(losses.gaussian_kl(seen.prior, prior).max()) == pytest.approx(0.0, abs=1e-6)


def test_relative_goals_are_displacements():
    config = small({"relative": True})
    scale = unit()._replace(goal_std=jnp.full(2, 2.0))
    seen = method.high_inputs(config, scale, jnp.zeros((1, 4)), jnp.array([[1.0, 2.0]]), jnp.array([[5.0, 0.0]]))
    assert seen.tolist() == [[0, 0, 0, 0, 2, -1]]


@pytest.mark.parametrize("boundary", ["clip", "drop"])
def test_windows_stay_in_their_episode(boundary):
    lengths = np.array([3, 9, 40])
    data = device_data(labelled(lengths), 6, boundary, 0.0)
    data = data._replace(actions=data.achieved)  # an action tells its row
    for given in (
        sample_trajectories(data, jax.random.key(0), 2_000, 6),
        (batch := sample_skills(data, jax.random.key(1), 2_000, 6, 0, 1.0, 0.0)).trajectories,
    ):
        start = np.asarray(given.observations[:, 0], int)
        last = lengths[start[:, 0]] - 1
        step = start[:, 1:] + np.arange(6)
        assert np.array_equal(given.valid, step < last[:, None])
        assert given.valid.all() == (boundary == "drop") and np.all(given.valid[:, 0])
        rows = np.stack([np.repeat(start[:, :1], 6, axis=1), np.minimum(step, last[:, None])], axis=-1)
        assert np.array_equal(given.observations, rows) and np.array_equal(given.actions, rows)
    later = np.minimum(start[:, 1] + 6, last)
    assert np.array_equal(batch.achieved, start) and np.array_equal(batch.later, batch.later_observation)
    assert np.array_equal(batch.later, np.stack([start[:, 0], later], axis=1))
    assert np.array_equal(batch.goal[:, 0], start[:, 0])
    assert np.all(batch.goal[:, 1] >= later) and np.all(batch.goal[:, 1] <= last)


def test_a_new_skill_every_period_and_at_resets():
    """All networks answer 0, and between steps 1 is added to the skill: it counts the steps it has been held."""
    config = override(small({}), {"skill_steps": 3, "skills.latent_dim": 1})
    state = jax.tree.map(jnp.zeros_like, fresh(config))
    policy = Policy(state._replace(scale=unit()), -jnp.ones(2), jnp.ones(2), "opal", config, (0, 1), 4)
    acting, steps_left = initial_state(policy, 2), []
    begins = [[True, True], [False, False], [False, True], [False, False], [False, False]]
    for reset in begins:
        acting = acting._replace(latent=acting.latent + 1)
        _, acting = compiled_act(policy, jnp.zeros((2, 4)), jnp.zeros((2, 2)), acting, jnp.array(reset))
        steps_left.append((acting.steps_left.tolist(), acting.latent[:, 0].tolist()))
    assert steps_left == [
        ([2, 2], [0, 0]),
        ([1, 1], [1, 1]),
        ([0, 2], [2, 0]),
        ([2, 1], [0, 1]),
        ([1, 0], [1, 2]),
    ]
