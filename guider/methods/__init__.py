"""Methods: how a policy comes out of logged data. One file each; a family of several shares one.

Yours may stand in a file of your own: see docs/own_method.py.
"""

from __future__ import annotations

from typing import Any, get_args

from guider.errors import GuiderError, names_like
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.methods import critic_guided, flat, guider, hiql, opal
from guider.methods.method import Method
from guider.methods.routed import routed
from guider.support import plugins

_ALONE = flat.METHODS | hiql.METHODS | critic_guided.METHODS
_ROUTED = {f"{name}-routes": routed(_ALONE[name]) for name in ("gcsl", "gciql", "hiql")}
METHODS: dict[str, Method] = guider.METHODS | opal.METHODS | _ALONE | _ROUTED
"""This package's, by name."""


def find_method(name: str) -> Method:
    """A method by name. Raises GuiderError for one that is none, and where one of your own cannot be loaded."""
    return plugins.find("methods", name, METHODS)


def preset_config(method: str, preset: Preset, problem: Problem) -> Any:
    """A method's settings for a problem. Raises GuiderError for a method or preset that is none."""
    if preset not in get_args(Preset):
        raise GuiderError(f"there is no preset {preset!r}; {names_like(str(preset), get_args(Preset))}")
    return find_method(method).config(preset, problem)
