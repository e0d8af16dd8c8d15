"""A run has one writer, in one place, that ends in order; what is damaged or does not belong there is told."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import dead_pid
from small_runs import BC, assert_bit_equal

import guider
from guider import runs
from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.learning.training import Position
from guider.runs import checkpoint, trainer
from guider.support import files
from guider.support.locks import hold


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
