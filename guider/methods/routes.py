"""A graph over logged places: what a subgoal is worth, far beyond the steps that an episode shows.

Eq. 4 asks of pi_h what is reachable, which the prior rho answers, and what is worth reaching, which a critic must
learn across the whole maze. The second is answered here by what the data did: places are spread over s^G, an edge leads
from one to another where episodes went from near the one to near the other within c steps, and the worth of a place is
how many steps it then is to the goal. Nothing is learned; it takes seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from guider.goals import Parts, largest_distance
from guider.learning.problem import Problem
from guider.learning.training import Metrics
from guider.learning.windows import Data
from guider.support.config import check_fraction, check_positive

LAST_LEG = 2.0


@dataclass(frozen=True)
class RoutesConfig:
    """Settings of the graph."""

    places: int = 1000
    """At most so many."""
    spacing: float = 0.5
    """Places are added until no logged one is further than this from the nearest, in reach radii."""
    crossings: int = 5
    """An edge leads where so many logged windows did; few logs want less."""
    horizon: float = 0.7
    """A subgoal lies along an edge of this share of c steps at most: a low level that learned from windows of up to c
    steps reaches what is nearer than that more surely, and without cutting corners."""

    def __post_init__(self) -> None:
        check_positive(self, "places", "spacing", "crossings", "horizon")
        check_fraction(self, "horizon")


def within_steps(config: RoutesConfig, problem: Problem) -> float:
    """Environment steps that a subgoal's edge may take."""
    return config.horizon * problem.period_steps


class Routes(NamedTuple):
    """K = config.places of them; those that were not needed are infinitely far from everything.

    places: [K, G] in goal units; edges: [K, K] environment steps from one to another, as the data took them in the mean
    of what it did within c, infinite where it did not; steps: [K, K] the least sum of edges.
    """

    places: jax.Array
    edges: jax.Array
    steps: jax.Array


def init(config: RoutesConfig, goal_dim: int) -> Routes:
    """No places."""
    nowhere = jnp.full((config.places, config.places), jnp.inf)
    return Routes(jnp.full((config.places, goal_dim), jnp.inf), nowhere, nowhere.copy())


def build(config: RoutesConfig, data: Data, problem: Problem) -> tuple[Routes, Metrics]:
    """The graph of all logged rows."""
    count, spacing = config.places, config.spacing * problem.reach_radius
    places, near, distance = spread_places(data.achieved, count, spacing, problem.goal_parts)
    passes = passing_rows(near, distance, data.last_row)
    edges = logged_edges(near, passes, data.last_row, count, problem.period_steps, config.crossings)
    leads_on = jnp.isfinite(edges).sum(axis=1) > 1
    places = jnp.where(leads_on[:, None], places, jnp.inf)  # nothing is known of how to leave the others
    edges = jnp.where(leads_on & leads_on[:, None], edges, jnp.inf)
    steps = shortest_steps(edges)
    known = jnp.isfinite(places[:, 0]).sum().astype(jnp.float32)
    metrics = {
        "places": known,
        "furthest_from_a_place": distance.max(),
        "edges": jnp.isfinite(edges).sum() - known,
        "reachable": jnp.isfinite(steps).sum() / jnp.maximum(known, 1) ** 2,
    }
    return Routes(places, edges, steps), metrics


def spread_places(
    achieved: jax.Array, count: int, spacing: float, parts: Parts
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Farthest-point sampling: the first row, then always the row furthest from all places so far, until none is
    further than `spacing`.

    achieved: [N, G]. Returns places [count, G], infinite where not needed, and of each row the index of the nearest
    place [N] and the distance to it [N].
    """

    def more(carry):
        index, _, _, distance = carry
        return (index < count) & (distance.max() > spacing)

    def add(carry):
        index, places, near, distance = carry
        place = achieved[distance.argmax()]
        away = largest_distance(achieved, place, parts)
        near = jnp.where(away < distance, index, near)
        return index + 1, places.at[index].set(place), near, jnp.minimum(distance, away)

    none = jnp.full((count, achieved.shape[1]), jnp.inf)
    everywhere = jnp.zeros(len(achieved), jnp.int32), jnp.full(len(achieved), jnp.inf)
    _, places, near, distance = jax.lax.while_loop(more, add, (0, none, *everywhere))
    return places, near, distance


def passing_rows(near: jax.Array, distance: jax.Array, last_row: jax.Array) -> jax.Array:
    """[N] bool: of all consecutive rows of an episode that are near one place, the row that is nearest to it.

    Steps are counted between such rows: those along a way through many places then add up to the steps that it took,
    where steps from one place's border to the next one's would not.
    """
    begins = jnp.ones(len(near), bool).at[1:].set((near[1:] != near[:-1]) | (last_row[1:] != last_row[:-1]))
    visit = jnp.cumsum(begins) - 1
    nearest = jax.ops.segment_min(distance, visit, num_segments=len(near), indices_are_sorted=True)[visit]
    rows = jnp.where(distance == nearest, jnp.arange(len(near)), len(near))
    return rows == jax.ops.segment_min(rows, visit, num_segments=len(near), indices_are_sorted=True)[visit]


def logged_edges(
    near: jax.Array, passes: jax.Array, last_row: jax.Array, count: int, period_steps: int, crossings: int
) -> jax.Array:
    """Mean of k <= c over all that passed one place and k steps later another, [count, count]; 0 from a place to
    itself, infinite where fewer than `crossings` did.

    The mean, since means along a way add up, where the least of many would be the less to be had the longer the way is.
    near: [N] index of the place that a row is near; passes: [N], see `passing_rows`; last_row: [N], of its episode.
    """
    rows = jnp.arange(len(near))
    nowhere = count * count

    def step(k, carry):
        seen, total = carry
        later = jnp.minimum(rows + k, last_row)
        pair = jnp.where(passes & passes[later] & (rows + k <= last_row), near * count + near[later], nowhere)
        return seen.at[pair].add(1, mode="drop"), total.at[pair].add(k, mode="drop")

    none = jnp.zeros(nowhere, jnp.int32)
    seen, total = jax.lax.fori_loop(1, period_steps + 1, step, (none, none))
    edges = jnp.where(seen >= crossings, total / jnp.maximum(seen, 1), jnp.inf).reshape(count, count)
    visited = jnp.zeros(count, bool).at[near].set(True)
    return jnp.where(jnp.diag(visited), 0.0, edges)


def shortest_steps(edges: jax.Array) -> jax.Array:
    """Floyd and Warshall's: [K, K] the sum of edges along the shortest way."""

    def through(place, steps):
        return jnp.minimum(steps, steps[:, place, None] + steps[place])

    return jax.lax.fori_loop(0, len(edges), through, edges)


class Way(NamedTuple):
    """From where one is to a goal.

    here, there: [B] indices of places, the one that one is at and, of those that ways lead to from it, the one nearest
    to the goal; steps: [B] from the one to the other; following: [B] the place to go to next; arrives: [B] bool,
    whether `there` is as near to the goal as any place, or no more than LAST_LEG reach radii off.
    """

    here: jax.Array
    there: jax.Array
    steps: jax.Array
    following: jax.Array
    arrives: jax.Array


def way(routes: Routes, achieved: jax.Array, goal: jax.Array, within_steps: float, problem: Problem) -> Way:
    """Next is, of the places that an edge of so many steps leads to, the one with the fewest steps to the goal; where
    none that short leads nearer, the next one on the shortest way.

    One is at the nearest place; but where the next one from there has more steps to go than a place that is reached
    already, one is at that: from a place that few windows passed, the only edge may lead back.
    achieved, goal: [B, G].
    """

    def from_one(achieved: jax.Array, goal: jax.Array) -> Way:
        distance = largest_distance(routes.places, achieved, problem.goal_parts)
        away = largest_distance(routes.places, goal, problem.goal_parts)
        nearest = distance.argmin()
        there = jnp.where(jnp.isfinite(routes.steps[nearest]), away, jnp.inf).argmin()
        to_go = routes.steps[:, there]

        def after(place: jax.Array) -> jax.Array:
            within = jnp.where(routes.edges[place] <= within_steps, to_go, jnp.inf).argmin()
            onward = jnp.where(jnp.arange(len(to_go)) == place, jnp.inf, routes.edges[place] + to_go).argmin()
            return jnp.where((within == place) & (place != there), onward, within)

        reached = jnp.where(distance <= problem.reach_radius, to_go, jnp.inf).argmin()
        here = jnp.where(to_go[after(nearest)] <= to_go[reached], nearest, reached)
        here = jnp.where(distance[here] <= problem.reach_radius, here, nearest)
        arrives = away[there] <= jnp.maximum(away.min(), LAST_LEG * problem.reach_radius)
        return Way(here, there, to_go[here], after(here), arrives)

    return jax.vmap(from_one)(achieved, goal)


def next_place(
    routes: Routes, achieved: jax.Array, goal: jax.Array, within_steps: float, problem: Problem
) -> tuple[jax.Array, jax.Array]:
    """Where to go next, [B, G]: the next place of the way; the goal itself where it is that near, or where there are no
    places. And the steps to the goal, [B].

    Where no way leads to the goal, it is to the place nearest to it that one leads to.
    achieved, goal: [B, G].
    """
    found = way(routes, achieved, goal, within_steps, problem)
    straight = found.arrives & ((found.steps <= within_steps) | jnp.isinf(routes.places[found.here]).any(axis=1))
    return jnp.where(straight[:, None], goal, routes.places[found.following]), found.steps
