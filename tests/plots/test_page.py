"""The page about runs: whole, without anything to load, and safe whatever names are in it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from small_runs import BC, OWN, write_plain

import guider
from guider import api, runs
from guider.cli import main
from guider.data import load
from guider.errors import GuiderError
from guider.plots.report import training_command


class Page(HTMLParser):
    """Collects tags, what they refer to, and the JSON in the page."""

    def __init__(self, text: str):
        super().__init__()
        self.references: list[str] = []
        self.scripts: list[str] = []
        self._inside = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "action", "data")]
        self._inside = tag == "script"

    def handle_endtag(self, tag):
        self._inside = False

    def handle_data(self, data):
        if self._inside:
            self.scripts.append(data)


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """Two scored runs on the same logs, whose columns have names, in folders with odd ones."""
    folder = tmp_path_factory.mktemp("runs <b>&")
    logs = load(write_plain(folder / "plain.npz"), (0, 1))
    guider.save_data(replace(logs, state_names=("x", "</script>", "z", "w")), folder / "logs.npz")
    found = [
        guider.train(data=folder / "logs.npz", out=folder / "guided", **OWN),
        guider.train(data=folder / "logs.npz", out=folder / "cloned", held_out=0.4, **BC),
    ]
    for run in found:
        guider.evaluate(run)
    return found


def test_a_page_that_loads_nothing_and_says_all(scored, tmp_path):
    path = api.report(scored, tmp_path / "page.html")
    text = path.read_text()
    page = Page(text)
    assert len(page.scripts) == 2 and page.references == []  # pictures are set by the script, from the page itself
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", text) and "{{" not in text
    content = json.loads(page.scripts[0])
    guided, cloned = content["runs"]
    assert [guided["name"], cloned["name"]] == ["guided", "cloned"]
    assert guided["score"]["unit"] == "of the goals met in imagination" and len(guided["score"]["words"]) == 2
    assert guided["facts"]["goal"] == "x, </script> within 0.5"
    assert "latent subgoals: kl" in guided["curves"] and guided["curves"]["latent subgoals: kl"]["x"] == [6]
    first, second = content["episodes"]
    assert first["names"] == ["x", "</script>"] and first["radius"] == 0.5 and len(first["logged"]) > 20
    for trace in first["traces"]:
        assert len(trace["path"]) == len(trace["subgoals"]) == len(trace["steps"])
        assert np.shape(trace["path"])[1:] == (2,) and trace["reach"][0]["step"] == 0
    assert all(trace["reach"] == [] and trace["subgoals"][0] == trace["goal"] for trace in second["traces"])
    assert {picture["name"] for picture in content["pictures"]} == {"learning", "subgoals"}
    assert all(picture["source"].startswith("data:image/png;base64,") for picture in content["pictures"])


def test_its_command_trains_the_same_run(scored, tmp_path, monkeypatch):
    import shlex

    words = shlex.split(training_command(scored[0].spec))
    assert words[:2] == ["guider", "train"]
    assert main([*words[1:], "--out", str(tmp_path / "again")]) == 0
    again = runs.open_run(tmp_path / "again")
    assert again.spec == scored[0].spec


def test_the_command(scored, tmp_path, capsys):
    assert main(["report", str(scored[1].directory)]) == 0
    assert "report.html is complete" in capsys.readouterr().out
    assert main(["report", str(scored[1].directory)]) == 0  # the run's own page is made anew
    other = tmp_path / "page.html"
    other.write_text("mine")
    assert main(["report", str(scored[1].directory), "--out", str(other)]) == 1
    assert "never overwritten" in capsys.readouterr().err and other.read_text() == "mine"
    (scored[1].directory / "evaluation.json").unlink()
    with pytest.raises(GuiderError, match="has not been scored"):
        api.report([scored[1]], tmp_path / "never.html")
