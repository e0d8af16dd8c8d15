"""D4RL's files: observations, actions, terminals, timeouts, and in antmaze infos/goal.

Flags differ in meaning between D4RL's domains. In antmaze `terminals` marks rows near the goal and the ant
walks on, so they never end an episode here. In the kitchen the episode is over at `terminals`.
"""

from __future__ import annotations

import numpy as np

from guider.data.store import Recording, Store, lengths_from_ends
from guider.episodes import check_goal_indices

KITCHEN_ACTIONS = 9
# A kitchen state is 30 numbers: joint positions of the robot (9) and of the objects (21). Other entries of rows that
# are wider are left out: of 59 numbers, Gymnasium-Robotics' FrankaKitchen-v1, the velocities of both (D4RL records
# none); of 60, D4RL, the goal.
_KITCHEN_ENTRIES = {30: np.arange(30), 59: np.r_[0:9, 18:39], 60: np.arange(30)}
KITCHEN_COLUMNS = tuple(_KITCHEN_ENTRIES)

_JUMP_FACTOR = 4.0
_NEIGHBOUR_FACTOR = 2.0
_STILL_FRACTION = 1e-3


def read_d4rl(store: Store, goal_indices: tuple[int, ...]) -> Recording:
    """D4RL antmaze and its like: episodes end at `timeouts` and where the state jumps, never at `terminals`.

    Goals are those in `infos/goal`, if they have as many entries as the goal space. Raises GuiderError for
    missing or misshapen arrays.
    """
    store.require("observations", "actions")
    observations = store.matrix("observations")
    goal_indices = check_goal_indices(goal_indices, observations.shape[1], store.source)
    rows = len(observations)
    ends = store.flags("timeouts", rows) if "timeouts" in store.keys else np.zeros(rows, bool)
    ends[:-1] |= find_jumps(observations[:, list(goal_indices)], ends)
    return Recording(observations, store.matrix("actions"), lengths_from_ends(ends), _infos_goal(store, goal_indices))


def read_d4rl_kitchen(store: Store, goal_indices: tuple[int, ...]) -> Recording:
    """D4RL kitchen: episodes end at `terminals` and at `timeouts`; jumps are not looked for, because a switch
    that snaps over is one.

    Rows of 59 or 60 numbers become states of 30, see kitchen_states. Of 60, the last 30 are the goal, recorded in
    the same order, so goals are its entries `goal_indices`. Rows of any other width are states as they stand.
    """
    store.require("observations", "actions", "terminals")
    observations = store.matrix("observations")
    rows = len(observations)
    ends = store.flags("terminals", rows)
    if "timeouts" in store.keys:
        ends |= store.flags("timeouts", rows)
    states = kitchen_states(observations) if observations.shape[1] in KITCHEN_COLUMNS else observations
    goal_indices = check_goal_indices(goal_indices, states.shape[1], store.source)
    has_goals = observations.shape[1] == 60
    goals = observations[:, 30:][:, list(goal_indices)] if has_goals else _infos_goal(store, goal_indices)
    return Recording(states, store.matrix("actions"), lengths_from_ends(ends), goals)


def kitchen_states(rows: np.ndarray) -> np.ndarray:
    """[..., 30, 59 or 60] rows of any kitchen's data -> [..., 30] states: positions of the robot's 9 joints (rad; m for
    the fingers) and of the objects' 21 (rad or m; the kettle's are its position and quaternion)."""
    return rows[..., _KITCHEN_ENTRIES[rows.shape[-1]]]


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
    66 times. A reset that lands within 4 times of the last state (1 % of antmaze's) is not seen: `timeouts`
    are for those.
    """
    if len(achieved) < 2:
        return np.zeros(0, bool)
    with np.errstate(invalid="ignore", over="ignore"):  # NaN and inf are reported later, with their row
        moved = np.linalg.norm(np.diff(achieved, axis=0), axis=1)
        extent = np.linalg.norm(achieved.max(axis=0) - achieved.min(axis=0))
        regular = moved[~ends[:-1] & (moved > _STILL_FRACTION * extent)]
    if len(regular) == 0:
        return np.zeros(len(moved), bool)
    far = moved > _JUMP_FACTOR * np.quantile(regular, 0.9, method="lower")
    padded = np.pad(moved, 1)
    return far & (moved > _NEIGHBOUR_FACTOR * np.maximum(padded[:-2], padded[2:]))


def _infos_goal(store: Store, goal_indices: tuple[int, ...]) -> np.ndarray | None:
    if "infos/goal" not in store.keys:
        return None
    goals = store.matrix("infos/goal")
    return goals if goals.shape[1] == len(goal_indices) else None
