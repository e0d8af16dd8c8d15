"""A trained policy as one step of a controller: numbers in, numbers out, and what it remembers beside them."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np

from guider.data.goal_spaces import extended
from guider.exporting.program import Program, read
from guider.methods import find_method
from guider.methods.policy import Policy, act, initial_state


def controller(policy: Policy) -> Program:
    """What `Agent.act` does in a step, with all its memory told.

    Inputs: observation [S] and goal [G] float32, begins (a truth value: whether an episode does), and what the last
    step returned as next_memory_0, next_memory_1, ... as memory_0, memory_1, ...; where an episode begins, that is not
    looked at. Outputs: action [A] within its bounds, the next memory, and, of a method that has subgoals, the one
    pursued, subgoal [G].
    """
    memory = initial_state(policy, 1)
    leaves, tree = jax.tree.flatten(memory)
    method = find_method(policy.method)

    def step(observation: jax.Array, goal: jax.Array, begins: jax.Array, *remembered: jax.Array) -> list[jax.Array]:
        acting = tree.unflatten([leaf[None] for leaf in remembered])
        seen = extended(observation[None], policy.computed)
        actions, acting = act(policy, seen, goal[None], acting, begins[None])
        results = [actions[0], *(leaf[0] for leaf in jax.tree.leaves(acting))]
        if method.subgoals is not None:
            results.append(method.subgoals.pursued(policy.config, acting)[0][0])
        return results

    inputs: dict[str, Any] = {
        "observation": np.zeros(policy.logged_dim, np.float32),
        "goal": np.zeros(policy.goal_dim, np.float32),
        "begins": np.ones((), bool),
    }
    inputs |= {f"memory_{index}": np.asarray(leaf[0]) for index, leaf in enumerate(leaves)}
    outputs = ["action", *(f"next_memory_{index}" for index in range(len(leaves)))]
    return read(step, inputs, outputs + (["subgoal"] if method.subgoals is not None else []))


def parameters(policy: Policy) -> dict[str, np.ndarray]:
    """Everything that was trained, by name: a path through the method's state."""
    found, _ = jax.tree_util.tree_flatten_with_path(policy.state)
    name = partial(jax.tree_util.keystr, simple=True, separator=".")
    return {name(path): np.asarray(leaf) for path, leaf in found}
