"""Logged trajectories: one immutable, validated container that every source fills and every sampler reads."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from guider.data.arrays import action_bounds, check_finite, immutable, numbers
from guider.errors import GuiderError, GuiderWarning

IN_MEMORY = "arrays in memory"
SMALLEST_SPREAD = 1e-3
"""Of a state entry, in its own unit: smaller ones are shown to networks as if they were this."""
GoalSpaceFrom = Literal["asked for", "the source", "assumed"]


@dataclass(frozen=True)
class Spaces:
    """What a policy's inputs and outputs look like.

    state_dim: S; goal_indices: entries of the state that form the goal; action_low, action_high: [A] bounds;
    state_low, state_high: [S] least and greatest of each state entry, or recorded goal's, in the data; () if not known;
    state_names, action_names: of the entries, () where they have none; computed: what the last entries of a state are
    computed by, see guider.data.goal_spaces; computed_widths: how many each; example: [S] a state, where any are.
    """

    state_dim: int
    goal_indices: tuple[int, ...]
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    state_low: tuple[float, ...] = ()
    state_high: tuple[float, ...] = ()
    state_names: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()
    computed: tuple[str, ...] = ()
    computed_widths: tuple[int, ...] = ()
    example: tuple[float, ...] = ()

    @property
    def goal_dim(self) -> int:
        return len(self.goal_indices)

    @property
    def action_dim(self) -> int:
        return len(self.action_low)

    @property
    def logged_dim(self) -> int:
        """Entries of a state that are logged, not computed."""
        return self.state_dim - sum(self.computed_widths)


def entry_name(names: Sequence[str], index: int | np.integer, kind: str = "state") -> str:
    """What an entry is called for people: by its name, or, where they have none, by its number."""
    return names[int(index)] if names else f"{kind} entry {index}"


@dataclass(frozen=True)
class EndSign:
    """Something that says where logged episodes end.

    name: the array it is read from, or what it is; ends: how many rows it marks; used: whether they were taken as ends.
    """

    name: str
    ends: int
    used: bool = True


@dataclass(frozen=True, eq=False)
class Episodes:
    """Ragged episodes, laid end to end.

    An episode is N states and the N - 1 transitions between them: `actions[t]` leads from row t to row t + 1,
    and the action in the last row of an episode is never read. Build it with `make_episodes`, which checks.

    observations: [rows, state_dim] float32
    actions:      [rows, action_dim] float32
    starts:       [episodes] int64, first row of each episode; starts[0] == 0
    goal_indices: the state entries that make up the goal space, s^G = phi(s) = s[goal_indices]
    goals:        [rows, goal_dim] float32, the goal recorded with each row, or None
    action_low, action_high: [action_dim] float32, bounds of a valid action
    source:       where the data came from, for people to read
    end_signs:    what said where episodes end, for people to read
    goal_space_from: who named the goal space: whoever asked for the data, its source, or nobody (it is assumed)
    state_names, action_names: of the entries, () where the source has no names
    times:        [rows] float64 seconds, for people to look at, or None
    computed:     what the last entries of a state were computed by, see guider.data.goal_spaces, and how many each
    """

    observations: np.ndarray
    actions: np.ndarray
    starts: np.ndarray
    goal_indices: tuple[int, ...]
    goals: np.ndarray | None
    action_low: np.ndarray
    action_high: np.ndarray
    source: str
    end_signs: tuple[EndSign, ...] = ()
    goal_space_from: GoalSpaceFrom = "asked for"
    state_names: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()
    times: np.ndarray | None = None
    computed: tuple[str, ...] = ()
    computed_widths: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("observations", "actions", "goals"):
            if (array := getattr(self, name)) is not None:
                object.__setattr__(self, name, immutable(array))

    @property
    def lengths(self) -> np.ndarray:
        """[episodes] number of states in each episode."""
        return np.diff(np.append(self.starts, len(self.observations)))

    @property
    def ends(self) -> np.ndarray:
        """[episodes] the last row of each, in which no action is taken."""
        return self.starts + self.lengths - 1

    @property
    def last_rows(self) -> np.ndarray:
        """[rows] int32: for each row, the last row of its episode."""
        return np.repeat(self.ends, self.lengths).astype(np.int32)

    @property
    def logged(self) -> np.ndarray:
        """[rows, logged]: states without what was computed of them."""
        return self.observations[:, : self.observations.shape[1] - sum(self.computed_widths)]

    @property
    def achieved(self) -> np.ndarray:
        """[rows, goal_dim]: s^G of every state."""
        return self.observations[:, list(self.goal_indices)]

    @property
    def spaces(self) -> Spaces:
        low, high, goal = self.observations.min(axis=0), self.observations.max(axis=0), list(self.goal_indices)
        if self.goals is not None:
            low[goal] = np.minimum(low[goal], self.goals.min(axis=0))
            high[goal] = np.maximum(high[goal], self.goals.max(axis=0))
        return Spaces(
            state_dim=self.observations.shape[1],
            goal_indices=self.goal_indices,
            action_low=tuple(map(float, self.action_low)),
            action_high=tuple(map(float, self.action_high)),
            state_low=tuple(map(float, low)),
            state_high=tuple(map(float, high)),
            state_names=self.state_names,
            action_names=self.action_names,
            computed=self.computed,
            computed_widths=self.computed_widths,
            example=tuple(map(float, self.observations[0])) if self.computed else (),
        )

    def fingerprint(self) -> str:
        """Hex digest of everything a learner sees; equal data has equal fingerprints, whatever its source."""
        digest = hashlib.sha256(repr(self.goal_indices).encode())
        for array in (
            self.observations,
            self.actions,
            self.starts,
            self.goals,
            self.action_low,
            self.action_high,
        ):
            if array is None:
                digest.update(b"none")
                continue
            digest.update(f"{array.shape}{array.dtype}".encode())
            digest.update(np.ascontiguousarray(array).data.cast("B"))
        return digest.hexdigest()[:16]

    def select(self, episodes: np.ndarray) -> Episodes:
        """The given episodes (indices, in the given order) as data of their own."""
        starts, lengths = self.starts[episodes], self.lengths[episodes]
        rows = np.concatenate([np.arange(a, a + n) for a, n in zip(starts, lengths, strict=True)])
        return replace(
            self,
            observations=self.observations[rows],
            actions=self.actions[rows],
            goals=None if self.goals is None else self.goals[rows],
            times=None if self.times is None else self.times[rows],
            starts=np.concatenate([[0], np.cumsum(lengths)[:-1]]),
        )

    def with_goal_space(self, goal_indices: Sequence[int]) -> Episodes:
        """The same episodes with the goal space asked for; goals recorded in another are left out."""
        indices = check_goal_indices(goal_indices, self.observations.shape[1], self.source)
        if indices == self.goal_indices:
            return self
        return replace(self, goal_indices=indices, goals=None, goal_space_from="asked for")

    def split(self, held_out: float) -> tuple[Episodes, Episodes]:
        """(training, held-out) episodes; the same fraction always holds out the same episodes, and at least one."""
        if not 0 < held_out < 1:
            raise GuiderError(f"the held-out fraction must lie between 0 and 1, got {held_out}")
        count = len(self.starts)
        n_held = max(1, round(held_out * count))
        if not 0 < n_held < count:
            raise GuiderError(
                f"{self.source}: cannot hold out {held_out:.0%} of {count} episodes, at least one must be held out and "
                "one must remain; learn from all (--held-out 0), or record more"
            )
        order = np.random.default_rng(0).permutation(count)
        return self.select(np.sort(order[n_held:])), self.select(np.sort(order[:n_held]))


_FEW_SINGLE, _SINGLE_FRACTION = 10, 0.01


def make_episodes(
    observations: np.ndarray,
    actions: np.ndarray,
    lengths: np.ndarray | list[int],
    goal_indices: tuple[int, ...] | list[int],
    *,
    goals: np.ndarray | None = None,
    times: np.ndarray | None = None,
    action_low: np.ndarray | float | None = None,
    action_high: np.ndarray | float | None = None,
    source: str = IN_MEMORY,
    end_signs: tuple[EndSign, ...] = (),
) -> Episodes:
    """Validate flat arrays and make Episodes of them.

    observations: [rows, state_dim]; actions: [rows, action_dim], one row per state;
    lengths: [episodes] states per episode, sum == rows. Episodes of a single state hold no transition and
    are dropped. The action in the last row of an episode may be anything, NaN too: it is set to 0, so that
    equal data are equal whatever a source writes there. Action bounds that are not given are inferred (see
    guider.data.arrays): [-1, 1] where all actions lie within it but for rounding, else the extremes seen.

    Raises GuiderError, naming `source` and the offending array, on NaN or inf, wrong shapes, lengths that
    disagree, goal indices out of range, actions outside the bounds given, or no episode of two states.
    """

    def fail(message: str) -> GuiderError:
        return GuiderError(f"{source}: {message}")

    observations, actions = numbers(observations, "observations", source), numbers(actions, "actions", source)
    goals = None if goals is None else numbers(goals, "goals", source)
    for name, array in (("observations", observations), ("goals", goals)):
        if array is not None:
            check_finite(array, name, fail)
    lengths = np.asarray(lengths)

    rows, state_dim = observations.shape
    if len(actions) != rows:
        raise fail(
            f"observations have {rows} rows but actions {len(actions)}; give one action row per state "
            "(the last of an episode is ignored)"
        )
    if lengths.ndim != 1 or lengths.dtype.kind not in "iu" or np.any((lengths < 1) | (lengths > rows)):
        raise fail(f"episode lengths must be a 1-D array of whole numbers from 1 to {rows}, the number of rows")
    if lengths.sum() != rows:
        raise fail(f"episode lengths sum to {lengths.sum()} but there are {rows} rows")
    lengths = lengths.astype(np.int64)
    goal_indices = check_goal_indices(goal_indices, state_dim, source)
    if goals is not None and goals.shape != (rows, len(goal_indices)):
        raise fail(f"goals have shape {goals.shape}, expected {(rows, len(goal_indices))}: one goal per row")

    is_action = np.ones((rows, 1), bool)
    is_action[np.cumsum(lengths) - 1] = False
    actions = np.where(is_action, actions, np.float32(0))
    check_finite(actions, "actions", fail)

    if np.any(lengths < 2):
        single = int(np.sum(lengths < 2))
        if single > max(_FEW_SINGLE, _SINGLE_FRACTION * rows):
            warnings.warn(
                GuiderWarning(f"{source}: {single:,} of {rows:,} rows are episodes of a single state and are left out"),
                stacklevel=2,
            )
        keep = np.repeat(lengths >= 2, lengths)
        observations, actions, is_action = observations[keep], actions[keep], is_action[keep]
        goals = None if goals is None else goals[keep]
        times = None if times is None else times[keep]
        lengths = lengths[lengths >= 2]
    if len(lengths) == 0:
        raise fail("no episode has two states, so there is no transition to learn from")

    low, high = action_bounds(actions[is_action[:, 0]], action_low, action_high, fail)
    return Episodes(
        observations=observations,
        actions=actions,
        starts=np.concatenate([[0], np.cumsum(lengths)[:-1]]),
        goal_indices=goal_indices,
        goals=goals,
        action_low=low,
        action_high=high,
        source=source,
        end_signs=end_signs or (EndSign("lengths", len(lengths)),),
        times=times,
    )


def check_goal_indices(goal_indices: Sequence[int], state_dim: int, source: str) -> tuple[int, ...]:
    """The indices as ints. Raises GuiderError unless they name entries of a state, each once."""
    if isinstance(goal_indices, str) or not all(isinstance(i, int | np.integer) for i in goal_indices):
        raise GuiderError(f"{source}: goal indices must be whole numbers, got {goal_indices!r}")
    indices = tuple(int(i) for i in goal_indices)
    if not indices or len(set(indices)) != len(indices):
        raise GuiderError(f"{source}: goal indices {indices} must name at least one state entry, each once")
    if min(indices) < 0 or max(indices) >= state_dim:
        raise GuiderError(f"{source}: goal indices {indices} must lie in 0..{state_dim - 1}, the entries of a state")
    return indices
