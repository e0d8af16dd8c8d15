"""Where logged episodes end: decided here, for every file of arrays, from all the signs that it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guider.data.episodes import EndSign
from guider.data.motion import find_jumps, find_wraps, goes_on, out_of_sequence
from guider.data.store import Store, describe_keys
from guider.errors import GuiderError, names_like

# The names that these go by in files people have.
LENGTHS = "lengths"
STATED = ("episode_ends",)
NUMBERS = ("episode_index", "episode_id", "episode_ids", "episode", "episodes")
TRUNCATIONS = ("timeouts", "timeout", "truncations", "truncation", "truncated", "truncateds")
LAST_ROWS = ("dones", "done", "episode_terminals", "is_last")
TERMINALS = ("terminals", "terminal", "terminated", "terminateds", "terminations")
FLAGS = (*TRUNCATIONS, *LAST_ROWS, *TERMINALS)
NEXT_STATES = ("next_observations", "next_observation", "next_obs")
TIMES = ("timestamps", "timestamp", "times", "time", "time_s", "stamp")
MARKS = (*STATED, *NUMBERS, *FLAGS, *NEXT_STATES)
JUMPS = "jumps"

_GAP_STEPS, _GAP_FACTOR, _BACK_STEPS = 20.0, 4.0, 5.0


@dataclass(frozen=True)
class Ends:
    """lengths: [episodes] states of each; signs: what was found, in the order looked for; warning: where they disagree,
    in one line without the source's name, None where they do not."""

    lengths: np.ndarray
    signs: tuple[EndSign, ...]
    warning: str | None = None


@np.errstate(invalid="ignore", over="ignore")  # NaN and inf are reported later, with their row
def find_ends(
    store: Store, observations: np.ndarray, achieved: np.ndarray | None, chosen: tuple[str, ...] = ()
) -> Ends:
    """Where episodes end in rows of `observations` [rows, S].

    achieved: [rows, G], in which jumps are looked for, None not to; chosen: signs to take instead of deciding, by name.

    `lengths`, `episode_ends` or a number per episode are taken alone. Otherwise an end is every row that a flag marks
    (terminals, timeouts, truncations, dones, under all their names), whose `next_observations` is another state than
    the next row's, after which time goes back or makes a gap, or after which the goal space jumps; but not
    - terminals and dones where other signs mark ends and the state goes on as on any other step (D4RL's antmaze);
    - jumps that no flag marks, where an entry crosses its whole range and all others go on (an angle that wraps), or
      where flags evidently mark all ends (see `_marks_all`).
    Raises GuiderError for flags that are not 0 or 1, for rows that do not follow each other (a shuffled replay buffer),
    and where nothing says where episodes end.
    """
    rows = len(observations)
    if store.lengths is not None:
        if chosen:
            raise GuiderError(f"{store.source} states its episodes; leave --episode-ends out")
        return Ends(store.lengths, (EndSign("episodes of the source", len(store.lengths)),))
    if chosen:
        return _chosen_ends(store, observations, achieved, chosen)
    marks = _marks(store, observations)
    flagged = _any(marks, (LENGTHS, *STATED, *NUMBERS, *FLAGS), rows)
    jumps = np.zeros(rows, bool)
    if achieved is not None:
        jumps[:-1] = find_jumps(achieved, flagged)
        marks[JUMPS] = jumps
    if stated := next((name for name in (LENGTHS, *STATED, *NUMBERS) if name in marks), None):
        found = _ends(marks, (stated,), rows)
        lengths = store.vector(LENGTHS) if stated == LENGTHS else found.lengths  # told as they stand if they do not fit
        return Ends(lengths, found.signs, _contradiction(marks, marks[stated], stated, observations))

    flags = [name for name in FLAGS if name in marks]
    others = [name for name in (*NEXT_STATES, *TIMES) if name in marks]
    if not flags and not others:
        raise store.fail(
            "nothing says where episodes end: missing one of lengths, episode_ends, timeouts, terminals; "
            f"the file holds {describe_keys(store.keys)} (to cut where the state jumps, {jumps.sum():,} times: "
            "--episode-ends jumps)"
        )
    warnings = []
    used = [name for name in (*flags, *others) if name not in (*LAST_ROWS, *TERMINALS)]
    for name in [name for name in flags if name not in used]:
        ends = _any(marks, used, rows)
        alone = np.flatnonzero((marks[name] & ~ends)[:-1])
        if len(alone) and ends[:-1].any() and goes_on(observations, alone, marks[name] | ends):
            warnings.append(f"{len(alone):,} rows marked by {name} are followed by an ordinary step: no ends")
        else:
            used.append(name)
    ends = _any(marks, [name for name in used if name in flags], rows)
    for name in others:
        if flags and (count := np.sum((marks[name] & ~ends)[:-1])):
            what = "another state than the next row's" if name in NEXT_STATES else "a gap in time"
            warnings.append(f"{count:,} rows that no flag marks have {what} ({name}): taken as ends too")
        ends |= marks[name]
    unmarked = np.flatnonzero((jumps & ~ends)[:-1])
    if len(unmarked) and ends[:-1].any() and (wraps := find_wraps(observations, unmarked, jumps | ends)).any():
        warnings.append(
            f"after {wraps.sum():,} rows an entry crosses its whole range and all others go on, as where an angle "
            "wraps or a switch snaps: no ends (as a goal, an angle is better given as its sine and cosine)"
        )
        unmarked = unmarked[~wraps]
    if len(unmarked):
        where = f"the goal space jumps after {len(unmarked):,} rows that nothing marks"
        if why := _marks_all(ends, jumps, unmarked):
            warnings.append(f"{where}: no ends, since {why}")
        else:
            ends[unmarked] = True
            used.append(JUMPS)
            late = len(unmarked) > 2 and np.mean(flagged[np.maximum(unmarked - 1, 0)]) > 0.5
            beside = " (flags are set a row early)" if late else ""
            warnings.append(f"{where}{beside}: taken as ends {'too' if flagged.any() else 'for want of others'}")
    elif not ends.any():
        warnings.append(f"no row is marked as an end: read as one episode of {rows:,} rows")
    if reason := out_of_sequence(observations, ends):
        warnings.append(reason)
    hint = f" (say which signs to take with --episode-ends: {', '.join(marks)})" if warnings else ""
    warning = "; ".join(warnings) + hint if warnings else None
    return Ends(lengths_from_ends(ends), _signs(marks, used), warning)


def _chosen_ends(store: Store, observations: np.ndarray, achieved: np.ndarray | None, chosen: tuple[str, ...]) -> Ends:
    """The user's word: these signs, whatever others say."""
    rows = len(observations)
    there = [name for name in (LENGTHS, *MARKS, *TIMES) if name in store.keys]
    there += [name for name in chosen if name not in there and store.column(name, rows) is not None]
    if unknown := [name for name in chosen if name not in (*there, JUMPS)]:
        raise store.fail(
            f"no sign of episode ends is called {unknown[0]!r} here; {names_like(unknown[0], [*there, JUMPS])}"
        )
    marks = _marks(store, observations, chosen)
    if JUMPS in chosen and achieved is not None:
        marks[JUMPS] = np.append(find_jumps(achieved, _any(marks, chosen, rows)), False)
    if lacking := [name for name in chosen if name not in marks]:
        raise store.fail(f"{lacking[0]} holds something else than a number for every row, and cannot mark ends")
    if chosen == (LENGTHS,):
        return Ends(store.vector(LENGTHS), _signs(marks, chosen))
    return _ends(marks, chosen, rows)


def lengths_from_ends(ends: np.ndarray) -> np.ndarray:
    """[episodes] int64 states per episode, from [rows] bool: True on the last row of each. The last row of
    all ends an episode whether it is marked or not."""
    ends = ends.copy()
    ends[-1] = True
    return np.diff(np.flatnonzero(ends), prepend=-1)


def _marks(store: Store, observations: np.ndarray, only: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """sign -> [rows] bool: True where it says that an episode ends. only: these signs, taken as they are.

    Raises GuiderError for rows out of order, unless the user names the signs.
    """
    rows = len(observations)
    marks: dict[str, np.ndarray] = {}

    def wanted(names: tuple[str, ...]) -> list[str]:
        return [name for name in names if name in store.keys and (not only or name in only)]

    for name in wanted((LENGTHS,)):
        lengths, marks[name] = store.vector(name), np.zeros(rows, bool)
        if lengths.dtype.kind in "iu":
            last = np.cumsum(lengths[:rows], dtype=np.float64) - 1
            marks[name][last[(last >= 0) & (last < rows)].astype(np.int64)] = True
    for name in wanted((*STATED, *FLAGS)):
        marks[name] = store.flags(name, rows)
    numbered = tuple(name for name in only if name not in (LENGTHS, *MARKS, *TIMES))
    for name in wanted((*NUMBERS, *numbered)):
        if (numbers := store.column(name, rows)) is not None:
            changes = numbers[1:] != numbers[:-1]
            runs = int(np.sum(changes)) + 1
            if not only and runs > len(np.unique(numbers)) and rows < 2 * runs:
                raise _out_of_order(store, f"rows with the same {name} lie apart", name)
            marks[name] = np.append(changes, True)
    for name in wanted(NEXT_STATES):
        if store.width(name) == observations.shape[1]:
            marks[name] = _broken(store, name, observations, refuse=not only)
    for name in wanted(TIMES):
        if (times := store.column(name, rows)) is not None and np.isfinite(times).all():
            marks[name] = _gaps(store, name, times.astype(np.float64), refuse=not only)
    return marks


def _gaps(store: Store, name: str, times: np.ndarray, refuse: bool) -> np.ndarray:
    """[rows] bool: after which rows a recording broke off, and True for the last.

    A gap is more than 20 usual steps and 4 times the steps that all but a tenth keep to, so that lost packets and those
    that come in bursts are none; time that goes back by 5 usual steps is another recording's.
    """
    passed = np.diff(times)
    if refuse and np.mean(passed < 0) > 0.5:
        raise _out_of_order(store, f"{name} goes back after more than half of them", name)
    forward = passed[passed > 0]
    usual = np.median(forward) if len(forward) else np.inf
    most = np.quantile(forward, 0.9, method="lower") if len(forward) else np.inf
    gap = passed > max(_GAP_STEPS * usual, _GAP_FACTOR * most)
    return np.append(gap | (passed < -_BACK_STEPS * usual), True)


def _broken(store: Store, name: str, observations: np.ndarray, refuse: bool) -> np.ndarray:
    """[rows] bool: whether the next row is another state than the row's next state, and True for the last."""
    followers = store.matrix(name)
    if len(followers) != len(observations):
        raise store.fail(f"{name} has {len(followers)} rows but observations have {len(observations)}")
    tolerance = 1e-3 * observations.std(axis=0) + 1e-3 * np.abs(observations[1:])  # half precision is enough
    same = ~(np.abs(followers[:-1] - observations[1:]) > tolerance + 1e-6).any(axis=1)
    if refuse and np.mean(~same) > 0.5:
        raise _out_of_order(store, f"{name} of {np.sum(~same):,} of {len(same):,} rows is not the next row", name)
    return np.append(~same, True)


def _out_of_order(store: Store, reason: str, name: str) -> GuiderError:
    return store.fail(
        f"the rows are shuffled ({reason}), as in a replay buffer, and episodes cannot be told from it; save them in "
        f"the order they were recorded, or, if they are and {name} is wrong, say what to go by (--episode-ends)"
    )


def _any(marks: dict[str, np.ndarray], names: Sequence[str], rows: int) -> np.ndarray:
    """[rows] bool: rows that one of the named signs marks."""
    return np.any([marks[name] for name in names if name in marks] or [np.zeros(rows, bool)], axis=0)


def _ends(marks: dict[str, np.ndarray], used: Sequence[str], rows: int) -> Ends:
    return Ends(lengths_from_ends(_any(marks, used, rows)), _signs(marks, used))


def _signs(marks: dict[str, np.ndarray], used: Sequence[str]) -> tuple[EndSign, ...]:
    return tuple(EndSign(name, int(mark.sum()), name in used) for name, mark in marks.items())


def _contradiction(marks: dict[str, np.ndarray], ends: np.ndarray, stated: str, observations: np.ndarray) -> str | None:
    """What speaks against the ends that a file states: not terminals where the state goes on, nor angles that wrap."""
    for name in marks:
        unstated = np.flatnonzero((marks[name] & ~ends)[:-1])
        if name in (*LAST_ROWS, *TERMINALS) and len(unstated) and goes_on(observations, unstated, marks[name] | ends):
            continue
        if name == JUMPS and len(unstated):
            unstated = unstated[~find_wraps(observations, unstated, marks[name] | ends)]
            if _marks_all(ends, marks[JUMPS], unstated):
                continue
        if len(unstated):
            return (
                f"{name} marks {len(unstated):,} ends that {stated} does not; {stated} is taken (else: --episode-ends "
                f"{name})"
            )
    return out_of_sequence(observations, ends)


def _marks_all(ends: np.ndarray, jumps: np.ndarray, unmarked: np.ndarray) -> str | None:
    """Why the marked ends must be all there are, although there are jumps elsewhere; None where that is not evident.

    The marked episodes are all equally long, but for the last that may be cut short, and mostly end in jumps, and the
    other jumps come now here, now there in them: they are part of the motion (a teleporter).
    """
    lengths = lengths_from_ends(ends)
    alike = len(np.unique(lengths[:-1])) == 1 and lengths[-1] <= lengths[0]
    if len(lengths) < 3 or not alike or np.mean(jumps[:-1][ends[:-1]]) <= 0.5:
        return None
    places = len(np.unique(unmarked % lengths[0]))
    return f"all marked episodes have {lengths[0]:,} rows" if places > 0.5 * len(unmarked) else None
