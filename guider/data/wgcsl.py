"""WGCSL's logs: a pickled dict of arrays o, u, g and ag, read without unpickling.

A pickle is a program, and whoever wrote the file wrote it. None of it is run here: the opcodes that NumPy's arrays are
pickled with are walked through, the calls they ask for are noted instead of made, and any other opcode or name is
refused. What the notes say about each array is then checked, and its bytes are viewed as numbers.
"""

from __future__ import annotations

import math
import mmap
import pickletools
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.episodes import EndSign
from guider.data.minari import with_goal_space
from guider.data.safety import memory_fault
from guider.data.store import Recording
from guider.errors import GuiderError

# Names as NumPy 1 spells them; NumPy 2 says numpy._core.
_ADMITTED = (
    "numpy.ndarray",
    "numpy.dtype",
    "numpy.core.multiarray._reconstruct",
    "numpy.core.multiarray.scalar",
    "numpy.core.numeric._frombuffer",
    "_codecs.encode",
)
_MOST_OPCODES = 10_000  # an array takes about 40
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_LITERALS = (
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"),
    *("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
    *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
)
_MARK = object()


@dataclass(frozen=True)
class _Name:
    """A function that the pickle names."""

    text: str


@dataclass
class _Call:
    """A call that unpickling would make, and the state that it would then give to the result."""

    function: str
    arguments: tuple[Any, ...]
    state: Any = None


class _RefusedError(Exception):
    """Why a pickle is not read."""


def is_pickle(path: Path) -> bool:
    """Whether the file begins as pickles of protocol 2 or newer do."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            head = file.read(2)
    except OSError:
        return False
    return len(head) == 2 and head[0] == 0x80 and 2 <= head[1] <= 5


def read_wgcsl(path: Path, goal_indices: tuple[int, ...] | None) -> Recording:
    """Read o [episodes, T + 1, state], u [episodes, T, action], g [episodes, T, goal], ag [episodes, T + 1, goal]:
    states, actions, the goals aimed at and the goals achieved. Other entries are ignored.

    `ag` is put in front of the state where it is not among its entries, so that a goal space can always be named by
    state entries; `g` is kept where `ag` is the goal space asked for, or none is. An episode's last goal stands for its
    last state too. Raises GuiderError for anything but arrays of numbers in these shapes.
    """

    def fail(message: str) -> GuiderError:
        return GuiderError(f"{path}: {message}")

    if not is_pickle(path):
        raise fail("no such file, or not a pickle of protocol 2 to 5")
    try:
        with (
            warnings.catch_warnings(),
            path.open("rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        ):
            warnings.simplefilter("ignore")  # the interpreter's, about escapes in names
            notes = _walk(content)
        states, actions, goals, achieved = (_array(notes, key) for key in ("o", "u", "g", "ag"))
    except _RefusedError as refused:
        raise fail(str(refused)) from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise fail(f"the pickle is damaged or cut off ({' '.join(str(error).split())})") from error

    episodes, steps = actions.shape[:2]
    for key, array, rows in (("o", states, steps + 1), ("g", goals, steps), ("ag", achieved, steps + 1)):
        if array.shape[:2] != (episodes, rows):
            raise fail(f"{key} has shape {array.shape}, but u {actions.shape} asks for {(episodes, rows)} rows")
    if goals.shape[2] != achieved.shape[2]:
        raise fail(f"g has {goals.shape[2]} columns but ag has {achieved.shape[2]}")
    flat, own, kept = with_goal_space(
        _flat(states), _flat(achieved), _flat(np.concatenate([goals, goals[:, -1:]], axis=1)), goal_indices, str(path)
    )
    return Recording(
        observations=flat,
        actions=_flat(np.concatenate([actions, np.zeros_like(actions[:, :1])], axis=1)),
        lengths=np.full(episodes, steps + 1),
        goals=kept,
        end_signs=(EndSign("the arrays' first axis", episodes),),
        goal_indices=own,
    )


def _flat(array: np.ndarray) -> np.ndarray:
    """[episodes, rows, columns] -> [episodes * rows, columns]."""
    return array.reshape(-1, array.shape[2])


def _walk(content: mmap.mmap) -> Any:
    """What the pickle makes, with a _Call in the place of every result of a call.

    Sizes that the pickle declares cannot make this ask for memory that the file does not fill: bytes are read from
    mapped memory, which ends where the file does, and the memo is a dict.
    """
    stack: list[Any] = []
    memo: dict[int, Any] = {}

    def pop_to_mark() -> list[Any]:
        mark = max(i for i, item in enumerate(stack) if item is _MARK)
        items = stack[mark + 1 :]
        del stack[mark:]
        return items

    operations: Iterator[tuple[Any, Any, Any]] = pickletools.genops(content)  # pyright: ignore[reportArgumentType]
    for number, (opcode, argument, _) in enumerate(operations):
        if number == _MOST_OPCODES:
            raise _RefusedError(f"the pickle has more than {_MOST_OPCODES} opcodes")
        match opcode.name:
            case "PROTO" | "FRAME":
                pass
            case "STOP":
                return stack.pop()
            case "MARK":
                stack.append(_MARK)
            case name if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case name if name in _LITERALS:
                stack.append(argument)
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                size = int(opcode.name[-1])
                stack[-size:] = [tuple(stack[-size:])]
            case "TUPLE":
                stack.append(tuple(pop_to_mark()))
            case "EMPTY_DICT":
                stack.append({})
            case "SETITEM":
                value, key = stack.pop(), stack.pop()
                _set_items(stack[-1], [key], [value])
            case "SETITEMS":
                items = pop_to_mark()
                _set_items(stack[-1], items[::2], items[1::2])
            case "BINPUT" | "LONG_BINPUT":
                memo[argument] = stack[-1]
            case "MEMOIZE":
                memo[len(memo)] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(memo[argument])
            case "GLOBAL":
                stack.append(_name(*argument.split(" ")))
            case "STACK_GLOBAL":
                name, module = stack.pop(), stack.pop()
                stack.append(_name(module, name))
            case "REDUCE":
                arguments, function = stack.pop(), stack.pop()
                if not isinstance(function, _Name) or not isinstance(arguments, tuple):
                    raise _RefusedError("the pickle calls something that is not a function")
                stack.append(_Call(function.text, arguments))
            case "BUILD":
                state = stack.pop()
                if not isinstance(stack[-1], _Call):
                    raise _RefusedError("the pickle changes an object that is not an array")
                stack[-1].state = state
            case name:
                raise _RefusedError(f"the pickle holds something other than a dict of arrays ({name})")
    raise ValueError("it has no end")


def _name(module: Any, name: Any) -> _Name:
    text = f"{module}.{name}" if isinstance(module, str) and isinstance(name, str) else "something without a name"
    text = text.replace("numpy._core.", "numpy.core.", 1)
    if text not in _ADMITTED:
        raise _RefusedError(f"the pickle asks for {text[:80]!r}; only arrays of numbers are read, and nothing is run")
    return _Name(text)


def _set_items(target: Any, keys: list[Any], values: list[Any]) -> None:
    if not isinstance(target, dict) or not all(isinstance(key, str) for key in keys):
        raise _RefusedError("the pickle holds a dict whose keys are not text")
    target.update(zip(keys, values, strict=True))


def _array(notes: Any, key: str) -> np.ndarray:
    """[episodes, rows, columns] float32: the array that was noted under `key`."""
    if not isinstance(notes, dict) or key not in notes:
        raise _RefusedError(f"the pickle is not a dict with {key}")
    match notes[key]:
        case _Call("numpy.core.multiarray._reconstruct", _, (_, shape, dtype, in_columns, buffer)):
            order, axes = ("F" if in_columns else "C"), ()
        case _Call("numpy.core.numeric._frombuffer", (buffer, dtype, shape, order, *axes)):
            pass  # order K: in rows, with the axes transposed after that
        case _:
            raise _RefusedError(f"{key} is not an array")
    if isinstance(buffer, _Call) and buffer.function == "_codecs.encode":  # protocol 2 spells bytes as text
        buffer = buffer.arguments[0].encode("latin-1")
    kind = _number_type(dtype)
    if not isinstance(buffer, bytes | bytearray) or order not in ("C", "F", "K"):
        raise _RefusedError(f"{key} is not an array of numbers")
    if not isinstance(shape, tuple) or not all(type(size) is int and size > 0 for size in shape):
        raise _RefusedError(f"{key} has no proper shape")
    if len(shape) != 3:
        raise _RefusedError(f"{key} has {len(shape)} dimensions instead of [episodes, rows, columns]")
    if math.prod(shape) * kind.itemsize != len(buffer):
        raise _RefusedError(f"{key} declares shape {shape} but holds {len(buffer)} bytes")
    if fault := memory_fault(key, 4 * math.prod(shape)):
        raise _RefusedError(fault)
    array = np.frombuffer(buffer, kind).reshape(shape, order="F" if order == "F" else "C")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array.transpose(axes[0]) if axes else array, np.float32)


def _number_type(noted: Any) -> np.dtype:
    match noted:
        case _Call("numpy.dtype", (str(code), *_), (_, "<" | ">" | "|" as byte_order, *_)) if re.fullmatch(
            "f[248]|[iu][1248]", code
        ):
            return np.dtype(byte_order + code)
    raise _RefusedError("the pickle holds an array of something other than numbers")
