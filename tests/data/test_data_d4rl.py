"""D4RL's antmaze and kitchen files, as they are found in the wild, against the Episodes they must become."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import GOAL, antmaze, ends, walk, write_hdf5, write_npz

from guider.data import load
from guider.data.readers.kitchen import kitchen_states
from guider.errors import GuiderError, GuiderWarning


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
    with pytest.warns(GuiderWarning, match=r"4 rows marked by terminals are followed by an ordinary step: no ends"):
        episodes = load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL)
    assert episodes.lengths.tolist() == [200, 300]


def test_antmaze_jumps_split_where_timeouts_are_a_row_early(tmp_path):
    arrays = antmaze([1001] * 4)
    arrays["timeouts"] = np.roll(arrays["timeouts"], -1)
    with pytest.warns(
        GuiderWarning, match="jumps after 3 rows that nothing marks .flags are set a row early.: taken as ends too"
    ):
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
    with pytest.warns(GuiderWarning, match="jumps after 3 rows that nothing marks: taken as ends for want of others"):
        assert load(write_hdf5(tmp_path / "a.hdf5", arrays), GOAL).lengths.tolist() == [1001] * 4


def test_antmaze_saved_as_npz(tmp_path):
    arrays = antmaze([30, 40])
    assert load(write_npz(tmp_path / "a.npz", arrays), GOAL).lengths.tolist() == [30, 40]


def test_goals_of_another_goal_space_are_left_out(tmp_path):
    path = write_hdf5(tmp_path / "a.hdf5", antmaze([30, 40]))
    assert load(path, GOAL).goals is not None
    assert load(path, (0, 1, 2)).goals is None
    arrays = antmaze([6000, 6000])
    arrays["observations"][:, 2:4] /= 100
    arrays["infos/goal"] += 5
    path = write_hdf5(tmp_path / "b.hdf5", arrays)
    with pytest.warns(GuiderWarning, match="infos/goal lies elsewhere than where the goal entries go: left out"):
        assert load(path, (2, 3)).goals is None


# Kitchen


def test_kitchen_terminals_end_episodes_and_the_goal_half_is_the_goal(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "observations": np.hstack([rng.normal(size=(90, 30)), np.repeat(rng.normal(size=(3, 30)), 30, axis=0)]).astype(
            "f4"
        ),
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
    assert load(path, indices, format="arrays", episode_ends=["timeouts"]).observations.shape == (90, 60)
    with pytest.raises(GuiderError, match=r"must lie in 0\.\.29"):
        load(path, (30,))


def test_kitchen_of_gymnasium_robotics_becomes_the_same_states(tmp_path):
    """59 numbers, which are robot and object positions with the velocities of each behind them."""
    arrays = walk([30, 30], state_dim=59, action_dim=9) | {"terminals": ends([30, 30])}
    arrays["observations"][:] = np.arange(59.0)
    arrays["observations"][10:30, 20] += 0.7  # a switch that snaps over
    path = write_hdf5(tmp_path / "k.hdf5", arrays)
    assert load(path, range(9, 30)).observations.shape == (60, 59), "any robot may have 59 state entries"
    episodes = load(path, range(9, 30), format="d4rl-kitchen")
    assert episodes.lengths.tolist() == [30, 30]
    assert episodes.goals is None
    np.testing.assert_array_equal(episodes.observations[0], [*range(9), *range(18, 39)])
    np.testing.assert_array_equal(episodes.achieved[10, :3], [18, 19, np.float32(20.7)])


def test_one_kitchen_state_in_all_three_widths():
    """The way back, too: from a state and velocities or a goal to the rows they are recorded in."""
    states, velocities, goals = np.random.default_rng(0).normal(size=(3, 5, 30))
    robot, objects = states[:, :9], states[:, 9:]
    gymnasium_rows = np.concatenate([robot, velocities[:, :9], objects, velocities[:, 9:29]], axis=1)
    d4rl_rows = np.concatenate([robot, objects, goals], axis=1)
    assert (gymnasium_rows.shape[1], d4rl_rows.shape[1]) == (59, 60)
    for rows in gymnasium_rows, d4rl_rows, states:
        np.testing.assert_array_equal(kitchen_states(rows), states)


def test_kitchen_states_alone_are_told_by_their_width(tmp_path):
    arrays = walk([30, 30], state_dim=30, action_dim=9) | {"terminals": np.zeros(60, bool), "timeouts": ends([30, 30])}
    arrays["observations"][:, 17] = np.arange(60) % 30 >= 10  # a switch that snaps over
    arrays["infos/goal"] = np.ones((60, 21), np.float32)
    episodes = load(write_hdf5(tmp_path / "k.hdf5", arrays), range(9, 30))
    assert episodes.lengths.tolist() == [30, 30]
    np.testing.assert_array_equal(episodes.goals, 1.0)


def test_kitchen_format_can_be_asked_for(tmp_path):
    arrays = antmaze([20, 30])
    arrays["terminals"][10] = True
    path = write_hdf5(tmp_path / "a.hdf5", arrays)
    assert load(path, GOAL, format="d4rl-kitchen").lengths.tolist() == [11, 9, 30]
