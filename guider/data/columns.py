"""Which arrays of a store, and which of their columns, are the state and the action: by name, or as they usually are
called.

A column goes by its array's name, by its own where the source names it (else its number), and by both:
`observation.state`, `x`, `observation.state.x`. Names may hold * and ?. Columns stand in the order in which they are
asked for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from guider.data.ends import LENGTHS, MARKS, TIMES
from guider.data.store import Store, describe_keys
from guider.errors import GuiderError

STATES = ("observations", "observation", "obs", "states", "state")
ACTIONS = ("actions", "action", "acs", "acts", "act")
ACHIEVED, DESIRED = "achieved_goal", "desired_goal"
_GROUPS = ("obs/", "observations/", "observation/", "observation.")
_ACTION_COLUMN = re.compile(r"(actions?|act|cmd|command|commanded|ctrl|controls?|u)(\W|_|\d|$)", re.IGNORECASE)
_OTHER_COLUMN = re.compile(
    r"((desired_?)?goal|target|reward|rewards|index|frame_index|task_index|step|success|next_\w+)(\W|_|\d|$)|unnamed",
    re.IGNORECASE,
)
_MOST_CHOICES = 32
_TABLES, _FILES = ("CSV", "parquet", "npy", "MCAP"), ("HDF5", "npz")


@dataclass(frozen=True)
class Chosen:
    """Columns of a store, side by side: rows [rows, columns] float32, and a name for each, () where none has one."""

    rows: np.ndarray
    names: tuple[str, ...]


def choose_states(store: Store, patterns: tuple[str, ...] = ()) -> Chosen:
    """The state: the columns that patterns mean, or where there are none those usually called so.

    Raises GuiderError, naming what there is, where it cannot be told.
    """
    if patterns:
        return _joined(store, _selected(store, patterns, "--state"))
    single = [key for key in STATES if _is_numbers(store, key)]
    grouped = [key for key in store.keys if key.startswith(_GROUPS) and _is_numbers(store, key)]
    grouped = [key for key in grouped if last_word(key) not in (ACHIEVED, DESIRED)]
    if not single and not grouped and store.kind in _TABLES:
        grouped = [key for key in store.keys if _is_numbers(store, key) and not _is_other(key)]
    keys = single[:1] or grouped
    if not keys:
        if pictured := next((key for key in (*STATES, *store.keys) if _is_picture(store, key)), None):
            raise store.fail(
                f"{pictured} holds pictures, and policies here see vectors; record joint or body positions "
                "beside them, and say which they are (--state NAME)"
            )
        if store.kind in _FILES:
            store.require(STATES[0])
        raise store.fail(
            f"which columns are the state? Say so (--state NAME ...); vectors of numbers are {_listed(store)}"
        )
    return _joined(store, [(key, None) for key in keys])


def choose_actions(store: Store, patterns: tuple[str, ...] = ()) -> Chosen:
    """The action, likewise. Raises GuiderError where it cannot be told, and for a discrete one."""
    if patterns:
        chosen = _selected(store, patterns, "--action")
    else:
        keys = [key for key in ACTIONS if _is_numbers(store, key)][:1]
        if not keys and store.kind in _TABLES:
            keys = [key for key in store.keys if _is_numbers(store, key) and _ACTION_COLUMN.match(key)]
        if not keys:
            if store.kind in _FILES:
                store.require(ACTIONS[0])
            raise store.fail(
                f"which columns are the action? Say so (--action NAME ...); vectors of numbers are {_listed(store)}"
            )
        chosen = [(key, None) for key in keys]
    _refuse_discrete(store, [key for key, _ in chosen])
    return _joined(store, chosen)


def entries_called(names: Sequence[str], state_dim: int, wanted: Sequence[str], source: str) -> tuple[int, ...]:
    """The state entries that patterns of names mean, in their order. names: of the state, () if it has none.

    Raises GuiderError, naming those there are, for one that means none.
    """
    found: list[int] = []
    for pattern in wanted:
        hits = [
            i for i, name in enumerate(names) if fnmatchcase(name, pattern) or fnmatchcase(last_word(name), pattern)
        ]
        if pattern.isdecimal() and int(pattern) < state_dim:
            hits.append(int(pattern))
        if not hits:
            there = describe_keys(tuple(names)) if names else f"0 to {state_dim - 1}, without names"
            raise GuiderError(
                f"{source}: no state entry is called {pattern!r}; there are {there} (what is computed is known once "
                "GUIDER_GOALS names its file)"
            )
        found.extend(hits)
    return tuple(dict.fromkeys(found))


def last_word(name: str) -> str:
    """What follows the last / or . of a name."""
    return re.split(r"[/.]", name)[-1] or name


def rows_called(store: Store, word: str) -> np.ndarray | None:
    """[rows, columns] of the array whose name ends in this word, None if there is none."""
    key = next((key for key in store.keys if last_word(key) == word and _is_numbers(store, key)), None)
    return None if key is None else _matrix(store, key)


def _selected(store: Store, patterns: Iterable[str], option: str) -> list[tuple[str, int | None]]:
    """(array, column) of all that the patterns mean, each once; None is all columns."""
    found: dict[tuple[str, int | None], None] = {}
    usable = [key for key in store.keys if _is_numbers(store, key)]
    for pattern in patterns:
        hits: list[tuple[str, int | None]] = [(key, None) for key in usable if fnmatchcase(key, pattern)]
        if not hits:
            hits = [
                (key, column)
                for key in usable
                for column, name in enumerate(_entry_names(store, key))
                if fnmatchcase(name, pattern) or fnmatchcase(f"{key}.{name}", pattern)
            ]
        if not hits:
            raise store.fail(f"{option} {pattern}: no column is called so; there are {_listed(store)}")
        found |= dict.fromkeys(hits)
    return list(found)


def _joined(store: Store, chosen: Sequence[tuple[str, int | None]]) -> Chosen:
    parts: list[np.ndarray] = []
    names: list[str] = []
    for key, column in chosen:
        rows = _matrix(store, key)
        entries = _entry_names(store, key)
        parts.append(rows if column is None else rows[:, column : column + 1])
        lone = rows.shape[1] == 1 and key not in store.entries
        own = [key] if lone else [name if key in store.entries else f"{key}.{name}" for name in entries]
        names.extend(own if column is None else [own[column]])
    for (key, _), part in zip(chosen, parts, strict=True):
        if len(part) != len(parts[0]):
            raise store.fail(
                f"{key} has {len(part)} rows but {chosen[0][0]} {len(parts[0])}; take columns of one length"
            )
    lone = len(chosen) == 1 and chosen[0][0] not in store.entries and chosen[0][0] in (*STATES, *ACTIONS)
    return Chosen(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1), () if lone else tuple(names))


def _matrix(store: Store, key: str) -> np.ndarray:
    array = store.arrays[key]
    if array is not None and len(array.shape) == 1:
        return store.vector(key).astype(np.float32)[:, None]
    return store.matrix(key)


def _entry_names(store: Store, key: str) -> tuple[str, ...]:
    return store.entries.get(key) or tuple(str(i) for i in range(max(1, store.width(key))))


def _is_numbers(store: Store, key: str) -> bool:
    """Whether an array of that name could be columns: what else is wrong with it, reading it says."""
    array = store.arrays.get(key)
    if key in (STATES[0], ACTIONS[0]) and key in store.keys:
        return not _is_picture(store, key)
    return array is not None and len(array.shape) in (1, 2) and array.kind in "fiub"


def _is_picture(store: Store, key: str) -> bool:
    array = store.arrays.get(key)
    return array is not None and len(array.shape) in (3, 4) and array.kind in "fiu"


def _is_other(key: str) -> bool:
    """Whether a table's column is usually no part of a state."""
    return bool(key in (LENGTHS, *MARKS, *TIMES) or _ACTION_COLUMN.match(key) or _OTHER_COLUMN.match(key))


def _refuse_discrete(store: Store, keys: Sequence[str]) -> None:
    array = store.arrays[keys[0]]
    if len(keys) != 1 or array is None or array.kind not in "iub" or max(1, store.width(keys[0])) != 1:
        return
    kinds = np.unique(_matrix(store, keys[0]))
    if len(kinds) <= _MOST_CHOICES:
        raise store.fail(
            f"{keys[0]} are whole numbers from {kinds[0]:g} to {kinds[-1]:g}, as of a choice among a few; actions here "
            "are continuous: give what each choice commands (speeds, torques, positions), or, if they are amounts, "
            "save them as floating-point numbers"
        )


def _listed(store: Store) -> str:
    names = []
    for key in store.keys:
        if _is_numbers(store, key):
            entries = store.entries.get(key)
            names.append(f"{key} ({describe_keys(entries)})" if entries else key)
    return describe_keys(tuple(names))
