"""A goal that no log has an entry for is a function in a file like this one: where an arm's hand is, from its joints.

    export GUIDER_GOALS=docs/own_goal.py
    guider train --data arm.npz --goal hand --radius 0.05 --out runs/arm

Its values are shown to the networks beside the state, and its name stands in the run, the pictures and what is
exported. The robot goes on sending the state it logs; its goal is what the function gives: agent.act(joints, [x, y]).
Functions are written with jax.numpy, since they leave for the robot with the policy, and take states [..., S] to goals
[..., G]. Scaled so that 1 is near enough in each entry, parts that are measured differently can share one radius.

An angle needs no function: --goal x y angle:heading is its cosine and sine.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

UPPER_ARM_M, FOREARM_M = 0.3, 0.2


def hand(states: jax.Array) -> jax.Array:
    """Places [..., 2] of the hand, metres; a state begins with the shoulder's and the elbow's angle."""
    shoulder, elbow = states[..., 0], states[..., 0] + states[..., 1]
    x = UPPER_ARM_M * jnp.cos(shoulder) + FOREARM_M * jnp.cos(elbow)
    y = UPPER_ARM_M * jnp.sin(shoulder) + FOREARM_M * jnp.sin(elbow)
    return jnp.stack([x, y], axis=-1)


def turned(states: jax.Array) -> jax.Array:
    """Two columns [..., 6] of the rotation that a quaternion stands for (w, x, y, z; entries 2 to 5): its sign, which
    means nothing, is gone."""
    w, x, y, z = jnp.moveaxis(states[..., 2:6], -1, 0)
    size = jnp.maximum(jnp.sqrt(w * w + x * x + y * y + z * z), 1e-6)
    w, x, y, z = w / size, x / size, y / size, z / size
    first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    return jnp.stack(first + second, axis=-1)


GOALS = {"hand": hand, "turned": turned}
