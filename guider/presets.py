"""The two presets of every method. `paper` is the equations and the authors' settings with the fixes named in the
methods' files; `fast` is `paper` with the departures written out here, each a setting of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeVar, get_args

from guider.config import flatten, override, to_dict
from guider.errors import GuiderError, names_like
from guider.learners import AwrConfig, CqlConfig, GcslConfig, IqlConfig, LearnerConfig, WgcslConfig
from guider.methods.flat import FlatConfig
from guider.methods.guider import GoalPolicyConfig, GuiderConfig
from guider.methods.hiql import HiqlConfig
from guider.methods.latent_subgoals import LatentSubgoalsConfig
from guider.methods.opal import OpalConfig
from guider.methods.view import ViewConfig
from guider.problem import Problem

C = TypeVar("C")
Preset = Literal["fast", "paper"]
Changes = dict[str, Any]
"""Settings by dotted name."""

LATENT_DIM = {"fetch": 3, "kitchen": 8}
"""Of latent subgoals, by domain; not published but for antmaze, whose 2 all others get."""

# A task whose goal stands still until something is touched: whether an episode moves it at all is what counts.
_MANIPULATION: Changes = {"view.move_within": "episode", "view.position_waves": 0}
_ARM: Changes = _MANIPULATION | {"latent.updates": 6_000, "low.random_goal_fraction": 0.0}
_IN_METRES: Changes = {"latent.error_in_spreads": False, "latent.beta": 1.0}


def _from_demonstrations(regression: str) -> Changes:
    """Few demonstrations: a regression held simple."""
    return {f"{regression}.error": "absolute", f"{regression}.dropout": 0.1}


EVERY_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    # D4RL's ant runs at its motors' limits, and falls. Done more gently, the same hardly ever does, nearly as fast.
    "antmaze": {"action_scale": 0.75},
    # A centimetre decides.
    "kitchen": {"precision": "float32"},
}
"""Where every method's `fast` differs between domains."""

FAST_IN_DOMAIN: dict[str | None, Changes] = {
    # How to round corners without falling is what takes long to learn.
    "antmaze": _IN_METRES | {"low.updates": 100_000},
    "pointmaze": _IN_METRES,
    # Recorded goals lie far off in random episodes too, and would set them beside the experts'. An object moves within
    # c steps only once the hand is there: with the slack, where it shall go is a subgoal on the way there too. Sized
    # for the tasks' 40,000 episodes: a tenth of them is learned by heart, and wants 8,000 updates.
    "fetch": _ARM
    | {"high.updates": 2_500, "low.updates": 32_000, "low.subgoal_slack_steps": 20, "low.relabel_fraction": 1.0},
    # Few demonstrations, many things that may come next, and no four of them in one episode.
    "kitchen": _ARM
    | {
        "view.boundary": "clip",
        "view.smallest_spread": 0.1,
        "candidates": 64,
        "high.updates": 3_000,
        "high.relabel_fraction": 0.5,
        "high.random_goal_fraction": 0.0,
        "low.updates": 20_000,
        "low.subgoal_slack_steps": 30,
        "low.relabel_fraction": 0.0,
    }
    | _from_demonstrations("low.learner.regression"),
}
"""The same for Guider alone."""

_FLAT: Changes = {
    "learner.samples": 2,
    "learner.conservative_weight": 1.0,
    "learner.cloning_weight": 10.0,
    "learner.expectile": 0.7,
    "learner.temperature": 0.5,
}
_FLAT_UPDATES = {"antmaze": 2.5, "fetch": 4 / 3, "kitchen": 1 / 2}
"""How much longer or shorter methods without subgoals train, by domain: about what Guider takes, or less."""

# Goals hundreds of steps ahead; and where all episodes are alike, the best advantages are noise.
_LONG: Changes = {"learner.discount": 0.995, "learner.best_advantage_weight": False}
FLAT_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "antmaze": _LONG,
    "pointmaze": _LONG,
    "fetch": _MANIPULATION,
    "kitchen": _MANIPULATION | _LONG | {"view.smallest_spread": 0.1} | _from_demonstrations("learner.regression"),
}
"""The same for methods without subgoals, after what `fast` changes of their learners everywhere."""

HIQL_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "antmaze": {"low.updates": 100_000},
    "fetch": _MANIPULATION | {"random_goal_fraction": 0.0, "subgoal_steps": 10},
    "kitchen": _MANIPULATION
    | {"view.smallest_spread": 0.1, "random_goal_fraction": 0.0}
    | _from_demonstrations("low.regression"),
}
"""The same for HIQL."""

OPAL_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    # A skill is the mean of many ways to walk, and gentle already.
    "antmaze": {"action_scale": 1.0, "skills.updates": 40_000, "high.updates": 15_000},
    "fetch": _MANIPULATION,
    "kitchen": _MANIPULATION | {"view.smallest_spread": 0.1} | _from_demonstrations("skills.regression"),
}
"""The same for OPAL."""


def preset_config(method: str, preset: Preset, problem: Problem) -> Any:
    """A method's settings for a problem. Raises GuiderError for a method or preset that is none."""
    for kind, name, names in (("method", method, _PRESETS), ("preset", preset, get_args(Preset))):
        if name not in names:
            raise GuiderError(f"there is no {kind} {name!r}; {names_like(str(name), names)}")
    return _PRESETS[method](preset, problem)


def guider_config(
    preset: Preset, problem: Problem, low: LearnerConfig | None = None, low_updates: float = 1.0
) -> GuiderConfig:
    """Guider's settings for a problem, with another learner for its low level where one is given (Figure 4), which
    `fast` trains for `low_updates` times as many updates: dear ones take no longer than Guider's own."""
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
        precision="auto",
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
    fast = _change(fast, _in_domain(problem, FAST_IN_DOMAIN))
    return replace(fast, low=replace(fast.low, updates=round(fast.low.updates * low_updates)))


def flat_config(preset: Preset, problem: Problem, learner: LearnerConfig, updates: int, changes: Changes) -> FlatConfig:
    """Settings of a method without subgoals. updates: in `fast`, before `_FLAT_UPDATES`; changes: in both presets, from
    FlatConfig's defaults."""
    paper = override(FlatConfig(problem=problem, view=ViewConfig(normalise=True), learner=learner), changes)
    if preset == "paper":
        return paper
    fast = replace(
        paper,
        view=_fast_view(problem),
        precision="auto",
        updates=round(updates * _FLAT_UPDATES.get(problem.domain or "", 1)),
        batch_size=256,
        learning_rate=1e-3,
        decay=True,
        relative=True,
    )
    return _change(fast, _FLAT | _in_domain(problem, FLAT_FAST_IN_DOMAIN))


def hiql_config(preset: Preset, problem: Problem) -> HiqlConfig:
    """HIQL's settings for a problem."""
    paper = HiqlConfig(problem=problem)
    if preset == "paper":
        return paper
    shared = {"batch_size": 256, "learning_rate": 1e-3, "decay": True}
    fast = replace(
        paper,
        view=_fast_view(problem),
        precision="auto",
        relative=True,
        subgoal="place",
        value=replace(
            paper.value,
            updates=20_000,
            hidden=(256, 256),
            discount=0.995,
            target_rate=0.02,
            backup_steps=5,
            **shared,
        ),
        high=replace(paper.high, updates=8_000, hidden=(256, 256), **shared),
        low=replace(paper.low, updates=25_000, hidden=(256, 256, 256), **shared),
    )
    return override(fast, _in_domain(problem, HIQL_FAST_IN_DOMAIN))


def opal_config(preset: Preset, problem: Problem) -> OpalConfig:
    """OPAL's settings for a problem."""
    paper = OpalConfig(problem=problem)
    if preset == "paper":
        return paper
    fast = replace(
        paper,
        view=_fast_view(problem),
        precision="auto",
        relative=True,
        skills=replace(
            paper.skills,
            updates=20_000,
            batch_size=20,
            decay=True,
            hidden=(256, 256),
            encoder_hidden=128,
            encoder_stride=5,
            beta=0.02,
        ),
        high=replace(
            paper.high,
            updates=10_000,
            batch_size=128,
            learning_rate=1e-3,
            hidden=(256, 256),
            relabel_fraction=0.7,
            random_goal_fraction=0.3,
            prior=True,
            target_divergence=0.4,
            samples=2,
            lagrange_threshold=None,
            conservative_weight=0.5,
            cap_targets=True,
        ),
    )
    return override(fast, _in_domain(problem, OPAL_FAST_IN_DOMAIN))


def _in_domain(problem: Problem, changes: dict[str | None, Changes]) -> Changes:
    """Every method's changes in the problem's domain, and a method's own."""
    return EVERY_FAST_IN_DOMAIN.get(problem.domain, {}) | changes.get(problem.domain, {})


def _change(config: C, changes: Changes) -> C:
    """The config with those of the changes that are for its learner, or for any."""
    names = flatten(to_dict(config))
    return override(config, {name: value for name, value in changes.items() if "learner." not in name or name in names})


IDLE_STRETCHES = ("antmaze", "fetch", "kitchen")
"""Domains in whose data learning from moving windows only was measured to help (docs/results.md). Elsewhere every row
is learned from: a robot that turns on the spot, or holds still at its goal, teaches that too."""


def _fast_view(problem: Problem) -> ViewConfig:
    minimum_move = problem.reach_radius if problem.domain in IDLE_STRETCHES else 0.0
    return ViewConfig(boundary="drop", minimum_move=minimum_move, normalise=True, position_waves=4)


_PRESETS: dict[str, Callable[[Preset, Problem], Any]] = {
    "guider": guider_config,
    "guider-gcsl": partial(guider_config, low=GcslConfig()),
    "guider-wgcsl": partial(guider_config, low=WgcslConfig()),
    "guider-cql": partial(guider_config, low=CqlConfig(), low_updates=0.3),
    "bc": partial(
        flat_config, learner=GcslConfig(), updates=40_000, changes={"relabel_fraction": 0.0, "future": "last"}
    ),
    "gcsl": partial(flat_config, learner=GcslConfig(), updates=40_000, changes={}),
    "wgcsl": partial(flat_config, learner=WgcslConfig(), updates=25_000, changes={"relabel_fraction": 0.8}),
    "cql-her": partial(flat_config, learner=CqlConfig(), updates=12_000, changes={"relabel_fraction": 0.8}),
    "iql": partial(flat_config, learner=IqlConfig(), updates=25_000, changes={"relabel_fraction": 0.8}),
    "hiql": hiql_config,
    "opal": opal_config,
}
