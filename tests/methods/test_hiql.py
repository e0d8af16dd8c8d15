"""HIQL's parts against hand-worked cases."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import labelled, make_ragged, shares

from guider.errors import GuiderError
from guider.learning.networks import layer_norm_mlp
from guider.learning.problem import Problem
from guider.learning.samplers import ValueBatch, WaypointBatch, sample_value, sample_waypoints
from guider.learning.windows import device_data
from guider.methods import goal_value
from guider.methods import hiql as method
from guider.methods.hiql import HiqlConfig, hiql_config
from guider.methods.view import Scale
from guider.support.config import Changes, from_dict, override, to_dict

SMALL: Changes = {"subgoal_steps": 5} | {
    f"{part}.{name}": value
    for part in ("value", "high", "low")
    for name, value in {"updates": 10, "hidden": (16, 16), "batch_size": 32}.items()
}


def small(changes: Changes) -> HiqlConfig:
    return override(hiql_config("paper", Problem(0.5, 1.0, period_steps=5)), SMALL | changes)


def fresh(config: HiqlConfig) -> method.HiqlState:
    return jax.jit(lambda key: method.init(config, make_ragged().spaces, unit(), key))(jax.random.key(0))


def unit() -> Scale:
    return Scale(jnp.zeros(4), jnp.ones(4), jnp.zeros(2), jnp.ones(2), jnp.ones(2), jnp.zeros(0))


def test_paper_settings_and_faults():
    paper = hiql_config("paper", Problem())
    assert paper == HiqlConfig() and from_dict(HiqlConfig, to_dict(paper)) == paper
    assert (paper.value.expectile, paper.value.discount, paper.value.target_rate) == (0.7, 0.99, 0.005)
    assert (paper.subgoal_steps, paper.value.representation_dim, paper.value.hidden) == (25, 10, (512, 512, 512))
    for name, value, message in (
        ("value.discount", 1.0, "discount must be below 1"),
        ("value.current_goal_fraction", 0.8, "add up to more than 1"),
        ("subgoal_steps", 0, "subgoal_steps must be above 0"),
        ("low.temperature", 0.0, "temperature must be above 0"),
    ):
        with pytest.raises(GuiderError, match=message):
            override(paper, {name: value})


def test_layer_norm_by_hand():
    """A hidden layer of two units, the first the larger, is +1 and -1 after standardising, whatever its size."""
    layers = ((jnp.array([[3.0, 1.0]]), jnp.zeros(2)), (jnp.array([[5.0], [2.0]]), jnp.array([0.5])))
    answers = jax.jit(layer_norm_mlp)(layers, jnp.array([[1.0], [40.0]]))
    np.testing.assert_allclose(answers, [[5 - 2 + 0.5]] * 2, atol=1e-4)


def test_relative_goals_are_displacements_in_spreads_of_moves():
    scale = unit()._replace(goal_std=jnp.full(2, 10.0), step_std=jnp.full(2, 4.0))
    given = jnp.zeros((1, 4)), jnp.array([[1.0, 2.0]]), jnp.array([[5.0, 0.0]])
    assert goal_value.goal_inputs(small({"relative": True}), scale, *given).tolist() == [[0, 0, 0, 0, 1, -0.5]]
    assert goal_value.goal_inputs(small({}), scale, *given).tolist() == [[0, 0, 0, 0, 0.5, 0]]
    places = small({"subgoal": "place"})
    assert method.name_subgoal(places, fresh(places).value.params, scale, *given).tolist() == [[1, -0.5]]


def test_representation_has_length_root_of_its_dimension():
    config = small({})
    state = fresh(config)
    places = jax.random.normal(jax.random.key(1), (7, 2))
    z = goal_value.represent(config, state.value.params, unit(), jnp.ones((7, 4)), jnp.ones((7, 2)), places)
    np.testing.assert_allclose(jnp.sum(z**2, axis=-1), 10.0, rtol=1e-5)
    assert float(jnp.std(z[:, 0])) > 0, "it tells places apart"


def constant(params: method.ValueParams, first: float, second: float) -> method.ValueParams:
    """Twins that answer two numbers wherever they are asked."""
    *hidden, (weight, bias) = jax.tree.map(jnp.zeros_like, params.twins)
    return params._replace(twins=(*hidden, (weight, bias.at[:, 0].set(jnp.array([first, second])))))


def test_value_targets_masks_and_expectile_by_hand():
    """V is (-4, -6) now; the target network says (-2, -3) of all states. Row 0 stands on its goal, row 1 does not.

    Row 0: target 0 for both, for nothing comes after a met goal; A = 0 - (-2.5) > 0, so the weight is 0.7.
    Row 1: targets -1 + 0.9 * (-2, -3) = (-2.8, -3.7); A = -1 + 0.9 * -3 - (-2.5) = -1.2 < 0, so the weight is 0.3,
    though both twins are below their targets.
    """
    config = small({"value.discount": 0.9})
    params = fresh(config).value.params
    batch = ValueBatch(
        observation=jnp.zeros((2, 4)),
        end_observation=jnp.zeros((2, 4)),
        achieved=jnp.zeros((2, 1, 2)),
        end=jnp.ones((2, 2)),
        valid=jnp.ones((2, 1), bool),
        goal=jnp.array([[0.3, 0.3], [0.4, 0.4]]),
    )
    now, target = constant(params, -4.0, -6.0), constant(params, -2.0, -3.0)
    loss_of = jax.jit(lambda now, target: goal_value.value_loss(config, now, target, unit(), batch))
    loss, metrics = loss_of(now, target)
    by_hand = (0.7 * 4**2 + 0.3 * 1.2**2) / 2 + (0.7 * 6**2 + 0.3 * 2.3**2) / 2
    assert float(loss) == pytest.approx(by_hand, rel=1e-5)
    assert float(metrics["advantage"]) == pytest.approx((2.5 - 1.2) / 2, rel=1e-5)


def test_returns_of_several_steps_by_hand():
    """Four stretches of three steps at a discount of 0.5: none meets its goal; one does at its second state; one at its
    first; and one ends with its episode after a step."""
    config = small({"value.discount": 0.5})
    places = jnp.array([[0.0, 1.0, 2.0], [0.0, 5.0, 2.0], [5.0, 1.0, 2.0], [0.0, 1.0, 1.0]])
    valid = jnp.array([[True, True, True]] * 3 + [[True, False, False]])
    zeros, achieved = jnp.zeros((4, 4)), jnp.stack([places, 0 * places], axis=-1)
    goal = jnp.broadcast_to(jnp.array([5.0, 0.0]), (4, 2))
    batch = ValueBatch(zeros, zeros, achieved, zeros[:, :2], valid, goal)
    earned, carried = goal_value.logged_return(config, batch)
    assert earned.tolist() == [-1.75, -1.0, 0.0, -1.0]
    assert carried.tolist() == [0.125, 0.0, 0.0, 0.5]


def waypoint_batch() -> WaypointBatch:
    zeros = jnp.zeros((2, 4))
    return WaypointBatch(
        observation=zeros,
        action=jnp.full((2, 2), 0.5),
        next_observation=zeros + 1,
        ahead_observation=zeros + 2,
        achieved=jnp.zeros((2, 2)),
        next_achieved=jnp.ones((2, 2)),
        ahead=jnp.full((2, 2), 2.0),
        goal=jnp.full((2, 2), 9.0),
    )


@pytest.mark.parametrize(
    ("level", "seen"),
    [("high", [("observation", "goal"), ("ahead", "goal")]), ("low", [("observation", "ahead"), ("next", "ahead")])],
)
@pytest.mark.parametrize("counted", ["squared", "absolute"])
def test_each_level_weighs_its_own_advantage(monkeypatch, level, seen, counted):
    """V(s, g) = -2 at s, -1 one step on, 0 at the state ahead: A = 2 above (k steps), 1 below (one step)."""
    config = small({"high.temperature": 2.0, "low.temperature": 0.5, "low.weight_ceiling": 5.0})
    config = override(config, {"high.regression.error": counted, "low.regression.error": counted})
    state = fresh(config)
    asked = []

    def values(config, params, scale, observation, achieved, goal):
        names = {0.0: "observation", 1.0: "next", 2.0: "ahead", 9.0: "goal"}
        asked.append((names[float(observation[0, 0])], names[float(goal[0, 0])]))
        return jnp.broadcast_to(observation[:, 0] - 2.0, (2, 2))

    monkeypatch.setattr(method, "values", values)
    batch, params = waypoint_batch(), getattr(state, level).params
    loss_of = {"high": method.high_loss, "low": method.low_loss}[level]
    loss, metrics = loss_of(config, params, state.value.params, unit(), batch, jax.random.key(0))
    assert asked == seen
    z = goal_value.represent(config, state.value.params, unit(), batch.observation, batch.achieved, batch.ahead)
    if level == "high":
        weight = np.exp(2.0 / 2.0)
        error = method.propose(config, params, unit(), batch.observation, batch.achieved, batch.goal) - z
    else:
        weight = 5.0  # exp(1 / 0.5) = 7.4 is above the ceiling
        error = method.control(config, params, unit(), batch.observation, batch.achieved, z) - 0.5
    assert float(metrics["weight"]) == pytest.approx(weight, rel=1e-5)
    mean = jnp.mean(error**2 if counted == "squared" else jnp.abs(error))
    assert float(loss) == pytest.approx(weight * float(mean), rel=1e-5)


def test_dropout_is_of_the_level_it_is_set_for():
    config = small({"low.regression.dropout": 0.5})
    state, batch = fresh(config), waypoint_batch()
    for loss_of, params, alike in (
        (method.high_loss, state.high.params, True),
        (method.low_loss, state.low.params, False),
    ):
        first, second = (
            loss_of(config, params, state.value.params, unit(), batch, jax.random.key(k))[0] for k in (1, 2)
        )
        assert (float(first) == float(second)) is alike


def test_waypoints_lie_k_steps_ahead_or_at_a_nearer_goal():
    lengths = np.array([4, 30, 60])
    data = device_data(labelled(lengths), 5, "clip", 0.0)
    for random_goal_fraction in (0.0, 1.0):
        batch = sample_waypoints(data, jax.random.key(0), 5_000, 7, random_goal_fraction)
        episode, now = np.asarray(batch.achieved, int).T
        end = np.asarray(batch.goal[:, 1], int) if random_goal_fraction == 0 else lengths[episode] - 1
        assert np.array_equal(batch.ahead, np.stack([episode, np.minimum(now + 7, end)], axis=1))
        assert np.array_equal(batch.ahead_observation, batch.ahead)
        assert np.array_equal(batch.next_achieved, np.stack([episode, now + 1], axis=1))
        assert np.all(now < end)
        own = np.asarray(batch.goal[:, 0]) == episode
        assert own.all() if random_goal_fraction == 0 else 0.4 < own.mean() < 0.6  # (4^2 + 30^2 + 60^2) / 94^2 = 0.51


def test_value_goals_come_in_their_shares_and_geometric():
    data = device_data(labelled([400] * 400), 5, "clip", 0.0)  # goals from anywhere hardly ever lie in the same episode
    batch = sample_value(data, jax.random.key(2), 100_000, 1, 4.0, 0.2, 0.3)
    start, goal = np.asarray(batch.observation), np.asarray(batch.goal)
    steps = np.where(goal[:, 0] == start[:, 0], goal[:, 1] - start[:, 1], -1)
    assert (steps == 0).mean() == pytest.approx(0.2, abs=0.006)
    assert (steps < 0).mean() == pytest.approx(0.3, abs=0.006)
    np.testing.assert_allclose(shares(steps[steps > 0], 4)[1:4], [1 / 4, 3 / 16, 9 / 64], atol=0.008)
    current = sample_value(data, jax.random.key(3), 100, 1, 4.0, 1.0, 0.0)
    assert np.array_equal(current.goal, current.observation)


def test_value_stretches_stay_in_their_episode():
    lengths = np.array([3, 9, 40])
    data = device_data(labelled(lengths), 5, "clip", 0.0)
    batch = sample_value(data, jax.random.key(4), 2_000, 6, 4.0, 0.2, 0.3)
    episode, now = np.asarray(batch.observation, int).T
    last = lengths[episode][:, None] - 1
    steps = now[:, None] + np.arange(7)
    rows = np.stack([np.repeat(episode[:, None], 7, axis=1), np.minimum(steps, last)], axis=-1)
    assert np.array_equal(batch.achieved, rows[:, :6]) and np.array_equal(batch.valid, (steps < last)[:, :6])
    assert np.array_equal(batch.end, rows[:, 6]) and np.array_equal(batch.end_observation, rows[:, 6])


def test_a_place_that_is_named_is_found_again_and_shown_as_the_subgoal():
    """Of hiql-places: spreads of moves are 2 and 4."""
    places = method.METHODS["hiql-places"]
    config = override(hiql_config("paper", Problem(0.5, 1.0, period_steps=5)), SMALL | method.PLACES)
    scale = unit()._replace(step_std=jnp.array([2.0, 4.0]))
    state = fresh(config)._replace(scale=scale)
    seen, goal = jnp.array([[1.0, 2.0, 0.0, 0.0]]), jnp.array([[9.0, -9.0]])
    here, there = seen[:, :2], jnp.array([[3.0, -2.0]])
    named = method.name_subgoal(config, state.value.params, scale, seen, here, there)
    np.testing.assert_allclose(named, [[1, -1]])
    np.testing.assert_allclose(method.place_of(scale, here, named), there)

    subgoals = places.subgoals
    assert subgoals is not None
    proposed, worth = subgoals.propose(config, state, seen, here, goal)
    acting = method.initial_acting_state(config, 2, 1)
    action, acting = method.act(config, state, (0, 1), seen, goal, acting, jnp.array([True]))
    pursued, new = subgoals.pursued(config, acting)
    np.testing.assert_array_equal(pursued, proposed)
    assert worth.shape == (1,) and new.tolist() == [True]
    np.testing.assert_array_equal(subgoals.reach(config, state, seen, here, proposed, goal), action)
