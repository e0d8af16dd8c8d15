"""The low-level policy that reaches subgoals (Section 4.4, Algorithm 1 lines 13-18): its settings, what it sees, and
what its learner is given. How a policy comes out of that, by Eq. 5-6 or as another method would, is in `learners`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import jax
import jax.numpy as jnp

from guider.learners import AwrConfig, LearnerConfig, Transitions
from guider.learning import losses
from guider.learning.problem import Problem
from guider.learning.samplers import Ahead, LowBatch
from guider.methods.view import Scale
from guider.support.config import Changes, check_fraction, check_networks, check_not_negative, check_shares


@dataclass(frozen=True)
class GoalPolicyConfig:
    """Settings of the low level. Defaults are the authors' (preset `paper`)."""

    updates: int = 500_000
    batch_size: int = 512
    learning_rate: float = 1e-4
    decay: bool = False
    """Let the learning rate fall to zero along a cosine over `updates` (departure)."""
    hidden: tuple[int, ...] = (256, 256, 256)
    subgoal_slack_steps: int = 0
    """Subgoals come from (t, t + c + slack]: 0 is Algorithm 1, 1 Section 4.4, 5 the authors' code."""
    ahead: Ahead = "uniform"
    """Which state of these becomes the subgoal: any, or the last, as for pi_h (departure)."""
    relabel_fraction: float = 0.8
    """Share of final goals relabelled with a future state; the rest are recorded goals, where data has them."""
    random_goal_fraction: float = 0.0
    """Share of final goals drawn from any trajectory (departure)."""
    future: Literal["uniform", "last"] = "uniform"
    """Which future state becomes the final goal: any, or the episode's last (departure)."""
    subgoal_input: Literal["goal", "latent"] = "goal"
    """What the networks see of the subgoal: s^G_j, or z ~ q(. | s^G_k, s^G_j), encoded where acting would have chosen
    it, up to c - 1 steps ago (Figure 5, without decoder)."""
    relative: bool = False
    """Show goals as displacements from s^G_t instead of positions (departure)."""
    learner: LearnerConfig = field(default_factory=AwrConfig)
    """How the policy is learned: Eq. 5-6 (awr), or as another method would (Figure 4)."""

    def __post_init__(self) -> None:
        check_networks(self)
        check_not_negative(self, "subgoal_slack_steps")
        check_fraction(self, "relabel_fraction", "random_goal_fraction")
        check_shares(self)


FAST: Changes = {
    "updates": 40_000,
    "batch_size": 256,
    "learning_rate": 1e-3,
    "decay": True,
    "relative": True,
    "relabel_fraction": 0.5,
    "random_goal_fraction": 0.5,
}
"""What preset `fast` changes, the learner's own apart."""


def inputs(
    config: GoalPolicyConfig,
    scale: Scale,
    observation: jax.Array,
    achieved: jax.Array,
    subgoal: jax.Array,
    goal: jax.Array,
) -> jax.Array:
    """What the networks see: scaled (s, g_sub, g_final), [..., inputs].

    With `relative`, goals are displacements from s^G. Without decoder, g_sub is a latent already.
    """
    if config.relative:
        seen_goal = (goal - achieved) / scale.goal_std
        seen_subgoal = (subgoal - achieved) / scale.step_std if config.subgoal_input == "goal" else subgoal
    else:
        seen_goal = scale.goal(goal)
        seen_subgoal = scale.goal(subgoal) if config.subgoal_input == "goal" else subgoal
    return jnp.concatenate([scale.state(observation), scale.waves(achieved), seen_subgoal, seen_goal], axis=-1)


def relabel(
    config: GoalPolicyConfig, problem: Problem, scale: Scale, batch: LowBatch, subgoal: jax.Array
) -> Transitions:
    """Algorithm 1, line 16. subgoal: what is shown of the batch's subgoals. The reward is for meeting these (Eq. 1), in
    goal space always."""
    return Transitions(
        state=inputs(config, scale, batch.observation, batch.achieved, subgoal, batch.goal),
        action=batch.action,
        reward=losses.goal_reward(batch.next_achieved, batch.subgoal, problem.radius, problem.goal_parts),
        next_state=inputs(config, scale, batch.next_observation, batch.next_achieved, subgoal, batch.goal),
        steps=batch.subgoal_steps,
    )
