"""The container: what it refuses, and that taking parts of it loses nothing."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError


def arrays(lengths: list[int], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = sum(lengths)
    return (
        rng.normal(size=(rows, 4)).astype(np.float32),
        rng.uniform(-1, 1, (rows, 2)).astype(np.float32),
    )


def ragged(lengths: list[int], **options) -> Episodes:
    observations, actions = arrays(lengths)
    return make_episodes(observations, actions, lengths, (0, 1), **options)


def test_lays_episodes_end_to_end():
    episodes = ragged([3, 2, 4])
    assert episodes.starts.tolist() == [0, 3, 5]
    assert episodes.lengths.tolist() == [3, 2, 4]
    assert episodes.last_rows.tolist() == [2, 2, 2, 4, 4, 8, 8, 8, 8]
    assert episodes.last_rows.dtype == np.int32
    np.testing.assert_array_equal(episodes.achieved, episodes.observations[:, :2])


def test_converts_to_float32():
    observations, actions = arrays([3, 3])
    episodes = make_episodes(observations.astype(np.float64), actions.astype(np.float64), [3, 3], (0,))
    assert episodes.observations.dtype == episodes.actions.dtype == np.float32


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("name", ["observations", "actions", "goals"])
def test_refuses_values_that_are_not_finite(name, value):
    observations, actions = arrays([3, 3])
    data = {"observations": observations, "actions": actions, "goals": np.zeros((6, 2))}
    data[name] = data[name].astype(np.float64)
    data[name][4, 1] = value
    with pytest.raises(GuiderError, match=f"{name} hold NaN or inf in 1 rows, first in row 4"):
        make_episodes(data["observations"], data["actions"], [3, 3], (0, 1), goals=data["goals"])


def test_the_last_action_of_an_episode_may_be_anything():
    observations, actions = arrays([3, 1, 4])
    untouched = actions.copy()
    other = actions.copy()
    other[[2, 3, 7]] = [[np.nan, 0], [np.inf, 1], [99, -99]]
    first = make_episodes(observations, actions, [3, 1, 4], (0,))
    second = make_episodes(observations, other, [3, 1, 4], (0,))
    assert first.fingerprint() == second.fingerprint()
    assert second.action_high.tolist() == [1, 1]
    np.testing.assert_array_equal(actions, untouched)  # the caller's array stays as it was


@pytest.mark.parametrize(
    ("observations", "actions"),
    [
        (np.zeros(6), np.zeros((6, 2))),
        (np.zeros((6, 4)), np.zeros((6, 2, 1))),
        (np.zeros((6, 0)), np.zeros((6, 2))),
        (np.zeros((0, 4)), np.zeros((0, 2))),
        (np.zeros((6, 4)), np.zeros((6, 2), object)),
        (np.zeros((6, 4), complex), np.zeros((6, 2))),
        (np.zeros((6, 4), "U3"), np.zeros((6, 2))),
    ],
)
def test_refuses_arrays_that_are_not_matrices_of_numbers(observations, actions):
    with pytest.raises(GuiderError, match="must be a non-empty 2-D array of numbers"):
        make_episodes(observations, actions, [6], (0,))


def test_refuses_rows_that_disagree():
    observations, actions = arrays([3, 3])
    with pytest.raises(GuiderError, match="observations have 6 rows but actions 5"):
        make_episodes(observations, actions[:5], [3, 3], (0,))
    with pytest.raises(GuiderError, match="one goal per row"):
        make_episodes(observations, actions, [3, 3], (0,), goals=np.zeros((6, 2)))


@pytest.mark.parametrize("lengths", [[3, 2], [3, 4], [7, -1], [6, 0], [[3, 3]], [3.0, 3.0], [], [2**62] * 4])
def test_refuses_lengths_that_disagree(lengths):
    observations, actions = arrays([3, 3])
    with pytest.raises(GuiderError, match="episode lengths"):
        make_episodes(observations, actions, lengths, (0,))


@pytest.mark.parametrize("goal_indices", [(), (0, 0), (4,), (-1,), (0, 99)])
def test_refuses_goal_indices_that_name_no_entries(goal_indices):
    observations, actions = arrays([3, 3])
    with pytest.raises(GuiderError, match="goal indices"):
        make_episodes(observations, actions, [3, 3], goal_indices)


def test_drops_episodes_of_a_single_state():
    observations, actions = arrays([1, 3, 1, 2])
    episodes = make_episodes(observations, actions, [1, 3, 1, 2], (0,), goals=observations[:, :1])
    assert episodes.lengths.tolist() == [3, 2]
    np.testing.assert_array_equal(episodes.observations, observations[[1, 2, 3, 5, 6]])
    assert episodes.goals is not None
    np.testing.assert_array_equal(episodes.goals, observations[[1, 2, 3, 5, 6], :1])
    with pytest.raises(GuiderError, match="no transition"):
        make_episodes(observations[:2], actions[:2], [1, 1], (0,))


def test_action_bounds_are_inferred_given_and_checked():
    observations, actions = arrays([5])
    assert make_episodes(observations, actions, [5], (0,)).action_low.tolist() == [-1, -1]
    wide = make_episodes(observations, actions * 3, [5], (0,))
    np.testing.assert_array_equal(wide.action_high, (actions * 3)[:4].max(axis=0))
    given_ = make_episodes(observations, actions, [5], (0,), action_low=-2, action_high=np.array([2, 3]))
    assert given_.action_low.tolist() == [-2, -2] and given_.action_high.tolist() == [2, 3]
    for low, high, message in [
        (-0.01, 0.01, "outside its bounds"),
        (1, -1, "never changes"),
        (np.nan, 1, "NaN or inf"),
        (-1, np.ones(3), r"have shape \(3,\), expected \(2,\)"),
    ]:
        with pytest.raises(GuiderError, match=message):
            make_episodes(observations, actions, [5], (0,), action_low=low, action_high=high)


def test_fingerprint_tells_data_apart():
    base = ragged([3, 2])
    observations, actions = arrays([3, 2])
    goals = np.zeros((5, 2))
    variants = [
        base,
        make_episodes(observations + 1e-3, actions, [3, 2], (0, 1)),
        make_episodes(observations, actions / 2, [3, 2], (0, 1)),
        make_episodes(observations, actions, [2, 3], (0, 1)),
        make_episodes(observations, actions, [3, 2], (1, 0)),
        make_episodes(observations, actions, [3, 2], (0, 1), goals=goals),
        make_episodes(observations, actions, [3, 2], (0, 1), action_high=2),
    ]
    assert len({episodes.fingerprint() for episodes in variants}) == len(variants)
    assert ragged([3, 2], source="elsewhere").fingerprint() == base.fingerprint()


def test_errors_name_the_source():
    with pytest.raises(GuiderError, match=r"^drive\.npz: "):
        make_episodes(np.zeros(3), np.zeros(3), [3], (0,), source="drive.npz")


def test_select_takes_whole_episodes_in_the_order_asked_for():
    episodes = ragged([3, 2, 4], goals=np.arange(18.0).reshape(9, 2))
    chosen = episodes.select(np.array([2, 0]))
    assert chosen.starts.tolist() == [0, 4]
    rows = [5, 6, 7, 8, 0, 1, 2]
    np.testing.assert_array_equal(chosen.observations, episodes.observations[rows])
    np.testing.assert_array_equal(chosen.actions, episodes.actions[rows])
    assert chosen.goals is not None and episodes.goals is not None
    np.testing.assert_array_equal(chosen.goals, episodes.goals[rows])
    assert episodes.select(np.arange(3)).fingerprint() == episodes.fingerprint()


def test_goal_entries_in_another_order_are_another_goal_space():
    episodes = ragged([3, 2], goals=np.zeros((5, 2)))
    assert episodes.with_goal_space((0, 1)) is episodes
    turned = episodes.with_goal_space((1, 0))
    assert turned.goals is None
    np.testing.assert_array_equal(turned.achieved, episodes.observations[:, [1, 0]])


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(2, 9), min_size=2, max_size=30), st.floats(0.05, 0.95))
def test_split_is_disjoint_complete_and_repeatable(lengths, held_out):
    episodes = ragged(lengths)
    expected = max(1, round(held_out * len(lengths)))
    if expected == len(lengths):
        with pytest.raises(GuiderError, match="cannot hold out"):
            episodes.split(held_out)
        return
    train, held = episodes.split(held_out)
    assert len(held.starts) == expected
    assert len(train.starts) + len(held.starts) == len(lengths)
    rows = {row.tobytes() for row in episodes.observations}
    train_rows, held_rows = ({row.tobytes() for row in part.observations} for part in (train, held))
    assert not train_rows & held_rows
    assert train_rows | held_rows == rows
    assert [part.fingerprint() for part in episodes.split(held_out)] == [
        train.fingerprint(),
        held.fingerprint(),
    ]


def test_rounding_does_not_widen_the_bounds():
    actions = np.tile([[0.5, -0.3]], (20, 1))
    actions[4] = -0.5, 0.3
    for value in (1.0, 1.0000002):
        actions[3, 0] = value
        made = make_episodes(np.eye(20), actions, [20], (0, 1))
        assert (made.action_low.tolist(), made.action_high.tolist()) == ([-1, -1], [1, 1])


def test_spaces_hold_what_is_seen_of_each_entry():
    observations = np.zeros((4, 3))
    observations[:, 0], observations[:, 2] = [1, 5, 3, 2], 7
    goals = np.array([[9.0], [1], [1], [-2]])
    spaces = make_episodes(observations, np.zeros((4, 1)), [4], (0,), goals=goals).spaces
    assert spaces.state_low == (-2, 0, 7) and spaces.state_high == (9, 0, 7)


@pytest.mark.parametrize("varies_by", [1.0, 1000.0])
def test_coarse_numbers_are_told_where_they_lose_a_share_of_how_they_vary(varies_by):
    """Around 541,193 float32 knows steps of 1/16: up to 3 % of 1 is lost, and next to nothing of 1000."""
    observations = np.random.default_rng(0).uniform(541_193, 541_193 + varies_by, (50, 2))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make_episodes(observations, np.zeros((50, 1)), [50], (0, 1))
    assert len(caught) == (2 if varies_by == 1.0 else 0)
    assert all("only steps of 0.062" in str(warning.message) for warning in caught)


@pytest.mark.parametrize(
    ("seen", "bounds"),
    [
        ((-0.4, 0.9), (-1, 1)),
        ((0.2, 0.9), (0, 1)),  # a throttle
        ((-0.9, 0.0), (-1, 0)),
        ((-0.03, 0.02), (-0.03, 0.02)),  # increments in metres
        ((0.0, 0.05), (0.0, 0.05)),
        ((0.0, 0.0), (-1, 1)),  # a gripper that was not used
    ],
)
def test_bounds_that_nobody_gave(seen, bounds):
    actions = np.tile([[seen[0], -0.9], [seen[1], 0.9]], (2, 1))
    made = make_episodes(np.eye(5), np.vstack([actions, [0, 0]]), [5], (0,))
    np.testing.assert_allclose((made.action_low[0], made.action_high[0]), bounds, rtol=1e-6)
    in_units = make_episodes(np.eye(5), np.vstack([actions * (1, 100), [0, 0]]), [5], (0,))
    expected = seen if seen[0] < seen[1] else bounds
    np.testing.assert_allclose((in_units.action_low[0], in_units.action_high[0]), expected, rtol=1e-6)
