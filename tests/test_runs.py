"""Runs on disk: a killed run resumes to the bit, and nothing is lost or silently overwritten."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tarfile
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
import pytest
from conftest import make_ragged, tiny
from test_checkpoint import dead_pid

import guider
from guider import runs
from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.learning.problem import Problem
from guider.learning.processor import settled
from guider.learning.training import Position
from guider.methods import guider as method
from guider.methods.guider import guider_config
from guider.methods.view import prepare
from guider.runs import checkpoint, trainer
from guider.support import files
from guider.support.files import read_json
from guider.support.locks import hold

SETTINGS = {
    "latent.updates": "6",
    "high.updates": "6",
    "low.updates": "12",
    "latent.hidden": "(8,)",
    "high.hidden": "(8,)",
    "low.hidden": "(8,)",
    "high.samples": "2",
    "latent.batch_size": "16",
    "high.batch_size": "16",
    "low.batch_size": "16",
}
OWN: dict[str, Any] = {
    "goal_indices": (0, 1),
    "radius": 0.5,
    "period_steps": 4,
    "seeds": 2,
    "held_out": 0.4,
    "settings": SETTINGS,
}
"""Always the same settings, so that all tests train by the same few compiled programs."""
BC: dict[str, Any] = {
    "goal_indices": (0, 1),
    "radius": 0.5,
    "method": "bc",
    "settings": {"updates": 12, "hidden": (8,), "batch_size": 16},
}


def write_plain(path: Path, seed: int = 0) -> Path:
    episodes = make_ragged(lengths=(7, 30, 6, 12, 55), seed=seed)
    np.savez(path, observations=episodes.observations, actions=episodes.actions, lengths=episodes.lengths)
    return path


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    return write_plain(tmp_path / "logs.npz")


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, runs.Run]:
    """(logs, a run of twelve updates with checkpoints after 9 and 12)."""
    folder = tmp_path_factory.mktemp("finished")
    logs = write_plain(folder / "logs.npz")
    return logs, guider.train(data=logs, out=folder / "run", pace=runs.Pace(3, 0.0), **BC)


@pytest.fixture
def copy(finished, tmp_path) -> runs.Run:
    """A copy of that run, to be spoiled."""
    shutil.copytree(finished[1].directory, tmp_path / "copy")
    return runs.open_run(tmp_path / "copy")


def final_state(run: runs.Run):
    restored = run.restore()
    assert restored is not None
    return jax.tree.leaves(restored[1])


def assert_bit_equal(first: runs.Run, second: runs.Run) -> None:
    for a, b in zip(final_state(first), final_state(second), strict=True):
        np.testing.assert_array_equal(a, b)


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
    assert all(np.isfinite(value) for value in scores.values())
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


# One writer, in one place, that ends in order


def names(directory: Path) -> list[str]:
    return sorted(os.listdir(directory))


def interrupted(logs: Path, out: Path, after: int, number: int = signal.SIGTERM, times: int = 1) -> Stopped:
    """What a training ends with that gets a signal, so many times, after so many updates."""

    def interrupt(chunk, state):
        if chunk.position.update == after:
            for _ in range(times):
                os.kill(os.getpid(), number)

    with pytest.raises(Stopped) as stopped:
        guider.train(data=logs, out=out, on_chunk=interrupt, pace=runs.Pace(3), **BC)
    return stopped.value


@pytest.mark.parametrize(
    ("number", "before"), [(signal.SIGTERM, signal.SIG_DFL), (signal.SIGINT, signal.default_int_handler)]
)
def test_a_signal_stops_training_which_goes_on_to_the_bit(finished, tmp_path, number, before):
    logs, whole = finished
    signal.signal(number, before)  # what starts the tests may have it ignored
    stopped = interrupted(logs, tmp_path / "run", 6, number)
    assert stopped.signal_number == number and signal.getsignal(number) is before
    words = f"interrupted after 6 of 12 updates of the policy stage; go on with `guider train --resume {tmp_path}/run`"
    assert str(stopped) == words and names(tmp_path / "run" / "checkpoints") == ["6"]
    resumed = guider.resume(tmp_path / "run", pace=runs.Pace(3))
    assert_bit_equal(resumed, whole)
    lines = [files.read_lines(run.directory / "metrics.jsonl") for run in (resumed, whole)]
    assert [line | {"seconds": 0} for line in lines[0]] == [line | {"seconds": 0} for line in lines[1]]


def test_a_second_signal_does_not_wait(finished, tmp_path):
    stopped = interrupted(finished[0], tmp_path / "run", 6, times=2)
    assert "not saved since" in str(stopped) and not (tmp_path / "run" / "checkpoints").exists()
    assert_bit_equal(guider.resume(tmp_path / "run"), finished[1])


def test_training_stops_within_a_chunk(logs, tmp_path):
    """The signal comes from outside, while a chunk that would take hours is under way or about to be."""
    before = signal.getsignal(signal.SIGTERM)

    def interrupt():
        while signal.getsignal(signal.SIGTERM) is before:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    endless = BC | {"settings": BC["settings"] | {"updates": 10**9}}
    with pytest.raises(Stopped, match="of 1000000000 updates"):
        guider.train(data=logs, out=tmp_path / "run", pace=runs.Pace(10**9), **endless)
    thread.join()
    restored = runs.open_run(tmp_path / "run").restore()
    (line,) = files.read_lines(tmp_path / "run" / "metrics.jsonl")
    assert restored is not None and restored[0] == Position(0, line["update"])


def test_only_one_process_trains_a_run(copy):
    with hold(copy.directory / ".lock", "held"):
        with pytest.raises(GuiderError, match=rf"copy is being trained \(process {os.getpid()} on .*\); wait"):
            guider.resume(copy.directory, data="nothing was read")
    guider.resume(copy.directory)
    assert ".lock" not in names(copy.directory)


def test_of_two_starts_in_one_place_one_wins(logs, tmp_path, monkeypatch):
    """The other made its run while this one prepared its data."""
    prepare_data = trainer._prepare

    def meanwhile(*arguments):
        shutil.copytree(tmp_path, tmp_path / "run")
        return prepare_data(*arguments)

    monkeypatch.setattr(trainer, "_prepare", meanwhile)
    with pytest.raises(GuiderError, match="run exists already and is never overwritten"):
        guider.train(data=logs, out=tmp_path / "run", **BC)
    assert names(tmp_path) == ["logs.npz", "run"] and names(tmp_path / "run") == ["logs.npz"]


def test_what_killed_starts_left_is_removed(logs, tmp_path):
    pid = dead_pid()
    for name in (f".run.{pid}", f".run.{os.getppid()}", f".other.{pid}"):
        (tmp_path / name).mkdir()
    guider.train(data=logs, out=tmp_path / "run", **BC)
    assert names(tmp_path) == sorted([f".other.{pid}", f".run.{os.getppid()}", "logs.npz", "run"])
    assert names(tmp_path / "run") == ["checkpoints", "metrics.jsonl", "run.json"]


def test_a_damaged_newest_checkpoint_is_trained_again(finished, copy):
    """Lines after the one before are written again, and the damaged one is replaced."""
    newest = copy.directory / "checkpoints" / "12"
    for path in newest.rglob("0*"):
        path.write_bytes(b"")
    with pytest.warns(GuiderWarning, match=r"checkpoints/12 is damaged: .*checkpoints/9 is used in its place"):
        resumed = guider.resume(copy.directory, pace=runs.Pace(3))
    assert_bit_equal(resumed, finished[1])
    assert [line["update"] for line in files.read_lines(copy.directory / "metrics.jsonl")] == [3, 6, 9, 12]


@pytest.mark.parametrize(
    "position", [{"stage": 1, "update": 2}, {"stage": 0, "update": 13}, {"stage": -1, "update": 12}]
)
def test_a_position_that_no_run_has_is_not_taken(copy, position):
    path = copy.directory / "checkpoints" / "12" / "manifest.json"
    files.write_json(path, files.parse_json(path) | {"position": position})
    with pytest.warns(GuiderWarning, match="checkpoints/12 cannot be at"):
        assert copy.restore() is not None


def test_hand_edits_are_told(copy):
    path = copy.directory / "run.json"
    path.write_text(path.read_text().replace("0.5", "0.6"))
    with pytest.raises(GuiderError, match=r"run\.json is damaged or was changed by hand.*; put the original back"):
        runs.open_run(copy.directory)


def test_damaged_lines_are_left_out_and_that_is_said(copy):
    path = copy.directory / "metrics.jsonl"
    lines = path.read_text().splitlines()
    wrong = [json.dumps(json.loads(lines[0]) | change) for change in ({"update": "3"}, {"seconds": -1}, {"metrics": 1})]
    path.write_text("\n".join([lines[0], "{", *wrong, "[" * 10**5, *lines[1:], '{"cut']))
    with pytest.warns(GuiderWarning, match=r"metrics\.jsonl is damaged and read without its line\(s\) 2, 3, 4, 5, 6$"):
        assert [line["update"] for line in files.read_lines(path)] == [3, 6, 9, 12]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        guider.resume(copy.directory)
    assert len(told) == 1 and path.read_text().splitlines() == lines


def test_a_line_that_does_not_fit_leaves_no_half(copy):
    path = copy.directory / "metrics.jsonl"
    before = path.read_text()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            files.append_line(path, {"update": 10**30})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_text() == before


def test_a_checkpoint_that_cannot_be_written_is_one_line(logs, tmp_path, monkeypatch):
    save = checkpoint.save

    def full(directory, step, *rest):
        if step == 12:
            raise OSError(f"{directory}/12 cannot be written: No space left on device")
        save(directory, step, *rest)

    monkeypatch.setattr(checkpoint, "save", full)
    words = r"run/checkpoints/12 cannot be written: No space left on device; what was saved last stays; .*`guider train"
    with pytest.raises(GuiderError, match=words):
        guider.train(data=logs, out=tmp_path / "run", pace=runs.Pace(3, 0.0), **BC)
    monkeypatch.undo()
    guider.resume(tmp_path / "run")


@pytest.mark.parametrize(
    "name", ["metrics.jsonl", "plots", "checkpoints", "checkpoints/12", "checkpoints/12/state/scale.x"]
)
def test_links_in_a_run_are_refused(copy, tmp_path, name):
    path = copy.directory / name
    elsewhere = tmp_path / "elsewhere"
    if path.exists():
        path.rename(elsewhere)
    else:
        elsewhere.mkdir()
    path.symlink_to(elsewhere)
    before = {file: file.stat().st_mtime_ns for file in elsewhere.rglob("*")}
    for act in (runs.open_run, guider.load, guider.resume, guider.evaluate):
        with pytest.raises(GuiderError, match=rf"{name} is a symbolic link, and those are not followed"):
            act(copy.directory)
    assert before == {file: file.stat().st_mtime_ns for file in elsewhere.rglob("*")}


@pytest.mark.parametrize("name", ["exp[1]", "a\\b", "s3:", "gs:", "sp ace #%?*", "naïve-日本", "dot.", "n" * 255])
def test_any_name_of_a_run_will_do(finished, tmp_path, name):
    out = tmp_path / name / name
    interrupted(finished[0], out, 6)
    guider.resume(out)
    guider.load(out).act(np.zeros(4), np.ones(2))
    assert names(tmp_path) == [name] and names(tmp_path / name) == [name]


@pytest.mark.parametrize("name", ["n" * 256, "/".join(["n" * 200] * 20)])
def test_a_name_that_no_place_can_have_is_refused(logs, tmp_path, name):
    with pytest.raises(GuiderError, match="choose another --out"):
        guider.train(data=logs, out=tmp_path / name, **BC)
    assert names(tmp_path) == ["logs.npz"]
