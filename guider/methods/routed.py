"""Rivals with Guider's graph: a method that pursues a goal is led to it from place to place (routes.py), which tells
what the graph is worth from what Guider is. What TTGS (2025) does to HIQL and GCIQL, by logged steps instead of learned
ones."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.goals import largest_distance
from guider.learning.training import Stage
from guider.methods import routes
from guider.methods.method import Method
from guider.methods.view import Scale

SETTINGS = routes.RoutesConfig()


@cache
def _with_routes(fields: tuple[str, ...]) -> type:
    """A state with these fields and the graph: whoever asks for the method's own finds them."""
    return namedtuple("Routed", (*fields, "routes"))


def routed(method: Method) -> Method:
    """The method, led through the graph; the graph's settings are their defaults."""

    def init(config: Any, spaces: Spaces, scale: Scale, key: jax.Array) -> Any:
        own = method.init(config, spaces, scale, key)
        return _with_routes(own._fields)(*own, routes=routes.init(SETTINGS, spaces.goal_dim))

    def stages(config: Any) -> tuple[Stage, ...]:
        build = Stage("routes", "routes", 1, lambda state, data, key: routes.build(SETTINGS, data, config.problem))
        return *method.stages(config), build

    def act(
        config: Any,
        state: Any,
        goal_indices: tuple[int, ...],
        observation: jax.Array,
        goal: jax.Array,
        acting: Any,
        reset_mask: jax.Array,
    ) -> tuple[jax.Array, Any]:
        problem, achieved = config.problem, observation[..., jnp.asarray(goal_indices)]
        place, _ = routes.next_place(state.routes, achieved, goal, routes.within_steps(SETTINGS, problem), problem)
        near = largest_distance(achieved, goal, problem.goal_parts) <= problem.reach_radius
        place = jnp.where(near[..., None], goal, place)
        return method.act(config, state, goal_indices, observation, place, acting, reset_mask)

    return replace(
        method,
        label=f"{method.label} + routes",
        init=init,
        stages=stages,
        act=act,
        acts_by=lambda config: f"{method.acts_by(config)}, led to it from one logged place to the next",
        subgoals=None,
    )
