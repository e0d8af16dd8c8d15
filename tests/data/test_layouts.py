"""Saving episodes: what is written is read back as it was, by ours and by those whose layout it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import guider
from guider.data import load
from guider.data.episodes import Episodes, make_episodes
from guider.data.layouts import save
from guider.errors import GuiderError


@pytest.fixture
def episodes() -> Episodes:
    rng = np.random.default_rng(0)
    made = make_episodes(
        rng.normal(size=(12, 3)),
        rng.uniform(-3, 3, (12, 2)),
        [5, 7],
        (2, 0),
        goals=rng.normal(size=(12, 2)),
        action_low=-4,
        action_high=np.array([3, 5]),
    )
    return Episodes(**{**vars(made), "state_names": ("x", "y", "z"), "action_names": ("v", "w")})


def test_plain_keeps_everything(tmp_path, episodes):
    assert guider.save_data(episodes, tmp_path / "a.npz") == "plain"
    back = load(tmp_path / "a.npz")
    assert back.fingerprint() == episodes.fingerprint() and back.goal_space_from == "the source"
    assert (back.state_names, back.action_names) == (episodes.state_names, episodes.action_names)
    assert load(tmp_path / "a.npz", goal=("x", "y")).goals is None  # they are of another goal space
    assert load(tmp_path / "a.npz", (2, 0)).goals is not None


@pytest.mark.parametrize(("name", "layout"), [("a.hdf5", None), ("a.npz", "ogbench"), ("a", None), ("a", "lerobot")])
def test_other_layouts_keep_what_is_learned_from(tmp_path, episodes, name: str, layout: str | None):
    save(episodes, tmp_path / name, layout)
    back = load(tmp_path / name, episodes.goal_indices)
    np.testing.assert_array_equal(back.observations, episodes.observations)
    np.testing.assert_array_equal(back.actions, episodes.actions)
    assert back.lengths.tolist() == [5, 7]


def test_lerobots_tables(tmp_path, episodes):
    from pyarrow import parquet

    save(episodes, tmp_path / "set", "lerobot", fps=20)
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert (info["fps"], info["total_frames"], info["codebase_version"]) == (20, 12, "v2.1")
    assert info["features"]["observation.state"]["names"] == ["x", "y", "z"]
    table = parquet.read_table(
        tmp_path / "set" / info["data_path"].format(episode_chunk=0, episode_index=1)
    ).to_pydict()
    assert table["timestamp"] == pytest.approx(np.arange(7) / 20)
    assert table["index"] == list(range(5, 12)) and table["action"][-1] == table["action"][-2]
    stats = [json.loads(line) for line in (tmp_path / "set/meta/episodes_stats.jsonl").read_text().splitlines()]
    assert stats[0]["stats"]["observation.state"]["mean"] == pytest.approx(episodes.observations[:5].mean(axis=0))


def test_ogbenchs_own_loader_reads_it(tmp_path, episodes):
    from ogbench.utils import load_dataset

    save(episodes, tmp_path / "a.npz", "ogbench")
    read = load_dataset(str(tmp_path / "a.npz"), ob_dtype=np.float32, action_dtype=np.float32)
    np.testing.assert_array_equal(read["observations"], np.delete(episodes.observations, [4, 11], axis=0))
    np.testing.assert_array_equal(read["next_observations"], np.delete(episodes.observations, [0, 5], axis=0))
    assert np.flatnonzero(read["terminals"]).tolist() == [3, 9]


def test_nothing_is_overwritten_and_endings_agree(tmp_path, episodes):
    (tmp_path / "a.npz").write_text("mine")
    with pytest.raises(GuiderError, match="exists already and is never overwritten"):
        save(episodes, tmp_path / "a.npz")
    for name, layout in (("a.txt", None), ("b.npz", "d4rl"), ("b.hdf5", "lerobot"), ("b", "rlds")):
        with pytest.raises(GuiderError, match="its ending is not its layout's"):
            save(episodes, tmp_path / name, layout)
    with pytest.raises(GuiderError, match="--fps must be"):
        save(episodes, tmp_path / "b", "lerobot", fps=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz"]
    assert Path(tmp_path / "a.npz").read_text() == "mine"


def test_the_command(tmp_path, episodes, capsys):
    from guider.cli import main

    save(episodes, tmp_path / "a.npz")
    assert main(["data", "convert", str(tmp_path / "a.npz"), str(tmp_path / "b.hdf5"), "--state", "observations"]) == 0
    assert "is complete (d4rl)" in capsys.readouterr().out
    for words, message in (
        ((), "say what to convert, and to what"),
        ((str(tmp_path / "a.npz"), str(tmp_path / "c.npz"), "--radius", "1"), "--radius says how to train"),
    ):
        assert main(["data", "convert", *words]) == 1
        assert message in capsys.readouterr().err
