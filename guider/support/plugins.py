"""Methods, tasks and goals from outside the package.

Of each kind are known what the files offer that an environment variable names (GUIDER_METHODS, GUIDER_TASKS,
GUIDER_GOALS; several as in PATH), and the modules that installed packages offer as entry points of a group
(`guider.methods`, `guider.tasks`, `guider.goals`). Each has a dictionary by name, METHODS, TASKS or GOALS. No name
makes code run: what a file of somebody else's asks for is found only where its user offered it.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal

from guider.errors import GuiderError, names_like

Kind = Literal["methods", "tasks", "goals"]


def check_environment(task: str, source: Path) -> None:
    """Raise GuiderError where a task that the file `source` names, gym:MODULE:ENV_ID, would import a module that its
    user has neither imported nor offered (GUIDER_ENVIRONMENTS; several as in PATH)."""
    form, _, identifier = task.partition(":")
    module, colon, _ = identifier.partition("?")[0].partition(":")
    offered = os.environ.get("GUIDER_ENVIRONMENTS", "").split(os.pathsep)
    if form == "gym" and colon and module not in sys.modules and module not in offered:
        raise GuiderError(
            f"{source} names the task {task}, for which the module {module} would be imported, and so run; if you know "
            f"it, say so: GUIDER_ENVIRONMENTS={module}"
        )


def find(kind: Kind, name: str, ours: Mapping[str, Any], hint: str = "") -> Any:
    """What is called `name`: one of `ours`, or from outside. Raises GuiderError, with the names closest to it and
    `hint`, if there is none, and where one from outside cannot be loaded."""
    if name in ours:
        return ours[name]
    own = known(kind, ours)
    if name in own:
        return own[name]
    way = f"one of your own is known once GUIDER_{kind.upper()} names its file"
    near = f"{names_like(name, own)}; " if own else ""
    raise GuiderError(f"there is no {kind[:-1]} {name!r}; {near}{hint}{way}")


def known(kind: Kind, ours: Mapping[str, Any]) -> dict[str, Any]:
    """`ours` and those from outside, by name."""
    own: dict[str, Any] = dict(ours)
    for place, offered in _offered(kind, os.environ.get(f"GUIDER_{kind.upper()}", "")).items():
        if taken := own.keys() & offered.keys():
            raise GuiderError(f"{place} calls a {kind[:-1]} {taken.pop()!r}, and that name is taken")
        own |= offered
    return own


@cache
def _offered(kind: Kind, files: str) -> dict[str, dict[str, Any]]:
    """place -> what it offers."""
    modules = {point.value: point.load for point in entry_points(group=f"guider.{kind}")}
    modules |= {file: lambda file=file: _loaded(Path(file)) for file in files.split(os.pathsep) if file}
    found = {}
    for place, load in modules.items():
        try:
            found[place] = getattr(load(), kind.upper())
        except Exception as error:
            raise GuiderError(f"{kind} of {place} cannot be loaded: {type(error).__name__}: {error}") from error
    return found


def _loaded(file: Path) -> Any:
    spec = importlib.util.spec_from_file_location(f"guider_own_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ImportError("not a file of Python's")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
