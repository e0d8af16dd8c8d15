"""`guider reproduce`: runs are made once, and survive anything."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from planned import SETTINGS, protocol_in

from guider import runs
from guider.cli import main
from guider.errors import GuiderError
from guider.reproduce import figures, report, runner
from guider.reproduce.plans import make_plan
from guider.support import files
from guider.support.locks import hold

TASK, BROKEN = "pointmaze-umaze", "pointmaze-medium"
OPTIONS = ["--seeds", "2", "--episodes", "3", "--methods", "guider"]
SETS = ["--set", *(f"{name}={value}" for name, value in SETTINGS.items())]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with data/ and out/, after a table of two tasks: one recorded, trained and scored, one with bad data."""
    folder = tmp_path_factory.mktemp("reproduce")
    (folder / "data").mkdir()
    (folder / "data" / f"{BROKEN}.hdf5").write_text("no data")
    collect = runner._collect
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_collect", lambda plan, task: [*collect(plan, task), "--steps", "600"])
        assert main(command("table1", folder, "--tasks", BROKEN, TASK)) == 1
    return folder


def command(target: str, folder: Path, *more: str, out: Path | None = None) -> list[str]:
    places = ["--data", str(folder / "data"), "--out", str(out or folder / "out")]
    by_method = OPTIONS if target in ("table1", "figure4", "figure6") else OPTIONS[:4]
    return ["reproduce", target, *by_method, *places, *more, *SETS]


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below `folder` with the time of its last change."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def test_data_is_recorded_and_a_failing_run_does_not_end_the_plan(made):
    """The task with bad data came first."""
    document = json.loads((made / "out" / "table1.json").read_text())
    broken, fine = document["rows"]
    assert broken["task"] == BROKEN and "mean" not in broken["cells"][0]
    result = json.loads((made / "out" / "runs" / TASK / "guider-fast" / "evaluation.json").read_text())
    assert fine["cells"][0]["per_seed"] == [seed["score"] for seed in result["per_seed"]]
    assert result["departures"]["low.updates"] == 2000 and result["episode_seeds"] == [0, 5]
    assert document["unfinished"][0]["task"] == BROKEN
    assert f"`guider reproduce table1 --tasks {BROKEN} --methods guider" in (made / "out" / "table1.md").read_text()
    log = (made / "out" / "logs" / f"{BROKEN}-guider-fast.log").read_text()
    assert log.startswith("$ guider train") and "neither an HDF5 file" in log


def test_what_is_done_is_skipped(made, capsys):
    before = contents(made / "out" / "runs") | contents(made / "out" / "logs")
    assert main(command("table1", made, "--tasks", TASK, "--json")) == 0
    assert contents(made / "out" / "runs") | contents(made / "out" / "logs") == before
    assert json.loads(capsys.readouterr().out)["failed"] == []


def test_a_failure_is_told_and_tried_again(made, capsys):
    assert main(command("table1", made, "--tasks", BROKEN)) == 1
    assert f"1 of 1 runs failed, the same command tries them again: {BROKEN}/guider-fast" in capsys.readouterr().err
    log = (made / "out" / "logs" / f"{BROKEN}-guider-fast.log").read_text()
    assert log.count("$ guider train") >= 2


def test_other_tables_find_the_run(made, capsys):
    assert main(command("table2", made, "--tasks", TASK, "--dry-run", "--json")) == 0
    states = {run["variant"]: run["state"] for run in json.loads(capsys.readouterr().out)["runs"]}
    ablations = ["guider-without-prior", "guider-without-cql", "guider-without-prior-or-cql"]
    assert states == {"guider": "done", **dict.fromkeys(ablations, "new")}
    assert main(command("table2", made, "--tasks", TASK, "--report-only", "--json")) == 0
    document = json.loads(capsys.readouterr().out)
    assert "mean" in document["rows"][0]["cells"][0]
    assert document["unfinished"] == [
        {
            "task": TASK,
            "variants": ablations,
            "command": document["rows"][0]["command"],
        }
    ]


def test_a_killed_run_is_resumed_to_the_same_result(made, tmp_path):
    """Runner and training get SIGKILL in the middle of the last stage; the same command goes on where they were."""
    out = tmp_path / "out"
    arguments = [*command("table1", made, "--tasks", TASK, out=out)]
    process = subprocess.Popen(
        [sys.executable, "-m", "guider", *arguments], stderr=subprocess.DEVNULL, start_new_session=True
    )
    run = out / "runs" / TASK / "guider-fast"
    deadline = time.monotonic() + 120
    while not any(line["stage"] == "goal policy" for line in files.read_lines(run / "metrics.jsonl")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    with hold(
        out / ".lock", "the training, which has the lock too, takes a moment longer to die", waiting=lambda _: None
    ):
        pass
    assert files.read_lines(run / "metrics.jsonl")[-1]["total_updates"] < 3008
    plan = make_plan("table1", protocol_in(made, out=out), [TASK], ["guider"])
    assert runner.state(plan, plan.runs[0]) == "interrupted"
    with pytest.raises(GuiderError, match=r"is not finished|stopped after|holds no checkpoint"):
        runs.open_run(run).policies()

    assert main(arguments) == 0
    log = (out / "logs" / f"{TASK}-guider-fast.log").read_text()
    assert log.count("$ guider train") == 2 and f"$ guider train --resume {run}" in log
    uninterrupted = made / "out" / "runs" / TASK / "guider-fast"
    assert (run / "evaluation.json").read_text() == (uninterrupted / "evaluation.json").read_text()
    for name in ("metrics.jsonl", "evaluations.jsonl"):
        ours, theirs = (
            [line | {"seconds": 0} for line in files.read_lines(folder / name)] for folder in (run, uninterrupted)
        )
        assert ours == theirs


def test_a_signal_ends_the_runs_too_which_save_first(made, tmp_path):
    """SIGTERM to the runner alone, in the middle of a stage that would take hours."""
    out = tmp_path / "out"
    arguments = [*command("table1", made, "--tasks", TASK, out=out), "low.updates=1000000000"]
    arguments.remove("low.updates=2000")
    process = subprocess.Popen([sys.executable, "-m", "guider", *arguments], stderr=subprocess.PIPE, text=True)
    run = out / "runs" / TASK / "guider-fast"
    deadline = time.monotonic() + 120
    while not any(line["stage"] == "goal policy" for line in files.read_lines(run / "metrics.jsonl")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM and "interrupted; what is done is kept, and `guider" in error
    log = (out / "logs" / f"{TASK}-guider-fast.log").read_text()
    assert "of 1000000000 updates of the goal policy stage; go on with" in log
    restored = runs.open_run(run).restore()
    assert restored is not None and restored[0].stage == 2 and restored[0].update > 0
    with hold(out / ".lock", "nobody is left that holds it"):
        pass


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": 3}, r"guider-fast answers to seeds \[0, 1\], not to \[0, 1, 2\] as asked for; choose another --out"),
        ({"first_seed": 1}, r"answers to seeds \[0, 1\], not to \[1, 2\]"),
        ({"settings": {}}, "answers to settings"),
        ({"episodes": 4}, r"evaluation\.json answers to episodes per seed 3, not to 4"),
    ],
)
def test_a_run_of_other_settings_is_refused(made, change, message):
    before = contents(made / "out" / "runs")
    plan = make_plan("table1", protocol_in(made, **change), [TASK], ["guider"])
    for action in (runner.execute, report.write):
        with pytest.raises(GuiderError, match=message):
            action(plan)
    assert contents(made / "out" / "runs") == before


def test_a_run_on_other_data_is_refused(made, tmp_path):
    assert main(["collect", TASK, "--steps", "600", "--seed", "1", "--out", str(tmp_path / f"{TASK}.hdf5")]) == 0
    plan = make_plan("table1", protocol_in(made, data=tmp_path), [TASK], ["guider"])
    with pytest.raises(GuiderError, match=r"was trained on data of fingerprint \w+, .* has \w+; choose another --out"):
        runner.execute(plan)


def test_a_directory_of_another_making_is_refused(tmp_path):
    plan = make_plan("table1", protocol_in(tmp_path), [TASK], ["guider"])
    plan.directory(plan.runs[0]).mkdir(parents=True)
    with pytest.raises(GuiderError, match="was not made by `guider reproduce`"):
        runner.execute(plan)


def test_two_runners_do_not_share_a_directory(made):
    plan = make_plan("table1", protocol_in(made), [TASK], ["guider"])
    with (made / "out" / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(GuiderError, match="still at work"):
            runner.execute(plan)
    assert runner.execute(plan) == []


def test_runs_keep_to_their_share_of_the_cores():
    before = runner._own_cores()
    with runner._on_cores({before[0]}):
        asked = subprocess.run(
            [sys.executable, "-c", "import os; print(os.sched_getaffinity(0))"], capture_output=True, text=True
        )
    assert asked.stdout.strip() == str({before[0]}) and runner._own_cores() == before


def test_subgoals_and_their_gaps_of_a_real_run(made):
    document, written = report.write(make_plan("figure3", protocol_in(made), [TASK]))
    (numbers,) = document["numbers"]
    assert [path.name for path in written] == [f"figure3-{TASK}.png", "figure3.json"]
    assert [episode["episode_seed"] for episode in numbers["episodes"]] == [0, 1, 2]
    assert all(episode["subgoals"][0]["step"] == 0 for episode in numbers["episodes"])

    document, written = report.write(make_plan("figure7", protocol_in(made), [TASK]))
    (numbers,) = document["numbers"]
    assert [path.name for path in written] == [f"figure7-{TASK}-guider.png", "figure7.json"]
    counts = [seed["subgoals"] for seed in numbers["per_seed"]]
    assert numbers["all_seeds"]["subgoals"] == sum(counts) > 0
    # A subgoal every 20 of 80 steps; the last has no whole period ahead of it.
    assert max(counts) <= 3 * figures.EPISODES_MEASURED
