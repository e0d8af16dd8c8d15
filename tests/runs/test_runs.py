"""Runs on disk: a killed run resumes to the bit, and nothing is lost or silently overwritten."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
import pytest
from conftest import make_ragged, tiny
from small_runs import OWN, SETTINGS, assert_bit_equal, final_state, write_plain

import guider
from guider import runs
from guider.errors import GuiderError
from guider.learning.problem import Problem
from guider.learning.processor import settled
from guider.learning.training import Position
from guider.methods import METHODS
from guider.methods import guider as method
from guider.methods.guider import guider_config
from guider.methods.view import prepare
from guider.runs import checkpoint
from guider.runs.run import EARLIER, FORMAT
from guider.support import files
from guider.support.config import flatten, to_dict
from guider.support.files import read_json


def test_train_writes_a_run_that_loads_and_acts(logs, tmp_path):
    precisions = []
    run = guider.train(
        data=logs,
        out=tmp_path / "run",
        on_chunk=lambda chunk, state: precisions.append(jax.default_matmul_precision.value),
        **OWN,
    )
    assert precisions == [settled("auto")] * 3 and jax.default_matmul_precision.value is None
    opened = runs.open_run(tmp_path / "run")
    assert opened.spec.config.precision == settled("auto"), "a run keeps what auto meant when it began"
    assert opened.spec == run.spec
    lines = files.read_lines(tmp_path / "run" / "metrics.jsonl")
    assert [line["stage"] for line in lines] == ["latent subgoals", "subgoal policy", "goal policy"]
    assert len(lines[0]["metrics"]["loss"]) == 2
    agent = guider.load(tmp_path / "run", seed=1)
    action = agent.act(np.zeros(4), np.ones(2))
    assert action.shape == (2,) and np.all(np.abs(action) <= 1)


def test_a_killed_run_resumes_to_the_bit(logs, tmp_path):
    """SIGKILL in the middle of the last stage, then --resume; the same with a run never interrupted."""
    script = f"""
import os, signal, guider
from guider import runs
from guider.learning.training import Chunk
def die(chunk, state):
    if chunk.stage.name == "goal policy" and chunk.position.update == 8:
        os.kill(os.getpid(), signal.SIGKILL)
guider.train(data={str(logs)!r}, out={str(tmp_path / "killed")!r}, on_chunk=die,
             pace=runs.Pace(2, 0.0), **{OWN!r})
"""
    killed = subprocess.run([sys.executable, "-c", script], env=os.environ, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    with pytest.raises(GuiderError, match=r"stopped after 6 of 12 updates of the goal policy stage.*--resume"):
        guider.load(tmp_path / "killed")
    resumed = guider.resume(tmp_path / "killed", pace=runs.Pace(5))
    whole = guider.train(data=logs, out=tmp_path / "whole", pace=runs.Pace(2), **OWN)
    assert_bit_equal(resumed, whole)
    totals = [line["total_updates"] for line in files.read_lines(tmp_path / "killed" / "metrics.jsonl")]
    assert totals == sorted(set(totals)) and totals[-1] == 24


def test_a_setting_more_or_less_raises_the_run_format():
    """Or runs made before it could not be read. Settings have changed: raise FORMAT."""
    names = {name: sorted(flatten(to_dict(made.config_type()))) for name, made in METHODS.items()}
    digest = hashlib.blake2b(json.dumps(names).encode(), digest_size=8).hexdigest()
    assert (FORMAT, digest) == (13, "80e177278851fc72")
    assert EARLIER == tuple(range(6, FORMAT))


def test_a_run_of_an_earlier_version_goes_on(tmp_path):
    """Interrupted in its last stage, beside the same run to its end; both as commit 6ffbf9b wrote them."""
    with tarfile.open(Path(__file__).parent / "earlier" / "run-format-6.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    resumed = guider.resume(tmp_path / "cut", make_ragged([12] * 10, recorded_goals=False))
    found, whole = resumed.restore(), runs.open_run(tmp_path / "whole").restore()
    assert found is not None and whole is not None and found[0] == Position(2, 6) == whole[0]
    for ours, theirs in zip(jax.tree.leaves(found[1]), jax.tree.leaves(whole[1]), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)  # other processors round otherwise


def test_a_run_killed_at_any_moment_resumes(logs, tmp_path):
    """Killed from outside, wherever it is: nothing half-written keeps it from resuming."""
    script = f"""
import guider
from guider import runs
guider.train(data={str(logs)!r}, out={str(tmp_path / "killed")!r}, pace=runs.Pace(1, 0.0), **{OWN!r})
"""
    process = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL)
    metrics = tmp_path / "killed" / "metrics.jsonl"
    deadline = time.monotonic() + 120
    while len(files.read_lines(metrics)) < 4 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    resumed = guider.resume(tmp_path / "killed")
    assert_bit_equal(resumed, guider.train(data=logs, out=tmp_path / "whole", **OWN))


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_a_checkpoint_holds_the_whole_state(ragged, tmp_path, preset):
    """Every leaf comes back as it was, in its place, those without entries too."""
    config = tiny(guider_config(preset, Problem(0.5, 1.0, 5)))
    _, scale = prepare(config.view, config.problem, ragged)
    state = method.init(config, ragged.spaces, scale, jax.random.key(0))
    checkpoint.save(tmp_path / "checkpoints", 7, Position(1, 3), state)
    restored = checkpoint.restore(tmp_path / "checkpoints", jax.eval_shape(lambda: state))
    assert restored is not None and restored[0] == Position(1, 3)
    assert jax.tree.structure(restored[1]) == jax.tree.structure(state)
    for a, b in zip(jax.tree.leaves(restored[1]), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(a, b)


def test_resuming_a_finished_run_changes_nothing(copy):
    before = final_state(copy)
    guider.resume(copy.directory)
    for a, b in zip(before, final_state(copy), strict=True):
        np.testing.assert_array_equal(a, b)


def test_an_existing_run_is_never_overwritten(logs, tmp_path):
    (tmp_path / "run").mkdir()
    with pytest.raises(GuiderError, match=r"exists already .*; choose another --out$"):
        guider.train(data=logs, out=tmp_path / "run", **OWN)
    (tmp_path / "run" / "run.json").touch()
    with pytest.raises(GuiderError, match=r"exists already.*or continue it with .*--resume"):
        guider.train(data=logs, out=tmp_path / "run", **OWN)


def test_resuming_on_other_data_is_refused(copy, tmp_path):
    other = write_plain(tmp_path / "other.npz", seed=1)
    with pytest.raises(GuiderError, match=r"is not the data .* was trained on"):
        guider.resume(copy.directory, other)


def test_a_checkpoint_of_another_config_is_refused(copy):
    path = copy.directory / "run.json"
    values = json.loads(path.read_text())
    values["config"]["hidden"] = [9]
    files.write_json(path, values)
    with pytest.raises(GuiderError, match="does not fit this run's config"):
        guider.load(copy.directory)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v | {"run_format": 99}, "another version"),
        (lambda v: v | {"method": "magic"}, "there is no method 'magic'"),
        (lambda v: v | {"config": v["config"] | {"perod": 3}}, "config has no setting 'perod'; did you mean"),
        (lambda v: v | {"config": v["config"] | {"precision": "half"}}, "must be one of auto, float32"),
        (lambda v: {k: x for k, x in v.items() if k != "seeds"}, "lacks the setting 'seeds'"),
    ],
)
def test_a_damaged_run_is_explained(copy, change, message):
    path = copy.directory / "run.json"
    files.write_json(path, change(json.loads(path.read_text())))
    with pytest.raises(GuiderError, match=message):
        runs.open_run(copy.directory)


def test_what_is_no_run_is_explained(tmp_path):
    with pytest.raises(GuiderError, match=r"is not a run: it has no run\.json"):
        runs.open_run(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(GuiderError, match="cannot be read"):
        runs.open_run(tmp_path)


def test_own_data_is_scored_on_episodes_training_never_saw(logs, tmp_path):
    run = guider.train(data=logs, out=tmp_path / "run", **OWN)
    result = guider.evaluate(run)
    assert result["held_out_episodes"] == 2
    scores = result["per_seed"][0]
    assert set(scores) >= {"action_error", "prior_coverage", "subgoals_in_range", "value_rank"}
    assert all(np.isfinite(value) for value in scores.values() if value is not None)
    assert read_json(tmp_path / "run" / "evaluation.json", "") == result


def test_data_of_another_robot_is_refused(tmp_path):
    path = tmp_path / "ant.hdf5"
    with h5py.File(path, "w") as file:
        file["observations"] = np.random.default_rng(0).normal(size=(20, 29))
        file["actions"] = np.zeros((20, 8))
        file["timeouts"] = np.arange(20) % 10 == 9
        file["terminals"] = np.zeros(20, bool)
    with pytest.raises(GuiderError, match="holds states of 29 and actions of 8 numbers; pointmaze-large"):
        guider.train("pointmaze-large", path, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_data_without_a_window_is_refused_before_anything_is_written(logs, tmp_path):
    other: dict[str, Any] = OWN | {"period_steps": 60}
    with pytest.raises(GuiderError, match="no episode holds a window of 60 steps"):
        guider.train(data=logs, out=tmp_path / "run", **other)
    assert not (tmp_path / "run").exists()


def test_a_diverging_run_stops_and_says_so(logs, tmp_path):
    other: dict[str, Any] = OWN | {"settings": SETTINGS | {"low.learning_rate": "1e30"}}
    with pytest.raises(GuiderError, match=r"seed 0 is no longer finite before update \d+ of the goal policy stage"):
        guider.train(data=logs, out=tmp_path / "run", pace=runs.Pace(1), **other)


@pytest.mark.parametrize("seeds", [0, (), (1, 1), (-1,), (2**32,)])
def test_seeds_are_checked(logs, tmp_path, seeds):
    with pytest.raises(GuiderError, match="seeds must be one or more distinct numbers"):
        guider.train(data=logs, out=tmp_path / "run", **(OWN | {"seeds": seeds}))


def test_own_data_needs_a_goal(logs, tmp_path):
    with pytest.raises(GuiderError, match="--goal-indices"):
        guider.train(data=logs, out=tmp_path / "run")
    with pytest.raises(GuiderError, match="no data given"):
        guider.train("pointmaze-umaze")


def test_a_strangers_run_imports_no_module_that_its_user_has_not_offered(copy, tmp_path, monkeypatch):
    """The task gym:MODULE:ENV_ID would: whoever wrote run.json could have written any module's name."""
    (tmp_path / "theirs.py").write_text("raise SystemExit('it ran')")
    monkeypatch.syspath_prepend(tmp_path)
    task = "gym:theirs:Robot-v0?radius=1"
    path = copy.directory / "run.json"
    files.write_json(
        path, {name: value for name, value in files.parse_json(path).items() if name != files.CHECKSUM} | {"task": task}
    )
    for use in (runs.open_run, guider.evaluate, guider.load, guider.resume):
        with pytest.raises(GuiderError, match=r"module theirs would be imported.*GUIDER_ENVIRONMENTS=theirs"):
            use(copy.directory)
    monkeypatch.setenv("GUIDER_ENVIRONMENTS", f"other{os.pathsep}theirs")
    assert runs.open_run(copy.directory).spec.task == task
    monkeypatch.delenv("GUIDER_ENVIRONMENTS")
    monkeypatch.setitem(sys.modules, "theirs", sys)
    assert runs.open_run(copy.directory).spec.task == task, "it was imported already"
