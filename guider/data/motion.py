"""What the states themselves say of whether one row follows another: leaps, angles that wrap, rows out of order."""

from __future__ import annotations

import numpy as np

_JUMP_FACTOR = 4.0
_NEIGHBOUR_FACTOR = 2.0
_STILL_FRACTION = 1e-3
_FEWEST_MOVES = 20
_WRAP_FRACTION = 0.9
_STEPS_COMPARED = 10_000
_FEWEST_ROWS = 200
_UNRELATED = 0.7
_MOST_ENVIRONMENTS = 64


def find_jumps(achieved: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """[rows - 1] bool: True at row t if the body was put elsewhere between rows t and t + 1.

    achieved: [rows, goal_dim]; ends: [rows] bool, episode ends already known, where motion is not regular.

    The distance moved in goal space from row t to row t + 1 is a jump if it is more than
    - 4 times the 90 % quantile of all distances of rows that move (by over a thousandth of the space the data
      covers; else data that mostly stands still would have a quantile near 0), and
    - 2 times the distances just before and just after it: a reset is a single step, a sprint or a hard push
      is not.
    The quantile sits at 90 %, not higher, so that the resets themselves do not enter it even where no end is
    marked and episodes are as short as ten rows. The factor: in a million rows of antmaze the longest regular
    step is 2.2 times the quantile, in a million rows of Gaussian noise 2.5 to 3.2 times, and the median reset
    66 times. A reset that lands within 4 times of the last state (1 % of antmaze's) is not seen: flags are for those.
    Fewer than 20 moves say nothing about what is regular.
    """
    if len(achieved) < 2:
        return np.zeros(0, bool)
    moved = np.linalg.norm(np.diff(achieved, axis=0), axis=1)
    extent = np.linalg.norm(achieved.max(axis=0) - achieved.min(axis=0))
    regular = moved[~ends[:-1] & (moved > _STILL_FRACTION * extent)]
    if len(regular) < _FEWEST_MOVES:
        return np.zeros(len(moved), bool)
    far = moved > _JUMP_FACTOR * np.quantile(regular, 0.9, method="lower")
    padded = np.pad(moved, 1)
    return far & (moved > _NEIGHBOUR_FACTOR * np.maximum(padded[:-2], padded[2:]))


def out_of_sequence(observations: np.ndarray, ends: np.ndarray) -> str | None:
    """Why rows do not seem to follow each other: no state entry is nearer to its next value than to any other's."""
    inside = np.flatnonzero(~ends[:-1])
    varying = np.ptp(observations, axis=0) > 0
    if len(observations) < _FEWEST_ROWS or len(inside) < _FEWEST_ROWS / 2 or not varying.any():
        return None
    elsewhere = np.random.default_rng(0).permutation(len(observations) - 1)

    def moved(rows: np.ndarray, to: np.ndarray) -> np.ndarray:
        some = np.linspace(0, len(rows) - 1, min(len(rows), _STEPS_COMPARED)).astype(int)
        return np.abs(observations[to[some]][:, varying] - observations[rows[some]][:, varying]).mean(axis=0)

    apart = moved(elsewhere, elsewhere[::-1])
    if (moved(inside, inside + 1) / np.maximum(apart, 1e-30)).min() < _UNRELATED:
        return None
    reason = "the rows do not seem to follow each other: the next is as far as any other"
    rows = np.arange(len(observations))
    for count in range(2, _MOST_ENVIRONMENTS + 1):
        if len(rows) > 4 * count and (moved(rows[:-count], rows[count:]) / np.maximum(apart, 1e-30)).min() < 0.5:
            return f"{reason}, but for every {count}th: as if {count} environments were written in turns"
    return reason


def goes_on(observations: np.ndarray, flagged: np.ndarray, marked: np.ndarray) -> bool:
    """Whether the steps from rows `flagged` are ordinary ones: at most half are longer than 90 % of those that nothing
    marks, in units of each entry's usual step. marked: [rows] bool."""
    last = len(observations) - 1
    ordinary = np.flatnonzero(~marked[:last])
    flagged = flagged[flagged < last]
    if len(ordinary) == 0 or len(flagged) == 0:
        return True

    usual = _steps(observations, ordinary)
    unit = np.sqrt(np.mean(usual**2, axis=0))
    moving = unit > 0
    lengths = [
        np.linalg.norm(part[:, moving] / unit[moving], axis=1) for part in (_steps(observations, flagged), usual)
    ]
    return bool(np.median(lengths[0]) <= np.quantile(lengths[1], 0.9))


def find_wraps(observations: np.ndarray, rows: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """[n] bool: whether after each of the rows some state entries cross nearly all that they range over and all others
    go on as after rows that nothing marks. marked: [all rows] bool."""
    ordinary = np.flatnonzero(~marked[:-1])
    if len(ordinary) == 0:
        return np.zeros(len(rows), bool)
    moved = np.abs(observations[rows + 1].astype(np.float64) - observations[rows])
    usual = _JUMP_FACTOR * np.quantile(np.abs(_steps(observations, ordinary)), 0.9, axis=0)
    crossed = (moved >= _WRAP_FRACTION * np.ptp(observations, axis=0)) & (moved > 0)
    return crossed.any(axis=1) & (crossed | (moved <= usual)).all(axis=1)


def _steps(observations: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """[n, S] float64: by how much the state changes after the rows, or after 10,000 of them spread evenly."""
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), _STEPS_COMPARED)).astype(int)]
    return observations[chosen + 1].astype(np.float64) - observations[chosen]
