"""The two presets. `paper` is the defaults of every config: the equations, the authors' settings and the fixes
named in the method's files. `fast` is `paper` with the departures written out here, each a setting of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from guider.config import override
from guider.goals import Parts
from guider.methods.guider import GuiderConfig

Preset = Literal["fast", "paper"]


@dataclass(frozen=True)
class Problem:
    """What a task, or the owner of the data, settles before any method is chosen.

    radius, reach_radius: goal units; period_steps: c, environment steps; goal_parts: see guider.goals;
    latent_dim: of latent subgoals; domain: of the task, None for one's own data.
    """

    radius: float
    reach_radius: float
    period_steps: int
    goal_parts: Parts = ()
    latent_dim: int = 2
    domain: str | None = None


# An arm that manipulates: the goal stands still until it is touched, and where it will go is seen in the final goal.
_MANIPULATION = {
    "move_within": "episode",
    "position_waves": 0,
    "latent.updates": 6_000,
    "low.relabel_fraction": 0.8,
    "low.random_goal_fraction": 0.0,
}
_IN_METRES = {"latent.error_in_spreads": False, "latent.beta": 1.0}
FAST_IN_DOMAIN: dict[str | None, dict[str, Any]] = {
    "antmaze": _IN_METRES,
    "pointmaze": _IN_METRES,
    "fetch": _MANIPULATION | {"high.updates": 2_500, "low.updates": 8_000},
    "kitchen": _MANIPULATION | {"high.updates": 4_000, "low.updates": 20_000},
}
"""Where `fast` differs between domains: domain -> settings by dotted name."""


def guider_config(preset: Preset, problem: Problem) -> GuiderConfig:
    """Guider's settings for a problem."""
    paper = GuiderConfig(
        radius=problem.radius,
        reach_radius=problem.reach_radius,
        period_steps=problem.period_steps,
        goal_parts=problem.goal_parts,
        latent=replace(GuiderConfig().latent, latent_dim=problem.latent_dim),
    )
    if preset == "paper":
        return paper
    fast = replace(
        paper,
        boundary="drop",
        minimum_move=problem.reach_radius,
        replan="reached",
        final_goal_substitution=True,
        normalise=True,
        position_waves=4,
        latent=replace(
            paper.latent,
            updates=12_000,
            batch_size=256,
            learning_rate=5e-4,
            hidden=(256, 256),
            beta=0.1,
            decoder_dropout=0.0,
            relative=True,
            error_in_spreads=True,
        ),
        high=replace(
            paper.high,
            updates=5_000,
            learning_rate=1e-3,
            hidden=(256, 256),
            relabel_fraction=0.7,
            random_goal_fraction=0.3,
            samples=2,
            lagrange_threshold=None,
            conservative_weight=0.5,
            cap_targets=True,
        ),
        low=replace(
            paper.low,
            updates=40_000,
            batch_size=256,
            learning_rate=1e-3,
            decay=True,
            relative=True,
            relabel_fraction=0.5,
            random_goal_fraction=0.5,
        ),
    )
    return override(fast, FAST_IN_DOMAIN.get(problem.domain, {}))
