"""Files of arrays, HDF5 or npz, whoever wrote them: one's own, D4RL's antmaze, OGBench's.

observations [rows, state_dim], actions [rows, action_dim], one or more signs of where episodes end (guider.data.ends),
and, where they exist, goals or infos/goal [rows, goal_dim], action_low and action_high [action_dim].
"""

from __future__ import annotations

import numpy as np

from guider.data.ends import find_ends
from guider.data.store import Recording, Store
from guider.episodes import check_goal_indices

GOAL_KEYS = ("goals", "infos/goal")


def read_arrays(store: Store, goal_indices: tuple[int, ...], episode_ends: tuple[str, ...]) -> Recording:
    """Raises GuiderError for missing or misshapen arrays, and for what `find_ends` refuses.

    Goals recorded as D4RL does, `infos/goal`, are left out where they have another number of entries than the goal
    space.
    """
    store.require("observations", "actions")
    observations = store.matrix("observations")
    goal_indices = check_goal_indices(goal_indices, observations.shape[1], store.source)
    ends = find_ends(store, observations, observations[:, list(goal_indices)], episode_ends)
    bounds = {key: store.vector(key) for key in ("action_low", "action_high") if key in store.keys}
    return Recording(
        observations,
        store.matrix("actions"),
        ends.lengths,
        store.matrix("goals") if "goals" in store.keys else infos_goal(store, len(goal_indices)),
        bounds.get("action_low"),
        bounds.get("action_high"),
        ends.signs,
        ends.warning,
    )


def infos_goal(store: Store, goal_dim: int) -> np.ndarray | None:
    """[rows, goal_dim] D4RL's recorded goals, None where there are none of that size."""
    if "infos/goal" not in store.keys:
        return None
    goals = store.matrix("infos/goal")
    return goals if goals.shape[1] == goal_dim else None
