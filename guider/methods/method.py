"""What a method is: a few pure functions, which are all that training and acting use of it. Each stands in its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from guider.learning.options import Preset
from guider.learning.problem import Problem


@dataclass(frozen=True)
class Subgoals:
    """Of a method that names places to go to: what scores and pictures ask of these. Arrays are batches, B long.

    pursued:    (config, acting_state) -> (subgoals [B, G] in goal units, whether each is new [B])
    propose:    (config, state, observation, achieved, goal) -> (subgoals [B, G], what being there is worth [B])
    worth:      (config) -> what that is, in a few words
    reach:      (config, state, observation, achieved, subgoal, goal) -> actions [B, A] in [-1, 1] of its low level
    periodic:   (config) -> settings with which a subgoal is always decoded, and kept for c steps (Figure 7)
    reachable:  (config, state, achieved, count) -> [count, B, G] samples of where it holds c steps may lead
    fit:        (config, state, achieved, outcome) -> share of what c steps led to that it holds for likely, at 95 %
    dead_end:   (config, state, achieved, goal) -> (whether no way that it knows leads to the goal [B], where the way to
                what is nearest to it ends [B, G]), None where it knows no ways
    The last four are None of a method that keeps no subgoal, learns nothing of what is reachable, or never knows ways.
    """

    pursued: Callable[..., Any]
    propose: Callable[..., Any]
    worth: Callable[..., str]
    reach: Callable[..., Any]
    periodic: Callable[..., Any] | None = None
    reachable: Callable[..., Any] | None = None
    fit: Callable[..., Any] | None = None
    dead_end: Callable[..., Any] | None = None


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
    subgoals: what it says of its subgoals, None where it has none in goal space
    metric_labels: (config) -> what its metrics are called in pictures, where plots/curves.py does not know
    """

    label: str
    config_type: type
    config: Callable[[Preset, Problem], Any]
    init: Callable[..., Any]
    stages: Callable[..., Any]
    initial_acting_state: Callable[..., Any]
    act: Callable[..., Any]
    acts_by: Callable[..., str]
    subgoals: Subgoals | None = None
    metric_labels: Callable[..., dict[str, str]] = lambda config: {}
