"""Stages trained before, by everything that determines them, so that runs which share a stage train it once.

Most of what is compared differs in one stage: Table 2's variants share their latent model and their low level. What a
stage depends on is read off the program of its update, not declared: another run's stage is taken over only where
program and inputs are equal to the bit, and so is then the result.

Below the cache's directory, DIGEST/ holds a checkpoint of what the stage trained, and its lines of metrics.jsonl.
Entries may be removed at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.extend.core import Var

from guider import checkpoint
from guider.training import Position, Stage

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


def find(entry: Path, part: PyTree) -> tuple[PyTree, list[dict[str, Any]]] | None:
    """What the stage of this entry trained, in the shape of `part`, and its metrics; None where there is no entry."""
    template = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), part)
    restored = checkpoint.restore(entry, template)
    return restored and (restored[1], json.loads((entry / "metrics.json").read_text()))


def keep(entry: Path, position: Position, part: PyTree, metrics: list[dict[str, Any]]) -> None:
    """Remember what a stage trained. Where another run has just done so, its entry stays."""
    temporary = entry.with_name(f".{entry.name}.{os.getpid()}")
    temporary.mkdir(parents=True)
    (temporary / "metrics.json").write_text(json.dumps(metrics))
    checkpoint.save(temporary, position.update, position, part)
    try:
        temporary.rename(entry)
    except OSError:
        if not entry.exists():
            raise
        shutil.rmtree(temporary)
