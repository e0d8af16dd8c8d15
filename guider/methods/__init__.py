"""Methods: how a policy comes out of logged data. One file each; a family of several shares one.

Files of your own are methods too, once the environment variable GUIDER_METHODS names them (several as in PATH), or an
installed package offers them as entry points of the group `guider.methods`. See docs/own_method.py.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, get_args

from guider.errors import GuiderError, names_like
from guider.learning.problem import Problem
from guider.methods import flat, guider, hiql, opal
from guider.methods.method import Method
from guider.methods.presets import Preset

METHODS: dict[str, Method] = guider.METHODS | flat.METHODS | hiql.METHODS | opal.METHODS
"""This package's, by name."""


def find_method(name: str) -> Method:
    """A method by name. Raises GuiderError for one that is none, and where one of your own cannot be loaded.

    No name makes code run: your own are those that GUIDER_METHODS and installed packages offer.
    """
    if name in METHODS:
        return METHODS[name]
    own = _own_methods(os.environ.get("GUIDER_METHODS", ""))
    if name in own:
        return own[name]
    hint = "one of your own is known once GUIDER_METHODS names its file"
    raise GuiderError(f"there is no method {name!r}; {names_like(name, METHODS | own)}; {hint}")


@cache
def _own_methods(files: str) -> dict[str, Method]:
    modules = {point.value: point.load for point in entry_points(group="guider.methods")}
    modules |= {file: lambda file=file: _loaded(Path(file)) for file in files.split(os.pathsep) if file}
    own: dict[str, Method] = {}
    for place, load in modules.items():
        try:
            offered = load().METHODS
        except Exception as error:
            raise GuiderError(f"methods of {place} cannot be loaded: {type(error).__name__}: {error}") from error
        if taken := (METHODS | own).keys() & offered.keys():
            raise GuiderError(f"{place} calls a method {taken.pop()!r}, and that name is taken")
        own |= offered
    return own


def _loaded(file: Path) -> Any:
    spec = importlib.util.spec_from_file_location(f"guider_methods_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ImportError("not a file of Python's")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def preset_config(method: str, preset: Preset, problem: Problem) -> Any:
    """A method's settings for a problem. Raises GuiderError for a method or preset that is none."""
    if preset not in get_args(Preset):
        raise GuiderError(f"there is no preset {preset!r}; {names_like(str(preset), get_args(Preset))}")
    return find_method(method).config(preset, problem)
