"""The picture of the graph over logged places."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from test_plots import MAZE, TASK, TITLE, TRACES, drawn, logs, make_policy, make_run, small_config

from guider import plots
from guider.evaluation.rollouts import Rollouts
from guider.methods import routes
from guider.plots import canvas


def corridor_routes() -> routes.Routes:
    """Places at x = 0, 1, 2 m, two steps apart there and back, and one at y = 2 m that no way leads to."""
    places = jnp.array([[0.0, 0.0], [1, 0], [2, 0], [0, 2], [jnp.inf, jnp.inf]])
    apart = jnp.abs(jnp.arange(3)[:, None] - jnp.arange(3)) * 2.0
    edges = jnp.full((5, 5), jnp.inf).at[:3, :3].set(jnp.where(apart <= 2, apart, jnp.inf)).at[3, 3].set(0.0)
    return routes.Routes(places, edges, routes.shortest_steps(edges))


@pytest.mark.parametrize(
    ("goal", "stars", "told"),
    [([2.1, 0.1], [[1, 0], [2.1, 0.1]], "4 steps"), ([0.0, 2.2], [[0, 0]], "to the nearest place")],
)
def test_routes_show_places_edges_and_the_way(goal, stars, told):
    config = replace(small_config(), planner="routes")  # subgoals lie within 3.5 steps
    ends = np.array([[0.1, 0.0], goal])
    figure = drawn(plots.routes_in_maze(TASK, MAZE, logs(2), config, corridor_routes(), ends, TITLE))
    axes = figure.axes[0]
    lines = next(c for c in axes.collections if isinstance(c, LineCollection))
    assert len(lines.get_segments()) == 4
    way = next(line for line in axes.lines if line.get_color() == canvas.DARK and np.size(line.get_xdata()) > 1)
    np.testing.assert_allclose(np.asarray(way.get_xydata()), [[0.1, 0], *stars], atol=1e-6)
    assert told in figure.get_suptitle()


def test_a_run_with_routes_has_their_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(
        plots, "rollout", lambda *rest: Rollouts(np.zeros(2), np.zeros(2, bool), np.zeros(2, int), TRACES)
    )
    policy = make_policy(2)
    config = replace(policy.config, planner="routes")
    policy = replace(policy, config=config, state=policy.state._replace(high=corridor_routes()))
    paths = plots.draw_run(make_run(tmp_path, logs(2), TASK.name, policy), TASK, logs(2), 4, 1000, episodes_shown=2)
    assert tmp_path / "plots" / "routes-seed4.png" in paths
