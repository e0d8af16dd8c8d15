"""Frozen dataclass configs to and from JSON and the command line, with every value checked."""

from __future__ import annotations

import ast
import dataclasses
import json
import types
from functools import reduce
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from guider.errors import GuiderError, names_like

C = TypeVar("C")
Changes = dict[str, Any]
"""Settings by dotted name."""
ByDomain = dict[str | None, Changes]
"""The same by domain of tasks (guider.learning.problem)."""


def to_dict(config: Any) -> dict[str, Any]:
    """Nested plain values, as JSON gives them back."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_dict(config_type: type[C], values: dict[str, Any], where: str = "config") -> C:
    """The inverse of `to_dict`. Raises GuiderError on unknown or missing names and on values of a wrong type."""
    hints = get_type_hints(config_type)
    if not isinstance(values, dict):
        raise GuiderError(f"{where} must hold settings by name, got {values!r}")
    for name in values:
        if name not in hints:
            raise GuiderError(f"{where} has no setting {name!r}; {names_like(name, hints)}")
    for name in hints:
        if name not in values:
            raise GuiderError(f"{where} lacks the setting {name!r}; it was written by another version")
    return config_type(**{name: _convert(hints[name], value, f"{where}.{name}") for name, value in values.items()})


def override(config: C, assignments: Changes) -> C:
    """Replace settings named by dotted paths. Texts are read as typed on a command line: {"high.samples": "4"}.

    Another `kind` comes with its own settings, those that are not named as preset `paper` has them.
    """
    values = to_dict(config)
    for path, text in sorted(assignments.items(), key=lambda assignment: not assignment[0].endswith(".kind")):
        *parents, name = path.split(".")
        inner = values
        for parent in parents:
            inner = inner.get(parent) if isinstance(inner, dict) else None
        if not isinstance(inner, dict) or name not in inner or isinstance(inner[name], dict):
            raise GuiderError(f"no setting is called {path!r}; {names_like(path, flatten(values))}")
        value = _parse(text) if isinstance(text, str) else text
        if name == "kind" and parents and isinstance(value, str) and value != inner[name]:
            inner.clear()
            inner |= to_dict(_default_of_kind(config, parents, value))
        else:
            inner[name] = value
    return from_dict(type(config), values)


def _default_of_kind(config: Any, parents: list[str], kind: str) -> Any:
    """What stands where `parents` lead to, were it of another kind."""
    *above, name = parents
    options = list(get_args(get_type_hints(type(reduce(getattr, above, config)))[name]))
    return _of_kind(options, kind, ".".join(["config", *parents]))()


def differences(config: Any, reference: Any) -> dict[str, Any]:
    """Dotted names and values of the settings in which `config` departs from `reference`, or that this lacks."""
    ours, theirs = flatten(to_dict(config)), flatten(to_dict(reference))
    return {name: value for name, value in ours.items() if name not in theirs or value != theirs[name]}


def flatten(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """{"high": {"samples": 4}} -> {"high.samples": 4}."""
    flat = {}
    for name, value in values.items():
        flat |= flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def merged(defaults: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """`given`, and from `defaults` what it lacks, in the settings within settings too."""
    both = (name for name, value in given.items() if isinstance(value, dict) and isinstance(defaults.get(name), dict))
    return defaults | given | {name: merged(defaults[name], given[name]) for name in both}


def under(name: str, changes: Changes) -> Changes:
    """The same settings of the config that `name` leads to."""
    return {f"{name}.{setting}": value for setting, value in changes.items()}


def check_fraction(config: Any, *names: str) -> None:
    """Raise GuiderError unless the named settings lie in [0, 1]."""
    for name in names:
        if not 0 <= getattr(config, name) <= 1:
            raise GuiderError(f"{name} must lie between 0 and 1, got {getattr(config, name)}")


def check_positive(config: Any, *names: str) -> None:
    """Raise GuiderError unless the named settings are above 0."""
    for name in names:
        if not 0 < getattr(config, name) < float("inf"):
            raise GuiderError(f"{name} must be above 0 and finite, got {getattr(config, name)}")


def check_networks(config: Any) -> None:
    """Raise GuiderError unless there is a hidden layer, every one has a unit, and there is an update to make."""
    if not config.hidden or min(config.hidden) < 1:
        raise GuiderError(f"hidden must name one or more layers of one or more units, got {config.hidden}")
    check_positive(config, "updates", "batch_size", "learning_rate")


def check_not_negative(config: Any, *names: str) -> None:
    """Raise GuiderError if one of the named settings is below 0."""
    for name in names:
        if getattr(config, name) < 0:
            raise GuiderError(f"{name} must not be below 0, got {getattr(config, name)}")


def check_shares(config: Any) -> None:
    """Raise GuiderError if relabelled and random goals together are more than all goals."""
    if config.relabel_fraction + config.random_goal_fraction > 1 + 1e-9:
        raise GuiderError("relabel_fraction and random_goal_fraction add up to more than 1")


def _parse(text: str) -> Any:
    try:
        return ast.literal_eval({"true": "True", "false": "False", "none": "None"}.get(text.lower(), text))
    except (ValueError, SyntaxError):
        return text


def _of_kind(options: list[Any], value: Any, where: str) -> Any:
    """The config among several whose `kind` the value names."""
    kinds = {get_args(get_type_hints(option)["kind"])[0]: option for option in options}
    kind = value.get("kind") if isinstance(value, dict) else value
    if kind not in list(kinds):
        raise GuiderError(f"{where}.kind must be one of {', '.join(kinds)}, got {kind!r}")
    return kinds[kind]


def _convert(hint: Any, value: Any, where: str) -> Any:
    """`value` as JSON, NumPy or a command line gives it, as the type the hint names."""
    if isinstance(value, np.generic):
        value = value.item()
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if isinstance(value, dict):
            return from_dict(hint, value, where)
    elif get_origin(hint) is Literal:
        if value in get_args(hint):
            return value
        raise GuiderError(f"{where} must be one of {', '.join(map(str, get_args(hint)))}, got {value!r}")
    elif get_origin(hint) in (Union, types.UnionType):
        if value is None and type(None) in get_args(hint):
            return None
        options = [option for option in get_args(hint) if option is not type(None)]
        return _convert(options[0] if len(options) == 1 else _of_kind(options, value, where), value, where)
    elif get_origin(hint) is tuple:
        if isinstance(value, list | tuple):
            return tuple(_convert(get_args(hint)[0], item, where) for item in value)
    elif hint is Any:
        return value
    elif hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    elif type(value) is hint:
        return value
    raise GuiderError(f"{where} must be of type {getattr(hint, '__name__', hint)}, got {value!r}")
