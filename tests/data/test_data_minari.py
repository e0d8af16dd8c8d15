"""Minari datasets, written by Minari's own API, against the Episodes they must become."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from recordings import GOAL, walk

from guider.data import load
from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError


@pytest.fixture
def minari_root(tmp_path, monkeypatch) -> Path:
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
    with pytest.raises(GuiderError, match="cannot be read as wgcsl"):
        load("minari:test/walk-v0", GOAL, format="wgcsl")


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
    with pytest.raises(GuiderError, match=r"no such Minari dataset .* guider data fetch minari:nobody/nothing-v0"):
        load("minari:nobody/nothing-v0", GOAL)
    write_minari("test/image-v0", [np.zeros((6, 3, 3))], [np.zeros((5, 2), np.float32)])
    with pytest.raises(GuiderError, match="vectors of numbers"):
        load("minari:test/image-v0", GOAL)
    write_minari("test/short-v0", [np.zeros((5, 3))], [np.zeros((5, 2), np.float32)])
    with pytest.raises(GuiderError, match="5 rows of observation and 5 actions"):
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


@pytest.mark.filterwarnings("ignore")
def test_the_kitchen_becomes_states_of_30(minari_root):
    rows = np.arange(59.0) + np.arange(5.0)[:, None] / 8
    write_minari("test/kitchen-v0", [rows], [np.zeros((4, 9))])
    episodes = load("minari:test/kitchen-v0", tuple(range(9, 30)))
    np.testing.assert_array_equal(episodes.observations, np.concatenate([rows[:, :9], rows[:, 18:39]], axis=1))
