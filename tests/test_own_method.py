"""A method in a file outside the package, docs/own_method.py, does all that the package's own do."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import equal, make_ragged

import guider
from guider import runs
from guider.cli import main
from guider.errors import GuiderError
from guider.exporting.actor import Actor
from guider.methods import find_method
from guider.support import plugins
from guider.support.files import parse_json

FILE = Path(__file__).parent.parent / "docs" / "own_method.py"


@pytest.fixture
def own(monkeypatch) -> None:
    monkeypatch.setenv("GUIDER_METHODS", str(FILE))


def test_it_trains_resumes_scores_acts_and_leaves(own, tmp_path):
    logs = make_ragged([20] * 10, recorded_goals=False)

    def cut(chunk, state):
        if chunk.position.update == 20:
            shutil.copytree(tmp_path / "run", tmp_path / "cut")

    run = guider.train(
        data=logs, radius=0.5, method="linear", settings={"updates": "30"}, seeds=2, out=tmp_path / "run",
        held_out=0.2, pace=runs.Pace(10, 0.0), on_chunk=cut,
    )  # fmt: skip
    resumed = guider.resume(tmp_path / "cut", logs)
    assert equal(run.restore(), resumed.restore())
    first, second = (policy.state.policy.layers for policy in run.policies())
    assert not equal(first, second)
    errors = [score["action_error"] for score in guider.evaluate(run, data=logs)["per_seed"]]
    assert np.isfinite(errors).all()
    action = guider.load(run).act(logs.observations[0], [1.0, 2.0])
    assert action.shape == (2,) and np.isfinite(action).all()
    with pytest.raises(GuiderError, match="linear has no subgoals"):
        _ = guider.load(run).subgoal
    out, _ = guider.export(run, tmp_path / "linear.npz")
    np.testing.assert_allclose(Actor(out).act(logs.observations[0], [1.0, 2.0]), action, atol=1e-5)


def test_it_is_compared_with_others(own, tmp_path, capsys):
    places = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
    wanted = ["--methods", "gcsl", "linear", "--tasks", "pointmaze-umaze", *places]
    assert main(["reproduce", "table1", *wanted, "--dry-run"]) == 0
    assert "pointmaze-umaze/linear-fast" in capsys.readouterr().out


def test_nothing_is_executed_that_nobody_named(own, tmp_path, monkeypatch, capsys):
    logs = make_ragged([20] * 10, recorded_goals=False)
    run = guider.train(data=logs, radius=0.5, method="linear", settings={"updates": "2"}, out=tmp_path / "run")
    assert parse_json(run.directory / "run.json")["method"] == "linear"
    monkeypatch.delenv("GUIDER_METHODS")
    assert main(["evaluate", str(run.directory)]) == 1
    assert (
        "there is no method 'linear'" in (said := capsys.readouterr().err) and "GUIDER_METHODS names its file" in said
    )


def test_an_installed_package_offers_methods(tmp_path, monkeypatch):
    shutil.copy(FILE, tmp_path / "toy_package.py")
    about = tmp_path / "toy-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[guider.methods]\ntoy = toy_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    plugins._offered.cache_clear()
    assert find_method("linear").label == "Linear"
    plugins._offered.cache_clear()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be loaded: FileNotFoundError"),
        ("1 / 0", "cannot be loaded: ZeroDivisionError"),
        ("", "cannot be loaded: AttributeError: .*METHODS"),
        ("METHODS = {'gcsl': None}", "calls a method 'gcsl', and that name is taken"),
    ],
)
def test_files_that_offer_no_methods_are_told(text, message, tmp_path, monkeypatch):
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    monkeypatch.setenv("GUIDER_METHODS", str(tmp_path / "mine.py"))
    with pytest.raises(GuiderError, match=message):
        find_method("mine")
