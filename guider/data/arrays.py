"""Arrays as people have them, made float32, finite and bounded, or refused in a line that says what to do."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from guider.errors import GuiderError, GuiderWarning

Fail = Callable[[str], GuiderError]
"""What makes an error of a message, with the source's name."""

_BLOCK_ROWS = 1 << 16
_MOST_LOST = 0.01
_FAR_FROM_ZERO = 4096.0
_SMALL_ACTIONS = 0.1  # of the unit box
_BOUND_TOLERANCE = 2e-3  # rounding, in the unit box; relative to half the range elsewhere


def immutable(array: np.ndarray) -> np.ndarray:
    """A read-only copy whose memory starts at a multiple of 64 bytes: JAX's CPU device shares such memory instead
    of copying it, so that the data is held once."""
    if not array.flags.writeable and array.ctypes.data % 64 == 0:
        return array
    memory = np.empty(array.nbytes + 64, np.uint8)
    offset = -memory.ctypes.data % 64
    copy = memory[offset : offset + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    copy.flags.writeable = False
    return copy


def numbers(array: np.ndarray, name: str, source: str) -> np.ndarray:
    """[rows, columns] float32. Raises GuiderError unless it is a table of numbers with a row and a column."""
    array = np.asarray(array)
    if array.ndim != 2 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise GuiderError(
            f"{source}: {name} must be a non-empty 2-D array of numbers, got {array.dtype} of shape {array.shape}"
        )
    return to_float32(array, name, source)


def to_float32(array: Any, name: str, source: str) -> np.ndarray:
    """[rows, columns] float32 of an array, or of an HDF5 dataset, which is read a block at a time.

    Warns of columns far from 0 that lose more than a hundredth of what they vary by: map coordinates, time stamps.
    """
    rows, columns = array.shape
    result = np.empty((rows, columns), np.float32)
    if array.dtype.itemsize <= 4 and array.dtype.kind == "f":
        result[...] = array
        return result
    low, high, lost = np.full(columns, np.inf), np.full(columns, -np.inf), np.zeros(columns)
    for start in range(0, rows, _BLOCK_ROWS):
        block = np.asarray(array[start : start + _BLOCK_ROWS], np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            result[start : start + len(block)] = block
            lost = np.fmax(lost, np.fmax.reduce(np.abs(block - result[start : start + len(block)]), axis=0))
        low, high = np.fmin(low, np.fmin.reduce(block, axis=0)), np.fmax(high, np.fmax.reduce(block, axis=0))
    size = np.fmax(np.abs(low), np.abs(high))
    coarse = (size <= np.finfo(np.float32).max) & (size >= _FAR_FROM_ZERO) & (high > low)
    coarse[coarse] = lost[coarse] > _MOST_LOST * (high[coarse] - low[coarse])
    for column in np.flatnonzero(coarse):
        warnings.warn(
            GuiderWarning(
                f"{source}: {name} column {column} varies by {high[column] - low[column]:.3g} around "
                f"{low[column]:.10g}, where float32, in which networks compute, tells apart only steps of "
                f"{np.spacing(np.float32(size[column])):.2g}; subtract an origin before saving it"
            ),
            stacklevel=2,
        )
    return result


def check_finite(array: np.ndarray, name: str, fail: Fail) -> None:
    """Raise where an entry of [rows, columns] is NaN or inf, and say which."""
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        entries = np.flatnonzero(~np.isfinite(array).all(axis=0))
        listed = ", ".join(map(str, entries[:8])) + (" and others" if len(entries) > 8 else "")
        raise fail(
            f"{name} hold NaN or inf in {np.sum(~finite)} rows, first in row {np.argmin(finite)} (entries {listed}); "
            "fill them in from their neighbours, leave those rows out, or take other columns"
        )


def _usual_bounds(seen_low: np.ndarray, seen_high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[A] bounds that nobody gave, from the extremes seen.

    Where all actions lie in the unit box but for rounding they are [-1, 1], and of an entry that never changes sign (a
    throttle) one side of that; the extremes themselves elsewhere (physical units), and for an entry that stays within a
    tenth of the box. An entry of the unit box that never changes (a gripper that was not used) is [-1, 1] in either
    case.
    """
    in_box = (seen_low >= -1 - _BOUND_TOLERANCE) & (seen_high <= 1 + _BOUND_TOLERANCE)
    still = seen_low == seen_high
    as_seen = ~in_box.all() | (np.maximum(-seen_low, seen_high) <= _SMALL_ACTIONS)
    low = np.where(as_seen, seen_low, np.where(seen_low >= 0, 0.0, -1.0))
    high = np.where(as_seen, seen_high, np.where(seen_high <= 0, 0.0, 1.0))
    return np.where(still & in_box, -1.0, low), np.where(still & in_box, 1.0, high)


def action_bounds(actions: np.ndarray, low, high, fail: Fail) -> tuple[np.ndarray, np.ndarray]:
    """[A] float32 bounds of actions [rows, A]: those given, each a number or [A], or the usual ones. Raises where they
    are of another shape, not finite, leave no range, or do not hold the actions."""
    seen_low, seen_high = actions.min(axis=0), actions.max(axis=0)
    usual_low, usual_high = _usual_bounds(seen_low, seen_high)
    low, high = usual_low if low is None else low, usual_high if high is None else high
    low, high = np.asarray(low, np.float32), np.asarray(high, np.float32)
    for bound in (low, high):
        if bound.shape not in ((), (1,), seen_low.shape):
            raise fail(f"action bounds have shape {bound.shape}, expected {seen_low.shape} or one number")
    low = np.broadcast_to(low, seen_low.shape).copy()
    high = np.broadcast_to(high, seen_high.shape).copy()
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise fail("action bounds hold NaN or inf")
    if np.any(low >= high):
        entry = int(np.argmax(low >= high))
        raise fail(
            f"action entry {entry} has bounds [{low[entry]:g}, {high[entry]:g}]: it never changes; leave that column "
            "out, or say what range it has (action_low and action_high in the file)"
        )
    tolerance = _BOUND_TOLERANCE / 2 * (high - low)
    outside = (seen_low < low - tolerance) | (seen_high > high + tolerance)
    if outside.any():
        entry = int(np.argmax(outside))
        raise fail(
            f"action entry {entry} spans [{seen_low[entry]:g}, {seen_high[entry]:g}], outside its bounds "
            f"[{low[entry]:g}, {high[entry]:g}]"
        )
    return low, high
