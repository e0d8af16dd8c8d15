"""The whole training state on disk: written to a temporary name and renamed, so a crash never leaves half of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np

from guider.errors import GuiderError
from guider.training import Position

PyTree = Any


def _manager(directory: Path):
    import orbax.checkpoint as ocp  # heavy: only runs that read or write checkpoints pay for it

    options = ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False)
    return ocp, ocp.CheckpointManager(directory.absolute(), options=options)


def save(directory: Path, total_updates: int, position: Position, state: PyTree) -> None:
    """Write `state` as the checkpoint after `total_updates` updates; the two newest are kept."""
    ocp, manager = _manager(directory)
    with manager:
        arguments = ocp.args.Composite(
            state=ocp.args.StandardSave(jax.tree.map(np.asarray, state)),
            position=ocp.args.JsonSave({"stage": position.stage, "update": position.update}),
        )
        manager.save(total_updates, args=arguments, force=True)


def restore(directory: Path, template: PyTree) -> tuple[Position, PyTree] | None:
    """The newest complete checkpoint, (position, state shaped like `template`), or None where there is none.

    template: tree of jax.ShapeDtypeStruct. Raises GuiderError if the checkpoint has another shape.
    """
    if not directory.is_dir():
        return None
    ocp, manager = _manager(directory)
    with manager:
        step = manager.latest_step()
        if step is None:
            return None
        arguments = ocp.args.Composite(state=ocp.args.StandardRestore(template), position=ocp.args.JsonRestore())
        try:
            restored = manager.restore(step, args=arguments)
        except (ValueError, KeyError, OSError) as error:
            raise _misfit(directory / str(step), str(error).strip().splitlines()[0]) from error
    for stored, wanted in zip(jax.tree.leaves(restored["state"]), jax.tree.leaves(template), strict=True):
        if stored.shape != wanted.shape:
            raise _misfit(directory / str(step), f"it holds an array of shape {stored.shape}, not {wanted.shape}")
    return Position(**restored["position"]), restored["state"]


def _misfit(path: Path, reason: str) -> GuiderError:
    return GuiderError(f"{path} does not fit this run's config: {reason}")
