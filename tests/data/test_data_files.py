"""Plain and OGBench files, what every format has in common, and files that cannot be read."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import GOAL, antmaze, ends, walk, write_hdf5, write_npz

from guider.data import describe, load
from guider.data.episodes import make_episodes
from guider.errors import GuiderError


def test_ogbench_terminals_mark_last_rows_and_their_action_is_not_valid(tmp_path):
    arrays = walk([20, 30]) | {"terminals": ends([20, 30]).astype(np.float32)}
    arrays["actions"][[19, 49]] = np.nan
    episodes = load(write_npz(tmp_path / "o.npz", arrays), GOAL)
    assert episodes.lengths.tolist() == [20, 30]
    assert np.all(episodes.actions[[19, 49]] == 0)


@pytest.mark.parametrize("write", [write_npz, write_hdf5])
@pytest.mark.parametrize("key", ["lengths", "episode_ends", "timeouts"])
def test_plain_file(tmp_path, write, key):
    arrays = walk([20, 1, 30]) | {
        key: np.array([20, 1, 30]) if key == "lengths" else ends([20, 1, 30]),
        "goals": np.ones((51, 2)),
        "action_low": np.array([-2.0, -3]),
        "action_high": np.array(2.0),
    }
    episodes = load(write(tmp_path / "p.npz", arrays), GOAL)
    assert episodes.lengths.tolist() == [20, 30]
    assert episodes.goals is not None and np.all(episodes.goals == 1)
    assert episodes.action_low.tolist() == [-2, -3]
    assert episodes.action_high.tolist() == [2, 2]
    assert load(tmp_path / "p.npz", GOAL, action_low=-1).action_low.tolist() == [-1, -1]


@pytest.mark.parametrize("lengths", [[20, 31], [20, 29], [50.0], [[25], [25], [1]], [-1, 51]])
def test_plain_lengths_that_disagree(tmp_path, lengths):
    path = write_npz(tmp_path / "p.npz", walk([50]) | {"lengths": np.array(lengths)})
    with pytest.raises(GuiderError, match="episode lengths"):
        load(path, GOAL)


# Any format


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(2, 30), min_size=1, max_size=12), st.integers(0, 10**6))
def test_ragged_episodes_come_back_equal_from_every_format(lengths, seed):
    arrays = walk(lengths, seed=seed)
    expected = make_episodes(arrays["observations"], arrays["actions"], lengths, GOAL)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        flags = ends(lengths)
        flat = np.array(lengths)
        sources = [
            write_hdf5(root / "d4rl.hdf5", arrays | {"timeouts": flags, "terminals": np.zeros(len(flags), bool)}),
            write_npz(root / "ogbench.npz", arrays | {"terminals": flags}),
            write_npz(root / "plain.npz", arrays | {"lengths": flat}),
            write_hdf5(root / "plain.hdf5", arrays | {"episode_ends": flags}),
        ]
        kitchen = write_hdf5(root / "kitchen.hdf5", arrays | {"terminals": flags})
        loaded = [load(source, GOAL) for source in sources]
        loaded.append(load(kitchen, GOAL, format="d4rl-kitchen"))
    for episodes in loaded:
        np.testing.assert_array_equal(episodes.observations, expected.observations)
        np.testing.assert_array_equal(episodes.actions, expected.actions)
        np.testing.assert_array_equal(episodes.starts, expected.starts)
        assert episodes.fingerprint() == expected.fingerprint()


def test_float64_files_of_equal_data_have_equal_fingerprints(tmp_path):
    arrays = walk([20, 30])
    wide = {key: array.astype(np.float64) for key, array in arrays.items()}
    lengths = {"lengths": np.array([20, 30], np.uint8)}
    prints = {
        load(write(tmp_path / f"{i}.dat.npz", data | lengths), GOAL).fingerprint()
        for i, (write, data) in enumerate(
            [(write_npz, arrays), (write_npz, wide), (write_hdf5, arrays), (write_hdf5, wide)]
        )
    }
    assert len(prints) == 1


def test_describe_is_json_and_right():
    arrays = walk([3, 40, 9])
    arrays["observations"][:, 4] = 7
    arrays["observations"][43:, :2] = 0  # the last episode stands still
    episodes = make_episodes(arrays["observations"], arrays["actions"], [3, 40, 9], GOAL, source="here")
    facts = describe(episodes)
    assert json.loads(json.dumps(facts)) == facts
    assert facts["rows"] == 52 and facts["transitions"] == 49 and facts["episodes"] == 3
    assert facts["episode_length"] == {"min": 3, "median": 9.0, "max": 40}
    assert facts["state_dim"] == 5 and facts["action_dim"] == 2
    assert facts["constant_state_entries"] == [4] and facts["state_range"][4] == [7, 7]
    assert facts["goal_range"] == facts["state_range"][:2]
    assert facts["action_bounds"] == [[-1, 1], [-1, 1]]
    assert facts["recorded_goals"] is False and facts["actions_at_bounds"] == 0
    assert facts["fingerprint"] == episodes.fingerprint() and facts["source"] == "here"
    travel = {row["steps"]: row for row in facts["goal_travel"]}
    assert list(travel) == [1, 5, 10, 20]
    assert travel[1]["windows"] == 49 and travel[1]["still_fraction"] == pytest.approx(8 / 49, abs=1e-5)
    assert travel[10]["windows"] == 30 and travel[10]["still_fraction"] == 0
    assert travel[10]["median_distance"] > travel[1]["median_distance"] > 0


def test_actions_at_their_bounds_are_counted_where_something_follows():
    actions = np.array([[1.0, 0.0], [-1.0, 0.5], [1.0, 1.0], [0.9, -1.0], [1.0, 1.0]])
    episodes = make_episodes(np.eye(5), actions, [3, 2], GOAL, action_low=-1, action_high=1)
    assert describe(episodes)["actions_at_bounds"] == pytest.approx(3 / 6, abs=1e-5)  # rows 0, 1 and 3


# What cannot be read


@pytest.mark.parametrize("write", [write_npz, write_hdf5])
def test_missing_keys_are_named_with_those_found(tmp_path, write):
    path = write(tmp_path / "a.npz", {"look": np.zeros((3, 2)), "acted": np.zeros((3, 2))})
    with pytest.raises(GuiderError, match=r"missing observations; the file holds .*acted") as error:
        load(path, GOAL)
    assert "look" in str(error.value) and str(path) in str(error.value)


def test_missing_episode_ends_are_named(tmp_path):
    path = write_npz(tmp_path / "a.npz", walk([20]))
    with pytest.raises(GuiderError, match="missing one of lengths, episode_ends, timeouts, terminals"):
        load(path, GOAL)


def test_empty_archive(tmp_path):
    with pytest.raises(GuiderError, match="the file holds no arrays"):
        load(write_npz(tmp_path / "a.npz", {}), GOAL)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"observations,actions\n1,2\n" * 50, "neither an HDF5 file nor an npz archive"),
        (b"PK\x03\x04 and then nothing that a zip holds", "damaged or cut off"),
        (b"\x89HDF\r\n\x1a\n and then nothing", "neither an HDF5|damaged or cut off"),
    ],
)
def test_foreign_files(tmp_path, content, message):
    path = tmp_path / "a.hdf5"
    path.write_bytes(content)
    with pytest.raises(GuiderError, match=message):
        load(path, GOAL)


def test_paths_that_lead_nowhere(tmp_path):
    with pytest.raises(GuiderError, match="no such file"):
        load(tmp_path / "a.hdf5", GOAL)
    with pytest.raises(GuiderError, match="not a Minari dataset's"):
        load(tmp_path, GOAL)
    with pytest.raises(GuiderError, match="unknown data format 'csv'; there are arrays, d4rl-kitchen, "):
        load(tmp_path / "a.hdf5", GOAL, format="csv")


@pytest.mark.parametrize("write", [write_npz, write_hdf5])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_truncated_files(tmp_path, write, part):
    path = write(tmp_path / "a.npz", antmaze([300, 300]))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(GuiderError, match="damaged or cut off"):
        load(path, GOAL)


def test_corrupted_archive(tmp_path):
    path = write_npz(tmp_path / "a.npz", antmaze([300, 300]))
    content = bytearray(path.read_bytes())
    content[3000:3100] = bytes(100)
    path.write_bytes(content)
    with pytest.raises(GuiderError, match="cannot read observations"):
        load(path, GOAL)


class Trap:
    """Fails the test if it is ever unpickled."""

    sprung = False

    def __reduce__(self):
        return (setattr, (Trap, "sprung", True))


def test_objects_are_refused_without_unpickling(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **walk([20]) | {"lengths": np.array([20]), "goals": np.array([Trap()])})  # pyright: ignore
    with pytest.raises(GuiderError, match="goals holds Python objects, which are never unpickled"):
        load(path, GOAL)
    assert not Trap.sprung


@pytest.mark.parametrize(
    ("key", "array", "message"),
    [
        ("observations", np.zeros(60), "goal indices .0, 1. must lie in 0..0"),
        ("observations", np.zeros((0, 5)), "observations must be a non-empty 2-D array"),
        ("actions", np.zeros((60, 2), "S4"), "actions must be a non-empty 2-D array of numbers"),
        ("actions", np.zeros((59, 2)), "observations have 60 rows but actions 59"),
        ("timeouts", np.zeros(59, bool), "timeouts has 59 entries but observations have 60 rows"),
        ("timeouts", np.zeros((60, 3)), "timeouts must be a 1-D array"),
        ("observations", np.full((60, 5), np.nan), "observations hold NaN or inf in 60 rows"),
        ("observations", np.full((60, 5), 1e300), "observations hold NaN or inf in 60 rows"),
        ("actions", np.full((60, 2), np.inf), "actions hold NaN or inf"),
        ("infos/goal", np.full((60, 2), np.nan), "goals hold NaN or inf"),
    ],
)
@pytest.mark.filterwarnings("ignore::guider.GuiderWarning")
def test_malformed_arrays(tmp_path, key, array, message):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 30]) | {key: array})
    with pytest.raises(GuiderError, match=message):
        load(path, GOAL)


@pytest.mark.parametrize("goal_indices", [(), (5,), (-1,), (0, 0)])
def test_goal_indices_that_name_no_entries(tmp_path, goal_indices):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 30]))
    with pytest.raises(GuiderError, match="goal indices"):
        load(path, goal_indices)
