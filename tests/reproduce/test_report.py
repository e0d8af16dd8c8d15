"""What tables and figures tell of the runs there are."""

from __future__ import annotations

import numpy as np
import pytest
from planned import fake, protocol_in

from guider.reproduce import figures, report
from guider.reproduce.plans import make_plan


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
