"""A task in a file outside the package, docs/own_task.py, does all that the package's own do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guider.cli import main
from guider.errors import GuiderError
from guider.support.files import parse_json
from guider.tasks import find_task

FILE = Path(__file__).parent.parent / "docs" / "own_task.py"


@pytest.fixture
def own(monkeypatch) -> None:
    monkeypatch.setenv("GUIDER_TASKS", str(FILE))


@pytest.mark.usefixtures("optimised")
def test_it_is_listed_recorded_learned_and_scored(own, tmp_path, capsys):
    data, run = str(tmp_path / "cart.hdf5"), str(tmp_path / "run")
    assert main(["tasks"]) == 0
    assert "cart" in capsys.readouterr().out.split()
    assert main(["collect", "cart", "--steps", "5000", "--out", data]) == 0
    quick = ["--method", "gcsl", "--set", "updates=1500", "batch_size=128"]
    assert main(["train", "cart", "--data", data, "--out", run, *quick]) == 0
    assert main(["evaluate", run, "--episodes", "50"]) == 0
    result = parse_json(Path(run) / "evaluation.json")
    assert result["environment"] == "a cart in NumPy" and result["unit"] == "success (%)"
    # A cart that only keeps turning meets one goal in fifty.
    assert result["score"] > 40
    assert main(["plot", run]) == 0


def test_it_is_a_row_of_tables(own, tmp_path, capsys):
    places = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
    assert main(["reproduce", "table1", "--tasks", "cart", "--methods", "gcsl", *places, "--dry-run"]) == 0
    assert "cart/gcsl-fast" in capsys.readouterr().out


def test_its_episodes_follow_from_their_seeds(own):
    env = find_task("cart").make_env(3)
    first, goals = env.reset(np.array([4, 5, 4]))
    assert (first[0] == first[2]).all() and (goals[0] == goals[2]).all() and (first[0] != first[1]).any()
    moved = env.step(np.ones((3, 2)), np.array([True, True, False]))
    assert (moved[0] != first[0]).any() and (moved[2] == first[2]).all()


def test_it_is_found_only_where_it_is_offered():
    with pytest.raises(GuiderError, match=r"there is no task 'cart'.*GUIDER_TASKS names its file"):
        find_task("cart")
