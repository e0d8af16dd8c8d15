"""The graph over logged places, on data whose ways can be counted by hand."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guider
from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError, GuiderWarning
from guider.learning.problem import Problem
from guider.learning.windows import device_data
from guider.methods.routes import (
    Routes,
    RoutesConfig,
    build,
    logged_edges,
    next_place,
    passing_rows,
    shortest_steps,
    spread_places,
)

INF = np.inf
SMALL = Problem(radius=0.5, reach_radius=1.0)


def walks(*paths: list[tuple[float, float]]) -> Episodes:
    """Episodes through these places."""
    rows = np.array([place for path in paths for place in path], np.float32)
    return make_episodes(rows, np.zeros((len(rows), 1), np.float32), [len(path) for path in paths], (0, 1))


def line(start: tuple[float, float], end: tuple[float, float], steps: int) -> list[tuple[float, float]]:
    """steps + 1 places from one to the other."""
    return [tuple(place) for place in np.linspace(start, end, steps + 1)]


def graph(episodes: Episodes, period_steps: int = 4, **config) -> Routes:
    problem = Problem(radius=0.5, reach_radius=1.0, period_steps=period_steps)
    data = device_data(episodes, period_steps, "clip", 0.0)
    return build(RoutesConfig(**{"places": 40, "spacing": 1.0, "crossings": 1} | config), data, problem)[0]


def index(routes: Routes, place: tuple[float, float]) -> int:
    return int(np.linalg.norm(np.asarray(routes.places) - place, axis=1).argmin())


def test_places_are_spread_until_all_is_near_one():
    """From 0 the furthest is 9, then 5, 4 from 9; 3 and 7 are 2 from it, and that is near enough."""
    achieved = jnp.array([[0.0], [1], [3], [5], [7], [9]])
    places, near, distance = spread_places(achieved, 6, 2.0, ())
    np.testing.assert_array_equal(places[:, 0], [0, 9, 5, INF, INF, INF])
    np.testing.assert_array_equal(near, [0, 0, 2, 2, 1, 1])
    np.testing.assert_array_equal(distance, [0, 1, 2, 0, 2, 0])
    fewer, _, distance = spread_places(achieved, 2, 2.0, ())
    np.testing.assert_array_equal(fewer[:, 0], [0, 9])
    assert distance.max() == 4


def test_parts_are_as_far_apart_as_the_furthest_of_them():
    """(0, 3) and (3, 0) are 3 apart by parts, 4.2 as one."""
    achieved = jnp.array([[0.0, 3], [3, 0]])
    assert np.isfinite(spread_places(achieved, 2, 3.5, ((0,), (1,)))[0]).all(axis=1).sum() == 1
    assert np.isfinite(spread_places(achieved, 2, 3.5, ())[0]).all(axis=1).sum() == 2


def test_a_place_is_passed_where_it_is_nearest_once_a_visit():
    """Three rows near place 0, the second nearest; then one near 1; then back at 0, twice as near; then, in another
    episode, near 0 still."""
    near = jnp.array([0, 0, 0, 1, 0, 0, 0, 0])
    distance = jnp.array([2.0, 1, 3, 1, 1, 1, 5, 4])
    last_row = jnp.array([5] * 6 + [7] * 2)
    np.testing.assert_array_equal(passing_rows(near, distance, last_row), [0, 1, 0, 1, 1, 0, 0, 1])


def test_edges_are_mean_steps_between_passes():
    """0 -> 1 in 1 and, in another episode, in 3 steps; 0 -> 2 in 4 steps is beyond c; place 3 is never passed, and no
    edge leads across episodes."""
    near = jnp.array([0, 1, 0, 3, 0, 1, 2])
    passes = jnp.array([1, 1, 1, 0, 0, 1, 1], bool)
    last_row = jnp.array([1, 1, 6, 6, 6, 6, 6])
    edges = logged_edges(near, passes, last_row, 4, 3, crossings=1)
    np.testing.assert_array_equal(edges, [[0, 2, INF, INF], [INF, 0, 1, INF], [INF, INF, 0, INF], [INF] * 3 + [0]])
    twice = logged_edges(near, passes, last_row, 4, 3, crossings=2)
    np.testing.assert_array_equal(twice, [[0, 2, INF, INF], [INF, 0, INF, INF], [INF, INF, 0, INF], [INF] * 3 + [0]])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_shortest_steps_are_those_of_the_best_of_all_ways(seed):
    rng = np.random.default_rng(seed)
    edges = np.where(rng.random((5, 5)) < 0.5, rng.integers(1, 9, (5, 5)), INF)
    np.fill_diagonal(edges, 0)

    def best(start: int, end: int) -> float:
        between = [place for place in range(5) if place not in (start, end)]
        ways = (way for count in range(4) for way in itertools.permutations(between, count))
        return min(
            sum(edges[here, there] for here, there in itertools.pairwise((start, *way, end))) if start != end else 0
            for way in ways
        )

    expected = [[best(start, end) for end in range(5)] for start in range(5)]
    np.testing.assert_array_equal(shortest_steps(jnp.asarray(edges)), expected)


def test_the_way_leads_round_a_wall_that_no_episode_crossed():
    """Up, across and down again, in two episodes that share the top: the way from one foot to the other is 12 steps
    long though they lie 4 apart. Each next place is at most two steps on, and they add up."""
    up_and_across = [*line((0, 0), (0, 4), 4), *line((1, 4), (4, 4), 3)]
    across_and_down = [*line((0, 4), (4, 4), 4), *line((4, 3), (4, 0), 3)]
    routes = graph(walks(up_and_across, across_and_down), spacing=0.5)
    foot, other = index(routes, (0, 0)), index(routes, (4, 1))
    assert float(routes.steps[foot, other]) == 11
    at, goal, visited = jnp.array([[0.0, 0.0]]), jnp.array([[4.0, 1.0]]), []
    for _ in range(6):
        at, left = next_place(routes, at, goal, 2.0, SMALL)
        visited.append(([float(x) for x in at[0]], float(left[0])))
    assert visited == [
        ([0, 2], 11), ([0, 4], 9), ([2, 4], 7), ([4, 4], 5), ([4, 2], 3), ([4, 1], 1),
    ]  # fmt: skip


def test_a_goal_within_reach_is_the_subgoal_itself():
    routes = graph(walks(line((0, 0), (9, 0), 9)), spacing=0.5)
    subgoal, left = next_place(routes, jnp.array([[3.1, 0.0]]), jnp.array([[5.3, 0.2]]), 2.0, SMALL)
    np.testing.assert_allclose(subgoal, [[5.3, 0.2]])
    assert left == 2


def test_to_a_goal_that_no_way_leads_to_it_is_to_the_nearest_place_that_one_does():
    """Two halls side by side; the goal lies in the other one."""
    routes = graph(walks(line((0, 0), (6, 0), 6), line((0, 5), (6, 5), 6)), spacing=0.5)
    assert np.isinf(float(routes.steps[index(routes, (0, 0)), index(routes, (4, 5))]))
    subgoal, left = next_place(routes, jnp.array([[0.0, 0.0]]), jnp.array([[4.0, 5.0]]), 4.0, SMALL)
    np.testing.assert_allclose(subgoal, [[4, 0]])
    assert left == 4


def test_a_place_whose_only_edge_leads_back_is_not_gone_back_from():
    """The way is 0, 1, 2, 3; off it lies 1.9, from where all that was seen went back to 1. Who is nearest to 1.9 has
    reached 2 already."""
    places = jnp.array([[0.0, 0], [1.5, 0], [3, 0], [4.5, 0], [2.6, 0.2]])
    edges = jnp.full((5, 5), jnp.inf).at[jnp.arange(5), jnp.arange(5)].set(0.0)
    edges = edges.at[jnp.array([0, 1, 2, 4]), jnp.array([1, 2, 3, 1])].set(jnp.array([3.0, 3, 3, 2]))
    routes = Routes(places, edges, shortest_steps(edges))
    at, goal = jnp.array([[2.6, 0.2], [1.6, 0.0], [0.0, 0.0]]), jnp.array([[4.5, 0.0]] * 3)
    subgoal, left = next_place(routes, at, goal, 3.0, SMALL)
    np.testing.assert_allclose(subgoal, [[4.5, 0], [3, 0], [1.5, 0]])
    assert left.tolist() == [3, 6, 9]


def test_edges_longer_than_asked_for_are_taken_where_none_leads_on():
    places = jnp.array([[0.0, 0], [4, 0], [8, 0]])
    edges = jnp.array([[0.0, 8, INF], [INF, 0, 8], [INF, INF, 0]])
    routes = Routes(places, edges, shortest_steps(edges))
    subgoal, left = next_place(routes, jnp.array([[0.1, 0.0]]), jnp.array([[8.0, 0.0]]), 7.0, SMALL)
    np.testing.assert_allclose(subgoal, [[4, 0]])
    assert left == 16


def test_from_the_last_place_it_is_to_a_goal_no_more_than_two_reach_radii_off():
    """The other hall's places are nearer to the goal, which lies between the two."""
    routes = graph(walks(line((0, 0), (6, 0), 6), line((0, 5), (6, 5), 6)), spacing=0.5)
    near, far = Problem(reach_radius=1.6), Problem(reach_radius=1.4)
    for problem, subgoal in (near, [4, 3]), (far, [4, 0]):
        found, _ = next_place(routes, jnp.array([[3.0, 0.0]]), jnp.array([[4.0, 3.0]]), 4.0, problem)
        np.testing.assert_allclose(found, [subgoal])


def test_a_place_that_nothing_leads_on_from_is_none():
    """The episode's end: who stands there is taken to stand at the place before it."""
    routes = graph(walks(line((0, 0), (6, 0), 6)), spacing=0.5)
    assert not (np.asarray(routes.places) == [6, 0]).all(axis=1).any()
    assert (np.asarray(routes.places) == [5, 0]).all(axis=1).any()


def test_more_logged_windows_than_one_make_an_edge_of_many_wanted():
    there = line((0, 0), (6, 0), 6)
    once, often = (graph(walks(*[there] * count), crossings=3, spacing=0.5) for count in (1, 3))
    assert not np.isfinite(np.asarray(once.places)).any()
    subgoal, _ = next_place(once, jnp.array([[0.0, 0.0]]), jnp.array([[6.0, 0.0]]), 4.0, SMALL)
    np.testing.assert_array_equal(subgoal, [[6, 0]])
    assert np.isfinite(np.asarray(often.steps)).sum() == 21


@pytest.mark.parametrize(
    "wrong", [{"places": 0}, {"spacing": 0.0}, {"crossings": 0}, {"horizon": 1.5}, {"horizon": 0.0}]
)
def test_settings_that_make_no_graph_are_refused(wrong):
    with pytest.raises(GuiderError, match=next(iter(wrong))):
        RoutesConfig(**wrong)


def test_an_agent_says_where_it_goes_instead_of_a_goal_that_no_way_leads_to(tmp_path):
    """Two halls side by side, learned from with next to no updates."""
    logs = walks(*[line((0, 0), (6, 0), 6)] * 6, *[line((0, 5), (6, 5), 6)] * 6)
    small = {f"{level}.updates": 2 for level in ("latent", "low")} | {"low.hidden": (8,), "latent.hidden": (8,)}
    small |= {"routes.places": 40, "routes.spacing": 0.5}
    own: Any = {"radius": 0.5, "period_steps": 4, "held_out": 0.0}
    run = guider.train(data=logs, method="guider-routes", settings=small, out=tmp_path / "run", **own)
    agent = guider.load(run)
    here, there = np.zeros(2), np.array([4.0, 5.0])
    said = r"no logged way leads from \(0, 0\) to the goal \(4, 5\); heading for \(4, 0\), the place nearest"
    with pytest.warns(GuiderWarning, match=said):
        agent.act(here, there)
    np.testing.assert_allclose(agent.subgoal, [2, 0], atol=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        agent.act(here, there)  # said once
        agent.act(here, np.array([5.0, 0.0]))
    with pytest.warns(GuiderWarning, match="no logged way"):
        agent.act(here, there)
