"""Guider: offline hierarchical reinforcement learning with a latent model of reachable subgoals (IJCAI 2023).

Names are imported when they are first used: reading data takes no compiler, and a command answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guider.api import evaluate, export, film, inspect, load, report, resume, save_data, train
    from guider.data import load as load_data
    from guider.data.episodes import Episodes, make_episodes
    from guider.errors import GuiderError, GuiderWarning
    from guider.methods.policy import Agent, Policy, act, initial_state

__all__ = [
    "Agent",
    "Episodes",
    "GuiderError",
    "GuiderWarning",
    "Policy",
    "act",
    "evaluate",
    "export",
    "film",
    "initial_state",
    "inspect",
    "load",
    "load_data",
    "make_episodes",
    "report",
    "resume",
    "save_data",
    "train",
]

_HOMES = {
    **dict.fromkeys(("evaluate", "export", "film", "inspect", "load", "report", "resume", "save_data", "train"), "api"),
    **dict.fromkeys(("Episodes", "make_episodes"), "data.episodes"),
    **dict.fromkeys(("GuiderError", "GuiderWarning"), "errors"),
    **dict.fromkeys(("Agent", "Policy", "act", "initial_state"), "methods.policy"),
}


def __getattr__(name: str) -> Any:
    if name == "load_data":
        return import_module("guider.data").load
    if name not in _HOMES:
        raise AttributeError(f"module 'guider' has no attribute {name!r}")
    return getattr(import_module(f"guider.{_HOMES[name]}"), name)
