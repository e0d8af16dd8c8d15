"""What is written comes back equal, and only ever whole."""

from __future__ import annotations

import json
import resource
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import minari
import numpy as np
import pytest
from recordings import GOAL, walk

from guider.cli import main
from guider.data import load, write
from guider.data.episodes import Episodes, make_episodes
from guider.data.store import Recording
from guider.data.write import check_destination, write_d4rl, write_minari, write_ogbench
from guider.errors import GuiderError

LENGTHS = (7, 2, 1, 30, 12)

minari_facts = partial(
    write_minari, dataset_id="test/walk-v0", recipe="a random walk", description="walks in the plane", seed=5
)


def recorded(goals: bool = True, bound: float | None = 1.0) -> Recording:
    arrays = walk(list(LENGTHS))
    bounds = (None, None) if bound is None else (np.full(2, -bound), np.full(2, bound))
    rows = sum(LENGTHS)
    goal = np.random.default_rng(1).normal(size=(rows, 2)).astype(np.float32) if goals else None
    return Recording(arrays["observations"], arrays["actions"], np.array(LENGTHS), goal, *bounds)


def as_episodes(recording: Recording) -> Episodes:
    return make_episodes(
        recording.observations,
        recording.actions,
        recording.lengths,
        GOAL,
        goals=recording.goals,
        action_low=recording.action_low,
        action_high=recording.action_high,
    )


@pytest.mark.parametrize("goals", [True, False])
@pytest.mark.parametrize("bound", [None, 1.0, 2.0])
def test_minari_comes_back_equal(tmp_path, goals, bound):
    recording = recorded(goals, bound)
    minari_facts(tmp_path / "new" / "walk", recording, GOAL, 0.5)
    assert load(tmp_path / "new" / "walk", GOAL).fingerprint() == as_episodes(recording).fingerprint()


NAMES = ["a b[1]", "-x", "%41\\n", "ü" * 120, "~", "set "]
"""Such as the file system takes; the fourth has 240 bytes of the 255 there may be."""


@pytest.mark.parametrize("name", NAMES)
def test_any_name_will_do_and_any_folder_to_start_from(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    out = Path("new") / name
    assert check_destination(out, 1000) == "minari" and check_destination(Path(f"{out}.H5"), 1000) == "d4rl"
    minari_facts(out, recorded(), GOAL, 0.5)
    write_d4rl(Path(f"{out}.H5"), recorded(), GOAL, 0.5)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted([name, f"{name}.H5"])
    for written in (out, Path(f"{out}.H5")):
        assert load(written.absolute(), GOAL).fingerprint() == as_episodes(recorded()).fingerprint()


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("x.csv", r"x.csv: recordings are not written as .csv; end the name in .hdf5 or .h5 .* or in nothing"),
        ("x.PKL", "not written as .pkl"),
        ("file", "exists already and is never overwritten"),
        ("link", "exists already and is never overwritten"),
        ("file/x.h5", "file/x.h5 cannot be written: "),
        ("x" * 256, "cannot be written: File name too long"),
        ("/proc/x", "/proc/x cannot be written: No such file"),
    ],
)
def test_where_nothing_can_be_written_is_known_before_anything_is(tmp_path, monkeypatch, out, message):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    Path("link").symlink_to("nowhere")
    with pytest.raises(GuiderError, match=message):
        check_destination(Path(out), 1000)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


def test_a_full_disk_is_one_line_before_and_after_recording(tmp_path):
    with pytest.raises(GuiderError, match=r"x.hdf5 cannot be written: (No space left|File too large)"):
        check_destination(tmp_path / "x.hdf5", 2**60)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        for writer, name in ((write_d4rl, "x.hdf5"), (minari_facts, "x")):
            with pytest.raises(GuiderError, match=f"{name} cannot be written: File too large"):
                writer(tmp_path / name, recorded(), GOAL, 0.5)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("goals", [True, False])
@pytest.mark.parametrize("lengths", [(2,) * 40, (1500, 1500)])
def test_minari_takes_no_more_room_than_asked_for(tmp_path, monkeypatch, goals, lengths):
    asked = []
    monkeypatch.setattr(write, "_check_room", lambda path, size: asked.append(size))
    goal = np.zeros((sum(lengths), 2), np.float32) if goals else None
    arrays = walk(list(lengths))
    minari_facts(
        tmp_path / "x", Recording(arrays["observations"], arrays["actions"], np.array(lengths), goal), GOAL, 0.5
    )
    taken = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert taken <= asked[0] <= 2.5 * taken


@pytest.mark.parametrize("goals", [True, False])
def test_d4rl_comes_back_equal(tmp_path, goals):
    recording = recorded(goals)
    write_d4rl(tmp_path / "new" / "walk.hdf5", recording, GOAL, 0.5)
    assert load(tmp_path / "new" / "walk.hdf5", GOAL).fingerprint() == as_episodes(recording).fingerprint()


@pytest.mark.parametrize("goals", [True, False])
def test_ogbench_comes_back_equal(tmp_path, goals):
    recording = recorded(goals)
    write_ogbench(tmp_path / "new" / "walk.npz", recording)
    assert load(tmp_path / "new" / "walk.npz", GOAL).fingerprint() == as_episodes(recording).fingerprint()


def on_a_line() -> Recording:
    """Two episodes on a line, with the goal at 10: one arrives, stays and leaves; the other starts there and stays."""
    x = np.array([8, 9.6, 10, 11, 10, 10.4], np.float32)[:, None]
    return Recording(
        observations=np.hstack([x, np.zeros_like(x)]),
        actions=np.arange(6, dtype=np.float32)[:, None],
        lengths=np.array([4, 2]),
        goals=np.full((6, 1), 10, np.float32),
        action_low=np.zeros(1),
        action_high=np.full(1, 9.0),
    )


def test_d4rl_rewards_and_flags_by_hand(tmp_path):
    write_d4rl(tmp_path / "line.hdf5", on_a_line(), (0,), radius=0.5)
    with h5py.File(tmp_path / "line.hdf5") as file:
        written = {key: np.asarray(file[key]).tolist() for key in ("rewards", "terminals", "timeouts")}
    assert written["rewards"] == [1, 1, 0, 0, 1, 0]
    assert written["timeouts"] == [False, False, False, True, False, True]
    assert not any(written["terminals"])


def test_minari_episodes_by_hand(tmp_path):
    minari_facts(tmp_path / "line", on_a_line(), (0,), radius=0.5)
    dataset = minari.MinariDataset(tmp_path / "line" / "data")
    first, second = dataset.iterate_episodes()
    assert first.rewards.tolist() == [1, 1, 0] and second.rewards.tolist() == [1]
    assert first.actions[:, 0].tolist() == [0, 1, 2] and second.actions[:, 0].tolist() == [4]
    assert first.truncations.tolist() == [False, False, True] and second.truncations.tolist() == [True]
    assert not first.terminations.any() and not second.terminations.any()
    assert {key: array.shape for key, array in first.observations.items()} == {
        "observation": (4, 2),
        "achieved_goal": (4, 1),
        "desired_goal": (4, 1),
    }
    assert first.observations["achieved_goal"][:, 0].tolist() == [8, np.float32(9.6), 10, 11]
    assert dataset.observation_space.contains({key: array[0] for key, array in first.observations.items()})
    assert (dataset.action_space.low.tolist(), dataset.action_space.high.tolist()) == ([0], [9])
    assert (dataset.total_episodes, dataset.total_steps) == (2, 4)


def test_a_goal_in_parts_is_met_when_every_part_is(tmp_path):
    rows = np.array([[9, 9], [0.4, 0.4], [0, 9]], np.float32)
    recording = Recording(rows, np.zeros((3, 1), np.float32), np.array([3]), np.zeros((3, 2), np.float32))
    for parts, rewards in (((), [0, 0]), (((0,), (1,)), [1, 0])):
        directory = tmp_path / str(len(parts))
        minari_facts(directory, recording, GOAL, radius=0.5, goal_parts=parts)
        (episode,) = minari.MinariDataset(directory / "data").iterate_episodes()
        assert episode.rewards.tolist() == rewards


def test_metadata_and_minari_finding_it_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    recording = recorded()
    minari_facts(tmp_path / "test" / "walk-v0", recording, GOAL, 0.5)
    dataset = minari.load_dataset("test/walk-v0")
    assert dataset.spec.dataset_id == "test/walk-v0"
    metadata = dataset.storage.metadata
    assert metadata["algorithm_name"] == "a random walk" and metadata["description"] == "walks in the plane"
    assert metadata["seed"] == 5 and "author" not in metadata
    assert load("minari:test/walk-v0", GOAL).fingerprint() == as_episodes(recording).fingerprint()


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_equal_recordings_give_equal_files(tmp_path):
    for name in ("first", "second"):
        minari_facts(tmp_path / name, recorded(), GOAL, 0.5)
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_minari_reports_its_episodes(tmp_path):
    progress = []
    minari_facts(tmp_path / "walk", recorded(), GOAL, 0.5, report=lambda done, total: progress.append((done, total)))
    assert progress == [(done, len(LENGTHS)) for done in range(1, len(LENGTHS) + 1)]


def test_what_fails_half_way_leaves_nothing(tmp_path):
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minari_facts(tmp_path / "walk", recorded(), GOAL, 0.5, report=stop)
    broken = replace(recorded(), actions=np.array([{}] * sum(LENGTHS)))
    with pytest.raises(TypeError):
        write_d4rl(tmp_path / "walk.hdf5", broken, GOAL, 0.5)
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / "notes.txt").write_text("mine")
    with pytest.raises(GuiderError, match="walk cannot be written: Directory not empty"):
        minari_facts(tmp_path / "walk", recorded(), GOAL, 0.5)
    assert contents(tmp_path) == {"notes.txt": b"mine"}


def test_collect_writes_what_the_name_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file, directory = Path("umaze.h5"), Path("umaze")
    for out in (file, directory):
        assert main(["collect", "pointmaze-umaze", "--steps", "500", "--seed", "3", "--out", str(out), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["data"] == str(out)
    assert load(file, GOAL).fingerprint() == load(directory, GOAL).fingerprint()
    metadata = json.loads((directory / "data" / "metadata.json").read_text())
    assert metadata["dataset_id"] == "guider/pointmaze-umaze-v0" and metadata["seed"] == 3
    assert "guider collect pointmaze-umaze --steps 500 --seed 3" in metadata["description"]
    assert main(["collect", "pointmaze-umaze", "--steps", "500", "--out", str(directory)]) == 1
    assert "never overwritten" in capsys.readouterr().err
    assert main(["collect", "pointmaze-umaze", "--out", "umaze.csv"]) == 1
    assert capsys.readouterr().err.startswith("guider: umaze.csv: recordings are not written as .csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["umaze", "umaze.h5"]
