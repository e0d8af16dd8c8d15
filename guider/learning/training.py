"""The training engine: compiled chunks of updates, many seeds in one program. It knows no method and no task."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

PyTree = Any
Metrics = dict[str, jax.Array]

SLICE_SECONDS = 1.0
"""How long training goes on before it looks whether it is to stop."""


@dataclass(frozen=True)
class Stage:
    """`updates` calls of `update(state, data, key) -> (part, metrics)`, a pure function of one seed's state.

    part: the field of the state (a NamedTuple) that the stage trains and `update` returns; the others are only read,
    and stay out of the compiled loop's carry, which would copy them at every update.
    """

    name: str
    part: str
    updates: int
    update: Callable[[Any, PyTree, jax.Array], tuple[PyTree, dict[str, jax.Array]]]


@dataclass(frozen=True)
class Position:
    """How far training has come: `update` updates of stage number `stage` are done."""

    stage: int
    update: int


@dataclass(frozen=True)
class Chunk:
    """What a callback learns between two chunks.

    position: after the chunk; metrics: name -> [seeds], means over the chunk's updates;
    updates, seconds: how many updates the chunk held and how long they took, compilation apart.
    """

    stage: Stage
    position: Position
    metrics: dict[str, jax.Array]
    updates: int
    seconds: float


def seed_keys(seeds: Sequence[int]) -> jax.Array:
    """[seeds] one root key per seed."""
    return jax.vmap(jax.random.key)(jnp.asarray(seeds, jnp.uint32))


def init_seeds(init: Callable[[jax.Array], PyTree], seeds: Sequence[int]) -> PyTree:
    """States of all seeds, stacked along a leading axis.

    Not compiled as one program: it runs once, and its few draws, each compiled for itself and known from then on, take
    less time than a program of all of them takes to compile. Leaves share no memory (a target begins as what it
    follows), since training consumes them.
    """
    return jax.device_put(jax.vmap(init)(seed_keys(seeds)), may_alias=False)


def compile_chunk(stage: Stage, stage_index: int) -> jax.stages.Wrapped:
    """run(state, sums, data, keys, first, last) -> (state, sums): updates first <= u < last for every seed.

    sums: of every metric over the updates so far, see `no_sums`; state and sums are consumed. Update u of a seed draws
    from fold_in(fold_in(key, stage_index), u), sums are carried on, and the loop's bounds are arguments of one compiled
    program; so how training is cut never matters, to the bit.
    """

    def one_seed(state, sums, data, key, first, last):
        stage_key = jax.random.fold_in(key, stage_index)

        def body(update, carry):
            part, sums = carry
            whole = state._replace(**{stage.part: part})
            part, metrics = stage.update(whole, data, jax.random.fold_in(stage_key, update))
            return part, jax.tree.map(jnp.add, sums, metrics)

        part, sums = jax.lax.fori_loop(first, last, body, (getattr(state, stage.part), sums))
        return state._replace(**{stage.part: part}), sums

    return jax.jit(jax.vmap(one_seed, in_axes=(0, 0, None, 0, None, None)), donate_argnums=(0, 1))


def no_sums(stage: Stage, state: PyTree, data: PyTree, keys: jax.Array) -> Metrics:
    """What a chunk's sums of metrics begin with: zeros, name -> [seeds]."""
    shapes = jax.eval_shape(jax.vmap(stage.update, in_axes=(0, None, 0)), state, data, keys)[1]
    return jax.tree.map(lambda metric: jnp.zeros(metric.shape, metric.dtype), shapes)


def train(
    stages: Sequence[Stage],
    state: PyTree,
    data: PyTree,
    seeds: Sequence[int],
    *,
    start: Position = Position(0, 0),
    chunk_updates: int = 1000,
    on_chunk: Callable[[Chunk, PyTree], None] = lambda chunk, state: None,
    known: Callable[[int, PyTree], PyTree | None] = lambda index, state: None,
    stop: Callable[[], bool] = lambda: False,
) -> PyTree:
    """Run all stages from `start` to the end, or until `stop` says so, and return the state then.

    state: leaves [seeds, ...] (see `init_seeds`); it is consumed. on_chunk sees the state between chunks, and
    must copy what it keeps: the next chunk reuses the memory. Chunks end at multiples of `chunk_updates`.
    known is asked before a stage begins, and gives what it would train where that is known already. stop is asked about
    every second: the chunk then ends early, and is the last.
    """
    keys = seed_keys(seeds)
    for index in range(start.stage, len(stages)):
        stage = replace(stages[index], update=jax.jit(stages[index].update))  # traced once, not at every use
        done = start.update if index == start.stage else 0
        if done == 0 and (part := known(index, state)) is not None:
            state = state._replace(**{stage.part: part})
            continue
        sums = no_sums(stage, state, data, keys)
        run = compile_chunk(stage, index).lower(state, sums, data, keys, jnp.asarray(0), jnp.asarray(1)).compile()
        slice_updates = 1
        while done < stage.updates:
            first, last = done, min(stage.updates, (done // chunk_updates + 1) * chunk_updates)
            sums, seconds = jax.tree.map(jnp.zeros_like, sums), 0.0
            while done == first or (done < last and not stop()):
                until = min(last, done + slice_updates)
                began = time.perf_counter()
                state, sums = jax.block_until_ready(run(state, sums, data, keys, jnp.asarray(done), jnp.asarray(until)))
                took = max(time.perf_counter() - began, 1e-6)
                slice_updates = max(1, min(10 * slice_updates, int((until - done) * SLICE_SECONDS / took)))
                done, seconds = until, seconds + took
            means = jax.device_get(jax.tree.map(lambda total, n=done - first: total / n, sums))
            on_chunk(Chunk(stage, Position(index, done), means, done - first, seconds), state)
            if stop():
                return state
    return state
