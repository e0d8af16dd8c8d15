"""Every method offers the same few pure functions, which are all that training and acting use of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from guider.methods import flat, guider, hiql, opal


@dataclass(frozen=True)
class Method:
    """The functions of one method; `config` is an instance of `config_type` throughout, and has the fields `problem`
    (guider.problem), `view` (guider.methods.view), `precision`, of training (guider.networks), and `action_scale`, of
    acting (guider.policy).

    init:     (config, spaces, scale, key) -> state of one seed
    stages:   (config) -> stages for the engine
    initial_acting_state: (config, goal_dim, batch_size) -> what acting remembers between steps
    act:      (config, state, goal_indices, observation, goal, acting_state, reset_mask)
              -> (actions in [-1, 1], acting_state)
    acts_by:  (config) -> how it chooses what it does, in a few words
    pursued:  (config, acting_state) -> (subgoals [B, G] in goal units, whether each is new [B]), None without subgoals
    """

    config_type: type
    init: Callable[..., Any]
    stages: Callable[..., Any]
    initial_acting_state: Callable[..., Any]
    act: Callable[..., Any]
    acts_by: Callable[..., str]
    pursued: Callable[..., Any] | None = None


_FLAT = Method(flat.FlatConfig, flat.init, flat.stages, flat.initial_acting_state, flat.act, flat.acts_by)
_GUIDER = Method(
    guider.GuiderConfig,
    guider.init,
    guider.stages,
    guider.initial_acting_state,
    guider.act,
    guider.acts_by,
    guider.pursued,
)
_HIQL = Method(hiql.HiqlConfig, hiql.init, hiql.stages, hiql.initial_acting_state, hiql.act, hiql.acts_by)
_OPAL = Method(opal.OpalConfig, opal.init, opal.stages, opal.initial_acting_state, opal.act, opal.acts_by)

METHODS = {
    "guider": _GUIDER,
    "guider-gcsl": _GUIDER,
    "guider-wgcsl": _GUIDER,
    "guider-cql": _GUIDER,
    "bc": _FLAT,
    "gcsl": _FLAT,
    "wgcsl": _FLAT,
    "cql-her": _FLAT,
    "iql": _FLAT,
    "hiql": _HIQL,
    "hiql-places": _HIQL,
    "opal": _OPAL,
}
"""Methods by name; guider.presets holds what tells those of one family apart."""
