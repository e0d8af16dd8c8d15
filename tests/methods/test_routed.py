"""Rivals that are led through the graph."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import equal, tiny
from test_routes import line, walks

from guider.learning.problem import Problem
from guider.learning.training import init_seeds, train
from guider.methods import METHODS, preset_config
from guider.methods.view import prepare

PROBLEM = Problem(radius=0.5, reach_radius=1.0, period_steps=4)


def trained(method: str) -> tuple[Any, Any]:
    """Its settings, and one seed's state after a few updates on walks round a corner."""
    logs = walks(*[[*line((0, 0), (0, 6), 6), *line((1, 6), (6, 6), 5)]] * 6)
    config = tiny(preset_config(method, "fast", PROBLEM), updates=2, hidden=(8,), batch_size=8)
    data, scale = prepare(config.view, config.problem, logs)
    found = METHODS[method]
    state = init_seeds(lambda key: found.init(config, logs.spaces, scale, key), (0,))
    state = jax.device_get(train(found.stages(config), state, data, (0,)))
    return config, jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), state)


@pytest.mark.parametrize("name", ["gcsl", "hiql"])
def test_a_rival_learns_as_it_does_alone_and_goes_from_place_to_place(name):
    config, state = trained(f"{name}-routes")
    _, alone = trained(name)
    assert all(equal(getattr(state, field), getattr(alone, field)) for field in alone._fields)
    observation = jnp.array([[0.0, 1.0], [0.0, 1.0], [5.0, 6.0]])
    goal = jnp.array([[5.0, 6.0], [5.0, 6.0], [5.5, 6.2]])
    method, start = METHODS[f"{name}-routes"], jnp.ones(3, bool)
    actions, _ = method.act(config, state, (0, 1), observation, goal, method.initial_acting_state(config, 2, 3), start)
    # 0.7 of 4 steps are two places; who is within a metre of the goal goes there
    places = jnp.array([[0, 3], [0, 3], [5.5, 6.2]])
    own = METHODS[name]
    expected, _ = own.act(config, alone, (0, 1), observation, places, own.initial_acting_state(config, 2, 3), start)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    straight, _ = own.act(config, alone, (0, 1), observation, goal, own.initial_acting_state(config, 2, 3), start)
    assert np.abs(np.asarray(straight - expected))[0].max() > 1e-4
    assert method.acts_by(config).endswith("led to it from one logged place to the next")
