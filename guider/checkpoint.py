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
            state=ocp.args.StandardSave({name: np.asarray(leaf) for name, leaf in _named(state).items()}),
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
        arguments = ocp.args.Composite(
            state=ocp.args.StandardRestore(_named(template)), position=ocp.args.JsonRestore()
        )
        try:
            restored = manager.restore(step, args=arguments)
        except (ValueError, KeyError, OSError) as error:
            raise _misfit(directory / str(step), str(error).strip().splitlines()[0]) from error
    stored = restored["state"]
    for name, wanted in _named(template).items():
        if stored[name].shape != wanted.shape:
            raise _misfit(directory / str(step), f"{name} has shape {stored[name].shape}, not {wanted.shape}")
    leaves, structure = jax.tree_util.tree_flatten_with_path(template)
    filled = [stored.get(_name(path), np.zeros(leaf.shape, leaf.dtype)) for path, leaf in leaves]
    return Position(**restored["position"]), jax.tree.unflatten(structure, filled)


def _named(tree: PyTree) -> dict[str, Any]:
    """Leaves by name; those without a single entry are left out, orbax does not take them."""
    return {_name(path): leaf for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0] if leaf.size}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _misfit(path: Path, reason: str) -> GuiderError:
    return GuiderError(f"{path} does not fit this run's config: {reason}")
