"""The engine: chunking never matters, seeds do, and a seed's run is bit-equal to itself."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import equal, train_guider

from guider.learning import training
from guider.learning.training import Position, Stage, seed_keys, train


class Counts(NamedTuple):
    total: jax.Array
    other: jax.Array


def counts(seeds: int) -> Counts:
    return Counts(jnp.zeros(seeds), jnp.ones(seeds))


def counting_stage(name="count", updates=7):
    def update(state, data, key):
        return state.total + data, {"draw": jax.random.uniform(key)}

    return Stage(name, "total", updates, update)


def test_updates_metrics_and_positions_by_hand():
    seen = []
    state = train(
        [counting_stage("one"), counting_stage("two", 3)],
        counts(2),
        jnp.asarray(2.0),
        seeds=(4, 9),
        chunk_updates=5,
        on_chunk=lambda chunk, state: seen.append((chunk, np.array(state.total))),
    )
    assert state.total.tolist() == [20.0, 20.0] and state.other.tolist() == [1.0, 1.0]
    positions = [(c.stage.name, c.position.stage, c.position.update, c.updates) for c, _ in seen]
    assert positions == [("one", 0, 5, 5), ("one", 0, 7, 2), ("two", 1, 3, 3)]
    assert [s.tolist() for _, s in seen] == [[10, 10], [14, 14], [20, 20]]
    stage_key = jax.random.fold_in(seed_keys([9])[0], 1)
    draws = [jax.random.uniform(jax.random.fold_in(stage_key, update)) for update in range(3)]
    assert float(seen[2][0].metrics["draw"][1]) == pytest.approx(float(np.mean(draws)), rel=1e-6)


def test_training_starts_where_it_is_told():
    seen = []
    state = train(
        [counting_stage("one"), counting_stage("two", 3)],
        counts(1),
        jnp.asarray(1.0),
        seeds=(0,),
        start=Position(0, 6),
        on_chunk=lambda chunk, state: seen.append(chunk.updates),
    )
    assert state.total.tolist() == [4.0] and seen == [1, 3]


def test_chunks_end_at_multiples_wherever_training_starts():
    ends = []
    train(
        [counting_stage(updates=14)],
        counts(1),
        jnp.asarray(1.0),
        seeds=(0,),
        start=Position(0, 3),
        chunk_updates=5,
        on_chunk=lambda chunk, state: ends.append((chunk.position.update, chunk.updates)),
    )
    assert ends == [(5, 2), (10, 5), (14, 4)]


def test_what_is_known_is_asked_before_a_stage_begins_alone():
    asked = []

    def known(index, state):
        asked.append(index)
        return jnp.full(1, 50.0) if index == 1 else None

    stages = [counting_stage("one"), counting_stage("two"), counting_stage("three", 3)]
    state = train(stages, counts(1), jnp.asarray(1.0), seeds=(0,), start=Position(0, 6), known=known)
    assert asked == [1, 2] and state.total.tolist() == [53.0]


def test_training_stops_when_told_and_goes_on_from_there():
    asked, seen = iter([False, True, True]), []
    stages = [counting_stage("one", 10**6), counting_stage("two", 3)]
    arguments = counts(1), jnp.asarray(1.0)
    state = train(
        stages, *arguments, (0,), chunk_updates=10**6, on_chunk=lambda c, _: seen.append(c), stop=lambda: next(asked)
    )
    (chunk,) = seen
    assert chunk.position == Position(0, 11) and chunk.updates == 11 and state.total.tolist() == [11.0]


class Trained(NamedTuple):
    state: Any
    metrics: list[dict[str, Any]]
    """After each chunk."""
    states: list[Any]


def trained(config, episodes, seconds: float, **settings) -> Trained:
    """Guider, two seeds, in slices of so many seconds."""
    metrics, states = [], []

    def see(chunk, state):
        metrics.append(chunk.metrics)
        states.append(jax.device_get(state))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SLICE_SECONDS", seconds)
        state = train_guider(config, episodes, (0, 1), on_chunk=see, **settings)
    return Trained(state, metrics, states)


@pytest.fixture(scope="module")
def whole(fast_config, ragged) -> Trained:
    """Every stage a chunk, every chunk in as few slices as can be."""
    return trained(fast_config, ragged, 1e9)


def test_slicing_never_matters_to_the_bit(whole, fast_config, ragged):
    """One update at a time, or nearly all of a chunk at once: parameters and metrics are equal."""
    one_by_one = trained(fast_config, ragged, 0.0)
    assert equal(whole.state, one_by_one.state) and equal(whole.metrics, one_by_one.metrics)


def test_chunking_never_matters_to_the_bit(whole, fast_config, ragged):
    assert equal(whole.state, train_guider(fast_config, ragged, (0, 1), chunk_updates=3))


def test_seeds_differ(whole):
    one, other = (jax.tree.map(lambda leaf, s=s: leaf[s], whole.state.low.params) for s in range(2))
    assert not equal(one, other)


def test_every_part_of_the_state_moves_in_its_stage_only(whole):
    latent, high, low = whole.states
    assert equal(latent.latent, low.latent) and equal(high.high, low.high)
    assert not equal(latent.high, high.high) and not equal(high.low, low.low)
