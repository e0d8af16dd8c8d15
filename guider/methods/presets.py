"""The two presets. `paper` is the equations and the authors' settings with the fixes named in the methods' files.
`fast` departs from it by settings of their own: those below, FAST in the method's file (Guider's: guider_fast.py)
and its learner's."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from guider.learning.problem import Problem
from guider.methods.view import ViewConfig
from guider.support.config import ByDomain, Changes, flatten, override, to_dict

C = TypeVar("C")

IDLE_STRETCHES = ("antmaze", "fetch", "kitchen")
"""Domains in whose data learning from moving windows only was measured to help (docs/results.md). Elsewhere every row
is learned from: a robot that turns on the spot, or holds still at its goal, teaches that too."""

IN_DOMAIN: ByDomain = {
    # D4RL's ant runs at its motors' limits, and falls. Done more gently, the same hardly ever does, nearly as fast.
    "antmaze": {"action_scale": 0.75},
    # A centimetre decides.
    "kitchen": {"precision": "float32"},
}
"""Where every method's `fast` differs between domains."""

MOST_PASSES, LEAST_UPDATES = 120, 2_000

MANIPULATION: Changes = {"view.move_within": "episode", "view.position_waves": 0}
"""For goals that stand still until something is touched: whether an episode moves them at all is what counts."""


def fast(paper: C, changes: Changes, in_domain: ByDomain) -> C:
    """A method's config with `fast`'s changes to every method, its own, and those of both in the problem's domain."""
    problem: Problem = paper.problem  # pyright: ignore[reportAttributeAccessIssue]
    minimum_move = problem.reach_radius if problem.domain in IDLE_STRETCHES else 0.0
    view = ViewConfig(
        boundary="drop",
        minimum_move=minimum_move,
        minimum_window_move=problem.window_move,
        normalise=True,
        position_waves=4,
    )
    in_domains = IN_DOMAIN.get(problem.domain, {}) | in_domain.get(problem.domain, {})
    config = override(replace(paper, view=view), {"precision": "auto"} | changes | in_domains)  # pyright: ignore
    return _not_by_heart(config, problem.transitions)


def _not_by_heart(config: C, transitions: int | None) -> C:
    """On one's own data, what chooses actions is trained for no more than MOST_PASSES over the transitions: after more,
    it has learned the noise in the logged actions too."""
    settings = flatten(to_dict(config))
    level = "low." if "low.updates" in settings else ""
    if transitions is None or f"{level}updates" not in settings:
        return config
    most = max(LEAST_UPDATES, MOST_PASSES * transitions // settings[f"{level}batch_size"])
    return override(config, {f"{level}updates": min(most, settings[f"{level}updates"])})
