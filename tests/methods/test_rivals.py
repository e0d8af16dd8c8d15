"""One update of each of HIQL's and OPAL's stages against NumPy, as test_updates.py does for Guider's and the learners'.

A batch is drawn by the package's samplers, which have tests of their own; OPAL's policy over skills is Guider's high
level, on transitions that test_opal.py works out by hand.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference as ref
from conftest import make_ragged
from reference import RATE, plain, shaken

from guider.learning.problem import Problem
from guider.learning.samplers import sample_trajectories, sample_value, sample_waypoints
from guider.learning.training import Stage
from guider.learning.windows import device_data
from guider.methods import hiql, opal
from guider.methods.hiql import hiql_config
from guider.methods.opal import opal_config
from guider.methods.view import Scale
from guider.support.config import Changes, override

PROBLEM = Problem(radius=1.5, reach_radius=1.5, period_steps=4)
ROWS = 8
KEY = jax.random.key(4)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def scale() -> Scale:
    return Scale(
        state_mean=jnp.array([0.5, -0.5, 20.0, 2.0]),
        state_std=jnp.array([2.0, 3.0, 15.0, 1.5]),
        goal_mean=jnp.array([0.5, -0.5]),
        goal_std=jnp.array([2.0, 3.0]),
        step_std=jnp.array([1.5, 2.5]),
        frequencies=jnp.zeros(0),
    )


def data() -> Any:
    return device_data(make_ragged((7, 30, 12), recorded_goals=False), PROBLEM.period_steps, "clip", 0.0)


def update(stages: tuple[Stage, ...], name: str, state: Any) -> tuple[Any, dict[str, jax.Array]]:
    """One update of the stage of that name: (its part of the state, metrics)."""
    (stage,) = (stage for stage in stages if stage.name == name)
    return jax.jit(stage.update)(state, data(), KEY)


# HIQL (Park et al. 2023)


class Hiql:
    """A state whose parts are shaken apart, and what its losses are made of."""

    def __init__(self, **changes):
        small: Changes = {"subgoal_steps": 3, "value.representation_dim": 3, "value.discount": 0.9}
        for part in ("value", "high", "low"):
            small |= {f"{part}.batch_size": ROWS, f"{part}.hidden": (4,), f"{part}.learning_rate": RATE}
        self.config = override(hiql_config("paper", PROBLEM), small | changes)
        init = jax.jit(lambda key: hiql.init(self.config, make_ragged().spaces, scale(), key))
        state = init(jax.random.key(0))
        shaken_value = shaken(state.value.params)
        self.state = state._replace(
            value=state.value._replace(params=shaken_value, target=shaken(shaken_value, 8)),
            high=state.high._replace(params=shaken(state.high.params, 7)),
            low=state.low._replace(params=shaken(state.low.params, 6)),
        )
        self.scale = plain(scale())
        self.sample_key, _ = jax.random.split(KEY)

    def update(self, name: str) -> tuple[Any, dict[str, jax.Array]]:
        return update(hiql.stages(self.config), name, self.state)

    def seen(self, observation, place):
        """(s, g) as phi and the high level see it; s as all see it comes first."""
        return np.concatenate([self.scale.state(observation), self.scale.goal(place)], -1)

    def phi(self, params, observation, place):
        """At length sqrt(3)."""
        vector = ref.layer_norm_mlp(params.representation, self.seen(observation, place))
        return vector / np.linalg.norm(vector, axis=-1, keepdims=True) * np.sqrt(3)

    def values(self, params, observation, place):
        """[2, B]."""
        seen = np.concatenate([self.scale.state(observation), self.phi(params, observation, place)], -1)
        return np.stack([ref.layer_norm_mlp(ref.twin(params.twins, i), seen)[:, 0] for i in range(2)])

    def weight(self, settings, begin, end, place):
        """exp(A / temperature) up to the ceiling, A by the mean of the twins."""
        value = plain(self.state.value.params)
        gain = self.values(value, end, place).mean(0) - self.values(value, begin, place).mean(0)
        weight = np.minimum(np.exp(gain / settings.temperature), settings.weight_ceiling)
        assert weight.min() < 1 < weight.max() == settings.weight_ceiling, "else one of the limits shows nothing"
        return weight


@pytest.mark.parametrize("backup_steps", [1, 3])
def test_hiql_value(backup_steps):
    """Expectile regression of either twin on its own target; the side is that of min V_target' against the mean of
    V_target. Rewards are counted until the goal is met or the episode ends."""
    hiql_ = Hiql(**{"value.backup_steps": backup_steps})
    settings = hiql_.config.value
    batch = plain(sample_value(data(), KEY, ROWS, backup_steps, 10.0, 0.2, 0.3))
    params, target = plain(hiql_.state.value.params), plain(hiql_.state.value.target)
    following = hiql_.values(target, batch.end_observation, batch.goal)
    current = hiql_.values(target, batch.observation, batch.goal).mean(0)
    earned, carried = np.zeros(ROWS), np.zeros(ROWS)
    for row in range(ROWS):
        factor = 1.0
        for place, counts in zip(batch.achieved[row], batch.valid[row], strict=True):
            if np.linalg.norm(place - batch.goal[row]) <= PROBLEM.radius:
                factor = 0.0
            if counts:
                earned[row] -= factor
                factor *= 0.9
        carried[row] = factor
    assert 0 < (carried == 0).sum() < ROWS, "else no goal is met, or all are"
    upper = earned + carried * following.min(0) - current >= 0
    assert 0 < upper.sum() < ROWS, "else all rows lie on one side"
    weight = np.where(upper, 0.7, 0.3)

    def loss(params):
        errors = earned + carried * following - hiql_.values(params, batch.observation, batch.goal)
        return (weight * errors**2).mean(-1).sum()

    after, metrics = hiql_.update("value")
    ref.check_first_step(hiql_.state.value, after, loss, RATE)
    ref.check_trails(hiql_.state.value.target, after.params, after.target, settings.target_rate)
    errors = earned + carried * following - hiql_.values(params, batch.observation, batch.goal)
    assert float(metrics["value_error"]) == pytest.approx((weight * errors**2).mean(), rel=1e-6)


@pytest.mark.parametrize("subgoal", ["representation", "place"])
def test_hiql_high_level(subgoal):
    """pi_h(s, g) is regressed on phi(s, s_{t+k}), or on the way there in spreads of moves, where V(., g) rises."""
    ceiling = 1.2
    hiql_ = Hiql(subgoal=subgoal, **{"high.weight_ceiling": ceiling})
    batch = plain(sample_waypoints(data(), hiql_.sample_key, ROWS, 3, 0.0))
    weight = hiql_.weight(hiql_.config.high, batch.observation, batch.ahead_observation, batch.goal)
    if subgoal == "representation":
        aim = hiql_.phi(plain(hiql_.state.value.params), batch.observation, batch.ahead)
    else:
        aim = (batch.ahead - batch.observation[:, :2]) / np.array([1.5, 2.5])

    def loss(params):
        predicted = ref.mlp(params, hiql_.seen(batch.observation, batch.goal), ref.gelu)
        return (weight[:, None] * (predicted - aim) ** 2).mean()

    ref.check_first_step(hiql_.state.high, hiql_.update("high level")[0], loss, RATE)


@pytest.mark.parametrize("squash", [False, True])
def test_hiql_low_level(squash):
    """pi_l(s, phi(s, s_{t+k})) is regressed on the logged action, where V(., s_{t+k}) rises."""
    hiql_ = Hiql(squash=squash, **{"low.weight_ceiling": 1.2})
    batch = plain(sample_waypoints(data(), hiql_.sample_key, ROWS, 3, 1.0))
    weight = hiql_.weight(hiql_.config.low, batch.observation, batch.next_observation, batch.ahead)
    named = hiql_.phi(plain(hiql_.state.value.params), batch.observation, batch.ahead)
    seen = np.concatenate([hiql_.scale.state(batch.observation), named], -1)

    def loss(params):
        outputs = ref.mlp(params, seen, ref.gelu)
        return (weight[:, None] * ((np.tanh(outputs) if squash else outputs) - batch.action) ** 2).mean()

    ref.check_first_step(hiql_.state.low, hiql_.update("low level")[0], loss, RATE)


# OPAL (Ajay et al. 2021)


@pytest.mark.parametrize("error", ["squared", "absolute"])
def test_opal_skills(error):
    """-log pi of all the window's actions, and beta times the KL of q from rho, summed over dimensions."""
    settings: Changes = {
        "skill_steps": 5,
        "skills.batch_size": ROWS,
        "skills.hidden": (4,),
        "skills.encoder_hidden": 2,
        "skills.latent_dim": 2,
        "skills.learning_rate": RATE,
        "skills.beta": 0.3,
        "skills.regression.error": error,
    }
    config = override(opal_config("paper", PROBLEM), settings)
    state = jax.jit(lambda key: opal.init(config, make_ragged().spaces, scale(), key))(jax.random.key(0))
    state = state._replace(skills=state.skills._replace(params=shaken(state.skills.params)))
    sample_key, update_key = jax.random.split(KEY)
    window = plain(sample_trajectories(data(), sample_key, ROWS, 5))
    noise = np.asarray(jax.random.normal(jax.random.split(update_key)[0], (ROWS, 2)))
    counts = window.valid
    assert 0 < (~counts).sum() < counts.size and (counts[:, :-1] >= counts[:, 1:]).all(), "else no window is cut short"
    states = plain(scale()).state(window.observations)
    entries = np.where(counts[..., None], np.concatenate([states, window.actions], -1), 0.0)

    def loss(params):
        ends = [
            ref.gru(params.forward, entries, counts),
            ref.gru(params.backward, entries[:, ::-1], counts[:, ::-1]),
        ]
        mean, std = ref.gaussian(ref.mlp(params.summary, np.concatenate(ends, -1)))
        latent = mean + std * noise
        surprise = np.zeros(ROWS)
        for step in range(5):
            centre, spread = ref.gaussian(ref.mlp(params.decoder, np.concatenate([states[:, step], latent], -1)))
            centre, action = np.tanh(centre), window.actions[:, step]
            if error == "squared":
                density = ref.log_density(centre, spread, action)
            else:
                density = (-np.abs(action - centre) / spread - np.log(2 * spread)).sum(-1)
            surprise -= np.where(counts[:, step], density, 0.0)
        held = ref.kl(mean, std, *ref.gaussian(ref.mlp(params.prior, states[:, 0]))).sum(-1)
        return (surprise + 0.3 * held).mean()

    after, metrics = update(opal.stages(config), "skills", state)
    ref.check_first_step(state.skills, after, loss, RATE)
    total = float(metrics["surprise"]) + 0.3 * float(metrics["kl"])
    assert total == pytest.approx(loss(plain(state.skills.params)), rel=1e-6)
