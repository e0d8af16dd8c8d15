"""The page about logs: whole, loading nothing, and safe whatever names are in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conftest import make_ragged
from matplotlib.axes import Axes
from test_page import Page

import guider
from guider.cli import main
from guider.data import describe
from guider.plots.inspection import entries, inspection_page, lengths_and_travel, ways

NAMES = ("x", "</td><script>", "$x$", "steps")


def test_a_page_says_what_inspect_does_and_loads_nothing(tmp_path, capsys):
    guider.save_data(replace(make_ragged((7, 30, 30)), state_names=NAMES), tmp_path / "logs.npz")
    page = tmp_path / "page.html"
    asked = [
        "data",
        "inspect",
        str(tmp_path / "logs.npz"),
        "--goal",
        "x",
        "$x$",
        "--radius",
        "0.5",
        "--report",
        str(page),
    ]
    assert main(asked) == 0
    text = page.read_text()
    found = Page(text)
    assert len(found.references) == 4 and all(link.startswith("data:image/png") for link in found.references)
    assert found.scripts == [] and "&lt;script&gt;" in text
    shown = capsys.readouterr().out
    for said in ("few: expect little away from them", "look at the", "windows of 10 steps that would leave"):
        assert said in text and said in " ".join(shown.split())
    assert main(asked) == 1 and "never overwritten; choose another --report" in capsys.readouterr().err
    assert main(["data", "fetch", "--report", str(tmp_path / "b.html")]) == 1


def test_pictures_by_their_numbers():
    logs = make_ragged((7, 30, 30))
    description = describe(logs)
    lengths, travel = lengths_and_travel(logs, description).axes
    assert [bar.get_height() for bar in lengths.patches if bar.get_height()] == [1, 2]  # pyright: ignore[reportAttributeAccessIssue]
    assert list(np.asarray(travel.lines[0].get_xdata())) == [1, 5, 10, 20]
    (axes,) = ways(logs).axes
    assert isinstance(axes, Axes) and len(axes.lines) == 3 * 3
    np.testing.assert_array_equal(np.asarray(axes.lines[3].get_xydata()), logs.achieved[7:37])
    (axes,) = ways(logs.with_goal_space((1,))).axes
    np.testing.assert_array_equal(np.asarray(axes.lines[0].get_ydata()), logs.observations[:7, 1])
    shown = entries(logs, "action").axes
    assert [axes.get_title() for axes in shown] == ["action entry 0", "action entry 1"]
    counted = sum(bar.get_height() for bar in shown[0].patches)  # pyright: ignore[reportAttributeAccessIssue]
    assert counted == 67 - 3, "in an episode's last row nothing is done"
    assert "nothing to aim at" in inspection_page(logs, description | {"verdict": "nothing to aim at"})
