"""Methods: how a policy comes out of logged data. One file each; a family of several shares one."""

from __future__ import annotations

from typing import Any, get_args

from guider.learning.problem import Problem
from guider.methods import flat, guider, hiql, opal
from guider.methods.method import Method
from guider.methods.presets import Preset
from guider.support.errors import GuiderError, names_like

METHODS: dict[str, Method] = guider.METHODS | flat.METHODS | hiql.METHODS | opal.METHODS


def preset_config(method: str, preset: Preset, problem: Problem) -> Any:
    """A method's settings for a problem. Raises GuiderError for a method or preset that is none."""
    for kind, name, names in (("method", method, METHODS), ("preset", preset, get_args(Preset))):
        if name not in names:
            raise GuiderError(f"there is no {kind} {name!r}; {names_like(str(name), names)}")
    return METHODS[method].config(preset, problem)
