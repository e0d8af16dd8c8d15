"""What logs themselves say of what they could be used for: which entries could be a goal, how near is near."""

from __future__ import annotations

import numpy as np

from guider.data.episodes import Episodes

_LEAST_TRAVEL, _LEAST_ENDS = 0.1, 0.3
_SPEED_CORRELATION = 0.8
_PERIOD_RADII, _LEAST_PERIOD, _SHORTEST_PERIOD = 3.0, 20, 5
_RADIUS_OF_EXTENT, _RADIUS_OF_STEP = 0.03, 2.0


def goal_candidates(episodes: Episodes) -> tuple[list[int], dict[int, str]]:
    """(state entries that could be a goal, entry -> why it could not).

    Such an entry moves within most episodes, by a tenth of all it covers, different episodes end at different values of
    it, and it is no other entry's speed.
    """
    states = episodes.observations.astype(np.float64)
    spans = np.ptp(states, axis=0)
    starts, ends = episodes.starts, episodes.ends
    travelled = np.median(np.maximum.reduceat(states, starts) - np.minimum.reduceat(states, starts), axis=0)
    varied = states[ends].std(axis=0) / np.maximum(states.std(axis=0), 1e-30)
    speeds = _speeds(episodes)
    good, refused = [], {}
    for entry in range(states.shape[1]):
        if spans[entry] == 0:
            refused[entry] = "never changes"
        elif entry in speeds:
            refused[entry] = f"the speed of {_name(episodes, speeds[entry])}"
        elif travelled[entry] < _LEAST_TRAVEL * spans[entry]:
            refused[entry] = "hardly moves within an episode"
        elif varied[entry] < _LEAST_ENDS:
            refused[entry] = "ends at much the same value in every episode"
        else:
            good.append(entry)
    return good, refused


def suggested_radius(episodes: Episodes) -> float:
    """A distance at which a goal could count as met: 3 % of what the goal space covers, or two usual steps if that is
    more; to one significant digit."""
    achieved = episodes.achieved.astype(np.float64)
    steps = np.linalg.norm(np.diff(achieved, axis=0), axis=1)
    steps = np.delete(steps, episodes.starts[1:] - 1)
    moving = steps[steps > 1e-3 * max(float(steps.max(initial=0.0)), 1e-30)]
    extent = float(np.linalg.norm(np.quantile(achieved, 0.99, axis=0) - np.quantile(achieved, 0.01, axis=0)))
    radius = max(_RADIUS_OF_EXTENT * extent, _RADIUS_OF_STEP * float(np.median(moving)) if len(moving) else 0.0)
    return float(f"{radius:.1g}")


def suggested_period(episodes: Episodes, radius: float) -> int:
    """c, steps between subgoals: the fewest in which windows that move (further than `radius`) go three radii in the
    median; 20 at least, within which a robot can change its speed, but a third of the median episode at most, or 5
    where that is less. Antmaze's come to some 50 so, the paper's number.
    """
    achieved, last = episodes.achieved.astype(np.float64), episodes.last_rows
    rows = np.arange(len(achieved))

    def goes_far(steps: int) -> bool:
        first = rows[rows + steps <= last]
        moved = np.linalg.norm(achieved[first + steps] - achieved[first], axis=1)
        moved = moved[moved > radius]
        return len(moved) > 0 and float(np.median(moved)) >= _PERIOD_RADII * radius

    longest = int(episodes.lengths.max()) - 1
    high = min(max(_SHORTEST_PERIOD, int(np.median(episodes.lengths)) // 3), longest)
    low = min(_LEAST_PERIOD, high)
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if goes_far(middle) else (middle + 1, high)
    return low


def rate(episodes: Episodes) -> float | None:
    """Steps a second, None where the source has no time."""
    if episodes.times is None:
        return None
    steps = np.delete(np.diff(episodes.times), episodes.starts[1:] - 1)
    usual = float(np.median(steps))
    return float(f"{1 / usual:.3g}") if usual > 0 else None


def named(episodes: Episodes, entries: list[int]) -> list[str]:
    return [_name(episodes, entry) for entry in entries]


def _speeds(episodes: Episodes) -> dict[int, int]:
    """entry -> the entry whose step it goes with."""
    inside = np.delete(np.arange(len(episodes.observations) - 1), episodes.starts[1:] - 1)
    rows = inside[np.linspace(0, len(inside) - 1, min(len(inside), 20_000)).astype(int)]
    now, later = (episodes.observations[rows + offset].astype(np.float64) for offset in (0, 1))
    matrix = np.maximum(_correlations(now, later - now), _correlations(later, later - now))
    np.fill_diagonal(matrix, 0.0)
    return {int(i): int(matrix[i].argmax()) for i in np.flatnonzero(matrix.max(axis=1) > _SPEED_CORRELATION)}


def _correlations(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[entries, entries] of every entry of the one with every entry of the other, without sign."""
    first, second = (values - values.mean(axis=0) for values in (first, second))
    size = np.outer(*(np.sqrt((values**2).sum(axis=0)) for values in (first, second)))
    return np.abs(first.T @ second) / np.maximum(size, 1e-30)


def _name(episodes: Episodes, entry: int) -> str:
    return episodes.state_names[entry] if episodes.state_names else str(entry)
