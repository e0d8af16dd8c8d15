"""What preset `fast` changes of Guider, everywhere and by domain, and why."""

from __future__ import annotations

from guider.methods import goal_policy, latent_subgoals, subgoal_policy
from guider.methods.presets import MANIPULATION
from guider.support.config import ByDomain, Changes, under

FAST: Changes = (
    under("latent", latent_subgoals.FAST)
    | under("high", subgoal_policy.FAST)
    | under("low", goal_policy.FAST)
    | {"replan": "reached", "final_goal_substitution": True}
)
_ARM: Changes = MANIPULATION | {"latent.updates": 6_000, "low.random_goal_fraction": 0.0}
_OWN: Changes = {
    "final_goal_within_reach": True,
    "replan": "step",
    "low.random_goal_fraction": 0.0,
    "low.ahead": "last",
    "low.future": "last",
}
"""One's own data. A robot that can be at its goal in c steps goes there, however coarse pi_h is about it. Where an
episode ends says what its driver meant by each action: among goals from anywhere that is lost, and of places that were
passed by at speed it is learned to pass goals by. A subgoal means to be there in c steps, to both levels and at every
step: of nearer ones the low level learns no pace but its driver's."""
_TABLE: Changes = {"view.position_waves": 0, "low.relabel_fraction": 1.0, "low.random_goal_fraction": 0.0}
_IN_METRES: Changes = {"latent.error_in_spreads": False, "latent.beta": 1.0}
FAST_IN_DOMAIN: ByDomain = {
    None: _OWN,
    "gym": _OWN,
    # How to round corners without falling is what takes long to learn.
    "antmaze": _IN_METRES | {"low.updates": 100_000},
    "pointmaze": _IN_METRES,
    # A point that goes where its action says is soon learned.
    "ogbench-pointmaze": {"low.updates": 10_000},
    # What was done to a cube soon after says what it was done for; a cube that c steps may bring home goes home.
    "ogbench-cube": _TABLE | {"final_goal_within_reach": True},
    # Buttons are on or off, and what one press did, the next does too.
    "ogbench-puzzle": _TABLE | {"routes.crossings": 1},
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
        "low.subgoal_slack_steps": 30,
        "low.relabel_fraction": 0.0,
    },
}

# Where the graph chooses, the latent model only draws pictures.
_FEW_LATENT: Changes = {"latent.updates": 3_000}
ROUTES_FAST_IN_DOMAIN: ByDomain = {
    # One action of a way gains a fiftieth of a step on the logs' mean, or loses it: that is what adds up.
    "antmaze": _FEW_LATENT | {"low.learner.temperature": 0.02},
    "pointmaze": _FEW_LATENT,
    "ogbench-pointmaze": _FEW_LATENT,
    "ogbench-puzzle": _FEW_LATENT,
}
"""Further departures of `guider-routes`."""
