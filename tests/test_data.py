"""Every file format, as it is found in the wild, against the Episodes it must become."""

import builtins
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guider.data import describe, load
from guider.data.d4rl import find_jumps
from guider.episodes import Episodes, make_episodes
from guider.errors import GuiderError

GOAL = (0, 1)


def walk(lengths: list[int], state_dim: int = 5, action_dim: int = 2, seed: int = 0) -> dict[str, np.ndarray]:
    """Episodes that start somewhere in a 20 m square and wander noisily from there, laid end to end."""
    rng = np.random.default_rng(seed)
    paths = []
    for length in lengths:
        steps = rng.normal(0, 0.05, (length, 2)) + rng.normal(0, 0.05, 2)
        paths.append(rng.uniform(-10, 10, 2) + np.cumsum(steps, axis=0))
    rows = sum(lengths)
    observations = rng.normal(size=(rows, state_dim))
    observations[:, :2] = np.concatenate(paths)
    return {
        "observations": observations.astype(np.float32),
        "actions": rng.uniform(-1, 1, (rows, action_dim)).astype(np.float32),
    }


def ends(lengths: list[int]) -> np.ndarray:
    flags = np.zeros(sum(lengths), bool)
    flags[np.cumsum(lengths) - 1] = True
    return flags


def write_hdf5(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            file.create_dataset(key, data=array)
    return path


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
    return path


def antmaze(lengths: list[int], **options) -> dict[str, np.ndarray]:
    rows = sum(lengths)
    return walk(lengths, **options) | {
        "rewards": np.zeros(rows, np.float32),
        "terminals": np.zeros(rows, bool),
        "timeouts": ends(lengths),
        "infos/goal": np.repeat(np.arange(2.0 * len(lengths)).reshape(-1, 2), lengths, axis=0),
    }


# D4RL antmaze


@pytest.mark.parametrize("rows", [1000, 1001])
def test_antmaze_episodes_end_at_timeouts(tmp_path, rows):
    arrays = antmaze([rows] * 3)
    episodes = load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL)
    assert episodes.lengths.tolist() == [rows] * 3
    np.testing.assert_array_equal(episodes.observations, arrays["observations"])
    np.testing.assert_array_equal(episodes.goals, arrays["infos/goal"])
    assert episodes.action_low.tolist() == [-1, -1]


def test_antmaze_terminals_in_the_middle_do_not_split(tmp_path):
    arrays = antmaze([200, 300])
    arrays["terminals"][[50, 51, 52, 350]] = True
    arrays["rewards"][[50, 51, 52, 350]] = 1
    assert load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL).lengths.tolist() == [200, 300]


def test_antmaze_jumps_split_where_timeouts_are_a_row_early(tmp_path):
    arrays = antmaze([1001] * 4)
    arrays["timeouts"] = np.roll(arrays["timeouts"], -1)
    episodes = load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL)
    assert episodes.lengths.tolist() == [1000] * 4  # the 1,001st state is cut off on both sides, and dropped
    starts = np.arange(4) * 1001
    np.testing.assert_array_equal(episodes.observations[episodes.starts], arrays["observations"][starts])


@pytest.mark.parametrize("drop", [True, False])
def test_antmaze_jumps_split_without_any_timeout(tmp_path, drop):
    arrays = antmaze([1001] * 4)
    arrays["timeouts"][:] = False
    if drop:
        del arrays["timeouts"]
    assert load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL).lengths.tolist() == [1001] * 4


def test_antmaze_saved_as_npz(tmp_path):
    arrays = antmaze([30, 40])
    arrays["terminals"][5] = True
    assert load(write_npz(tmp_path / "a.npz", arrays), GOAL).lengths.tolist() == [30, 40]


def test_goals_of_another_goal_space_are_left_out(tmp_path):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 40]))
    assert load(path, GOAL).goals is not None
    assert load(path, (0, 1, 2)).goals is None


@pytest.mark.parametrize("goal_dim", [1, 2, 3])
def test_noise_is_no_jump(goal_dim):
    achieved = np.random.default_rng(0).normal(size=(200_000, goal_dim)).astype(np.float32)
    assert not find_jumps(achieved, np.zeros(len(achieved), bool)).any()


def test_sprints_pushes_and_standing_still_are_no_jumps():
    still = np.zeros(2000)
    sprint = np.cumsum(np.where(np.arange(2000) % 400 < 20, 0.5, 0.01))  # 50 times faster for 20 steps
    push = 1e-7 * np.random.default_rng(0).normal(size=2000)  # lies there, trembling, is pushed now and then
    for row in range(100, 2000, 300):
        push[row:] += 0.02
        push[row + 1 :] += 0.015
    for track in (still, sprint, push):
        achieved = np.stack([track, np.zeros(2000)], axis=1).astype(np.float32)
        assert not find_jumps(achieved, np.zeros(2000, bool)).any()


def test_jumps_are_found_among_short_episodes():
    lengths = [12] * 50
    achieved = walk(lengths)["observations"][:, :2]
    found = find_jumps(achieved, np.zeros(len(achieved), bool))
    assert not (found & ~ends(lengths)[:-1]).any()
    assert found.sum() >= 47  # two starts drawn close together cannot be told from a step


# D4RL kitchen


def test_kitchen_terminals_end_episodes_and_the_goal_half_is_the_goal(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "observations": rng.normal(size=(90, 60)).astype(np.float32),
        "actions": rng.uniform(-1, 1, (90, 9)).astype(np.float32),
        "terminals": ends([40, 50]),
        "timeouts": ends([20, 70]),
    }
    path = write_hdf5(tmp_path / "k.hdf5", arrays)
    indices = tuple(range(9, 30))
    episodes = load(path, indices)
    assert episodes.lengths.tolist() == [20, 20, 50]
    np.testing.assert_array_equal(episodes.observations, arrays["observations"][:, :30])
    np.testing.assert_array_equal(episodes.goals, arrays["observations"][:, 39:])
    assert load(path, indices, format="d4rl").observations.shape == (90, 60)
    with pytest.raises(GuiderError, match=r"must lie in 0\.\.29"):
        load(path, (30,))


def test_kitchen_of_gymnasium_robotics_keeps_its_59_numbers(tmp_path):
    arrays = walk([30, 30], state_dim=59, action_dim=9) | {"terminals": ends([30, 30])}
    arrays["observations"][10:30, 20] += 0.7  # a switch that snaps over
    episodes = load(write_hdf5(tmp_path / "k.hdf5", arrays), range(18, 39))
    assert episodes.observations.shape[1] == 59
    assert episodes.lengths.tolist() == [30, 30]
    assert episodes.goals is None


def test_kitchen_format_can_be_asked_for(tmp_path):
    arrays = antmaze([20, 30])
    arrays["terminals"][10] = True
    path = write_hdf5(tmp_path / "a.hdf5", arrays)
    assert load(path, GOAL, format="d4rl-kitchen").lengths.tolist() == [11, 9, 30]


# OGBench and plain files


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
    episodes = load(write(tmp_path / "p.npz", arrays), GOAL, format="plain")
    assert episodes.lengths.tolist() == [20, 30]
    assert episodes.goals is not None and np.all(episodes.goals == 1)
    assert episodes.action_low.tolist() == [-2, -3]
    assert episodes.action_high.tolist() == [2, 2]
    assert load(tmp_path / "p.npz", GOAL, format="plain", action_low=-1).action_low.tolist() == [-1, -1]


@pytest.mark.parametrize("lengths", [[20, 31], [20, 29], [50.0], [[25], [25], [1]], [-1, 51]])
def test_plain_lengths_that_disagree(tmp_path, lengths):
    path = write_npz(tmp_path / "p.npz", walk([50]) | {"lengths": np.array(lengths)})
    with pytest.raises(GuiderError, match="episode lengths"):
        load(path, GOAL)


# What cannot be read


@pytest.mark.parametrize("write", [write_npz, write_hdf5])
def test_missing_keys_are_named_with_those_found(tmp_path, write):
    path = write(tmp_path / "a.npz", {"observation": np.zeros((3, 2)), "acts": np.zeros((3, 2))})
    with pytest.raises(GuiderError, match=r"missing observations, actions; the file holds .*acts") as error:
        load(path, GOAL)
    assert "observation" in str(error.value) and str(path) in str(error.value)


def test_missing_episode_ends_are_named(tmp_path):
    path = write_npz(tmp_path / "a.npz", walk([20]))
    with pytest.raises(GuiderError, match="missing one of lengths, episode_ends, timeouts, terminals"):
        load(path, GOAL)
    with pytest.raises(GuiderError, match="missing lengths or episode_ends; the file holds observations"):
        load(path, GOAL, format="plain")
    with pytest.raises(GuiderError, match="missing terminals"):
        load(path, GOAL, format="ogbench")


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
    with pytest.raises(GuiderError, match="unknown data format 'csv'; choose one of d4rl, "):
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
        ("observations", np.zeros(60), "observations must be a non-empty 2-D array"),
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
def test_malformed_arrays(tmp_path, key, array, message):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 30]) | {key: array})
    with pytest.raises(GuiderError, match=message):
        load(path, GOAL)


@pytest.mark.parametrize("goal_indices", [(), (5,), (-1,), (0, 0)])
def test_goal_indices_that_name_no_entries(tmp_path, goal_indices):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 30]))
    with pytest.raises(GuiderError, match="goal indices"):
        load(path, goal_indices)


# Minari


@pytest.fixture
def minari_root(tmp_path, monkeypatch) -> Path:
    pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def write_minari(
    dataset_id: str, states: list, actions: list[np.ndarray], bound: float = 1.0, action_space=None
) -> None:
    """States and actions of each episode, by Minari's own API; a state may be a dict of arrays."""
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    def space(array) -> spaces.Space:
        if isinstance(array, dict):
            return spaces.Dict({key: space(value) for key, value in array.items()})
        return spaces.Box(-np.inf, np.inf, array.shape[1:], np.float64)

    buffers = []
    for index, (state, action) in enumerate(zip(states, actions, strict=True)):
        flags = np.zeros(len(action), bool)
        buffers.append(
            EpisodeBuffer(
                id=index,
                observations=state,
                actions=action,  # pyright: ignore[reportArgumentType]
                rewards=list(np.zeros(len(action))),
                terminations=list(flags),
                truncations=list(flags),
            )
        )
    minari.create_dataset_from_buffers(
        dataset_id,
        buffers,
        observation_space=space(states[0]),
        action_space=action_space or spaces.Box(-bound, bound, actions[0].shape[1:], np.float32),
    )


def cut(episodes: Episodes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(states, actions) of each episode, one action fewer than states."""
    for start, length in zip(episodes.starts, episodes.lengths, strict=True):
        rows = slice(start, start + length)
        yield episodes.observations[rows], episodes.actions[rows][:-1]


@pytest.mark.filterwarnings("ignore")
def test_minari_vectors(minari_root):
    arrays = walk([5, 9, 2])
    expected = make_episodes(arrays["observations"], arrays["actions"], [5, 9, 2], GOAL, action_low=-2, action_high=2)
    states, actions = zip(*cut(expected), strict=True)
    write_minari("test/walk-v0", list(states), list(actions), bound=2.0)
    directory = minari_root / "test" / "walk-v0"
    for source in (
        "minari:test/walk-v0",
        directory,
        directory / "data",
        directory / "data" / "main_data.hdf5",
    ):
        episodes = load(source, GOAL)
        assert episodes.fingerprint() == expected.fingerprint()
        assert episodes.source == str(source)
    with pytest.raises(GuiderError, match="cannot be read as d4rl"):
        load("minari:test/walk-v0", GOAL, format="d4rl")


@pytest.mark.filterwarnings("ignore")
def test_minari_dicts(minari_root):
    rng = np.random.default_rng(0)
    states, actions = [], []
    for length in (6, 4):
        observation = rng.normal(size=(length, 5))
        goal = rng.normal(size=(length, 2))
        states.append({"observation": observation, "achieved_goal": observation[:, 3:5], "desired_goal": goal})
        actions.append(rng.uniform(-1, 1, (length - 1, 2)).astype(np.float32))
    write_minari("test/dict-v0", states, actions)
    episodes = load("minari:test/dict-v0", (3, 4))
    assert episodes.lengths.tolist() == [6, 4]
    assert episodes.observations.shape == (10, 5)
    assert episodes.goals is not None
    np.testing.assert_allclose(episodes.goals, np.concatenate([s["desired_goal"] for s in states]), rtol=1e-6)
    assert load("minari:test/dict-v0", (0, 1)).goals is None  # desired goals are of another goal space


@pytest.mark.filterwarnings("ignore")
def test_minari_dicts_whose_observation_leaves_the_goal_space_out(minari_root):
    rng = np.random.default_rng(0)
    state = {key: rng.normal(size=(6, n)) for key, n in [("observation", 4), ("achieved_goal", 2), ("desired_goal", 2)]}
    write_minari("test/ant-v0", [state], [rng.uniform(-1, 1, (5, 2)).astype(np.float32)])
    episodes = load("minari:test/ant-v0", GOAL)
    np.testing.assert_allclose(
        episodes.observations,
        np.concatenate([state["achieved_goal"], state["observation"]], axis=1),
        rtol=1e-6,
    )
    assert episodes.goals is not None
    np.testing.assert_allclose(episodes.goals, state["desired_goal"], rtol=1e-6)


@pytest.mark.filterwarnings("ignore")
def test_minari_goals_that_are_dicts_are_left_out(minari_root):
    goal = {"kettle": np.ones((6, 7)), "microwave": np.ones((6, 1))}
    state = {
        "observation": np.random.default_rng(0).normal(size=(6, 9)),
        "achieved_goal": goal,
        "desired_goal": goal,
    }
    write_minari("test/kitchen-v0", [state], [np.zeros((5, 2), np.float32)])
    episodes = load("minari:test/kitchen-v0", (0, 1))
    assert episodes.observations.shape == (6, 9)
    assert episodes.goals is None


@pytest.mark.filterwarnings("ignore")
def test_minari_that_cannot_be_read(minari_root):
    with pytest.raises(GuiderError, match=r"no such Minari dataset .* minari download nobody/nothing-v0"):
        load("minari:nobody/nothing-v0", GOAL)
    write_minari("test/image-v0", [np.zeros((6, 3, 3))], [np.zeros((5, 2), np.float32)])
    with pytest.raises(GuiderError, match="observations must be vectors"):
        load("minari:test/image-v0", GOAL)
    write_minari("test/short-v0", [np.zeros((5, 3))], [np.zeros((5, 2), np.float32)])
    with pytest.raises(GuiderError, match="5 states and 5 actions"):
        load("minari:test/short-v0", GOAL)
    from gymnasium.spaces import MultiDiscrete

    discrete = np.zeros((5, 2), np.int64)
    write_minari("test/keys-v0", [np.zeros((6, 3))], [discrete], action_space=MultiDiscrete([2, 2]))
    with pytest.raises(GuiderError, match="actions must be continuous"):
        load("minari:test/keys-v0", GOAL)
    file = minari_root / "test" / "short-v0" / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(GuiderError, match="damaged or cut off"):
        load("minari:test/short-v0", GOAL)


def test_minari_extra_is_asked_for_when_absent(monkeypatch):
    real_import = builtins.__import__

    def without_minari(name, *args, **kwargs):
        if name.split(".")[0] == "minari":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    for module in [name for name in sys.modules if name.split(".")[0] == "minari"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(builtins, "__import__", without_minari)
    with pytest.raises(GuiderError, match=r'pip install "guider-rl\[minari\]"'):
        load("minari:test/walk-v0", GOAL)


# Properties


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
            write_hdf5(root / "d4rl.hdf5", arrays | {"timeouts": flags, "terminals": ~flags}),
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


# describe


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
    assert facts["recorded_goals"] is False
    assert facts["fingerprint"] == episodes.fingerprint() and facts["source"] == "here"
    travel = {row["steps"]: row for row in facts["goal_travel"]}
    assert list(travel) == [1, 5, 10, 20]
    assert travel[1]["windows"] == 49 and travel[1]["still_fraction"] == pytest.approx(8 / 49, abs=1e-5)
    assert travel[10]["windows"] == 30 and travel[10]["still_fraction"] == 0
    assert travel[10]["median_distance"] > travel[1]["median_distance"] > 0
