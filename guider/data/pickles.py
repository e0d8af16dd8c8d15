"""Pickles, read without unpickling.

A pickle is a program, and whoever wrote the file wrote it. None of it is run here: the opcodes that dicts, lists and
NumPy's arrays are pickled with are walked through, the calls they ask for are noted instead of made, and any other
opcode or name is refused. What the notes say about each array is then checked, and its bytes are viewed as numbers.
"""

from __future__ import annotations

import math
import mmap
import pickletools
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.safety import first_bytes, memory_fault
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
_MOST_OPCODES = 10_000_000  # an array takes about 40, and each is noted in some 100 bytes
_SMALL_BYTES = 1 << 20
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


@contextmanager
def open_pickle(path: Path) -> Iterator[Any]:
    """What the pickle at `path` makes: dicts, lists, tuples, text and numbers as they are, and notes of arrays, for
    `array` and `objects`. Raises GuiderError for a pickle of anything else, or a damaged one, within the context too.
    """
    with (
        pickle_faults(str(path)),
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        yield notes(content)


@contextmanager
def pickle_faults(name: str) -> Iterator[None]:
    """What goes wrong with a pickle in this context, as GuiderError with `name` in front."""
    try:
        yield
    except _RefusedError as refused:
        raise GuiderError(f"{name}: {refused}") from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise GuiderError(f"{name}: the pickle is damaged or cut off ({' '.join(str(error).split())})") from error


def is_pickle(path: Path) -> bool:
    """Whether the file begins as pickles of protocol 2 or newer do."""
    head = first_bytes(path, 2)
    return len(head) == 2 and head[0] == 0x80 and 2 <= head[1] <= 5


def notes(content: mmap.mmap | bytes) -> Any:
    """What the pickle makes, with a _Call in the place of every result of a call. Within `pickle_faults`.

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
    for number, (opcode, argument, _) in enumerate(_quietly(operations)):
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
            case "EMPTY_LIST":
                stack.append([])
            case "APPEND":
                item = stack.pop()
                _append(stack[-1], [item])
            case "APPENDS":
                items = pop_to_mark()
                _append(stack[-1], items)
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
                raise _RefusedError(f"the pickle holds something other than dicts, lists and arrays ({name})")
    raise ValueError("it has no end")


def _name(module: Any, name: Any) -> _Name:
    text = f"{module}.{name}" if isinstance(module, str) and isinstance(name, str) else "something without a name"
    text = text.replace("numpy._core.", "numpy.core.", 1)
    if text not in _ADMITTED:
        raise _RefusedError(f"the pickle asks for {text[:80]!r}; only arrays of numbers are read, and nothing is run")
    return _Name(text)


def _quietly(operations: Iterator[Any]) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the interpreter's, about escapes in names
        yield from operations


def _append(target: Any, items: list[Any]) -> None:
    if not isinstance(target, list):
        raise _RefusedError("the pickle appends to something that is not a list")
    target.extend(items)


def _set_items(target: Any, keys: list[Any], values: list[Any]) -> None:
    if not isinstance(target, dict) or not all(isinstance(key, str) for key in keys):
        raise _RefusedError("the pickle holds a dict whose keys are not text")
    target.update(zip(keys, values, strict=True))


def array(note: Any, name: str) -> np.ndarray:
    """[...] float32: the array of numbers that was noted. Raises _RefusedError, with its name, for anything else."""
    shape, dtype, order, axes, buffer = _parts(note, name)
    if isinstance(buffer, _Call) and buffer.function == "_codecs.encode":  # protocol 2 spells bytes as text
        buffer = buffer.arguments[0].encode("latin-1")
    kind = _number_type(dtype)
    if not isinstance(buffer, bytes | bytearray) or order not in ("C", "F", "K"):
        raise _RefusedError(f"{name} is not an array of numbers")
    if not all(size > 0 for size in shape):
        raise _RefusedError(f"{name} has no proper shape")
    if math.prod(shape) * kind.itemsize != len(buffer):
        raise _RefusedError(f"{name} declares shape {shape} but holds {len(buffer)} bytes")
    size = 4 * math.prod(shape)
    if size > _SMALL_BYTES and (fault := memory_fault(name, size)):
        raise _RefusedError(fault)
    numbers = np.frombuffer(buffer, kind).reshape(shape, order="F" if order == "F" else "C")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(numbers.transpose(axes[0]) if axes else numbers, np.float32)


def objects(note: Any) -> tuple[tuple[int, ...], list[Any]] | None:
    """(shape, items in rows) of an array of Python objects that was noted; None for anything else."""
    try:
        shape, dtype, order, _, items = _parts(note, "it")
    except _RefusedError:
        return None
    match dtype:
        case _Call("numpy.dtype", ("O8" | "O4" | "O", *_)) if isinstance(items, list) and order == "C":
            return (shape, items) if math.prod(shape) == len(items) else None
    return None


def _parts(note: Any, name: str) -> tuple[tuple[int, ...], Any, Any, list[Any], Any]:
    """(shape, type, order, transposed axes, content) of a noted array."""
    match note:
        case _Call("numpy.core.multiarray._reconstruct", _, (_, shape, dtype, in_columns, buffer)):
            order, axes = ("F" if in_columns else "C"), []
        case _Call("numpy.core.numeric._frombuffer", (buffer, dtype, shape, order, *axes)):
            pass  # order K: in rows, with the axes transposed after that
        case _:
            raise _RefusedError(f"{name} is not an array")
    if not isinstance(shape, tuple) or not all(type(size) is int and size >= 0 for size in shape):
        raise _RefusedError(f"{name} has no proper shape")
    return shape, dtype, order, axes, buffer


def _number_type(noted: Any) -> np.dtype:
    match noted:
        case _Call("numpy.dtype", (str(code), *_), (_, "<" | ">" | "|" as byte_order, *_)) if re.fullmatch(
            "f[248]|[iu][1248]", code
        ):
            return np.dtype(byte_order + code)
    raise _RefusedError("the pickle holds an array of something other than numbers")
