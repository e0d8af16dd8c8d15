"""Trajectories saved by the package imitation: an npz of obs, acts, indices, terminal."""

from __future__ import annotations

import numpy as np

from guider.data.store import Store, stacked


def is_imitation(store: Store) -> bool:
    return {"obs", "acts", "indices", "terminal"} <= set(store.keys)


def read_imitation(store: Store) -> Store:
    """`indices` [episodes - 1] say where `acts` are cut; each episode of T actions has T + 1 of `obs`. Raises
    GuiderError where they do not fit.
    """
    store.admit("acts")
    observations, cuts = store.matrix("obs"), store.vector("indices")
    actions = np.asarray(store.file["acts"])
    actions = actions[:, None] if actions.ndim == 1 else actions
    ends = np.append(cuts, len(actions))
    if cuts.dtype.kind not in "iu" or (np.diff(ends, prepend=0) < 1).any():
        raise store.fail(f"indices must cut the {len(actions)} rows of acts into episodes, in order")
    if len(observations) != len(actions) + len(ends):
        raise store.fail(
            f"{len(ends)} episodes of {len(actions)} acts need {len(actions) + len(ends)} obs, not {len(observations)}"
        )
    starts = np.append(0, ends[:-1])
    return stacked(
        store.source,
        store.kind,
        (
            (f"episode {i}", {"obs": observations[start + i : end + i + 1], "acts": actions[start:end]})
            for i, (start, end) in enumerate(zip(starts, ends, strict=True))
        ),
    )
