"""Runs share stages: what is taken over is, to the bit, what training would have given."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from conftest import make_ragged
from small_runs import OWN, SETTINGS, assert_bit_equal, write_plain

import guider
from guider import runs
from guider.errors import GuiderError, GuiderWarning
from guider.learning.training import Position, init_seeds
from guider.methods import METHODS
from guider.methods.view import prepare
from guider.runs import stage_cache
from guider.runs.stage_cache import stage_digest
from guider.support import files, locks
from guider.support.config import override

STAGES = ["latent subgoals", "subgoal policy", "goal policy"]


def train(logs: Path, out: Path, **options: Any) -> tuple[runs.Run, list[str]]:
    """The run, and the stages that were trained for it."""
    trained: dict[str, None] = {}
    defaults: dict[str, Any] = {"on_chunk": lambda chunk, state: trained.setdefault(chunk.stage.name)}
    run = guider.train(data=logs, out=out, **(OWN | defaults | options))
    return run, list(trained)


@pytest.fixture(scope="module")
def shared(tmp_path_factory) -> tuple[Path, Path, runs.Run]:
    """(logs, a cache, the run that filled it)."""
    folder = tmp_path_factory.mktemp("shared")
    logs = write_plain(folder / "logs.npz")
    run, trained = train(logs, folder / "first", stage_cache=folder / "cache")
    assert trained == STAGES
    return logs, folder / "cache", run


def test_a_variant_trains_what_differs_and_ends_bit_equal(shared, tmp_path):
    logs, cache, _ = shared
    without_prior = {"settings": SETTINGS | {"high.prior": "false", "high.updates": "9"}}
    run, trained = train(logs, tmp_path / "variant", stage_cache=cache, **without_prior)
    assert trained == ["subgoal policy"]
    alone, trained = train(logs, tmp_path / "alone", **without_prior)
    assert trained == STAGES
    assert_bit_equal(run, alone)
    lines = [files.read_lines(each.directory / "metrics.jsonl") for each in (run, alone)]
    for ours, theirs in zip(*lines, strict=True):
        assert ours | {"seconds": 0} == theirs | {"seconds": 0}


def test_an_interrupted_run_takes_over_what_others_have_trained_since(shared, tmp_path):
    logs, cache, whole = shared

    def interrupt(chunk, state):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(logs, tmp_path / "run", on_chunk=interrupt)
    trained = []
    resumed = guider.resume(tmp_path / "run", stage_cache=cache, on_chunk=lambda chunk, _: trained.append(chunk))
    assert not trained
    assert_bit_equal(resumed, whole)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        lambda entry: (entry / "metrics.json").write_text((entry / "metrics.json").read_text()[:-9]),
        lambda entry: flip(entry / "metrics.json"),
        lambda entry: files.write_json(entry / "metrics.json", {"lines": [{"stage": "goal policy"}]}),
        lambda entry: (entry / "metrics.json").unlink(),
        lambda entry: next(entry.glob("*/manifest.json")).unlink(),
    ],
)
def test_a_damaged_entry_is_told(tmp_path, damage):
    part = {"weight": np.ones(3, np.float32)}
    line = {"stage": "goal policy", "update": 7, "total_updates": 7, "seconds": 0.1, "metrics": {"loss": [1.0]}}
    end = Position(0, 7)
    stage_cache.keep(tmp_path / "entry", end, part, [line])
    found = stage_cache.find(tmp_path / "entry", end, part)
    assert found is not None and found[0]["weight"].tolist() == [1, 1, 1] and found[1] == [line]
    damage(tmp_path / "entry")
    with pytest.warns(GuiderWarning, match="entry is damaged, its stage is trained anew"):
        assert stage_cache.find(tmp_path / "entry", end, part) is None


def test_a_damaged_entry_is_trained_anew_and_replaced(shared, tmp_path):
    logs, cache, whole = shared
    shutil.copytree(cache, tmp_path / "cache")
    entry = next(entry for entry in (tmp_path / "cache").iterdir() if list(entry.glob("12")))
    flip(max(entry.glob("*/state/*/0*"), key=lambda path: path.stat().st_size))
    with pytest.warns(GuiderWarning, match=rf"{entry} is damaged, its stage is trained anew: .* not as it was written"):
        run, trained = train(logs, tmp_path / "run", stage_cache=tmp_path / "cache")
    assert trained == ["goal policy"]
    assert_bit_equal(run, whole)
    _, trained = train(logs, tmp_path / "again", stage_cache=tmp_path / "cache")
    assert trained == []


def test_a_stage_that_another_trains_is_waited_for(shared, tmp_path, monkeypatch):
    """The other ends while we wait; then what it trained is taken over."""
    logs, cache, whole = shared
    shutil.copytree(cache, tmp_path / "cache")
    entry = next(entry for entry in (tmp_path / "cache").iterdir() if list(entry.glob("12")))
    entry.rename(tmp_path / "done")
    other = stage_cache.training(entry, lambda message: None)
    other.__enter__()

    def sleep(seconds: float) -> None:
        if not entry.exists():
            (tmp_path / "done").rename(entry)
        else:
            other.__exit__(None, None, None)

    monkeypatch.setattr(locks.time, "sleep", sleep)
    with pytest.warns(GuiderWarning) as told:
        run, trained = train(logs, tmp_path / "run", stage_cache=tmp_path / "cache")
    assert trained == [] and len(told) == 1
    assert f"the stage of {entry} is being trained (process {os.getpid()} on" in str(told[0].message)
    assert_bit_equal(run, whole)


def test_a_stage_is_known_by_what_it_reads(fast_config, ragged):
    method = METHODS["guider"]
    data, scale = prepare(fast_config.view, fast_config.problem, ragged)
    state = init_seeds(lambda key: method.init(fast_config, ragged.spaces, scale, key), (0, 1))

    def digests(config, state=state, data=data, seeds=(0, 1)) -> list[str]:
        return [stage_digest(stage, i, state, data, seeds, {}) for i, stage in enumerate(method.stages(config))]

    known = digests(fast_config)
    assert digests(fast_config) == known and len(set(known)) == 3

    def new_stages(found: list[str]) -> list[str]:
        return [name for name, before, now in zip(STAGES, known, found, strict=True) if before != now]

    def changed(name: str, value: Any):
        return override(fast_config, {name: value})

    assert new_stages(digests(changed("latent.beta", 2.0))) == ["latent subgoals"]
    assert new_stages(digests(changed("high.prior", False))) == ["subgoal policy"]
    assert new_stages(digests(changed("low.learning_rate", 0.01))) == ["goal policy"]
    assert new_stages(digests(changed("low.updates", 1_000))) == ["goal policy"]
    nearer = replace(fast_config, problem=replace(fast_config.problem, radius=0.1))
    assert new_stages(digests(nearer)) == ["subgoal policy", "goal policy"]
    another_latent = state._replace(latent=jax.tree.map(lambda leaf: leaf + 1, state.latent))
    assert new_stages(digests(fast_config, state=another_latent)) == ["latent subgoals", "subgoal policy"]
    other_data = prepare(fast_config.view, fast_config.problem, make_ragged(seed=1))[0]
    assert new_stages(digests(fast_config, data=other_data)) == STAGES
    assert new_stages(digests(fast_config, seeds=(0, 2))) == STAGES


def test_learning_curves_need_the_last_stage(tmp_path):
    with pytest.raises(GuiderError, match="leave --stage-cache out"):
        guider.train("pointmaze-umaze", data="none", stage_cache=tmp_path / "cache", evaluate_every=5)
