"""The two presets. `paper` is the defaults of every config: the equations, the authors' settings and the fixes
named in the method's files. `fast` is `paper` with the departures written out here, each a setting of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

from guider.config import differences
from guider.methods.guider import GuiderConfig

Preset = Literal["fast", "paper"]


def guider_config(preset: Preset, radius: float, reach_radius: float, period_steps: int) -> GuiderConfig:
    """Guider's settings for a task.

    radius, reach_radius: goal units; period_steps: c, environment steps.
    """
    paper = GuiderConfig(radius=radius, reach_radius=reach_radius, period_steps=period_steps)
    if preset == "paper":
        return paper
    return replace(
        paper,
        boundary="drop",
        minimum_move=reach_radius,
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
            beta=1.0,
            decoder_dropout=0.0,
            relative=True,
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


def departures(config: GuiderConfig, radius: float, reach_radius: float, period_steps: int) -> dict[str, Any]:
    """Settings in which a config departs from the preset `paper` for a task of these radii and period."""
    return differences(config, guider_config("paper", radius, reach_radius, period_steps))
