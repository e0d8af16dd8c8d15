"""Where logged episodes end: decided here, for every file of arrays, from all the signs that it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guider.data.store import Store, describe_keys
from guider.episodes import EndSign
from guider.errors import GuiderError, names_like

# The names that these go by in files people have.
LENGTHS = "lengths"
STATED = ("episode_ends",)
NUMBERS = ("episode_index", "episode_id", "episode_ids", "episode", "episodes")
TRUNCATIONS = ("timeouts", "timeout", "truncations", "truncation", "truncated", "truncateds")
LAST_ROWS = ("dones", "done", "episode_terminals", "is_last")
TERMINALS = ("terminals", "terminal", "terminated", "terminateds", "terminations")
NEXT_STATES = ("next_observations", "next_observation", "next_obs")
TIMES = ("timestamps", "timestamp", "times", "time")
JUMPS = "jumps"

_GAP_FACTOR = 5.0
_JUMP_FACTOR = 4.0
_NEIGHBOUR_FACTOR = 2.0
_STILL_FRACTION = 1e-3
_FEWEST_MOVES = 20
_WRAP_FRACTION = 0.9
_STEPS_COMPARED = 10_000


@dataclass(frozen=True)
class Ends:
    """lengths: [episodes] states of each; signs: what was found, in the order looked for; warning: where they disagree,
    in one line without the source's name, None where they do not."""

    lengths: np.ndarray
    signs: tuple[EndSign, ...]
    warning: str | None = None


def find_ends(
    store: Store, observations: np.ndarray, achieved: np.ndarray | None, chosen: tuple[str, ...] = ()
) -> Ends:
    """Where episodes end in rows of `observations` [rows, S].

    achieved: [rows, G], in which jumps are looked for, None not to; chosen: signs to take instead of deciding, by name.

    `lengths`, `episode_ends` or a number per episode are taken alone. Otherwise an end is every row that a flag marks
    (terminals, timeouts, truncations, dones, under all their names), whose `next_observations` is another state than
    the next row's, after which time goes back or makes a gap, or after which the goal space jumps; but not
    - terminals where other flags mark the ends and the state goes on as on any other step (D4RL's antmaze);
    - jumps that no flag marks where flags evidently mark all ends (see `_marks_all`).
    Raises GuiderError for flags that are not 0 or 1, for rows that do not follow each other (a shuffled replay buffer),
    and where nothing says where episodes end.
    """
    rows = len(observations)
    marks = _marks(store, observations)
    jumps = np.zeros(rows, bool)
    flagged = _any(marks, (LENGTHS, *STATED, *NUMBERS, *TRUNCATIONS, *LAST_ROWS, *TERMINALS), rows)
    if achieved is not None:
        jumps[:-1] = find_jumps(achieved, flagged)
        marks[JUMPS] = jumps

    if chosen:
        unknown = [name for name in chosen if name not in marks]
        if unknown:
            raise store.fail(f"no sign of episode ends is called {unknown[0]!r} here; {names_like(unknown[0], marks)}")
        return _ends(marks, chosen, rows)
    if LENGTHS in marks:  # not through flags: lengths that disagree with the rows are told as they stand
        signs = _ends(marks, (LENGTHS,), rows).signs
        return Ends(store.vector(LENGTHS), signs, _contradiction(marks, marks[LENGTHS], LENGTHS))
    if stated := next((name for name in (*STATED, *NUMBERS) if name in marks), None):
        found = _ends(marks, (stated,), rows)
        return Ends(found.lengths, found.signs, _contradiction(marks, marks[stated], stated))

    flags = [name for name in (*TRUNCATIONS, *LAST_ROWS, *TERMINALS) if name in marks]
    others = [name for name in (*NEXT_STATES, *TIMES) if name in marks]
    if not flags and not others:
        raise store.fail(
            "nothing says where episodes end: missing one of lengths, episode_ends, timeouts, terminals; "
            f"the file holds {describe_keys(store.keys)} (to cut where the state jumps, {jumps.sum():,} times: "
            "--episode-ends jumps)"
        )
    warnings = []
    used = list(flags)
    ends = _any(marks, [name for name in flags if name not in TERMINALS], rows)
    for name in [name for name in flags if name in TERMINALS]:
        alone = np.flatnonzero(marks[name] & ~ends)
        if len(alone) and ends.any() and _goes_on(observations, alone, marks[name] | ends):
            used.remove(name)
            warnings.append(f"{len(alone):,} rows marked by {name} are followed by an ordinary step: no ends")
    ends = _any(marks, used, rows)
    for name in others:
        used.append(name)
        if flags and (count := np.sum(marks[name] & ~ends)):
            what = "another state than the next row's" if name in NEXT_STATES else "a gap in time"
            warnings.append(f"{count:,} rows that no flag marks have {what} ({name}): taken as ends too")
        ends |= marks[name]
    unmarked = jumps & ~ends
    if unmarked.any():
        where = f"the goal space jumps after {np.sum(unmarked):,} rows that nothing marks"
        if why := _marks_all(ends, jumps, observations):
            warnings.append(f"{where}: no ends, since {why}")
        else:
            used.append(JUMPS)
            warnings.append(f"{where}: taken as ends {'too' if ends.any() else 'for want of others'}")
    elif not ends.any():
        warnings.append(f"no row is marked as an end: read as one episode of {rows:,} rows")
    found = _ends(marks, tuple(used), rows)
    hint = f" (say which signs to take with --episode-ends: {', '.join(marks)})" if warnings else ""
    return Ends(found.lengths, found.signs, "; ".join(warnings) + hint if warnings else None)


def lengths_from_ends(ends: np.ndarray) -> np.ndarray:
    """[episodes] int64 states per episode, from [rows] bool: True on the last row of each. The last row of
    all ends an episode whether it is marked or not."""
    ends = ends.copy()
    ends[-1] = True
    return np.diff(np.flatnonzero(ends), prepend=-1)


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
    with np.errstate(invalid="ignore", over="ignore"):  # NaN and inf are reported later, with their row
        moved = np.linalg.norm(np.diff(achieved, axis=0), axis=1)
        extent = np.linalg.norm(achieved.max(axis=0) - achieved.min(axis=0))
        regular = moved[~ends[:-1] & (moved > _STILL_FRACTION * extent)]
    if len(regular) < _FEWEST_MOVES:
        return np.zeros(len(moved), bool)
    far = moved > _JUMP_FACTOR * np.quantile(regular, 0.9, method="lower")
    padded = np.pad(moved, 1)
    return far & (moved > _NEIGHBOUR_FACTOR * np.maximum(padded[:-2], padded[2:]))


def _marks(store: Store, observations: np.ndarray) -> dict[str, np.ndarray]:
    """sign -> [rows] bool: True where it says that an episode ends. Raises GuiderError for rows out of order."""
    rows = len(observations)
    marks: dict[str, np.ndarray] = {}
    if LENGTHS in store.keys:
        lengths, marks[LENGTHS] = store.vector(LENGTHS), np.zeros(rows, bool)
        if lengths.dtype.kind in "iu":
            last = np.cumsum(lengths[:rows], dtype=np.float64) - 1
            marks[LENGTHS][last[(last >= 0) & (last < rows)].astype(np.int64)] = True
    for name in (*STATED, *TRUNCATIONS, *LAST_ROWS, *TERMINALS):
        if name in store.keys:
            marks[name] = store.flags(name, rows)
    for name in NUMBERS:
        if (numbers := store.column(name, rows)) is not None:
            changes = numbers[1:] != numbers[:-1]
            if np.sum(changes) + 1 > len(np.unique(numbers)):
                raise _out_of_order(store, f"rows with the same {name} lie apart")
            marks[name] = np.append(changes, True)
    for name in NEXT_STATES:
        if name in store.keys and store.width(name) == observations.shape[1]:
            marks[name] = _broken(store, name, observations)
    for name in TIMES:
        if (times := store.column(name, rows)) is not None and np.isfinite(times).all():
            passed = np.diff(times.astype(np.float64))
            if np.mean(passed < 0) > 0.5:
                raise _out_of_order(store, f"{name} goes back after more than half of them")
            usual = np.median(passed[passed > 0]) if (passed > 0).any() else np.inf
            marks[name] = np.append((passed < 0) | (passed > _GAP_FACTOR * usual), True)
    return marks


def _broken(store: Store, name: str, observations: np.ndarray) -> np.ndarray:
    """[rows] bool: whether the next row is another state than the row's next state, and True for the last."""
    followers = store.matrix(name)
    if len(followers) != len(observations):
        raise store.fail(f"{name} has {len(followers)} rows but observations have {len(observations)}")
    off = np.abs(followers[:-1] - observations[1:]) > 1e-6 + 1e-4 * np.abs(observations[1:])
    same = ~off.any(axis=1)
    if np.mean(~same) > 0.5:
        raise _out_of_order(store, f"{name} of {np.sum(~same):,} of {len(off):,} rows is not the next row")
    return np.append(~same, True)


def _out_of_order(store: Store, reason: str) -> GuiderError:
    return store.fail(
        f"the rows are shuffled ({reason}), as in a replay buffer, and episodes cannot be told from it; save them in "
        "the order they were recorded"
    )


def _any(marks: dict[str, np.ndarray], names: tuple[str, ...] | list[str], rows: int) -> np.ndarray:
    """[rows] bool: rows that one of the named signs marks."""
    return np.any([marks[name] for name in names if name in marks] or [np.zeros(rows, bool)], axis=0)


def _ends(marks: dict[str, np.ndarray], used: tuple[str, ...], rows: int) -> Ends:
    signs = tuple(EndSign(name, int(mark.sum()), name in used) for name, mark in marks.items())
    return Ends(lengths_from_ends(_any(marks, used, rows)), signs)


def _contradiction(marks: dict[str, np.ndarray], ends: np.ndarray, stated: str) -> str | None:
    """What speaks against the ends that a file states. A terminal within an episode does not, nor does a jump."""
    for name in (*STATED, *NUMBERS, *TRUNCATIONS, *LAST_ROWS, *NEXT_STATES, *TIMES):
        if name in marks and (count := np.sum(marks[name] & ~ends)):
            return (
                f"{name} marks {count:,} ends that {stated} does not; {stated} is taken (else: --episode-ends {name})"
            )
    return None


def _goes_on(observations: np.ndarray, flagged: np.ndarray, marked: np.ndarray) -> bool:
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


def _marks_all(ends: np.ndarray, jumps: np.ndarray, observations: np.ndarray) -> str | None:
    """Why the marked ends must be all there are, although there are jumps elsewhere; None where that is not evident.

    Either the marked episodes are all equally long and mostly end in jumps, so that other jumps are part of the motion
    (a teleporter), or at each of the other jumps some state entries cross nearly all that they range over (an angle
    that wraps) and all others go on as usual.
    """
    if not ends.any():
        return None
    lengths = lengths_from_ends(ends)
    if len(lengths) > 2 and len(np.unique(lengths)) == 1 and np.mean(jumps[ends]) > 0.5:
        return f"all marked episodes have {lengths[0]:,} rows"
    rows, ordinary = np.flatnonzero(jumps & ~ends), np.flatnonzero(~(jumps | ends)[:-1])
    moved = np.abs(_steps(observations, rows))
    usual = _JUMP_FACTOR * np.quantile(np.abs(_steps(observations, ordinary)), 0.9, axis=0)
    crossed = moved >= _WRAP_FRACTION * np.ptp(observations, axis=0)
    if (crossed | (moved <= usual)).all():
        return "each crosses the whole range of an entry, as an angle does that wraps"
    return None


def _steps(observations: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """[n, S] float64: by how much the state changes after the rows, or after 10,000 of them spread evenly."""
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), _STEPS_COMPARED)).astype(int)]
    return observations[chosen + 1].astype(np.float64) - observations[chosen]
