"""The two presets of every method. `paper` is the equations and the authors' settings with the fixes named in the
methods' files; `fast` is `paper` with the departures written out here, each a setting of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from guider.config import override
from guider.errors import GuiderError
from guider.learners import AwrConfig, CqlConfig, GcslConfig, IqlConfig, LearnerConfig, WgcslConfig
from guider.methods.flat import FlatConfig
from guider.methods.guider import GoalPolicyConfig, GuiderConfig
from guider.methods.latent_subgoals import LatentSubgoalsConfig
from guider.methods.view import ViewConfig
from guider.problem import Problem

Preset = Literal["fast", "paper"]
Changes = dict[str, Any]
"""Settings by dotted name."""

LATENT_DIM = {"fetch": 3, "kitchen": 8}
"""Of latent subgoals, by domain; not published but for antmaze, whose 2 all others get."""

# A task whose goal stands still until something is touched: whether an episode moves it at all is what counts.
_MANIPULATION: Changes = {"view.move_within": "episode", "view.position_waves": 0}
_ARM: Changes = _MANIPULATION | {
    "latent.updates": 6_000,
    "low.relabel_fraction": 0.8,
    "low.random_goal_fraction": 0.0,
}
_IN_METRES: Changes = {"latent.error_in_spreads": False, "latent.beta": 1.0}
FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "antmaze": _IN_METRES,
    "pointmaze": _IN_METRES,
    "fetch": _ARM | {"high.updates": 2_500, "low.updates": 8_000},
    "kitchen": _ARM | {"high.updates": 4_000, "low.updates": 20_000},
}
"""Where Guider's `fast` differs between domains."""

_FLAT_ARM: Changes = _MANIPULATION | {"relabel_fraction": 1.0, "random_goal_fraction": 0.0}
FLAT_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "fetch": _FLAT_ARM | {"updates": 12_000},
    "kitchen": _FLAT_ARM | {"updates": 24_000},
}
"""The same for methods without subgoals."""


def preset_config(method: str, preset: Preset, problem: Problem) -> Any:
    """A method's settings for a problem. Raises GuiderError for a method that is none."""
    if method not in _PRESETS:
        raise GuiderError(f"there is no method {method!r}; there are {', '.join(_PRESETS)}")
    return _PRESETS[method](preset, problem)


def guider_config(preset: Preset, problem: Problem, low: LearnerConfig | None = None) -> GuiderConfig:
    """Guider's settings for a problem, with another learner for its low level where one is given (Figure 4)."""
    paper = GuiderConfig(
        problem=problem,
        latent=LatentSubgoalsConfig(latent_dim=LATENT_DIM.get(problem.domain or "", 2)),
        low=GoalPolicyConfig(learner=low or AwrConfig()),
    )
    if preset == "paper":
        return paper
    fast = replace(
        paper,
        view=_fast_view(problem),
        replan="reached",
        final_goal_substitution=True,
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


def flat_config(preset: Preset, problem: Problem, learner: LearnerConfig, changes: Changes) -> FlatConfig:
    """Settings of a method without subgoals. changes: in both presets, where it is not FlatConfig's default."""
    paper = override(FlatConfig(problem=problem, view=ViewConfig(normalise=True), learner=learner), changes)
    if preset == "paper":
        return paper
    fast = replace(
        paper,
        view=_fast_view(problem),
        updates=60_000,
        batch_size=256,
        learning_rate=1e-3,
        decay=True,
        relative=True,
    )
    return override(fast, FLAT_FAST_IN_DOMAIN.get(problem.domain, {}))


def _fast_view(problem: Problem) -> ViewConfig:
    return ViewConfig(boundary="drop", minimum_move=problem.reach_radius, normalise=True, position_waves=4)


_PRESETS: dict[str, Callable[[Preset, Problem], Any]] = {
    "guider": guider_config,
    "guider-gcsl": partial(guider_config, low=GcslConfig()),
    "guider-wgcsl": partial(guider_config, low=WgcslConfig()),
    "guider-cql": partial(guider_config, low=CqlConfig()),
    "bc": partial(flat_config, learner=GcslConfig(), changes={"relabel_fraction": 0.0, "future": "last"}),
    "gcsl": partial(flat_config, learner=GcslConfig(), changes={}),
    "wgcsl": partial(flat_config, learner=WgcslConfig(), changes={"relabel_fraction": 0.8}),
    "cql-her": partial(flat_config, learner=CqlConfig(), changes={"relabel_fraction": 0.8}),
    "iql": partial(flat_config, learner=IqlConfig(), changes={"relabel_fraction": 0.8}),
}
