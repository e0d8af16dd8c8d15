"""The two presets of every method. `paper` is the equations and the authors' settings with the fixes named in the
methods' files; `fast` is `paper` with the departures written out here, each a setting of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

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

Preset = Literal["fast", "paper"]
Changes = dict[str, Any]
"""Settings by dotted name."""

LATENT_DIM = {"fetch": 3, "kitchen": 8}
"""Of latent subgoals, by domain; not published but for antmaze, whose 2 all others get."""

# A task whose goal stands still until something is touched: whether an episode moves it at all is what counts.
_MANIPULATION: Changes = {"view.move_within": "episode", "view.position_waves": 0}
_ARM: Changes = _MANIPULATION | {"latent.updates": 6_000, "low.random_goal_fraction": 0.0}
_IN_METRES: Changes = {"latent.error_in_spreads": False, "latent.beta": 1.0}
_STEADY_CRITIC: Changes = {
    "samples": 2,
    "backup": "max_of_min",
    "uniform_box": "per_entry",
    "lagrange_threshold": None,
    "conservative_weight": 0.5,
    "cap_targets": True,
    "temperature_loss": "log_alpha",
    "initialisation": "fan_in",
}
"""Of the high level: values that stay at or below 0, from few samples."""


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
    },
}
"""The same for Guider, whatever learns its low level."""

LEARNERS_FAST: dict[str, Changes] = {
    # Values that stay low, from few samples, and a policy near the data.
    "cql": {"samples": 2, "conservative_weight": 1.0, "cloning_weight": 10.0},
    "iql": {"expectile": 0.7, "temperature": 0.5},
    "wgcsl": {"twins": True, "recent_advantages": 4096},
    "awr": {"advantage": "action_value", "policy": "tanh", "initialisation": "fan_in"},
}
"""Where `fast` changes learners, alone and as Guider's low level alike: Figure 4 compares what stands above them."""

# Goals hundreds of steps ahead; and where all episodes are alike, the best advantages are noise.
_LONG: Changes = {"discount": 0.995, "best_advantage_weight": False}
LEARNERS_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "antmaze": _LONG,
    "pointmaze": _LONG,
    # Values of up to 4 / (1 - discount) would drown the cloning.
    "kitchen": _LONG | _from_demonstrations("regression") | {"cloning_weight": 1000.0},
}
"""The same by domain; Guider's own learner (`awr`), which pursues what lies c steps ahead, keeps its discount."""

_FLAT_UPDATES = {"antmaze": 2.5, "fetch": 4 / 3, "kitchen": 1 / 2}
"""How much longer or shorter methods without subgoals train, by domain: about what Guider takes, or less."""

FLAT_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "fetch": _MANIPULATION,
    "kitchen": _MANIPULATION | {"view.smallest_spread": 0.1},
}
"""The same for methods without subgoals, besides their learners."""

HIQL_FAST_IN_DOMAIN: dict[str | None, Changes] = {
    "antmaze": {"low.updates": 100_000},
    "fetch": _MANIPULATION | {"random_goal_fraction": 0.0, "subgoal_steps": 10},
    "kitchen": _MANIPULATION
    | {"view.smallest_spread": 0.1, "random_goal_fraction": 0.0}
    | _from_demonstrations("low.regression"),
}
"""The same for HIQL, on representations and on places."""

_ON_PLACES: Changes = {
    "subgoal": "place",
    "squash": True,
    "random_goal_fraction": 0.3,
    "value.backup_steps": 5,
    "high.temperature": 1.0,
    "low.temperature": 1.0,
}
"""What makes HIQL `hiql-places`, in both presets."""

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
    learner = low or AwrConfig()
    paper = GuiderConfig(
        problem=problem,
        latent=LatentSubgoalsConfig(latent_dim=LATENT_DIM.get(problem.domain or "", 2)),
        low=GoalPolicyConfig(learner=learner),
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
            initialisation="fan_in",
        ),
        high=replace(
            paper.high,
            updates=5_000,
            learning_rate=1e-3,
            hidden=(256, 256),
            relabel_fraction=0.7,
            random_goal_fraction=0.3,
            **_STEADY_CRITIC,
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
            learner=_fast_learner(problem, learner),
        ),
    )
    fast = override(fast, _in_domain(problem, FAST_IN_DOMAIN))
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
        learner=_fast_learner(problem, learner),
    )
    return override(fast, _in_domain(problem, FLAT_FAST_IN_DOMAIN))


def hiql_config(preset: Preset, problem: Problem, places: bool = False) -> HiqlConfig:
    """HIQL's settings for a problem, or those of its variant on places."""
    paper = override(HiqlConfig(problem=problem), _ON_PLACES if places else {})
    if preset == "paper":
        return paper
    shared = {"batch_size": 256, "learning_rate": 1e-3, "decay": True}
    fast = replace(
        paper,
        view=_fast_view(problem),
        precision="auto",
        relative=True,
        value=replace(
            paper.value,
            updates=20_000,
            hidden=(256, 256),
            discount=0.995,
            target_rate=0.02,
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
            **_STEADY_CRITIC,
        ),
    )
    return override(fast, _in_domain(problem, OPAL_FAST_IN_DOMAIN))


def _in_domain(problem: Problem, changes: dict[str | None, Changes]) -> Changes:
    """Every method's changes in the problem's domain, and a method's own."""
    return EVERY_FAST_IN_DOMAIN.get(problem.domain, {}) | changes.get(problem.domain, {})


def _fast_learner(problem: Problem, learner: LearnerConfig) -> LearnerConfig:
    """A learner with those of `fast`'s changes that are for it."""
    names = flatten(to_dict(learner)).keys() - ({"discount"} if learner.kind == "awr" else set())
    in_domain = LEARNERS_FAST_IN_DOMAIN.get(problem.domain, {})
    changes = {name: value for name, value in in_domain.items() if name in names}
    return override(learner, LEARNERS_FAST.get(learner.kind, {}) | changes)


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
    "hiql-places": partial(hiql_config, places=True),
    "opal": opal_config,
}
