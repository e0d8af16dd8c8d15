"""What is wrong with logs, or may be, in words: looked for before anything is learned from them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from guider.data.episodes import Episodes, entry_name

_STILL_SHARE = 0.02
_JUMP_FACTOR, _JUMP_RANGE = 5.0, 0.2
_WRAP_RANGE = 0.9
_GAP_FACTOR = 3.0
_SATURATED_SHARE = 0.3
_MOST_LAG, _LEAST_CORRELATION, _LAG_FACTOR = 5, 0.1, 1.5
_ODD_SPREADS = 8.0
_ROWS_COMPARED = 20_000
_FEW_EPISODES, _FEW_TRANSITIONS = 10, 2_000
_NAMED = 8


def find_faults(episodes: Episodes) -> list[str]:
    """A line for everything found, the gravest first; [] where there is nothing."""
    checks = (timing, alignment, duplicates, jumps, stills, saturation, constants, odd_ones, scarcity)
    return [line for check in checks for line in check(episodes)]


def timing(episodes: Episodes) -> list[str]:
    """Gaps in time, and time that goes back, within episodes."""
    if episodes.times is None:
        return []
    steps, inside = np.diff(episodes.times), _inside(episodes)
    usual = float(np.median(steps[inside]))
    found = []
    back = inside & (steps <= 0)
    if back.any():
        found.append(f"time stands still or goes back after {_rows(episodes, back)}")
    gaps = inside & (steps > _GAP_FACTOR * usual)
    if usual > 0 and gaps.any():
        found.append(
            f"gaps in time after {_rows(episodes, gaps)}: up to {steps[gaps].max():.3g} s, usually {usual:.3g} s"
        )
    return found


def alignment(episodes: Episodes) -> list[str]:
    """Actions that stand some rows before or after the change of the state that goes with them.

    Both are freed of what follows from their own past, one step back, so that what moves smoothly does not seem to go
    with everything near it; then the largest correlation of any action entry with any state entry tells, at each shift.
    """
    inside = _inside(episodes)
    shifts = range(-_MOST_LAG, _MOST_LAG + 1)
    rows = np.flatnonzero(inside)
    rows = rows[(rows > _MOST_LAG) & (rows < len(episodes.observations) - _MOST_LAG - 2)]
    run = np.cumsum(np.append(0, ~inside))  # which episode a row is of
    rows = rows[(run[rows - _MOST_LAG - 1] == run[rows + _MOST_LAG + 1])][-_ROWS_COMPARED:]
    if len(rows) < 20 * _MOST_LAG:
        return []
    changes = _surprise(np.diff(episodes.observations.astype(np.float64), axis=0), rows)
    size = []
    for shift in shifts:
        actions = _surprise(episodes.actions.astype(np.float64), rows + shift)
        size.append(float(np.abs(actions.T @ changes / len(rows)).max(initial=0.0)))
    best = int(np.argmax(size)) - _MOST_LAG
    here = size[_MOST_LAG]
    if best == 0 or max(size) < max(_LEAST_CORRELATION, _LAG_FACTOR * here):
        return []
    if best > 0:
        return [
            f"actions stand {best} rows after the motion they caused (correlation {max(size):.2f}, in their own row "
            f"{here:.2f}): logged late; move them up"
        ]
    return [
        f"the state answers {-best} rows after the action (correlation {max(size):.2f}, in its own row {here:.2f}): "
        "a slow drive, or states that are logged late"
    ]


def duplicates(episodes: Episodes) -> list[str]:
    """Episodes that hold the same states."""
    seen: dict[bytes, list[int]] = {}
    for number, (start, length) in enumerate(zip(episodes.starts, episodes.lengths, strict=True)):
        digest = hashlib.sha256(episodes.observations[start : start + length].tobytes()).digest()
        seen.setdefault(digest, []).append(number)
    again = [numbers for numbers in seen.values() if len(numbers) > 1]
    if not again:
        return []
    extra = sum(len(numbers) - 1 for numbers in again)
    return [f"{extra} episodes are copies of others (episodes {_listed(again[0])} are one)"]


def jumps(episodes: Episodes) -> list[str]:
    """State entries that leap within an episode, and those that wrap or switch."""
    wraps, leaping, leaps = _leaps(episodes)
    found = []
    if leaping:
        names = _listed([_name(episodes, entry) for entry in leaping])
        found.append(f"{names}: leaps, after {_rows(episodes, leaps)}")
    if wraps:
        found.append(
            f"{_listed([_name(episodes, entry) for entry in wraps])}: whole range crossed in a step; angles that wrap "
            "are better given as sine and cosine, as a goal --goal angle:NAME is (in radians)"
        )
    return found


def wrapping_entries(episodes: Episodes) -> list[int]:
    """State entries that cross their whole range in a step: angles that wrap, or switches."""
    return _leaps(episodes)[0]


def _leaps(episodes: Episodes) -> tuple[list[int], list[int], np.ndarray]:
    """(entries that wrap, other entries that leap, [rows - 1] bool after which rows those do)."""
    steps, inside = np.abs(np.diff(episodes.observations, axis=0)), _inside(episodes)
    spans = np.ptp(episodes.observations, axis=0)
    wraps, leaping, leaps = [], [], np.zeros(len(steps), bool)
    for entry in map(int, np.flatnonzero(spans > 0)):
        usual = float(np.quantile(steps[inside, entry], 0.95))
        far = inside & (steps[:, entry] > max(_JUMP_FACTOR * usual, _JUMP_RANGE * spans[entry]))
        if far.any() and np.median(steps[far, entry]) >= _WRAP_RANGE * spans[entry]:
            wraps.append(entry)
        elif far.any():
            leaping.append(entry)
            leaps |= far
    return wraps, leaping, leaps


def stills(episodes: Episodes) -> list[str]:
    """Steps that change nothing."""
    inside = _inside(episodes)
    still = inside & (np.diff(episodes.observations, axis=0) == 0).all(axis=1)
    share = still.sum() / inside.sum()
    if share < _STILL_SHARE:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    longest = int((edges[1::2] - edges[::2]).argmax())
    start = edges[::2][longest]
    return [
        f"{share:.0%} of the steps change nothing in the state, {edges[1::2][longest] - start} in a row in episode "
        f"{_episode_of(episodes, start)}: a robot at rest, or a sensor that froze"
    ]


def saturation(episodes: Episodes) -> list[str]:
    """Action entries that are often at their limits."""
    actions = episodes.actions[:-1][_inside(episodes)]
    low, high = episodes.action_low, episodes.action_high
    at = np.mean((actions <= low + 1e-3 * (high - low)) | (actions >= high - 1e-3 * (high - low)), axis=0)
    return [
        f"{_name(episodes, entry, 'action')} is at a limit in {at[entry]:.0%} of the steps"
        for entry in np.flatnonzero((at > _SATURATED_SHARE) & (np.ptp(actions, axis=0) > 0))
    ]


def constants(episodes: Episodes) -> list[str]:
    """Entries that never change."""
    found = []
    actions = episodes.actions[:-1][_inside(episodes)]
    for kind, rows in (("state", episodes.observations), ("action", actions)):
        if len(entries := np.flatnonzero(np.ptp(rows, axis=0) == 0)):
            names = ", ".join(_name(episodes, entry, kind) for entry in entries[:_NAMED])
            found.append(f"never changes: {names}{_more(len(entries))}; leave it out, or see why")
    return found


def odd_ones(episodes: Episodes) -> list[str]:
    """Episodes unlike most: in length, in how far they travel, in how far from others they are."""
    achieved = episodes.achieved.astype(np.float64)
    steps = np.linalg.norm(np.diff(achieved, axis=0), axis=1) * _inside(episodes)
    travelled = np.add.reduceat(np.append(steps, 0.0), episodes.starts)
    centre = np.median(achieved, axis=0)
    away = np.maximum.reduceat(np.linalg.norm(achieved - centre, axis=1), episodes.starts)
    found = []
    for what, values in (("length", episodes.lengths), ("way travelled", travelled), ("place", away)):
        middle = np.median(values)
        spread = np.median(np.abs(values - middle))
        odd = np.flatnonzero(np.abs(values - middle) > _ODD_SPREADS * max(float(spread), 1e-9 + 0.05 * float(middle)))
        if 0 < len(odd) <= max(1, 0.05 * len(values)):
            found.append(f"episodes {_listed(odd)} differ much from the others in {what}")
    return found


def scarcity(episodes: Episodes) -> list[str]:
    """Too little to learn much from."""
    count, transitions = len(episodes.starts), int(np.sum(episodes.lengths - 1))
    if count >= _FEW_EPISODES and transitions >= _FEW_TRANSITIONS:
        return []
    return [f"{count} episodes of {transitions:,} steps in all are few: expect little away from them"]


def _inside(episodes: Episodes) -> np.ndarray:
    """[rows - 1] bool: whether the step to the next row stays in its episode."""
    inside = np.ones(len(episodes.observations) - 1, bool)
    inside[episodes.starts[1:] - 1] = False
    return inside


def _surprise(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """[rows, entries] what the row before does not tell of it, in its own spreads; 0 for what is constant."""
    now, before = (values[rows + offset] - values[rows + offset].mean(axis=0) for offset in (0, -1))
    weight = (now * before).sum(axis=0) / np.maximum((before**2).sum(axis=0), 1e-30)
    left = now - weight * before
    spread = left.std(axis=0)
    return np.where(spread > 1e-9 * (1 + np.abs(values).max(axis=0)), left / np.maximum(spread, 1e-30), 0.0)


def _name(episodes: Episodes, entry: int | np.integer, kind: str = "state") -> str:
    names = episodes.state_names if kind == "state" else episodes.action_names
    return entry_name(names, entry, kind)


def _rows(episodes: Episodes, marked: np.ndarray) -> str:
    rows = np.flatnonzero(marked)
    numbers = np.unique([_episode_of(episodes, row) for row in rows[:1000]])
    return f"{len(rows):,} rows (first row {rows[0]}; in episodes {_listed(numbers)})"


def _episode_of(episodes: Episodes, row: int | np.integer) -> int:
    return int(np.searchsorted(episodes.starts, row, side="right") - 1)


def _listed(numbers: Sequence[object] | np.ndarray) -> str:
    return ", ".join(map(str, numbers[:_NAMED])) + _more(len(numbers))


def _more(count: int) -> str:
    return f" and {count - _NAMED} more" if count > _NAMED else ""
