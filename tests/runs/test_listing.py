"""`guider runs`: every run below a folder, whatever became of it. `guider info`."""

from __future__ import annotations

import json
import shutil

import guider
from guider.cli import main


def test_runs_are_listed_with_what_became_of_them(finished, tmp_path, capsys):
    logs, run = finished
    for name in ("a", "deep/b", "c"):
        shutil.copytree(run.directory, tmp_path / "runs" / name)
    guider.train(
        data=logs,
        out=tmp_path / "scored",
        radius=0.5,
        goal_indices=(0, 1),
        method="bc",
        held_out=0.4,
        settings={"updates": 2, "hidden": (8,), "batch_size": 4},
    )
    guider.evaluate(tmp_path / "scored")
    shutil.move(tmp_path / "scored", tmp_path / "runs" / "d")
    unfinished, damaged = tmp_path / "runs" / "deep" / "b", tmp_path / "runs" / "c" / "run.json"
    lines = (unfinished / "metrics.jsonl").read_text().splitlines(keepends=True)
    (unfinished / "metrics.jsonl").write_text("".join(lines[:2]))
    damaged.write_text(damaged.read_text().replace("fast", "slow"))
    (tmp_path / "runs" / "link").symlink_to(run.directory)

    assert main(["runs", str(tmp_path / "runs"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["run"].rpartition("runs/")[2] for row in rows] == ["a", "c", "d", "deep/b"]
    whole, broken, scored, begun = rows
    assert (whole["updates"], whole["of_updates"], whole["problem"]) == (12, 12, None) and "score" not in whole
    assert begun["updates"] == 6
    assert "changed by hand" in broken["problem"] and "method" not in broken
    assert 0 < scored["action_error"] < 4

    assert main(["runs", str(tmp_path / "runs")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "6 of 12" in shown and "action error" in shown
    assert main(["runs", str(tmp_path / "runs" / "deep" / "b" / "checkpoints")]) == 0
    assert "there are no runs below" in capsys.readouterr().out
    assert main(["runs", str(tmp_path / "nowhere")]) == 1
    assert "nowhere is no folder" in capsys.readouterr().err


def test_a_bug_report_has_its_facts(capsys, monkeypatch):
    monkeypatch.setenv("GUIDER_TASKS", "my_tasks.py")
    assert main(["info", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["cores"] >= 1 and "GUIDER_TASKS=my_tasks.py" in facts["variables"]
    assert {"jax", "mujoco", "guider-rl", "system", "trains on", "extras"} <= facts.keys()
