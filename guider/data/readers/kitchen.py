"""D4RL's kitchen files: observations, actions, terminals, sometimes timeouts."""

from __future__ import annotations

import numpy as np

from guider.data.ends import FLAGS, NUMBERS, find_ends
from guider.data.episodes import check_goal_indices
from guider.data.recording import Wanted, infos_goal, no_goal_space
from guider.data.store import Recording, Store, in_memory, store_of

KITCHEN_ACTIONS = 9
# A kitchen state is 30 numbers: joint positions of the robot (9) and of the objects (21). Other entries of rows that
# are wider are left out: of 59 numbers, Gymnasium-Robotics' FrankaKitchen-v1, the velocities of both (D4RL records
# none); of 60, D4RL, the goal.
_KITCHEN_ENTRIES = {30: np.arange(30), 59: np.r_[0:9, 18:39], 60: np.arange(30)}
KITCHEN_COLUMNS = tuple(_KITCHEN_ENTRIES)


def is_kitchen(store: Store) -> bool:
    """Whether a file is D4RL's kitchen: by its widths and, of 60 numbers, by a goal that stays from row to row."""
    if not {"observations", "actions", "terminals"} <= set(store.keys) or {"lengths", "episode_ends"} & set(store.keys):
        return False
    columns = store.width("observations")
    if store.width("actions") != KITCHEN_ACTIONS or columns not in (30, 60):
        return False
    return columns == 30 or bool(np.mean(np.diff(store.matrix("observations")[:, 30:], axis=0) == 0) > 0.9)


def without_velocities(store: Store) -> Store:
    """Of Minari's kitchen, whose states are 59 numbers, what all kitchens have in common; any other store as it is."""
    if store.kind != "Minari" or (store.width("observation"), store.width("actions")) != (59, KITCHEN_ACTIONS):
        return store
    states = kitchen_states(store.matrix("observation"))
    return store_of(store.source, store.kind, {**in_memory(store), "observation": states}, lengths=store.lengths)


def read_kitchen(store: Store, wanted: Wanted) -> Recording:
    """Episodes end at every flag, where the kitchen's are over, and with their number; jumps are no ends, because
    a switch that snaps over is one.

    Rows of 59 or 60 numbers become states of 30, see kitchen_states. Of 60, the last 30 are the goal, recorded in
    the same order, so goals are its entries `goal_indices`. Rows of any other width are states as they stand.
    """
    store.require("observations", "actions")
    goal_indices = wanted.assumed_goal if wanted.goal_indices is None else wanted.goal_indices
    if goal_indices is None:
        raise no_goal_space(store.source)
    observations = store.matrix("observations")
    signs = tuple(name for name in (*NUMBERS, *FLAGS) if name in store.keys)
    ends = find_ends(store, observations, None, wanted.episode_ends or signs)
    states = kitchen_states(observations) if observations.shape[1] in KITCHEN_COLUMNS else observations
    goal_indices = check_goal_indices(goal_indices, states.shape[1], store.source)
    has_goals = observations.shape[1] == 60
    goals = observations[:, 30:][:, list(goal_indices)] if has_goals else infos_goal(store, len(goal_indices))
    return Recording(
        states,
        store.matrix("actions"),
        ends.lengths,
        goals,
        end_signs=ends.signs,
        warning=ends.warning,
        goal_indices=wanted.goal_indices,
    )


def kitchen_states(rows: np.ndarray) -> np.ndarray:
    """[..., 30, 59 or 60] rows of any kitchen's data -> [..., 30] states: positions of the robot's 9 joints (rad; m for
    the fingers) and of the objects' 21 (rad or m; the kettle's are its position and quaternion)."""
    return rows[..., _KITCHEN_ENTRIES[rows.shape[-1]]]
