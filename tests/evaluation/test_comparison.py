"""Runs beside one another: what may be compared, and intervals of differences against independent ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guider.cli import main
from guider.errors import GuiderError
from guider.evaluation.comparison import compare, difference_interval
from guider.support import files


def scored(folder: Path, scores: list[list[float]], **changes: Any) -> Path:
    """A run's folder, of which only the score is there: [seeds][episodes]."""
    folder.mkdir()
    episodes = len(scores[0])
    result = {
        "task": "pointmaze-umaze",
        "method": folder.name,
        "preset": "fast",
        "fingerprint": "0123456789abcdef",
        "environment": "a ball",
        "unit": "success (%)",
        "radius": 0.5,
        "horizon_steps": 300,
        "episodes_per_seed": episodes,
        "episode_seeds": [0, len(scores) * episodes - 1],
        "checkpoint": "last",
        "score": float(np.mean(scores)),
        "interval_95": [0.0, 100.0],
        "per_seed": [{"episodes": {"score": of_seed}} for of_seed in scores],
    }
    files.write_json(folder / "evaluation.json", result | changes)
    return folder


def test_differences_are_from_the_first_run(tmp_path, capsys):
    """Seeds that score 50 and 25, and 75 and 50: of four pairs, the second is better in three, and level in one."""
    first = scored(tmp_path / "bc", [[100, 0, 100, 0], [0, 0, 0, 100]])
    second = scored(tmp_path / "guider", [[100, 100, 100, 0], [100, 0, 100, 0]])
    rows = compare([first, second])
    assert [row["score"] for row in rows] == [37.5, 62.5] and "difference" not in rows[0]
    assert rows[1]["difference"] == 25 and rows[1]["probability_of_improvement"] == pytest.approx(3.5 / 4)
    low, high = rows[1]["difference_interval_95"]
    assert low < 0 < 25 < high

    assert main(["compare", str(first), str(second), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == rows
    assert main(["compare", str(first), str(second)]) == 0
    shown = capsys.readouterr().out
    assert "+25.0" in shown and "88 %" in shown


def test_scores_that_were_not_made_alike_do_not_stand_beside_each_other(tmp_path):
    first = scored(tmp_path / "first", [[100, 0]])
    for name, changes, message in (
        ("other_task", {"task": "pointmaze-large"}, "task is pointmaze-large and pointmaze-umaze"),
        ("longer", {"horizon_steps": 600}, "horizon_steps is 600 and 300"),
    ):
        with pytest.raises(GuiderError, match=f"not scored alike: {message}"):
            compare([first, scored(tmp_path / name, [[100, 0]], **changes)])
    with pytest.raises(GuiderError, match="two runs or more"):
        compare([first])
    with pytest.raises(GuiderError, match="has not been scored; do so with `guider evaluate"):
        compare([first, tmp_path])
    own = scored(tmp_path / "own", [[100, 0]], task=None)
    with pytest.raises(GuiderError, match="has no score of its own to compare"):
        compare([own, first])
    (first / "evaluation.json").write_text((first / "evaluation.json").read_text().replace("300", "301"))
    with pytest.raises(GuiderError, match="score the run anew"):
        compare([first, own])


def test_one_seed_on_the_same_episodes_is_compared_episode_by_episode():
    """As the t-interval of 400 gaps says; apart from each other, the same episodes tell three times less."""
    rng = np.random.default_rng(3)
    shared, gaps = rng.normal(0, 10, 400), rng.normal(1, 3, 400)
    ours, theirs = (shared + gaps)[None], shared[None]
    half = 1.96 * gaps.std() / 20
    np.testing.assert_allclose(
        difference_interval(ours, theirs, True), [gaps.mean() - half, gaps.mean() + half], atol=0.03
    )
    low, high = difference_interval(ours, theirs, False)
    assert high - low > 3 * 2 * half


def test_what_varies_over_seeds_is_in_the_interval():
    """Ten seeds of one score each, 10 apart over its deviation: as wide as resampling seeds makes it."""
    ours = np.repeat(np.arange(10.0)[:, None] * 10, 50, axis=1)
    theirs = np.full((10, 50), 45.0)
    low, high = difference_interval(ours, theirs, True)
    half = 1.96 * np.arange(10.0).std() * 10 / 10**0.5
    np.testing.assert_allclose([low, high], [-half, half], atol=1.0)
