"""The low-level policy that reaches subgoals (Section 4.4, Eq. 5-6, Algorithm 1 lines 13-18).

Where the authors' code and this file differ: the target critics start as copies of the critics, and the
Bellman target stops at a met subgoal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax

from guider import losses
from guider.config import check_fraction, check_networks, check_not_negative, check_positive, check_shares
from guider.networks import Layers, mlp, mlp_init, twin_init, twin_values
from guider.optimisers import Rate, adam_step, trail

Metrics = dict[str, jax.Array]


@dataclass(frozen=True)
class GoalPolicyConfig:
    """Settings of the low level. Defaults are the authors' (preset `paper`)."""

    updates: int = 500_000
    batch_size: int = 512
    learning_rate: float = 1e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    hidden: tuple[int, ...] = (256, 256, 256)
    discount: float = 0.99
    target_rate: float = 0.005
    subgoal_slack_steps: int = 0
    """Subgoals come from (t, t + c + slack]: 0 is Algorithm 1, 1 Section 4.4, 5 the authors' code."""
    relabel_fraction: float = 0.8
    """Share of final goals relabelled with a future state; the rest are recorded goals, where data has them."""
    random_goal_fraction: float = 0.0
    """Share of final goals drawn from any trajectory (departure)."""
    weight_ceiling: float = 10.0
    temperature: float = 1.0
    """Advantages are divided by this before the exponential; 1 is Eq. 6."""
    subgoal_input: Literal["goal", "latent"] = "goal"
    """What the networks see of the subgoal: s^G_j, or z ~ q(. | s^G_t, s^G_j) (Figure 5, without decoder)."""
    relative: bool = False
    """Show goals as displacements from s^G_t instead of positions (departure)."""

    def __post_init__(self) -> None:
        check_networks(self)
        check_positive(self, "weight_ceiling", "temperature")
        check_not_negative(self, "subgoal_slack_steps")
        check_fraction(self, "discount", "target_rate", "relabel_fraction", "random_goal_fraction")
        check_shares(self)


class Params(NamedTuple):
    actor: Layers
    critic: Layers


class GoalPolicyState(NamedTuple):
    params: Params
    target_critic: Layers
    optimiser: optax.OptState


class Transitions(NamedTuple):
    """Relabelled transitions as the networks see them (Algorithm 1, line 16).

    state, next_state: [B, inputs] scaled (s, g_sub, g_final); action: [B, A] in [-1, 1];
    reward: [B], 0 where the subgoal is met after the step, else below.
    """

    state: jax.Array
    action: jax.Array
    reward: jax.Array
    next_state: jax.Array


def init(key: jax.Array, config: GoalPolicyConfig, input_dim: int, action_dim: int) -> GoalPolicyState:
    actor_key, critic_key = jax.random.split(key)
    params = Params(
        actor=mlp_init(actor_key, (input_dim, *config.hidden, action_dim)),
        critic=twin_init(critic_key, (input_dim + action_dim, *config.hidden, 1)),
    )
    return GoalPolicyState(params, params.critic, optax.adam(_rate(config)).init(params))


def _rate(config: GoalPolicyConfig) -> Rate:
    rate = config.learning_rate
    return optax.cosine_decay_schedule(rate, max(1, config.updates)) if config.decay else rate


def act(params: Params, state: jax.Array) -> jax.Array:
    """Mean of pi_l(a | s, g_sub, g_final), in [-1, 1]. state: [..., inputs] scaled. Returns [..., A]."""
    return jnp.tanh(mlp(params.actor, state))


def update(config: GoalPolicyConfig, state: GoalPolicyState, batch: Transitions) -> tuple[GoalPolicyState, Metrics]:
    """One step of Algorithm 1, lines 17-18.

    Critic: TD error towards r + gamma * min Q(s', pi_l(s')), sum over the twins. Actor: Eq. 6, where
    A = min Q(s, a) - min Q(s, pi_l(s)), its gradient through log pi_l alone.
    """
    old = state.params
    next_value = twin_values(state.target_critic, batch.next_state, act(old, batch.next_state)).min(axis=0)
    target = losses.td_target(batch.reward, next_value, config.discount)

    def loss(params: Params) -> tuple[jax.Array, Metrics]:
        values = twin_values(params.critic, batch.state, batch.action)
        td = ((values - target) ** 2).mean(axis=-1).sum()
        predicted = act(params, batch.state)
        baseline = twin_values(old.critic, batch.state, jax.lax.stop_gradient(predicted)).min(axis=0)
        advantage = jax.lax.stop_gradient(values.min(axis=0) - baseline)
        weight = losses.advantage_weight(advantage, config.temperature, config.weight_ceiling)
        regression = losses.weighted_regression(weight, predicted, batch.action).mean()
        metrics = {
            "td_error": td,
            "value": values.mean(),
            "advantage_std": advantage.std(),
            "weight": weight.mean(),
            "action_error": ((predicted - batch.action) ** 2).mean(),
        }
        return td + regression, metrics

    gradients, metrics = jax.grad(loss, has_aux=True)(old)
    params, optimiser = adam_step(_rate(config), old, gradients, state.optimiser)
    target_critic = trail(state.target_critic, params.critic, config.target_rate)
    return GoalPolicyState(params, target_critic, optimiser), metrics
