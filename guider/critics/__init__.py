"""Critics: what says which logged or proposed actions lead to a goal. A policy that follows one is a method
(guider.methods.critic_guided)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from guider.critics import contrastive, iql, ivl, quasimetric
from guider.critics.contrastive import ContrastiveConfig
from guider.critics.iql import ImplicitQConfig
from guider.critics.ivl import ImplicitVConfig
from guider.critics.quasimetric import QuasimetricConfig
from guider.critics.types import Steps

__all__ = [
    "ContrastiveConfig",
    "Critic",
    "CriticConfig",
    "ImplicitQConfig",
    "ImplicitVConfig",
    "QuasimetricConfig",
    "Steps",
    "critic",
]

CriticConfig = ContrastiveConfig | ImplicitQConfig | ImplicitVConfig | QuasimetricConfig


@dataclass(frozen=True)
class Critic:
    """The functions of one critic; `config` is an instance of its config type throughout.

    init:      (key, config, hidden, state_dim, place_dim, action_dim) -> parameters
    loss:      (config, parameters, trailing parameters, Steps, discount) -> (loss, metrics)
    quality:   (config, parameters, state, action, goal) -> [B] the more, the better; None where actions are not asked
    advantage: (config, parameters, Steps) -> [B] by how much the logged step was better than usual; None where actions
               are asked
    """

    init: Callable[..., Any]
    loss: Callable[..., Any]
    quality: Callable[..., Any] | None = None
    advantage: Callable[..., Any] | None = None


_CRITICS: dict[type, Critic] = {
    ContrastiveConfig: Critic(contrastive.init, contrastive.loss, quality=contrastive.quality),
    ImplicitQConfig: Critic(iql.init, iql.loss, quality=iql.quality),
    ImplicitVConfig: Critic(ivl.init, ivl.loss, advantage=ivl.advantage),
    QuasimetricConfig: Critic(quasimetric.init, quasimetric.loss, quality=quasimetric.quality),
}


def critic(config: CriticConfig) -> Critic:
    """The critic that a config is of."""
    return _CRITICS[type(config)]
