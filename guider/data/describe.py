"""Facts about logged trajectories, to look at before learning from them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from guider.data import suggestions
from guider.data.episodes import SMALLEST_SPREAD, Episodes
from guider.data.findings import find_faults

_WINDOWS = (1, 5, 10, 20, 50, 100)
_STILL_FRACTION = 1e-3
_BOUND_FRACTION = 1e-3


def describe(episodes: Episodes) -> dict[str, Any]:
    """Numbers, strings and lists only, so that it can be written as JSON.

    `state_range` is [lowest, highest] of each state entry, `goal_range` of each goal-space entry.
    `goal_travel` says how far states that lie `steps` rows apart in one episode are from each other in goal
    space: the median distance, and the fraction that stay within a thousandth of the goal space the data
    covers. It helps to choose a subgoal period and to see data that stands still. Periods longer than every
    episode are left out. `actions_at_bounds` is the fraction of action entries that lie within a thousandth of their
    range from a bound: behaviour at its limits may be worth repeating more gently (`action_scale`, which scales
    towards `resting_action`). `episode_ends` lists every sign of where episodes end, how many rows it marks, and
    whether these were taken as ends. `goal_space_from` says who named the goal indices: "assumed" if nobody did.
    `hardly_varying_state_entries` have a spread below 0.001, which is as good as none to a network. `rate_hz` is None
    where the source has no time. `could_be_goal` names state entries, `no_goal` says why others could not be one;
    `suggested_radius` is for the goal entries above. `faults` are lines about what is wrong, or may be
    (guider.data.findings), and `verdict` sums them up.
    """
    achieved = episodes.achieved
    low, high = episodes.observations.min(axis=0), episodes.observations.max(axis=0)
    indices = list(episodes.goal_indices)
    lengths = episodes.lengths
    candidates, refused = suggestions.goal_candidates(episodes)
    faults = find_faults(episodes)
    extent = float(np.linalg.norm(high[indices] - low[indices]))
    return {
        "source": episodes.source,
        "fingerprint": episodes.fingerprint(),
        "rows": len(episodes.observations),
        "transitions": int(np.sum(lengths - 1)),
        "episodes": len(lengths),
        "episode_length": {
            "min": int(lengths.min()),
            "median": float(np.median(lengths)),
            "max": int(lengths.max()),
        },
        "episode_ends": [asdict(sign) for sign in episodes.end_signs],
        "rate_hz": suggestions.rate(episodes),
        "state_names": list(episodes.state_names),
        "action_names": list(episodes.action_names),
        "state_dim": episodes.observations.shape[1],
        "action_dim": episodes.actions.shape[1],
        "goal_indices": indices,
        "goal_space_from": episodes.goal_space_from,
        "state_range": _pairs(low, high),
        "constant_state_entries": [int(i) for i in np.flatnonzero(low == high)],
        "hardly_varying_state_entries": _hardly_varying(episodes.observations),
        "goal_range": _pairs(low[indices], high[indices]),
        "action_bounds": _pairs(episodes.action_low, episodes.action_high),
        "resting_action": [_round(entry) for entry in np.clip(0.0, episodes.action_low, episodes.action_high)],
        "actions_at_bounds": _at_bounds(episodes),
        "recorded_goals": episodes.goals is not None,
        "goal_travel": [
            _travel(achieved, episodes.last_rows, steps, extent) for steps in _WINDOWS if steps < lengths.max()
        ],
        "could_be_goal": suggestions.named(episodes, candidates),
        "no_goal": dict(zip(suggestions.named(episodes, list(refused)), refused.values(), strict=True)),
        "suggested_radius": suggestions.suggested_radius(episodes),
        "faults": faults,
        "verdict": _verdict(faults, candidates),
    }


def in_words(value: Any) -> str:
    """A value of a description in a line, for people to read."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {in_words(item)}" for name, item in value.items())
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "; ".join(map(in_words, value))
    if isinstance(value, list) and value and isinstance(value[0], str):
        return ", ".join(value)
    return str(value)


def _verdict(faults: list[str], candidates: list[int]) -> str:
    if not candidates:
        return "would not train on this: no entry moves and ends at different values, so there is nothing to aim at"
    if faults:
        return (
            f"look at the {len(faults)} findings above, then train"
            if len(faults) > 1
            else "look at the finding above, then train"
        )
    return "nothing found that speaks against training on it"


def _hardly_varying(observations: np.ndarray) -> list[int]:
    spread = observations.std(axis=0, dtype=np.float64)
    return [int(i) for i in np.flatnonzero((spread < SMALLEST_SPREAD) & (np.ptp(observations, axis=0) > 0))]


def _at_bounds(episodes: Episodes) -> float:
    actions = np.delete(episodes.actions, episodes.last_rows[episodes.starts], axis=0)  # nothing follows a last row
    margin = _BOUND_FRACTION * (episodes.action_high - episodes.action_low)
    return _round(np.mean((actions <= episodes.action_low + margin) | (actions >= episodes.action_high - margin)))


def _travel(achieved: np.ndarray, last_rows: np.ndarray, steps: int, extent: float) -> dict[str, Any]:
    first = np.flatnonzero(np.arange(len(achieved)) + steps <= last_rows)
    distances = np.linalg.norm(achieved[first + steps] - achieved[first], axis=1)
    return {
        "steps": steps,
        "windows": len(first),
        "median_distance": _round(np.median(distances)),
        "still_fraction": _round(np.mean(distances <= _STILL_FRACTION * extent)),
    }


def _pairs(low: np.ndarray, high: np.ndarray) -> list[list[float]]:
    return [[_round(a), _round(b)] for a, b in zip(low, high, strict=True)]


def _round(value: np.floating | float) -> float:
    """Six significant digits: more than anyone reads, and what float32 holds."""
    return float(f"{float(value):.6g}")
