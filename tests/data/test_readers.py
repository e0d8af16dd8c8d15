"""Logs as people have them: each layout is written here, by what its own package or page says of it, and comes back
whole."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from guider.data import load
from guider.errors import GuiderError, GuiderWarning

LENGTHS = (7, 5, 6)
NAMES = ("x", "y", "heading")
Log = list[tuple[np.ndarray, np.ndarray]]


@pytest.fixture
def log() -> Log:
    """(states [n, 3], actions [n, 2]) of each episode; float32 holds them all."""
    rng = np.random.default_rng(0)
    return [
        (np.cumsum(rng.normal(size=(n, 3)), axis=0).astype(np.float32), rng.uniform(-2, 2, (n, 2)).astype(np.float32))
        for n in LENGTHS
    ]


def write_csv(folder: Path, log: Log) -> Path:
    for number, (states, actions) in enumerate(log):
        table = np.column_stack([0.1 * np.arange(len(states)), states, actions, np.full((len(states), 1), 9.0)])
        header = ",".join(["time_s", *NAMES, "cmd_v", "cmd_w", "goal_x"])
        # run 10 comes after run 9
        np.savetxt(folder / f"run_{number + 8}.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    (folder / "notes.md").write_text("not an episode")
    (folder / ".hidden.csv").write_text("a\n1")
    return folder


def write_parquet(folder: Path, log: Log) -> Path:
    for number, (states, actions) in enumerate(log):
        columns = {name: states[:, i] for i, name in enumerate(NAMES)} | {
            "action_v": actions[:, 0],
            "action_w": actions[:, 1],
        }
        parquet.write_table(pa.table(columns | {"task": ["walk"] * len(states)}), folder / f"run_{number}.parquet")
    return folder


def write_npz_folder(folder: Path, log: Log) -> Path:
    """An action less than states in each, and a number that holds for the whole episode."""
    for number, (states, actions) in enumerate(log):
        np.savez(folder / f"{number}.npz", observations=states, actions=actions[:-1], rate=[50.0])
    return folder


def frames(log: Log, first: int, last: int) -> pa.Table:
    part = log[first:last]
    states, actions = (np.concatenate([episode[i] for episode in part]) for i in (0, 1))
    numbers = np.concatenate([np.full(len(s), first + i) for i, (s, _) in enumerate(part)])
    return pa.table(
        {
            "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(states.ravel()), 3),
            "action": list(actions),  # lists of no declared length
            "timestamp": np.concatenate([np.arange(len(s)) / 30 for s, _ in part]).astype(np.float32),
            "frame_index": np.concatenate([np.arange(len(s)) for s, _ in part]),
            "episode_index": numbers,
            "index": np.arange(len(states)),
            "observation.images.front": pa.array([b"png"] * len(states)),
        }
    )


def write_lerobot(folder: Path, log: Log, version: str, names: object, tables: dict[str, tuple[int, int]]) -> Path:
    features = {
        "observation.state": {"dtype": "float32", "shape": [3], "names": names},
        "action": {"dtype": "float32", "shape": [2], "names": None},
        "observation.images.front": {"dtype": "video", "shape": [3, 8, 8], "names": ["c", "h", "w"]},
    }
    (folder / "meta" / "episodes").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 30, "features": features, "data_path": "../../../etc/{episode_index}"}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    parquet.write_table(pa.table({"episode_index": [0]}), folder / "meta" / "episodes" / "file-000.parquet")
    for name, (first, last) in tables.items():
        path = folder / "data" / "chunk-000" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(frames(log, first, last), path)
    return folder


def write_lerobot_2(folder: Path, log: Log) -> Path:
    tables = {f"episode_{i:06d}.parquet": (i, i + 1) for i in range(len(log))}
    return write_lerobot(folder, log, "v2.1", [list(NAMES)], tables)


def write_lerobot_3(folder: Path, log: Log) -> Path:
    tables = {"file-000.parquet": (0, 2), "file-001.parquet": (2, 3)}
    return write_lerobot(folder, log, "v3.0", {"axes": list(NAMES)}, tables)


def write_robomimic(folder: Path, log: Log) -> Path:
    with h5py.File(folder / "a.hdf5", "w") as file:
        for number, (states, actions) in enumerate(log):
            demo = file.create_group(f"data/demo_{number + 8}")
            demo["actions"] = actions[:-1]
            demo["dones"] = np.zeros(len(states) - 1)
            for name, columns in (("pose", slice(0, 2)), ("heading", slice(2, 3))):
                demo[f"obs/{name}"], demo[f"next_obs/{name}"] = states[:-1, columns], states[1:, columns]
            demo["obs/camera"] = np.zeros((len(states) - 1, 4, 4, 3), np.uint8)
        file["mask/train"] = np.array([b"demo_8"])
    return folder / "a.hdf5"


def write_robosuite(folder: Path, log: Log) -> Path:
    with h5py.File(folder / "a.hdf5", "w") as file:
        for number, (states, actions) in enumerate(log):
            demo = file.create_group(f"data/demo_{number + 1}")
            demo["states"] = np.column_stack([0.05 * np.arange(len(states)), states])
            demo["actions"], demo["joint_torques"] = actions, np.zeros((len(actions), 7))
    return folder / "a.hdf5"


def write_d3rlpy(folder: Path, log: Log) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file["columns"] = [b"observations", b"actions", b"rewards", b"terminated"]
        file["num_episodes"], file["version"] = len(log), "2.1"
        for number, (states, actions) in enumerate(log):
            file[f"observations_{number}"], file[f"actions_{number}"] = states, actions
            file[f"rewards_{number}"], file[f"terminated_{number}"] = np.zeros((len(states), 1)), False
    return folder / "a.h5"


def write_imitation(folder: Path, log: Log) -> Path:
    np.savez(
        folder / "a.npz",
        obs=np.concatenate([states for states, _ in log]),
        acts=np.concatenate([actions[:-1] for _, actions in log]),
        infos=np.array([{}] * (sum(LENGTHS) - len(LENGTHS)), object),
        indices=np.cumsum(np.array(LENGTHS[:-1]) - 1),
        terminal=np.ones(len(log), bool),
        rews=np.zeros(sum(LENGTHS) - len(LENGTHS)),
    )
    return folder / "a.npz"


def write_ragged(folder: Path, log: Log) -> Path:
    ragged = [np.empty(len(log), object) for _ in range(2)]
    for number, episode in enumerate(log):
        ragged[0][number], ragged[1][number] = episode
    np.savez(folder / "a.npz", observations=ragged[0], actions=ragged[1])
    return folder / "a.npz"


def write_dicts(folder: Path, log: Log) -> Path:
    """hand_dapg's, with what is no array beside them."""
    episodes = [
        {"observations": states, "actions": actions, "init_state_dict": {"qpos": states[0]}, "name": "demo", "tries": 3}
        for states, actions in log
    ]
    (folder / "a.pickle").write_bytes(pickle.dumps(episodes, 3))
    return folder / "a.pickle"


WRITERS: dict[str, Callable[[Path, Log], Path]] = {
    "a CSV an episode": write_csv,
    "a parquet an episode": write_parquet,
    "an npz an episode": write_npz_folder,
    "LeRobot 2.1": write_lerobot_2,
    "LeRobot 3.0": write_lerobot_3,
    "robomimic": write_robomimic,
    "robosuite": write_robosuite,
    "d3rlpy": write_d3rlpy,
    "imitation": write_imitation,
    "ragged npz": write_ragged,
    "a list of dicts": write_dicts,
}
NAMED = {
    "a CSV an episode": (NAMES, ("cmd_v", "cmd_w")),
    "a parquet an episode": (NAMES, ("action_v", "action_w")),
    "LeRobot 2.1": (NAMES, ()),
    "LeRobot 3.0": (NAMES, ()),
    "robomimic": (("obs/heading", "obs/pose.0", "obs/pose.1"), ()),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_every_layout_comes_back(tmp_path, log, kind):
    episodes = load(WRITERS[kind](tmp_path, log), (0, 1))
    assert episodes.lengths.tolist() == list(LENGTHS)
    states, actions = (np.concatenate([episode[i] for episode in log]) for i in (0, 1))
    if kind == "robomimic":  # HDF5 lists names by the alphabet
        states = states[:, [2, 0, 1]]
    np.testing.assert_array_equal(episodes.observations, states)
    followed = np.delete(np.arange(len(states)), np.cumsum(LENGTHS) - 1)
    np.testing.assert_array_equal(episodes.actions[followed], actions[followed])
    assert (episodes.state_names, episodes.action_names) == NAMED.get(kind, ((), ()))
    np.testing.assert_array_equal(episodes.action_low, actions[followed].min(axis=0))
    assert episodes.spaces.state_names == episodes.state_names


def test_hers_demonstrations(tmp_path):
    """Two episodes of three steps and four states, dicts in an object array as Baselines' HER wants them."""
    rng = np.random.default_rng(1)
    state, goal = rng.normal(size=(2, 4, 5)).astype(np.float32), rng.normal(size=(2, 1, 2)).astype(np.float32)
    obs = np.empty((2, 4), object)
    for episode, step in np.ndindex(2, 4):
        obs[episode, step] = {
            "observation": state[episode, step],
            "achieved_goal": state[episode, step, 1:3],
            "desired_goal": goal[episode, 0],
        }
    info = np.array([[{"is_success": 0.0}] * 3] * 2, object)
    actions = rng.uniform(-1, 1, (2, 3, 2)).astype(np.float32)
    np.savez(tmp_path / "demo.npz", acs=actions, obs=obs, info=info)
    episodes = load(tmp_path / "demo.npz")
    assert episodes.goal_indices == (1, 2) and episodes.goal_space_from == "the source"
    np.testing.assert_array_equal(episodes.observations, state.reshape(8, 5))
    np.testing.assert_array_equal(episodes.actions[[0, 1, 2, 4, 5, 6]], actions.reshape(6, 2))
    assert episodes.goals is not None
    np.testing.assert_array_equal(episodes.goals, np.repeat(goal[:, 0], 4, axis=0))
    elsewhere = load(tmp_path / "demo.npz", (0, 3))
    assert elsewhere.goal_indices == (0, 3) and elsewhere.goals is None
    os.link(tmp_path / "demo.npz", tmp_path / "more.npz")
    assert load(tmp_path).lengths.tolist() == [4] * 4  # a folder of such files keeps every episode apart


def test_a_table_whose_column_says_which_episode(tmp_path):
    lines = ["run;t;x;y;u"] + [f"{'ab'[i // 4]};{i % 4};{i};{-i};0.5" for i in range(8)]
    (tmp_path / "all.csv").write_text("\n".join(lines))
    episodes = load(tmp_path / "all.csv", goal=("x", "y"), state=("x", "y"), episode_ends=("run",))
    assert episodes.lengths.tolist() == [4, 4] and episodes.state_names == ("x", "y")


def test_columns_go_by_name_in_the_order_asked_for(tmp_path, log):
    folder = write_lerobot_2(tmp_path, log)
    states = np.concatenate([episode[0] for episode in log])
    episodes = load(folder, goal=("head*",), state=("heading", "observation.state.x"), action=("action",))
    np.testing.assert_array_equal(episodes.observations, states[:, [2, 0]])
    assert episodes.state_names == ("heading", "x") and episodes.goal_indices == (0,)
    assert load(folder, goal="?").goal_indices == (0, 1)  # x and y
    assert load(folder, goal=("y", "x")).goal_indices == (1, 0)
    with pytest.raises(GuiderError, match=r"no state entry is called 'z'.*x, y, heading"):
        load(folder, goal=("z",))
    with pytest.raises(
        GuiderError, match=r"--state speed: no column is called so; there are.*observation.state \(x, y, heading"
    ):
        load(folder, goal="x", state=("speed",))
    with pytest.raises(GuiderError, match=r"name them .--goal x y. .entries: x, y, heading"):
        load(folder)
    with pytest.raises(GuiderError, match="named twice"):
        load(folder, (0,), goal="x")


def test_minari_dicts_of_any_shape(tmp_path):
    import minari
    from gymnasium.spaces import Box, Dict
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    def box(width):
        return Box(-np.inf, np.inf, (width,), np.float32)

    space = Dict(arm=Dict(position=box(2), speed=box(2)), camera=Box(0, 255, (4, 4, 3), np.uint8), gripper=box(1))
    storage = MinariStorage.new(tmp_path / "data", space, Box(-1, 1, (2,), np.float32))
    storage.update_metadata({"dataset_id": "own/arm-v0", "minari_version": minari.__version__})
    rows = np.arange(20, dtype=np.float32).reshape(4, 5)
    seen = {
        "arm": {"position": rows[:, :2], "speed": rows[:, 2:4]},
        "camera": np.zeros((4, 4, 4, 3), np.uint8),
        "gripper": rows[:, 4:],
    }
    flags = np.zeros(3, bool)
    storage.update_episodes(
        [EpisodeBuffer(None, None, None, seen, np.zeros((3, 2), np.float32), np.zeros(3), flags, flags, None)]  # pyright: ignore
    )
    episodes = load(tmp_path, goal=("obs/arm/position*",))
    np.testing.assert_array_equal(episodes.observations, rows)
    assert episodes.state_names[:2] == ("obs/arm/position.0", "obs/arm/position.1") and episodes.goal_indices == (0, 1)


def test_an_action_less_than_states_and_another_array_beside_them(tmp_path, log):
    states, actions = (np.concatenate([episode[i][: None if i == 0 else -1] for episode in log]) for i in (0, 1))
    np.savez(tmp_path / "a.npz", observations=states, obs=states, actions=actions, lengths=LENGTHS)
    episodes = load(tmp_path / "a.npz", (0, 1))
    assert episodes.observations.shape == (18, 3)
    np.testing.assert_array_equal(np.delete(episodes.actions, np.cumsum(LENGTHS) - 1, axis=0), actions)


# What is not read is refused in a line that says what to do


def test_discrete_actions_and_pictures(tmp_path):
    rows = {"observations": np.eye(6), "lengths": [6]}
    np.savez(tmp_path / "discrete.npz", **rows, actions=np.array([0, 1, 2, 0, 1, 2]))
    with pytest.raises(GuiderError, match=r"whole numbers from 0 to 2.*give what each choice commands"):
        load(tmp_path / "discrete.npz", (0,))
    np.savez(tmp_path / "counts.npz", **rows, actions=np.array([0.0, 1, 2, 0, 1, 2]))
    assert load(tmp_path / "counts.npz", (0,)).actions.shape == (6, 1)
    np.savez(tmp_path / "pictures.npz", observations=np.zeros((6, 4, 4, 3)), lengths=[6], actions=np.zeros((6, 1)))
    with pytest.raises(GuiderError, match=r"holds pictures.*--state NAME"):
        load(tmp_path / "pictures.npz", (0,))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.bag", "a ROS 1 recording.*write it as MCAP"),
        ("b.db3", "a ROS 2 recording.*write it as MCAP"),
        ("train.array_record", "ArrayRecord.*as an npz"),
    ],
)
def test_recordings_that_take_another_reader(tmp_path, name, message):
    (tmp_path / name).write_bytes(b"#ROSBAG V2.0" + bytes(50))
    for source in (tmp_path, tmp_path / name):
        with pytest.raises(GuiderError, match=message) as error:
            load(source, (0,))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,cmd\n1,2\n", "line 2 has 2 values for 3 columns"),
        ("1,2,3\n4,5,6\n", "first line holds numbers"),
        ("x,x,cmd\n1,2,3\n", "two columns are called 'x'"),
        ("x,y,cmd\n", "no rows below its first line"),
        ("", "no rows|empty"),
        ("x,y,cmd,episode\n1,,3.5,0\n4,5,6,0\n", "NaN or inf in 1 rows, first in row 0 [(]entries 1[)]; fill them in"),
        ("x,y,speed\n1,2,3\n4,5,6\n", r"which columns are the action\? Say so .--action NAME"),
    ],
)
def test_tables_that_cannot_be_read(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(GuiderError, match=message) as error:
        load(tmp_path / "a.csv", (0, 1), episode_ends=())
    assert str(tmp_path / "a.csv") in str(error.value)


def test_damaged_parquet_and_numbers_that_are_missing(tmp_path, log):
    path = write_parquet(tmp_path, log) / "run_0.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(GuiderError, match=r"run_0\.parquet.*damaged or cut off"):
        load(tmp_path, (0, 1))


def test_a_folder_leads_nowhere_else(tmp_path, log):
    """Neither by a link, nor by the paths that LeRobot's info.json gives (those of `write_lerobot` leave the
    folder)."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_csv(elsewhere, log)
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "run_1.csv").symlink_to(elsewhere / "run_8.csv")
    with pytest.raises(GuiderError, match="symbolic link, which is not followed"):
        load(folder, (0, 1))
    (folder / "run_1.csv").unlink()
    with pytest.raises(GuiderError, match="a directory, but not a Minari dataset's nor LeRobot's"):
        load(folder, (0, 1))


def test_a_folder_of_two_kinds_or_two_widths(tmp_path, log):
    write_csv(tmp_path, log)
    np.savez(tmp_path / "a.npz", observations=np.zeros((3, 3)))
    with pytest.raises(GuiderError, match="files of several kinds"):
        load(tmp_path, (0, 1))
    (tmp_path / "a.npz").unlink()
    np.savetxt(tmp_path / "run_8.csv", np.zeros((3, 2)), delimiter=",", header="x,cmd_v", comments="")
    with pytest.warns(GuiderWarning, match=r"as not every episode has it: cmd_w \(not in .*run_8.csv\), goal_x"):
        assert load(tmp_path, (0,)).state_names == ("x",)


REAL = Path(__file__).parents[3] / "shared" / "realdata"


@pytest.mark.skipif(not REAL.is_dir(), reason="the real logs are not here")
@pytest.mark.parametrize(
    ("name", "shape", "episodes"),
    [
        ("lerobot_v21_unitree_g1", (35_965, 26), 100),
        ("surrol_needle_pick", (20_000, 19), 100),
        ("robosuite_teleop/lift-panda-demo.hdf5", (412, 31), 1),
        ("hand_dapg/door-v0_demos.pickle", (6729, 39), 25),
        ("imitation_npz/pendulum_final.npz", (11_256, 3), 56),
        ("rlds_bridge_octo", (250, 7), 25),
    ],
)
def test_logs_that_nobody_here_wrote(name, shape, episodes):
    found = load(REAL / name, assumed_goal=(0, 1))
    assert found.observations.shape == shape and len(found.lengths) == episodes
