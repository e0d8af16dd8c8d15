"""The tables that documents show are those of the store."""

from __future__ import annotations

import re

import pytest

from guider.support.files import write_json
from tools import results


def result(scores: list[list[float]], ending: str, processor: str = "a processor") -> dict:
    per_seed = [
        {
            "score": sum(of_seed) / len(of_seed),
            "episodes": {"score": of_seed, "ending": ["met" if score else ending for score in of_seed]},
            "subgoals_in_walls": 0.25,
            "subgoals_off_data": 0.0,
        }
        for of_seed in scores
    ]
    facts = {"acts_by": "mean", "updates": {"low": 5}, "evaluated_on": processor, "commands": ["guider one", "two"]}
    return facts | {"per_seed": per_seed}


def test_documents_show_what_the_store_holds(capsys):
    assert results.main(["tables", "--check"]) == 0, capsys.readouterr().out


def test_tables_by_hand(tmp_path):
    """Four runs of two episodes: 100, 50, 50 and 0 % succeed; one of the failures fell, three were stuck."""
    (tmp_path / "antmaze-large-diverse").mkdir()
    write_json(tmp_path / "antmaze-large-diverse" / "guider-fast-7.json", result([[100, 100], [100, 0]], "fell"))
    write_json(
        tmp_path / "antmaze-large-diverse" / "guider-fast-8.json", result([[0, 100], [0, 0]], "stuck", "another")
    )
    theirs = result([[100, 100]], "fell") | {"commands": ["# theirs"]}
    write_json(tmp_path / "antmaze-large-diverse" / "d4rl-policy-guider-fast-5.json", theirs)
    beside = results.tables(tmp_path)["antmaze-d4rl-policy"]
    assert "D4RL's own ant policy, data seed 5 | 100 |" in beside and beside.endswith("```\n# theirs\n```")
    table = results.tables(tmp_path)["antmaze"]
    row = table.splitlines()[2]
    assert re.sub(r"\(.*?\)", "()", row) == (
        "| antmaze-large-diverse | `guider collect`, data seeds 7, 8 | 100, 50; 50, 0 | **50.0** () | 2 x 2, 8 | "
        "1 / 3 / 0 of 8 | 25.0 / 0.0 |"
    )
    assert (
        table.endswith("```\nguider one\ntwo\n```") and "Acts by the mean. Processors: a processor; another." in table
    )
    short = results.tables(tmp_path)["headline"].splitlines()[2]
    assert re.sub(r"\(.*?\)", "()", short) == "| antmaze-large-diverse | **50.0** () | 2 x 2, 8 | 1 / 3 / 0 of 8 |"
    document = "a\n<!-- table antmaze -->\nold\n<!-- end -->\nb\n"
    assert results.filled(document, {"antmaze": "new"}) == document.replace("old", "new")
    with pytest.raises(KeyError):
        results.filled(document, {})


def test_kitchens_stand_beside_the_papers(tmp_path):
    (tmp_path / "kitchen-partial").mkdir()
    facts = {"method": "gcsl", "score": 62.5, "interval_95": [50.0, 75.04], "training_minutes": 1.6}
    write_json(tmp_path / "kitchen-partial" / "gcsl-fast-9.json", result([[75, 100], [50, 25]], "time") | facts)
    write_json(
        tmp_path / "kitchen-partial" / "hiql-fast-9.json", result([[75], [50]], "time") | facts | {"method": "hiql"}
    )
    assert results.tables(tmp_path)["kitchen"].splitlines()[2:] == [
        "| kitchen-partial | gcsl-fast-9 | 87.5, 37.5 | **62.5** (50.0 to 75.0) | 55.0 ± 14.5 | 2 min |",
        "| kitchen-partial | hiql-fast-9 | 75, 50 | **62.5** (50.0 to 75.0) | - | 2 min |",
    ]


def test_ogbenchs_rows_stand_beside_the_published_ones(tmp_path):
    folder = tmp_path / "ogbench-pointmaze-giant-stitch-v0"
    folder.mkdir()
    facts = {"method": "guider-routes", "per_goal": [100.0, 50.0], "training_minutes": 12.4}
    write_json(folder / "guider-routes-fast-8.json", result([[100, 100], [100, 0]], "stuck") | facts)
    rival = result([[0, 0], [100, 0]], "stuck") | facts | {"method": "qrl", "per_goal": [50.0, None]}
    write_json(folder / "qrl-20k-8.json", rival)
    row = results.tables(tmp_path)["ogbench"].splitlines()[2]
    assert re.sub(r"\(\d.*?;", "(..;", row) == (
        "| pointmaze-giant-stitch | guider-routes-fast-8 **75.0** (..; by goal 100 50; 12 min) | "
        "0 | 0 | 0 | 50<br>ours: qrl-20k-8 **25.0** (..; by goal 50 -; 12 min) | 0 | 0 | GCIQL + TTGS 98 |"
    )
