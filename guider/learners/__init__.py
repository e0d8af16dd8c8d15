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
from guider.support.config import override

__all__ = [
    "AwrConfig",
    "CqlConfig",
    "GcslConfig",
    "IqlConfig",
    "Learner",
    "LearnerConfig",
    "Transitions",
    "WgcslConfig",
    "fast_learner",
    "learner",
]

LearnerConfig = AwrConfig | CqlConfig | GcslConfig | IqlConfig | WgcslConfig

_LEARNERS: dict[type, Learner] = {
    AwrConfig: Learner(awr.init, awr.update, awr.act, awr.FAST, awr.FAST_IN_DOMAIN),
    CqlConfig: Learner(cql.init, cql.update, cql.act, cql.FAST, cql.FAST_IN_DOMAIN),
    GcslConfig: Learner(gcsl.init, gcsl.update, gcsl.act, gcsl.FAST, gcsl.FAST_IN_DOMAIN),
    IqlConfig: Learner(iql.init, iql.update, iql.act, iql.FAST, iql.FAST_IN_DOMAIN),
    WgcslConfig: Learner(wgcsl.init, wgcsl.update, wgcsl.act, wgcsl.FAST, wgcsl.FAST_IN_DOMAIN),
}


def learner(config: LearnerConfig) -> Learner:
    """The learner that a config is of."""
    return _LEARNERS[type(config)]


def fast_learner(config: LearnerConfig, domain: str | None) -> LearnerConfig:
    """With what preset `fast` changes."""
    found = learner(config)
    return override(config, found.fast | found.fast_in_domain.get(domain, {}))
