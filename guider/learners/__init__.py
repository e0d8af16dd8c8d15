"""Learners: how a goal-conditioned policy comes out of labelled transitions. Alone on final goals they are flat methods
(guider.methods.flat); on subgoals they are low levels for Guider (Figure 4)."""

from __future__ import annotations

from guider.learners import awr, cql, gcsl, iql, wgcsl
from guider.learners.awr import AwrConfig
from guider.learners.cql import CqlConfig
from guider.learners.gcsl import GcslConfig
from guider.learners.iql import IqlConfig
from guider.learners.types import Learner, Transitions
from guider.learners.wgcsl import WgcslConfig

__all__ = [
    "AwrConfig",
    "CqlConfig",
    "GcslConfig",
    "IqlConfig",
    "Learner",
    "LearnerConfig",
    "Transitions",
    "WgcslConfig",
    "learner",
]

LearnerConfig = AwrConfig | CqlConfig | GcslConfig | IqlConfig | WgcslConfig

_LEARNERS: dict[type, Learner] = {
    AwrConfig: Learner(awr.init, awr.update, awr.act),
    CqlConfig: Learner(cql.init, cql.update, cql.act),
    GcslConfig: Learner(gcsl.init, gcsl.update, gcsl.act),
    IqlConfig: Learner(iql.init, iql.update, iql.act),
    WgcslConfig: Learner(wgcsl.init, wgcsl.update, wgcsl.act),
}


def learner(config: LearnerConfig) -> Learner:
    """The learner that a config is of."""
    return _LEARNERS[type(config)]
