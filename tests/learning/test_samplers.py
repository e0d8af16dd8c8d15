"""Samplers by their bounds and distributions, on ragged episodes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import labelled, make_ragged, shares
from hypothesis import given, settings
from hypothesis import strategies as st

from guider.data.episodes import make_episodes
from guider.learning.samplers import sample_critic, sample_flat, sample_high, sample_low, sample_windows
from guider.learning.windows import Data, device_data, moves, window_starts


def test_window_starts_by_hand():
    episodes = labelled([3, 6])
    assert window_starts(episodes, 3, "drop").tolist() == [3, 4, 5]
    assert window_starts(episodes, 3, "clip").tolist() == [0, 1, 3, 4, 5, 6, 7]


@pytest.mark.parametrize("minimum_move", [1.0, 2.0])
def test_minimum_move_leaves_out_idle_windows(minimum_move):
    position = np.array([0.0, 0.0, 0.0, 2.0, 2.0, 2.0])[:, None]
    episodes = make_episodes(position, np.zeros((6, 1)), [6], (0,))
    assert window_starts(episodes, 2, "drop", minimum_move).tolist() == [1, 2]


def test_idle_windows_alone_are_left_out():
    """All transitions are learned from; of windows, those within `drop` that move as far as asked."""
    episodes = make_episodes(np.array([[0.0], [0], [1], [3], [3], [3]]), np.zeros((6, 1)), [6], (0,))
    data = device_data(episodes, 2, "drop", 0.0, "period", 2.0)
    assert data.transition_rows.tolist() == [0, 1, 2, 3, 4] and data.window_rows.tolist() == [1, 2]
    assert device_data(episodes, 2, "drop", 0.0).window_rows.tolist() == [0, 1, 2, 3]
    assert device_data(episodes, 2, "drop", 3.0, "period", 2.0).window_rows.tolist() == [1]


def test_minimum_move_leaves_out_idle_episodes():
    """Three episodes: one that goes 2 away and comes back, one that stays, one that drifts by 0.9."""
    position = np.array([0.0, 2.0, 0.0, 5.0, 5.0, 5.0, 7.0, 7.4, 7.9])[:, None]
    episodes = make_episodes(position, np.zeros((9, 1)), [3, 3, 3], (0,))
    assert window_starts(episodes, 1, "drop", 1.0, "episode").tolist() == [0, 1]
    assert window_starts(episodes, 1, "drop", 2.0, "episode").tolist() == [0, 1]
    assert window_starts(episodes, 1, "drop", 0.9, "episode").tolist() == [0, 1, 6, 7]


def test_moves_by_hand():
    episodes = make_episodes(np.array([[0.0], [1], [3], [6], [0], [5]]), np.zeros((6, 1)), [4, 2], (0,))
    assert moves(episodes, 2).tolist() == [3, 5]
    assert moves(episodes, 1).tolist() == [1, 2, 3, 5]


def test_actions_are_learned_from_every_row_with_a_successor():
    data = device_data(labelled([3, 6]), 3, "drop", 0.0)
    assert data.window_rows.tolist() == [3, 4, 5]
    assert data.transition_rows.tolist() == [0, 1, 3, 4, 5, 6, 7]


@settings(max_examples=20, deadline=None)
@given(
    lengths=st.lists(st.integers(2, 40), min_size=1, max_size=6),
    period=st.integers(1, 12),
    boundary=st.sampled_from(["clip", "drop"]),
    seed=st.integers(0, 2**31 - 1),
)
def test_no_sample_crosses_an_episode(lengths, period, boundary, seed):
    episodes = labelled([*lengths, 60])
    last = np.asarray([*lengths, 60]) - 1
    data = device_data(episodes, period, boundary, 0.0)
    key = jax.random.key(seed)

    windows = sample_windows(data, key, 256, period)
    episode = np.asarray(windows.achieved[:, 0], int)
    start, later = np.asarray(windows.achieved[:, 1]), np.asarray(windows.later[:, 1])
    assert np.array_equal(windows.later[:, 0], episode)
    assert np.array_equal(later, np.minimum(start + period, last[episode]))
    if boundary == "drop":
        assert np.all(later == start + period)

    for offset in (0, 1):
        high = sample_high(data, key, 256, period, offset, 1.0, 0.0)
        episode = np.asarray(high.achieved[:, 0], int)
        goal = np.asarray(high.goal[:, 1])
        start, later = np.asarray(high.achieved[:, 1]), np.asarray(high.later[:, 1])
        assert np.array_equal(high.goal[:, 0], episode) and np.array_equal(high.later[:, 0], episode)
        assert np.array_equal(later, np.minimum(start + period, last[episode]))
        assert np.all(goal >= np.minimum(later + offset, last[episode]))
        assert np.all(goal <= last[episode])

    low = sample_low(data, key, 256, period, 1, "uniform", "uniform", 1.0, 0.0)
    episode = np.asarray(low.achieved[:, 0], int)
    now, subgoal, goal = (np.asarray(x[:, 1]) for x in (low.achieved, low.subgoal, low.goal))
    assert np.array_equal(low.subgoal[:, 0], episode) and np.array_equal(low.goal[:, 0], episode)
    assert np.array_equal(low.next_achieved, np.stack([episode, now + 1], axis=1))
    assert np.array_equal(low.observation, low.achieved) and np.array_equal(low.next_observation, low.next_achieved)
    rows = np.cumsum([0, *lengths])[episode] + now.astype(int)
    assert np.array_equal(low.action, np.asarray(data.actions)[rows])
    assert np.all((now < subgoal) & (subgoal <= np.minimum(now + period, last[episode])))
    assert np.array_equal(low.subgoal_steps, subgoal - now)
    assert np.all((subgoal <= goal) & (goal <= last[episode]))


def test_subgoals_that_are_kept_were_chosen_up_to_a_period_ago_in_the_same_episode():
    """As acting has it: the age of a subgoal is uniform, and what it names lies within the period of where it was
    chosen."""
    data = device_data(labelled([12, 9]), 4, "clip", 0.0)
    low = sample_low(data, jax.random.key(1), 200_000, 4, 4, "uniform", "uniform", 1.0, 0.0)
    now, chosen, subgoal = (np.asarray(x[:, 1], int) for x in (low.achieved, low.chosen_at, low.subgoal))
    assert np.array_equal(low.chosen_at[:, 0], low.achieved[:, 0])
    assert np.array_equal(low.subgoal_steps, subgoal - now)
    ages = now - chosen
    np.testing.assert_allclose(shares(ages[now >= 3], 4), 1 / 4, atol=0.01)
    np.testing.assert_allclose(shares(ages[now == 1], 4), [1 / 2, 1 / 2, 0, 0], atol=0.02)
    last = np.where(np.asarray(low.achieved[:, 0]) == 0, 11, 8)
    assert np.all((now < subgoal) & (subgoal <= np.minimum(chosen + 4, last)))
    at_five = (now == 5) & (chosen == 4)
    np.testing.assert_allclose(shares(subgoal[at_five], 9)[6:], 1 / 3, atol=0.03)


def test_windows_are_uniform_over_rows():
    data = device_data(labelled([4, 11]), 3, "drop", 0.0)
    windows = sample_windows(data, jax.random.key(0), 90_000, 3)
    rows = np.asarray(windows.achieved[:, 0] * 4 + windows.achieved[:, 1], int)
    assert set(rows) == {0, 4, 5, 6, 7, 8, 9, 10, 11}
    np.testing.assert_allclose(shares(rows, 12)[shares(rows, 12) > 0], 1 / 9, atol=0.006)


def test_future_goals_are_uniform_and_subgoals_too():
    data = device_data(labelled([12]), 4, "clip", 0.0)
    low = sample_low(data, jax.random.key(1), 200_000, 4, 1, "uniform", "uniform", 1.0, 0.0)
    at_two = np.asarray(low.achieved[:, 1]) == 2
    subgoals = np.asarray(low.subgoal[:, 1])[at_two]
    np.testing.assert_allclose(shares(subgoals, 7)[3:7], 1 / 4, atol=0.015)
    at_six = at_two & (np.asarray(low.subgoal[:, 1]) == 6)
    goals = np.asarray(low.goal[:, 1])[at_six]
    np.testing.assert_allclose(shares(goals, 12)[6:], 1 / 6, atol=0.03)


def test_subgoals_can_lie_a_period_ahead_of_where_they_were_chosen_or_at_the_episodes_end():
    data = device_data(labelled([12, 7]), 4, "clip", 0.0)
    low = sample_low(data, jax.random.key(1), 10_000, 4, 1, "last", "uniform", 1.0, 0.0)
    now, subgoal = (np.asarray(x[:, 1], int) for x in (low.achieved, low.subgoal))
    last = np.where(np.asarray(low.achieved[:, 0]) == 0, 11, 6)
    assert np.array_equal(subgoal, np.minimum(now + 4, last)) and np.array_equal(low.subgoal_steps, subgoal - now)
    assert np.array_equal(low.subgoal[:, 0], low.achieved[:, 0]) and np.all(low.goal[:, 1] >= low.subgoal[:, 1])


def test_final_goals_can_be_where_episodes_end():
    data = device_data(labelled([12, 7]), 4, "clip", 0.0)
    low = sample_low(data, jax.random.key(1), 100_000, 4, 1, "uniform", "last", 1.0, 0.0)
    episode = np.asarray(low.achieved[:, 0], int)
    assert np.array_equal(low.goal, np.stack([episode, np.array([11, 6])[episode]], axis=1))
    at_two = np.asarray(low.achieved[:, 1]) == 2
    np.testing.assert_allclose(shares(np.asarray(low.subgoal[:, 1])[at_two], 7)[3:7], 1 / 4, atol=0.015)


@pytest.mark.parametrize(("relabel", "anywhere"), [(0.8, 0.0), (0.5, 0.3), (1.0, 0.0)])
def test_goal_kinds_come_in_their_shares(relabel, anywhere):
    lengths = [10] * 50
    data = device_data(labelled(lengths, recorded=True), 3, "clip", 0.0)
    high = sample_high(data, jax.random.key(2), 100_000, 3, 0, relabel, anywhere)
    recorded = np.asarray(high.goal[:, 0]) == -7
    own = np.asarray(high.goal[:, 0] == high.achieved[:, 0])
    assert recorded.mean() == pytest.approx(1 - relabel - anywhere, abs=0.006)
    assert own.mean() == pytest.approx(relabel + anywhere / 50, abs=0.006)


def test_goals_from_anywhere_are_uniform_over_all_rows():
    data = device_data(labelled([4, 16]), 3, "clip", 0.0)
    flat = sample_flat(data, jax.random.key(6), 100_000, "uniform", 1.0, 0.6, 0.4)
    anywhere = np.asarray(flat.goal)[np.asarray(flat.steps) == -1]
    assert len(anywhere) / 100_000 == pytest.approx(0.4, abs=0.006)
    rows = (anywhere[:, 0] * 4 + anywhere[:, 1]).astype(int)
    np.testing.assert_allclose(shares(rows, 20), 1 / 20, atol=0.005)


def test_geometric_goals_end_with_the_episode():
    data = device_data(labelled([5, 7]), 3, "clip", 0.0)
    flat = sample_flat(data, jax.random.key(7), 10_000, "geometric", 4.0, 1.0, 0.0)
    assert np.array_equal(flat.goal[:, 0], flat.achieved[:, 0])
    assert np.array_equal(flat.goal[:, 1] - flat.achieved[:, 1], flat.steps) and int(flat.steps.min()) == 1
    first = np.asarray(flat.steps)[np.asarray(flat.achieved[:, 0] + flat.achieved[:, 1]) == 0]
    np.testing.assert_allclose(shares(first, 5), [0, 1 / 4, 3 / 16, 9 / 64, 27 / 64], atol=0.05)


def test_data_without_recorded_goals_is_relabelled_wholly():
    data = device_data(labelled([10, 20]), 3, "clip", 0.0)
    high = sample_high(data, jax.random.key(3), 10_000, 3, 0, 0.4, 0.0)
    assert np.array_equal(high.goal[:, 0], high.achieved[:, 0])


def test_recorded_goals_are_those_of_the_row():
    episodes = make_ragged()
    goals = np.arange(len(episodes.observations) * 2.0).reshape(-1, 2)
    episodes = make_episodes(episodes.observations, episodes.actions, episodes.lengths, (2, 3), goals=goals)
    data = device_data(episodes, 1, "clip", 0.0)
    high = sample_high(data, jax.random.key(4), 500, 1, 0, 0.0, 0.0)
    row = episodes.starts[np.asarray(high.later[:, 1], int)] + np.asarray(high.later[:, 0], int)
    assert np.array_equal(high.goal, goals[row].astype(np.float32))


def test_device_data_scales_actions_to_unit_bounds():
    actions = np.array([[0.0], [4.0], [2.0]])
    episodes = make_episodes(np.zeros((3, 1)), actions, [3], (0,), action_low=0.0, action_high=4.0)
    data = device_data(episodes, 1, "clip", 0.0)
    assert isinstance(data, Data)
    np.testing.assert_allclose(data.actions[:2, 0], [-1.0, 1.0])


def test_the_device_shares_the_memory_of_the_episodes(ragged):
    data = device_data(ragged, 5, "clip", 0.0)
    if jax.default_backend() == "cpu":
        assert data.observations.unsafe_buffer_pointer() == ragged.observations.ctypes.data
    assert not ragged.observations.flags.writeable


def test_equal_keys_give_equal_batches(ragged):
    data = device_data(ragged, 5, "clip", 0.0)
    first = sample_low(data, jax.random.key(5), 64, 5, 1, "uniform", "uniform", 0.8, 0.1)
    second = jax.jit(lambda d, k: sample_low(d, k, 64, 5, 1, "uniform", "uniform", 0.8, 0.1))(data, jax.random.key(5))
    assert all(jnp.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_a_critic_and_its_policy_have_goals_of_their_own():
    """The critic's: a fifth stays, three tenths from anywhere, the rest two steps ahead in the mean; the policy's: any
    of the future, or a quarter from anywhere."""
    data = device_data(labelled([400] * 400), 5, "clip", 0.0)  # goals from anywhere hardly ever lie in the same episode
    batch = sample_critic(data, jax.random.key(2), 100_000, 2.0, 0.2, 0.3, 0.25)
    start = np.asarray(batch.observation)
    np.testing.assert_array_equal(batch.next_observation, start + np.array([0, 1]))
    np.testing.assert_array_equal(batch.achieved, start)
    steps, aims = (
        np.where(goal[:, 0] == start[:, 0], goal[:, 1] - start[:, 1], -1)
        for goal in (np.asarray(batch.goal), np.asarray(batch.actor_goal))
    )
    assert (steps == 0).mean() == pytest.approx(0.2, abs=0.006)
    assert (steps < 0).mean() == pytest.approx(0.3, abs=0.006)
    np.testing.assert_allclose(shares(steps[steps > 0], 4)[1:4], [1 / 2, 1 / 4, 1 / 8], atol=0.008)
    assert (aims < 0).mean() == pytest.approx(0.25, abs=0.006) and not (aims == 0).any()
    ahead = aims[aims > 0] / (399 - start[aims > 0, 1])  # uniform over what is left of the episode
    np.testing.assert_allclose(np.quantile(ahead, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.02)
    assert abs(np.corrcoef(steps == 0, aims < 0)[0, 1]) < 0.02
