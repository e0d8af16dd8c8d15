"""What a method is: a few pure functions, which are all that training and acting use of it. Each stands in its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from guider.learning.options import Preset
from guider.learning.problem import Problem


@dataclass(frozen=True)
class Method:
    """One method; `config` is an instance of `config_type` throughout, and has the fields `problem`
    (learning/problem.py), `view` (view.py), `precision`, of training (learning/networks.py), and `action_scale`, of
    acting (policy.py).

    label:    in tables and figures
    config:   (preset, problem) -> config
    init:     (config, spaces, scale, key) -> state of one seed
    stages:   (config) -> stages for the engine
    initial_acting_state: (config, goal_dim, batch_size) -> what acting remembers between steps
    act:      (config, state, goal_indices, observation, goal, acting_state, reset_mask)
              -> (actions in [-1, 1], acting_state)
    acts_by:  (config) -> how it chooses what it does, in a few words
    pursued:  (config, acting_state) -> (subgoals [B, G] in goal units, whether each is new [B]), None without subgoals
    """

    label: str
    config_type: type
    config: Callable[[Preset, Problem], Any]
    init: Callable[..., Any]
    stages: Callable[..., Any]
    initial_acting_state: Callable[..., Any]
    act: Callable[..., Any]
    acts_by: Callable[..., str]
    pursued: Callable[..., Any] | None = None
