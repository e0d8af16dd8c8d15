"""OGBench's npz: observations, actions, terminals."""

from __future__ import annotations

from guider.data.store import Recording, Store, lengths_from_ends


def read_ogbench(store: Store, goal_indices: tuple[int, ...]) -> Recording:
    """`terminals` marks the last row of each episode, whose action is not valid; no goals are recorded.

    `goal_indices` are not needed to find episodes here; every reader takes them.
    Raises GuiderError for missing or misshapen arrays.
    """
    store.require("observations", "actions", "terminals")
    observations = store.matrix("observations")
    lengths = lengths_from_ends(store.flags("terminals", len(observations)))
    return Recording(observations, store.matrix("actions"), lengths)
