"""Every method offers the same few pure functions, which are all that training and acting use of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from guider.methods import guider


@dataclass(frozen=True)
class Method:
    """The functions of one method; `config` is an instance of `config_type` throughout.

    prepare:  (config, episodes) -> (device data, input scale)
    unit_scale: (config, spaces) -> a scale of the right shapes
    init:     (config, spaces, scale, key) -> state of one seed
    stages:   (config) -> stages for the engine
    initial_acting_state: (config, goal_dim, batch_size) -> what acting remembers between steps
    act:      (config, state, goal_indices, observation, goal, acting_state, reset_mask)
              -> (actions in [-1, 1], acting_state)
    """

    config_type: type
    prepare: Callable[..., Any]
    unit_scale: Callable[..., Any]
    init: Callable[..., Any]
    stages: Callable[..., Any]
    initial_acting_state: Callable[..., Any]
    act: Callable[..., Any]


METHODS = {
    "guider": Method(
        config_type=guider.GuiderConfig,
        prepare=guider.prepare,
        unit_scale=guider.unit_scale,
        init=guider.init,
        stages=guider.stages,
        initial_acting_state=guider.initial_acting_state,
        act=guider.act,
    )
}
