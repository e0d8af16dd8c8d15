"""Who chooses subgoals, under Guider."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from conftest import make_ragged
from test_guider import plain_scale

from guider.data.episodes import make_episodes
from guider.learning.problem import Problem
from guider.methods import guider as method
from guider.methods import latent_subgoals
from guider.methods.guider import guider_config
from guider.methods.routes import Routes
from guider.methods.view import prepare
from guider.support.config import override


def test_routes_choose_in_the_policys_stead():
    """There and back along ten metres, eight times: a subgoal is a logged place within 0.7 of c = 5 steps, and value
    is minus the steps that are left. No pi_h is trained."""
    ahead = np.stack([np.arange(11.0), np.zeros(11)], axis=1)
    rows = np.concatenate([ahead, ahead[::-1]] * 8).astype(np.float32)
    logs = make_episodes(rows, np.zeros((len(rows), 1), np.float32), [11] * 16, (0, 1))
    small = {"routes.places": 30, "latent.hidden": (8,), "low.hidden": (8,)}
    config = override(guider_config("fast", Problem(0.5, 1.0, 5), planner="routes"), small)
    stages = method.stages(config)
    assert [stage.name for stage in stages] == ["latent subgoals", "routes", "goal policy"]
    data, scale = prepare(config.view, config.problem, logs)
    state = method.init(config, logs.spaces, scale, jax.random.key(0))
    routes, metrics = stages[1].update(state, data, jax.random.key(0))
    assert metrics["places"] == 11 and metrics["reachable"] == 1
    state = state._replace(high=routes)
    here, goal = jnp.array([[2.0, 0.0], [8.0, 0.0]]), jnp.array([[9.0, 0.0], [1.0, 0.0]])
    subgoal, latent = method.propose_subgoal(config, state, here, goal)
    np.testing.assert_array_equal(subgoal, [[5, 0], [5, 0]])
    assert latent.shape == (2, 2)
    proposed, worth = method.SUBGOALS.propose(config, state, here, here, goal)
    np.testing.assert_array_equal(proposed, subgoal)
    np.testing.assert_array_equal(worth, [-7, -7])
    assert method.acts_by(config).startswith("logged place nearest to the goal")


def test_routes_serve_a_low_level_that_sees_latents():
    """Without decoder, the next place is encoded where it is chosen."""
    config = override(
        guider_config("paper", Problem(0.5, 1.0, 5)), {"planner": "routes", "low.subgoal_input": "latent"}
    )
    state = method.init(config, make_ragged().spaces, plain_scale(), jax.random.key(0))
    edges = jnp.array([[0.0, 2.0], [2.0, 0.0]])
    state = state._replace(high=Routes(jnp.array([[0.0, 0.0], [3.0, 0.0]]), edges, edges))
    here, goal = jnp.array([[0.0, 0.0]]), jnp.array([[3.2, 0.0]])
    subgoal, latent = method.propose_subgoal(config, state, here, goal)
    np.testing.assert_array_equal(subgoal, goal)  # two steps on
    expected = latent_subgoals.encode(config.latent, state.latent.params, state.scale, here, goal).mean
    np.testing.assert_array_equal(latent, expected)
