"""Stages trained before, by everything that determines them, so that runs which share a stage train it once.

Most of what is compared differs in one stage: Table 2's variants share their latent model and their low level. What a
stage depends on is read off the program of its update, not declared: another run's stage is taken over only where
program and inputs are equal to the bit, and so is then the result.

Below the cache's directory, DIGEST/ holds a checkpoint of what the stage trained, and its lines of metrics.jsonl.
Entries may be removed at any time; a damaged one is trained anew.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.extend.core import Var

from guider.errors import GuiderError, GuiderWarning
from guider.learning.training import Position, Stage
from guider.runs import checkpoint
from guider.support.files import clear_leftovers, is_line, read_json, remove, temporary, write_json
from guider.support.locks import clear_free, hold

PyTree = Any


def stage_digest(
    stage: Stage, index: int, state: PyTree, data: PyTree, seeds: Sequence[int], made_with: dict[str, str]
) -> str:
    """Digest of all that a stage's result depends on: program, number of updates, what the update reads, random keys.

    state: leaves [seeds, ...] at the stage's beginning; made_with: the software's versions.
    """
    one_seed = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), state)
    arguments = one_seed, data, jax.random.key(0)
    traced = jax.jit(stage.update).trace(*arguments)
    jaxpr = traced.jaxpr.jaxpr
    read = {name for equation in jaxpr.eqns for name in equation.invars if isinstance(name, Var)} | set(jaxpr.outvars)
    digest = hashlib.blake2b(digest_size=16)
    digest.update(json.dumps([traced.lower().as_text(), index, stage.updates, list(seeds), made_with]).encode())
    for name, leaf in zip(jaxpr.invars, jax.tree.leaves((state, data)), strict=False):  # the key comes last
        if name in read:
            digest.update(np.ascontiguousarray(jax.device_get(leaf)).data)
    return digest.hexdigest()


def find(entry: Path, end: Position, part: PyTree) -> tuple[PyTree, list[dict[str, Any]]] | None:
    """What the stage of this entry trained up to `end`, in the shape of `part`, and its metrics.

    None where there is no entry, and, with a GuiderWarning, where it is damaged.
    """
    template = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), part)
    try:
        restored = checkpoint.restore(entry, template, lambda step, position: (step, position) == (end.update, end))
        lines = read_json(entry / "metrics.json", "remove the entry").get("lines") if restored else []
        if not isinstance(lines, list) or not all(is_line("metrics.jsonl", line) for line in lines):
            raise GuiderError(f"{entry / 'metrics.json'} holds no lines of metrics.jsonl")
    except (GuiderError, OSError) as error:
        warnings.warn(GuiderWarning(f"{entry} is damaged, its stage is trained anew: {error}"), stacklevel=2)
        return None
    return restored and (restored[1], lines)


def keep(entry: Path, position: Position, part: PyTree, metrics: list[dict[str, Any]]) -> None:
    """Remember what a stage trained, in place of a damaged entry. Raises OSError where that fails."""
    new = temporary(entry)
    try:
        checkpoint.save(new, position.update, position, part)
        write_json(new / "metrics.json", {"lines": metrics})
        remove(entry)
        new.rename(entry)
    except OSError:
        shutil.rmtree(new, ignore_errors=True)
        raise


def clear(directory: Path) -> None:
    """Remove what killed processes left of entries."""
    if directory.is_dir():
        clear_leftovers(directory, r"[0-9a-f]{32}")
        clear_free(directory, f".{'[0-9a-f]' * 32}.lock")


@contextmanager
def training(entry: Path, waiting: Callable[[str], None]) -> Iterator[None]:
    """Within, no other process trains the stage of this entry. While one does, `waiting` is told again and again."""
    entry.parent.mkdir(parents=True, exist_ok=True)
    with hold(entry.with_name(f".{entry.name}.lock"), f"the stage of {entry} is being trained", waiting):
        yield
