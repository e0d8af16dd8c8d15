"""d(s, g), the steps from a state to a goal, as a quasimetric on a latent space: far apart as a whole, one step apart
where a logged step leads (quasimetric RL, Wang et al. 2023; OGBench's QRL), with a model of what actions do there.

Where it differs from OGBench's: states and places have encoders of their own, since goals are places. A place is what
the states in it have in common: being in one, it is no step to the other, d(phi(s), psi(s^G)) <= 0, held by the same
multiplier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.critics.types import Steps
from guider.errors import GuiderError
from guider.learning.networks import Layers, layer_norm_mlp, mlp_init
from guider.learning.training import Metrics
from guider.support.config import check_positive

FAR, SCALE = 5.0, 100.0
"""Distances are pushed apart up to FAR * SCALE steps, ever less."""


@dataclass(frozen=True)
class QuasimetricConfig:
    """Settings. Defaults are OGBench's."""

    kind: Literal["quasimetric"] = "quasimetric"
    representation_dim: int = 512
    intervals: int = 8
    """Entries of a component, whose distance is the length of the union of so many intervals."""
    slack: float = 0.05
    """Mean squared excess of logged steps over one that the multiplier lets pass."""

    def __post_init__(self) -> None:
        check_positive(self, "representation_dim", "intervals", "slack")
        if self.representation_dim % self.intervals:
            raise GuiderError(
                f"representation_dim must be a multiple of intervals, got {self.representation_dim} and "
                f"{self.intervals}"
            )


class Params(NamedTuple):
    """state: phi; place: psi; dynamics: (phi(s), a) -> phi(s') - phi(s); mean_share: logit of how much the components'
    mean counts beside their greatest; log_multiplier: of the constraint."""

    state: Layers
    place: Layers
    dynamics: Layers
    mean_share: jax.Array
    log_multiplier: jax.Array


def init(
    key: jax.Array,
    config: QuasimetricConfig,
    hidden: tuple[int, ...],
    state_dim: int,
    place_dim: int,
    action_dim: int,
) -> Params:
    state_key, place_key, dynamics_key = jax.random.split(key, 3)
    width = config.representation_dim
    return Params(
        state=mlp_init(state_key, (state_dim, *hidden, width)),
        place=mlp_init(place_key, (place_dim, *hidden, width)),
        dynamics=mlp_init(dynamics_key, (width + action_dim, *hidden, width)),
        mean_share=jnp.zeros(()),
        log_multiplier=jnp.zeros(()),
    )


def interval_distance(config: QuasimetricConfig, mean_share: jax.Array, start: jax.Array, end: jax.Array) -> jax.Array:
    """The interval quasimetric embedding (Wang & Isola 2022): of each component, the length of the union of the
    intervals [start_i, end_i] that go up; then between their mean and their greatest. [..., Z] each -> [...]."""
    start, end = (x.reshape(*x.shape[:-1], -1, config.intervals) for x in (start, end))
    # A union's length is the sum of its right ends minus that of its left ends. Which they are changes nowhere but in
    # steps, so gradients leave it alone. Seen in a mirror, right ends are left ones.
    begins, ends = _left_ends(start, end), _left_ends(-end, -start)
    components = (jnp.where(ends, end, 0.0) - jnp.where(begins, start, 0.0)).sum(axis=-1)
    share = jax.nn.sigmoid(mean_share)
    return share * components.mean(axis=-1) + (1 - share) * components.max(axis=-1)


def _left_ends(start: jax.Array, end: jax.Array) -> jax.Array:
    """Whether an interval begins where no other one is: [..., intervals] bool. Of those that begin together the first
    counts; those that go down are none."""
    rises, index = end > start, jnp.arange(start.shape[-1])
    other_start, other_end = start[..., None, :], end[..., None, :]
    here, earlier = start[..., None], index < index[:, None]
    covered = rises[..., None, :] & ((other_start < here) & (here <= other_end) | (other_start == here) & earlier)
    return rises & ~covered.any(axis=-1)


def loss(
    config: QuasimetricConfig, params: Params, target: Params, steps: Steps, discount: float
) -> tuple[jax.Array, Metrics]:
    """Goals from anywhere are pushed away, while a logged step is held to one step and a state to its own place, by a
    multiplier; the dynamics are fitted in the distance itself, both ways."""

    def distance(start: jax.Array, end: jax.Array) -> jax.Array:
        return interval_distance(config, params.mean_share, start, end)

    state, next_state = (layer_norm_mlp(params.state, seen) for seen in (steps.state, steps.next_state))
    place, goal = (layer_norm_mlp(params.place, seen) for seen in (steps.place, steps.goal))
    away = distance(state, goal)
    pushed = SCALE * jax.nn.softplus(FAR - away / SCALE).mean()
    excess = jax.nn.relu(distance(state, next_state) - 1) ** 2 + distance(state, place) ** 2
    excess = excess.mean()
    multiplier = jnp.exp(params.log_multiplier)
    held = excess * jax.lax.stop_gradient(multiplier) + multiplier * (config.slack - jax.lax.stop_gradient(excess))
    predicted = state + layer_norm_mlp(params.dynamics, jnp.concatenate([state, steps.action], axis=-1))
    dynamics = (distance(next_state, predicted) + distance(predicted, next_state)).mean() / 2
    metrics = {"distance": away.mean(), "excess": excess, "multiplier": multiplier, "dynamics_error": dynamics}
    return pushed + held + dynamics, metrics


def quality(
    config: QuasimetricConfig, params: Params, state: jax.Array, action: jax.Array, goal: jax.Array
) -> jax.Array:
    """Minus the steps that are left after the action, [B]."""
    here = layer_norm_mlp(params.state, state)
    after = here + layer_norm_mlp(params.dynamics, jnp.concatenate([here, action], axis=-1))
    return -interval_distance(config, params.mean_share, after, layer_norm_mlp(params.place, goal))
