"""Files of arrays, HDF5 or npz, whoever wrote them: one's own, D4RL's antmaze, OGBench's.

observations [rows, state_dim], actions [rows, action_dim], one or more signs of where episodes end (guider.data.ends),
and, where they exist, goals or infos/goal [rows, goal_dim], action_low and action_high [action_dim].
"""

from __future__ import annotations

import numpy as np

from guider.data.ends import find_ends
from guider.data.episodes import check_goal_indices
from guider.data.store import Recording, Store

_FEWEST_ROWS = 10_000


def read_arrays(store: Store, goal_indices: tuple[int, ...], episode_ends: tuple[str, ...]) -> Recording:
    """Raises GuiderError for missing or misshapen arrays, and for what `find_ends` refuses.

    Goals recorded as D4RL does, `infos/goal`, are left out where they are of another goal space: have another
    number of entries, or mostly lie further off than the states range.
    """
    store.require("observations", "actions")
    observations = store.matrix("observations")
    goal_indices = check_goal_indices(goal_indices, observations.shape[1], store.source)
    achieved = observations[:, list(goal_indices)]
    ends = find_ends(store, observations, achieved, episode_ends)
    goals = store.matrix("goals") if "goals" in store.keys else infos_goal(store, len(goal_indices))
    warning = ends.warning
    if goals is not None and "goals" not in store.keys and not _lie_near(goals, achieved):
        goals, elsewhere = None, "infos/goal lies elsewhere than where the goal entries go: left out"
        warning = f"{warning}; {elsewhere}" if warning else elsewhere
    bounds = {key: store.vector(key) for key in ("action_low", "action_high") if key in store.keys}
    return Recording(
        observations,
        store.matrix("actions"),
        ends.lengths,
        goals,
        bounds.get("action_low"),
        bounds.get("action_high"),
        ends.signs,
        warning,
    )


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
