"""`guider reproduce`: which runs a table needs, that they are made once and survive anything, and what it reports."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guider import runs
from guider.cli import main
from guider.errors import GuiderError
from guider.reproduce import figures, paper, report, runner
from guider.reproduce.plans import Plan, PlannedRun, Protocol, make_plan
from guider.support import files
from guider.support.locks import hold
from guider.tasks import find_task

SETTINGS = {
    "latent.updates": "4",
    "high.updates": "4",
    "low.updates": "3000",
    "latent.hidden": "(8,)",
    "high.hidden": "(8,)",
    "low.hidden": "(8,)",
    "latent.batch_size": "16",
    "high.batch_size": "16",
    "low.batch_size": "16",
}
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


def protocol_in(folder: Path, **changes: Any) -> Protocol:
    asked = {"seeds": 2, "episodes": 3, "settings": SETTINGS, "data": folder / "data", "out": folder / "out"}
    return Protocol(**(asked | changes))


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below `folder` with the time of its last change."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def fake(plan: Plan, run: PlannedRun, scores: list[float], curve: tuple[float, ...] = (1.0,), **facts: Any) -> None:
    """Put a finished run on disk that scored `scores`, a seed each."""
    directory = plan.directory(run)
    directory.mkdir(parents=True)
    files.write_json(directory.with_name(f"{directory.name}.json"), run.request())
    first = run.seeds[0] * plan.protocol.episodes
    result = {
        "task": run.task,
        "method": run.method,
        "preset": run.preset,
        "departures": {"high.samples": 2, "low.updates": len(run.variant)},
        "period_steps": 50,
        "acts_by": "mean of the policy",
        "data": "somewhere",
        "fingerprint": "0123456789abcdef",
        "training_seeds": list(run.seeds),
        "updates": {"goal policy": 1000},
        "versions": {"python": "3.11"},
        "environment": "an ant",
        "horizon_steps": 1000,
        "episodes_per_seed": plan.protocol.episodes,
        "episode_seeds": [first, first + len(scores) * plan.protocol.episodes - 1],
        "unit": "success (%)",
        "score": float(np.mean(scores)),
        "interval_95": [0.0, 100.0],
        "per_seed": [{"score": score} for score in scores],
    }
    files.write_json(directory / "evaluation.json", result | facts)
    for seconds in (30.0, 60.0):
        line = {"stage": "goal policy", "update": 500, "total_updates": 500, "seconds": seconds, "metrics": {}}
        files.append_line(directory / "metrics.jsonl", line)
    for index, share in enumerate(curve, start=1):
        line = {"total_updates": 500 * index, "score": [share * score for score in scores], "episodes": 20}
        files.append_line(directory / "evaluations.jsonl", line)


# Plans


def test_the_papers_numbers_agree_with_its_text_and_with_each_other():
    assert {task: find_task(task).paper_score for task in paper.TABLE_1} == {
        task: scores[-1] and scores[-1][0] for task, scores in paper.TABLE_1.items()
    }
    best = [max(scores, key=lambda score: score[0] if score else 0) == scores[-1] for scores in paper.TABLE_1.values()]
    assert sum(best) == 12  # "best performance on 12 out of 14 tasks"
    for task, scores in paper.TABLE_2.items():
        assert scores[0] == paper.TABLE_1[task][-1]
    for task, scores in paper.TABLE_3.items():
        guider = paper.TABLE_1[task][-1]
        assert guider is not None and scores[1] == (guider[0], None)  # c = 50 is Guider itself


def test_table_1_is_every_method_on_every_task():
    plan = make_plan("table1", Protocol(seeds=3, first_seed=4, preset="paper"))
    assert len(plan.runs) == 14 * 5 and {run.seeds for run in plan.runs} == {(4, 5, 6)}
    assert plan.runs[0].name == "antmaze-umaze-diverse/opal-paper"
    curves = make_plan("figure6", plan.protocol).runs
    assert [replace(run, curve=False) for run in curves] == plan.runs and all(run.curve for run in curves)
    chosen = make_plan("table1", Protocol(), ["kitchen-mixed"], ["guider", "bc"])
    assert [run.name for run in chosen.runs] == ["kitchen-mixed/guider-fast", "kitchen-mixed/bc-fast"]
    assert chosen.paper_scores == (((67.1, 5.8), None),)


def test_ablations_change_what_the_paper_changes():
    variants = {v.name: (v.settings, v.period_steps) for v in make_plan("table2", Protocol()).variants}
    assert variants == {
        "guider": ({}, None),
        "guider-without-prior": ({"high.prior": "false"}, None),
        "guider-without-cql": ({"high.critic": "td"}, None),
        "guider-without-prior-or-cql": ({"high.prior": "false", "high.critic": "td"}, None),
    }
    large = make_plan("table3", Protocol()).grid[0]
    assert [run.period_steps for run in large] == [25, None, 75, 100]
    (_, latent), *_ = make_plan("figure5", Protocol()).grid
    assert latent.settings == {"low.subgoal_input": "latent"}


def test_tables_and_figures_share_their_runs():
    shared = make_plan("table1", Protocol(), ["antmaze-large-diverse"], ["guider"]).runs[0]
    for target in ("table2", "table3", "figure3", "figure4", "figure7"):
        assert shared in make_plan(target, Protocol()).runs
    curve = make_plan("figure5", Protocol(), ["antmaze-large-diverse"]).runs[0]
    assert curve == replace(shared, curve=True) and curve.name == f"{shared.name}-curve"
    assert make_plan("figure7", Protocol()).runs == make_plan("table2", Protocol(), ["antmaze-large-diverse"]).runs


def test_settings_are_for_all_runs_or_for_one_methods():
    asked = Protocol(settings={"gcsl:updates": "5", "batch_size": "16", "gcsl:batch_size": "32"})
    gcsl, guider = make_plan("table1", asked, ["kitchen-mixed"], ["gcsl", "guider"]).runs
    assert gcsl.settings == {"batch_size": "32", "updates": "5"} and guider.settings == {"batch_size": "16"}


def test_a_plan_names_the_commands_it_takes(tmp_path):
    plan = make_plan("table3", protocol_in(tmp_path, first_seed=5), ["antmaze-large-diverse"])
    described = runner.describe(plan)
    train, evaluate = described["runs"][0]["commands"]
    assert "train antmaze-large-diverse" in train and "--seeds 2 --first-seed 5" in train
    assert "--period-steps 25" in train and "--set latent.updates=4" in train and "--evaluate-every" not in train
    assert evaluate.endswith("guider-c25-fast --episodes 3 --first-seed 15")  # seed s: episodes from 3 s on
    assert described["data_to_record"] == [
        f"guider collect antmaze-large-diverse --out {tmp_path}/data/antmaze-large-diverse.hdf5"
    ]
    assert main(["reproduce", "table2", "--out", str(tmp_path / "new"), "--dry-run"]) == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["table1", "--methods", "magic"], "there is no method 'magic'; there are"),
        (["table2", "--methods", "guider"], "leave --methods out"),
        (["table2", "--set", "high.prior=true"], "table2 compares values of high.prior"),
        (["table2", "--set", "gcsl:updates=3"], "table2 has no runs of a method 'gcsl'"),
        (["table2", "--tasks", "antmaze-larg"], "there is no task 'antmaze-larg'"),
        (["figure7", "--tasks", "fetch-pick-mixed"], "fetch-pick-mixed has none"),
        (["table2", "--seeds", "0"], "must be 1 or more"),
        (["table2", "--jobs", "10000"], "--jobs must lie between 1 and"),
        (["table2", "--tasks", "antmaze-large-play"], "cannot be recorded here; put it there"),
    ],
)
def test_bad_input_gets_one_line_and_starts_nothing(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(runner._Runner, "work", None)
    assert main(["reproduce", *arguments, "--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("guider:")]
    assert len(error) == 1 and message in error[0]


# Running


def test_data_is_recorded_and_a_failing_run_does_not_end_the_plan(made):
    """The task with bad data came first."""
    document = json.loads((made / "out" / "table1.json").read_text())
    broken, fine = document["rows"]
    assert broken["task"] == BROKEN and "mean" not in broken["cells"][0]
    result = json.loads((made / "out" / "runs" / TASK / "guider-fast" / "evaluation.json").read_text())
    assert fine["cells"][0]["per_seed"] == [seed["score"] for seed in result["per_seed"]]
    assert result["departures"]["low.updates"] == 3000 and result["episode_seeds"] == [0, 5]
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
    arguments.remove("low.updates=3000")
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


# Reports


def test_the_table_says_mean_and_deviation_beside_the_papers(tmp_path):
    plan = make_plan("table1", protocol_in(tmp_path), ["antmaze-large-diverse", "fetch-pick-mixed"], ["gcsl", "guider"])
    (ant_gcsl, ant_guider), (fetch_gcsl, fetch_guider) = plan.grid
    fake(plan, ant_gcsl, [10.0, 20.0])
    fake(plan, ant_guider, [80.0, 70.0])
    fake(plan, fetch_guider, [40.0, 30.0], unit="steps with the goal met", horizon_steps=50)
    document, written = report.write(plan)
    assert [path.name for path in written] == ["table1.json", "table1.md"]
    page = written[1].read_text()
    assert "| antmaze-large-diverse | **15.0** ± 5.0 (11.8 ± 3.6) | **75.0** ± 5.0 (80.8 ± 4.6) |  |" in page
    fill = "guider reproduce table1 --tasks fetch-pick-mixed --methods gcsl guider --seeds 2 --episodes 3"
    assert f"| fetch-pick-mixed | - (12.0 ± 3.5) | **35.0** ± 5.0 (33.2 ± 2.4) | `{fill}" in page
    assert document["aggregate"]["tasks"] == ["antmaze-large-diverse"]  # what both have finished

    fake(plan, fetch_gcsl, [35.0, 45.0], unit="steps with the goal met", horizon_steps=50)
    gcsl, guider = report.write(plan)[0]["aggregate"]["variants"]
    # Of 0.1, 0.2, 0.7 and 0.9, and of 0.8, 0.7, 0.8 and 0.6, the middle two.
    assert gcsl["interquartile_mean"] == pytest.approx(0.45) and guider["interquartile_mean"] == pytest.approx(0.75)
    assert guider["paper_mean"] == pytest.approx((0.808 + 33.2 / 50) / 2)
    # Antmaze: always. Fetch: 40 beats 35, three times of four it does not.
    assert gcsl["guider_improves"] == pytest.approx((1 + 0.25) / 2) and "guider_improves" not in guider
    low, high = gcsl["interval_95"]
    assert 0 < low < 0.45 < high < 0.9


def test_the_protocol_is_stated(tmp_path):
    plan = make_plan("table2", protocol_in(tmp_path), ["antmaze-large-diverse"])
    for run in plan.runs[:2]:
        fake(plan, run, [50.0, 60.0])
    document, written = report.write(plan)
    stated = document["protocol"]
    assert stated["departures_of_all_runs"] == {"high.samples": 2}
    assert [run["other_departures"] for run in stated["runs"]] == [{"low.updates": 6}, {"low.updates": 20}]
    assert [run["training_minutes"] for run in stated["runs"]] == [1.5, 1.5]
    assert stated["training_seeds"] == [0, 1] and stated["checkpoint"] == "last"
    page = written[1].read_text()
    for fact in ("an ant", "0123456789abcdef", "python 3.11", "| 1.5 |", "3 episodes each", "preset `fast`"):
        assert fact in page


def test_curves_and_bars_give_their_numbers(tmp_path):
    """Figures 5 and 4 of two fake runs; a third, unfinished, is left out and its command named."""
    plan = make_plan("figure5", protocol_in(tmp_path), ["fetch-pick-mixed"])
    for run in plan.runs:
        fake(plan, run, [20.0, 40.0], curve=(0.5, 1.0))
    document, (picture, _) = report.write(plan)
    assert picture.read_bytes().startswith(b"\x89PNG")
    with_decoder, without = document["numbers"][0]["variants"]
    assert with_decoder["curve"]["updates"] == [500, 1000]
    assert without["curve"]["scores_per_seed"] == [[10.0, 20.0], [20.0, 40.0]]
    assert with_decoder["paper"] == (33.2, 2.4) and without["paper"] is None

    bars = make_plan("figure4", plan.protocol, ["fetch-pick-mixed"], ["guider", "guider-gcsl"])
    fake(bars, bars.runs[0], [20.0, 40.0])
    document, _ = report.write(bars)
    (guider,) = document["numbers"][0]["methods"]
    assert (guider["mean"], guider["deviation"], guider["paper"]) == (30.0, 10.0, (33.2, 2.4))
    assert document["unfinished"][0]["variants"] == ["guider-gcsl"]


def test_gap_statistics_by_hand():
    assert figures.gap_statistics(np.array([0.0, 1.0, 2.0, 3.0, 9.0]), 2.0) == {
        "subgoals": 5,
        "mean": 3.0,
        "median": 2.0,
        "quartiles": [1.0, 3.0],
        "within_reach_radius_percent": 60.0,
    }
    assert figures.gap_statistics(np.zeros(0), 1.0) == {"subgoals": 0}


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
