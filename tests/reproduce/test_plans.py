"""Which runs a table or figure of the paper needs, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planned import protocol_in

from guider.cli import main
from guider.reproduce import paper, runner
from guider.reproduce.plans import Protocol, make_plan
from guider.tasks import find_task


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
