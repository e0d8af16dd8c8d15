"""Data of one's own, HDF5 or npz:

observations [rows, state_dim], actions [rows, action_dim],
lengths [episodes] (states per episode) or episode_ends [rows] (true on the last row of each),
and, where they exist, goals [rows, goal_dim], action_low and action_high [action_dim].
"""

from __future__ import annotations

from guider.data.store import Recording, Store, describe_keys, lengths_from_ends

END_KEYS = ("episode_ends", "timeouts")


def read_plain(store: Store, goal_indices: tuple[int, ...]) -> Recording:
    """Episodes exactly as the file says; jumps are not looked for. `timeouts` will do for `episode_ends`.

    `goal_indices` are not needed to find episodes here; every reader takes them.
    Raises GuiderError for missing or misshapen arrays.
    """
    store.require("observations", "actions")
    observations = store.matrix("observations")
    end_key = next((key for key in END_KEYS if key in store.keys), None)
    if "lengths" in store.keys:
        lengths = store.vector("lengths")
    elif end_key is not None:
        lengths = lengths_from_ends(store.flags(end_key, len(observations)))
    else:
        raise store.fail(f"missing lengths or episode_ends; the file holds {describe_keys(store.keys)}")
    bounds = {key: store.vector(key) for key in ("action_low", "action_high") if key in store.keys}
    return Recording(
        observations,
        store.matrix("actions"),
        lengths,
        store.matrix("goals") if "goals" in store.keys else None,
        bounds.get("action_low"),
        bounds.get("action_high"),
    )
