"""From a store of arrays, whoever wrote them, to what was recorded: which columns are the state, the action and the
goal, and where episodes end.

Files of one's own, D4RL's and OGBench's have observations [rows, state_dim], actions [rows, action_dim], one or more
signs of where episodes end (guider.data.ends), and, where they exist, goals or infos/goal [rows, goal_dim], action_low
and action_high [action_dim]. Arrays called achieved_goal and desired_goal are Gymnasium's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guider.data.columns import ACHIEVED, DESIRED, choose_actions, choose_states, entries_called, rows_called
from guider.data.ends import TIMES, find_ends
from guider.data.episodes import check_goal_indices
from guider.data.store import Recording, Store, describe_keys
from guider.errors import GuiderError
from guider.goals import goal_entries

_FEWEST_ROWS = 10_000


@dataclass(frozen=True)
class Wanted:
    """What was asked of a source.

    goal_indices, goal: the state entries of the goal space, by number or by name; None and () for the source's own;
    assumed_goal: taken where nobody names one, None to raise; state, action: patterns of names, () for the usual ones;
    episode_ends: signs of episode ends to take, () to decide.
    """

    goal_indices: tuple[int, ...] | None = None
    goal: tuple[str, ...] = ()
    assumed_goal: tuple[int, ...] | None = None
    state: tuple[str, ...] = ()
    action: tuple[str, ...] = ()
    episode_ends: tuple[str, ...] = ()


def recording_of(store: Store, wanted: Wanted) -> Recording:
    """Raises GuiderError for missing or misshapen arrays, where nobody names a goal space, and for what `find_ends`
    refuses.

    An achieved goal is put in front of the state where it is not among its entries (as in AntMaze, whose `observation`
    leaves out x and y), so that a goal space can always be named by state entries. `desired_goal` is the recorded goal
    where the achieved one is the goal space asked for, or none is. Goals recorded as D4RL does, `infos/goal`, are left
    out where they are of another goal space: have another number of entries, or mostly lie further off than the states
    range.
    """
    states, actions = choose_states(store, wanted.state), choose_actions(store, wanted.action)
    achieved, desired = rows_called(store, ACHIEVED), rows_called(store, DESIRED)
    observations, own = with_goal_space(states.rows, achieved, store.source)
    names = states.names or store.texts("state_names")
    if own and observations is not states.rows and names:
        names = (*(f"{ACHIEVED}.{i}" for i in range(len(own))), *names)
    if own is None and "goal_indices" in store.keys:
        own = tuple(store.vector("goal_indices").tolist())
    asked = wanted.goal_indices
    if wanted.goal:
        asked = entries_called(names, observations.shape[1], wanted.goal, store.source)
    known = own if asked is None else asked
    indices = wanted.assumed_goal if known is None else known
    if indices is None:
        listed = f" (entries: {describe_keys(names)})" if names else ""
        raise no_goal_space(store.source, f"--goal {' '.join(names[:2])}" if names else "--goal-indices 0 1", listed)
    indices = check_goal_indices(indices, observations.shape[1], store.source)
    reached = observations[:, list(indices)]
    ends = find_ends(store, observations, reached, wanted.episode_ends)
    warnings = [ends.warning] if ends.warning else []
    goals = store.matrix("goals") if "goals" in store.keys else desired
    if own is not None and not _same_space(indices, own, observations):
        goals = None
    elif goals is None and (goals := infos_goal(store, len(indices))) is not None and not _lie_near(goals, reached):
        goals = None
        warnings.append("infos/goal lies elsewhere than where the goal entries go: left out")
    bounds = {key: store.vector(key) for key in ("action_low", "action_high") if key in store.keys}
    return Recording(
        observations,
        _a_row_each(actions.rows, ends.lengths, len(observations)),
        ends.lengths,
        goals,
        bounds.get("action_low"),
        bounds.get("action_high"),
        ends.signs,
        "; ".join(warnings) or None,
        known,
        names,
        actions.names or store.texts("action_names"),
        _times(store, len(observations)),
    )


def _times(store: Store, rows: int) -> np.ndarray | None:
    """[rows] seconds. Times of day in milli-, micro- and nanoseconds are known by their size."""
    for name in TIMES:
        times = store.column(name, rows)
        if times is not None and np.isfinite(times).all():
            size = float(np.abs(times).max())
            unit = next((unit for least, unit in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)) if size > least), 1.0)
            return times.astype(np.float64) * unit
    return None


def no_goal_space(source: str, example: str = "--goal-indices 0 1", listed: str = "") -> GuiderError:
    return GuiderError(f"{source} does not say which state entries are the goal; name them ({example}){listed}")


def with_goal_space(
    states: np.ndarray, achieved: np.ndarray | None, source: str
) -> tuple[np.ndarray, tuple[int, ...] | None]:
    """States among whose entries the achieved goal is: it is put in front where it is not. states: [rows, S]; achieved:
    [rows, G], None where the source has none. Returns (states, the entries of the source's goal space).
    """
    if achieved is None:
        return states, None
    if len(achieved) != len(states):
        raise GuiderError(f"{source}: there are {len(achieved)} achieved goals for {len(states)} states")
    if (own := goal_entries(states, achieved)) is not None:
        return states, own
    return np.concatenate([achieved, states], axis=1), tuple(range(achieved.shape[1]))


def _same_space(asked: tuple[int, ...], own: tuple[int, ...], observations: np.ndarray) -> bool:
    return len(asked) == len(own) and np.allclose(observations[:, list(asked)], observations[:, list(own)], atol=1e-5)


def _a_row_each(actions: np.ndarray, lengths: np.ndarray, rows: int) -> np.ndarray:
    """[rows, A] actions, one for every state: where each episode has a state more than actions, zeros in its last
    row."""
    if len(actions) == rows or lengths.sum() != rows or len(actions) != rows - len(lengths):
        return actions
    return np.insert(actions, np.cumsum(lengths - 1), np.float32(0), axis=0)


@np.errstate(invalid="ignore", over="ignore")  # NaN and inf are reported later, with their row
def _lie_near(goals: np.ndarray, achieved: np.ndarray) -> bool:
    """Whether most goals are at most thrice as far off as the states themselves go; little data says nothing of that.

    goals, achieved: [rows, goal_dim].
    """
    if len(achieved) < _FEWEST_ROWS:
        return True
    low, high = achieved.min(axis=0), achieved.max(axis=0)
    reach = 3 * np.linalg.norm(high - low)
    far = (goals < low - reach) | (goals > high + reach)
    return bool(np.mean(far.any(axis=1)) < 0.5)


def infos_goal(store: Store, goal_dim: int) -> np.ndarray | None:
    """[rows, goal_dim] D4RL's recorded goals, None where there are none of that size."""
    if "infos/goal" not in store.keys:
        return None
    goals = store.matrix("infos/goal")
    return goals if goals.shape[1] == goal_dim else None
