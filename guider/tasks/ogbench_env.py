"""What OGBench's mazes and tables share: the package, which is an extra, and its protocol of five goals."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import gymnasium

from guider.collect.ogbench import Play, Recipe, record
from guider.support.extras import extra
from guider.tasks.simulation import on_all_cores
from guider.tasks.types import Collector

GOALS = 5
"""Of every environment. Episode e aims at goal 1 + e % 5."""


class Data(NamedTuple):
    """One of the sets that OGBench publishes for an environment: who acts, and how much of it there is."""

    play: Play
    episodes: int
    episode_steps: int


def make_unwrapped(env_id: str, **settings: Any) -> Any:
    """OGBench's environment. Raises GuiderError without the package."""
    with warnings.catch_warnings(), extra("ogbench", f"OGBench, of which {env_id} is,"):
        warnings.simplefilter("ignore")  # of a screen that is not there
        import ogbench  # noqa: F401  (it registers its environments)
    warnings.filterwarnings("ignore", ".*precision lowered by casting")  # of its action spaces, at every reset
    warnings.filterwarnings("ignore", ".*DISPLAY environment variable")
    logging.getLogger("absl").setLevel(logging.ERROR)  # the arm's inverse kinematics warn of a search that goes on
    return gymnasium.make(env_id, disable_env_checker=True, **settings).unwrapped


def collector(make_env: Callable[[], Any], data: Data, recipe: str) -> Collector:
    """Records by OGBench's protocol."""
    asked = Recipe(make_env, data.play, data.episode_steps)
    return Collector(partial(on_all_cores, asked, record=record), data.episodes * data.episode_steps, recipe)
