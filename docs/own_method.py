"""A method of your own is a file like this one: one linear layer from state and goal to the logged action.

    GUIDER_METHODS=docs/own_method.py guider train pointmaze-umaze --data FILE --method linear --seeds 2
    GUIDER_METHODS=docs/own_method.py guider evaluate runs/pointmaze-umaze-linear-fast

All that is done with a method is done with it: several seeds at once, exact resume, scores, tables, `guider export`. A
package offers its methods as entry points of the group `guider.methods` instead, each a module with METHODS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp

from guider.data.episodes import Spaces
from guider.learning.networks import Layers, Precision, mlp, mlp_init
from guider.learning.optimisers import Moments, adam_init, adam_step
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.learning.samplers import sample_flat
from guider.learning.training import Stage
from guider.learning.windows import Data
from guider.methods.method import Method
from guider.methods.presets import fast
from guider.methods.view import Scale, ViewConfig


# What can be set, by --set and in Python. The first four every method has.
@dataclass(frozen=True)
class LinearConfig:
    problem: Problem = field(default_factory=Problem)
    view: ViewConfig = field(default_factory=ViewConfig)
    precision: Precision = "float32"
    action_scale: float = 1.0
    updates: int = 2_000
    batch_size: int = 256
    learning_rate: float = 1e-2


# What training changes, and acting needs: any tree of arrays. `scale` holds the data's means and spreads.
class Policy(NamedTuple):
    layers: Layers
    optimiser: Moments


class LinearState(NamedTuple):
    scale: Scale
    policy: Policy


def init(config: LinearConfig, spaces: Spaces, scale: Scale, key: jax.Array) -> LinearState:
    """One seed's fresh state; the engine asks for as many as there are seeds."""
    layers = mlp_init(key, (spaces.state_dim + spaces.goal_dim, spaces.action_dim))
    return LinearState(scale, Policy(layers, adam_init(layers)))


def predict(layers: Layers, scale: Scale, observation: jax.Array, achieved: jax.Array, goal: jax.Array) -> jax.Array:
    """Actions [B, A] in [-1, 1] for states [B, S] at places [B, G] and goals [B, G]."""
    way = (goal - achieved) / scale.goal_std
    return jnp.tanh(mlp(layers, jnp.concatenate([scale.state(observation), way], axis=-1)))


def stages(config: LinearConfig) -> tuple[Stage, ...]:
    """One stage after the other; each changes one part of the state, here `policy`, and gives its metrics."""

    def update(state: LinearState, data: Data, key: jax.Array) -> tuple[Policy, dict[str, jax.Array]]:
        batch = sample_flat(data, key, config.batch_size, "uniform", 100.0, 1.0, 0.0)  # goals from the same episode

        def loss(layers: Layers) -> jax.Array:
            actions = predict(layers, state.scale, batch.observation, batch.achieved, batch.goal)
            return ((actions - batch.action) ** 2).mean()

        error, gradients = jax.value_and_grad(loss)(state.policy.layers)
        stepped = adam_step(config.learning_rate, state.policy.layers, gradients, state.policy.optimiser)
        return Policy(*stepped), {"action_error": error}

    return (Stage("regression", "policy", config.updates, update),)


def initial_acting_state(config: LinearConfig, goal_dim: int, batch_size: int) -> tuple[()]:
    """What it remembers between steps: nothing."""
    return ()


def act(config, state, goal_indices, observation, goal, acting, reset_mask):
    """Actions [B, A] in [-1, 1] for observations [B, S] and goals [B, G], and what it remembers."""
    achieved = observation[..., jnp.asarray(goal_indices)]
    return predict(state.policy.layers, state.scale, observation, achieved, goal), acting


def acts_by(config: LinearConfig) -> str:
    """Printed with its scores."""
    return "linear action towards the final goal"


def preset(name: Preset, problem: Problem) -> LinearConfig:
    """`fast` changes what it changes for every method, and whatever is named here, also by domain."""
    paper = LinearConfig(problem=problem)
    return paper if name == "paper" else fast(paper, {"updates": 1_000}, {})


# Subgoals in goal space, where it has any, are scored and drawn too (`subgoals=Subgoals(...)`, guider.methods.method).
METHODS = {"linear": Method("Linear", LinearConfig, preset, init, stages, initial_acting_state, act, acts_by)}
