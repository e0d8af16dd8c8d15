"""Guider: offline hierarchical reinforcement learning with a latent model of reachable subgoals (IJCAI 2023)."""

from guider.api import evaluate, inspect, load, resume, train
from guider.data import load as load_data
from guider.episodes import Episodes, make_episodes
from guider.errors import GuiderError, GuiderWarning
from guider.policy import Agent, Policy, act, initial_state

__all__ = [
    "Agent",
    "Episodes",
    "GuiderError",
    "GuiderWarning",
    "Policy",
    "act",
    "evaluate",
    "initial_state",
    "inspect",
    "load",
    "load_data",
    "make_episodes",
    "resume",
    "train",
]
