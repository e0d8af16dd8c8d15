"""Where episodes end: every sign a file may have, alone and against others."""

from __future__ import annotations

import re

import numpy as np
import pytest
from recordings import GOAL, ends, walk, write_hdf5, write_npz

from guider.data import load
from guider.data.motion import find_jumps
from guider.errors import GuiderError, GuiderWarning

LENGTHS = [20, 35, 27, 40]
ENDS = ends(LENGTHS)
NONE = np.zeros(sum(LENGTHS), bool)
HALF = ENDS & (np.cumsum(ENDS) % 2 == 1)  # those of every other episode


def read(folder, arrays, write=write_npz, **options):
    return load(write(folder / "a.npz", walk(LENGTHS) | arrays), GOAL, **options)


def signs(episodes) -> dict[str, tuple[int, bool]]:
    return {sign.name: (sign.ends, sign.used) for sign in episodes.end_signs}


@pytest.mark.parametrize("write", [write_npz, write_hdf5])
@pytest.mark.parametrize(
    "arrays",
    [
        {"terminals": ENDS},
        {"terminals": ENDS, "timeouts": NONE},
        {"terminals": NONE, "timeouts": ENDS},
        *({"terminals": HALF, name: ENDS & ~HALF} for name in ("timeouts", "timeout", "truncations", "truncation")),
        *({"terminated": HALF, name: ENDS & ~HALF} for name in ("truncated", "truncateds")),
        *({"terminals": HALF, name: ENDS} for name in ("dones", "done", "episode_terminals", "is_last")),
        {"episode_ends": ENDS.astype(np.float32)},
        {"lengths": np.array(LENGTHS)},
        {"episode_index": np.repeat(np.arange(4), LENGTHS)},
        {"episode": np.repeat([3.0, 1.0, 2.0, 7.0], LENGTHS), "terminals": NONE},
        {"timestamp": np.concatenate([np.arange(n) / 30 for n in LENGTHS])},
        {"next_observations": np.roll(walk(LENGTHS)["observations"], -1, axis=0), "terminals": ENDS},
    ],
    ids=lambda arrays: "+".join(arrays),
)
def test_equal_arrays_read_equal_whatever_marks_the_ends(tmp_path, arrays, write):
    """No warning either: nothing disagrees."""
    episodes = read(tmp_path, arrays, write)
    assert episodes.lengths.tolist() == LENGTHS
    found = signs(episodes)
    assert set(found) == {*arrays, "jumps"}
    jumps = found.pop("jumps")
    assert jumps == (3, False)
    assert any(used for _, used in found.values())


def test_next_observations_end_episodes_where_they_are_not_the_next_row(tmp_path):
    observations = walk(LENGTHS)["observations"]
    followers = np.roll(observations, -1, axis=0)
    followers[ENDS] += 1
    assert read(tmp_path, {"next_observations": followers}).lengths.tolist() == LENGTHS
    with pytest.warns(GuiderWarning, match="1 rows that no flag marks have another state than the next row's"):
        episodes = read(tmp_path, {"next_observations": followers, "terminals": HALF})
    assert episodes.lengths.tolist() == LENGTHS
    assert signs(episodes)["next_observations"] == (4, True)


def test_a_gap_in_time_ends_an_episode_and_is_told(tmp_path):
    times = np.arange(sum(LENGTHS)) * 0.1
    times[55:] += 60.0
    with pytest.warns(GuiderWarning, match=r"1 rows that no flag marks have a gap in time \(timestamps\)"):
        episodes = read(tmp_path, {"timestamps": times, "terminals": ends([20, 62, 40])})
    assert episodes.lengths.tolist() == LENGTHS


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"terminals": ENDS}, "next_observations of .* is not the next row"),
        ({"lengths": np.array(LENGTHS)}, "next_observations of .* is not the next row"),
    ],
)
def test_shuffled_rows_are_refused(tmp_path, arrays, message):
    observations = walk(LENGTHS)["observations"]
    order = np.random.default_rng(0).permutation(len(observations))
    followers = np.roll(observations, -1, axis=0)[order]
    shuffled = {"observations": observations[order], "next_observations": followers}
    with pytest.raises(GuiderError, match=f"rows are shuffled .*{message}.*save them in the order"):
        read(tmp_path, shuffled | arrays)


@pytest.mark.parametrize("arrays", [{"episode_index": np.arange(122) % 4}, {"timestamps": -np.arange(122.0)}])
def test_rows_told_to_be_shuffled_by_other_columns(tmp_path, arrays):
    with pytest.raises(GuiderError, match="rows are shuffled"):
        read(tmp_path, arrays | {"terminals": ENDS})


@pytest.mark.parametrize("other", [-1.0, np.nan, 2.0])
def test_flags_that_are_none(tmp_path, other):
    with pytest.raises(GuiderError, match=rf"terminals must mark rows by 0 or 1, got {re.escape(str(other))} in row 0"):
        read(tmp_path, {"terminals": np.where(ENDS, 1.0, other)})


def test_the_users_word_is_taken(tmp_path):
    arrays = {"terminals": HALF, "timeouts": ENDS & ~HALF, "lengths": np.array([60, 62])}
    with pytest.warns(GuiderWarning, match=r"timeouts marks 1 ends that lengths does not; lengths is taken"):
        assert read(tmp_path, arrays).lengths.tolist() == [60, 62]
    assert read(tmp_path, arrays, episode_ends=["terminals"]).lengths.tolist() == [20, 62, 40]
    episodes = read(tmp_path, arrays, episode_ends=["terminals", "timeouts"])
    assert episodes.lengths.tolist() == LENGTHS
    assert signs(episodes) == {"terminals": (2, True), "timeouts": (2, True)}
    assert read(tmp_path, {}, episode_ends=["jumps"]).lengths.tolist() == LENGTHS
    with pytest.raises(GuiderError, match=r"no sign of episode ends is called 'terminal' here; did you mean terminals"):
        read(tmp_path, arrays, episode_ends=["terminal"])


def test_no_flag_set_is_told(tmp_path):
    arrays = walk([60]) | {"terminals": np.zeros(60, bool)}
    with pytest.warns(GuiderWarning, match="no row is marked as an end: read as one episode of 60 rows"):
        assert load(write_npz(tmp_path / "a.npz", arrays), GOAL).lengths.tolist() == [60]


def test_jumps_split_where_flags_are_incomplete(tmp_path):
    with pytest.warns(GuiderWarning, match="jumps after 1 rows that nothing marks: taken as ends too"):
        episodes = read(tmp_path, {"terminals": HALF})
    assert episodes.lengths.tolist() == LENGTHS
    assert signs(episodes)["jumps"] == (3, True)


def turning(rows: int) -> np.ndarray:
    """[rows, 2] a heading that turns by 0.1 rad a row and wraps at pi, and a place that wanders."""
    heading = (np.arange(rows) * 0.1 + np.pi) % (2 * np.pi) - np.pi
    return np.stack([heading, np.cumsum(np.random.default_rng(0).normal(0, 0.01, rows))], axis=1)


def test_an_angle_that_wraps_is_no_end_where_flags_mark_the_ends(tmp_path):
    arrays = {"observations": turning(sum(LENGTHS)), "terminals": ENDS}
    with pytest.warns(
        GuiderWarning, match="after 2 rows an entry crosses its whole range and all others go on, .*: no ends"
    ):
        episodes = read(tmp_path, arrays)
    assert episodes.lengths.tolist() == LENGTHS


def test_a_teleporter_is_no_end_where_marked_episodes_are_equally_long(tmp_path):
    lengths = [50] * 6
    arrays = walk(lengths) | {"terminals": ends(lengths)}
    arrays["observations"][np.r_[20:50, 130:150], 0] += 4.0
    with pytest.warns(GuiderWarning, match="jumps after 2 rows .*: no ends, since all marked episodes have 50 rows"):
        assert load(write_npz(tmp_path / "a.npz", arrays), GOAL).lengths.tolist() == lengths


def test_terminals_that_are_resets_end_episodes_beside_timeouts(tmp_path):
    """A reset within reach of one step is still no ordinary step: everything else jumps, too."""
    rng = np.random.default_rng(0)
    lengths = [25] * 8
    arrays = walk(lengths) | {"terminals": ends(lengths), "timeouts": np.zeros(200, bool)}
    arrays["timeouts"][99], arrays["terminals"][99] = True, False
    arrays["observations"][:, :2] = 0.3 * rng.normal(size=(200, 2))
    arrays["observations"][:, 2] = np.tile(np.arange(25.0), 8)
    assert load(write_npz(tmp_path / "a.npz", arrays), GOAL).lengths.tolist() == lengths


def test_many_single_states_are_told(tmp_path):
    arrays = walk([122]) | {"lengths": np.array([60, *[1] * 62])}
    with pytest.warns(GuiderWarning, match=r"62 of 122 rows are episodes of a single state and are left out"):
        load(write_npz(tmp_path / "a.npz", arrays), GOAL)


# What people have, tried out by somebody who had not written the rules

MANY = [60, 80, 45, 100, 70, 90, 55, 66]


def smooth(lengths, seed=0) -> dict[str, np.ndarray]:
    """A point with velocities, each episode from another start."""
    rng = np.random.default_rng(seed)
    parts = []
    for length in lengths:
        velocity = np.cumsum(rng.normal(0, 0.02, (length, 2)), axis=0)
        parts.append(np.hstack([rng.uniform(0, 10, 2) + np.cumsum(velocity, axis=0), velocity]))
    observations = np.vstack(parts).astype(np.float32)
    return {"observations": observations, "actions": rng.uniform(-1, 1, (len(observations), 2)).astype(np.float32)}


def loaded(folder, arrays, **options):
    return load(write_npz(folder / "a.npz", arrays), GOAL, **options)


def followers(arrays, lengths) -> np.ndarray:
    """next_observations, with a state of their own after each episode's last row."""
    after = np.roll(arrays["observations"], -1, axis=0)
    after[ends(lengths)] += 0.5
    return after


def test_rows_of_several_environments_in_turns_are_told(tmp_path):
    parts = [smooth([100], seed) for seed in range(4)]
    arrays = {key: np.stack([part[key] for part in parts], axis=1).reshape(400, -1) for key in parts[0]}
    with pytest.warns(
        GuiderWarning, match="do not seem to follow each other.* but for every 4th: as if 4 environments"
    ):
        loaded(tmp_path, arrays | {"dones": np.repeat(np.arange(100) == 99, 4)})


def test_shuffled_rows_without_next_states_are_told(tmp_path):
    order = np.random.default_rng(1).permutation(sum(MANY))
    arrays = {key: array[order] for key, array in smooth(MANY).items()} | {"dones": ends(MANY)[order]}
    with pytest.warns(GuiderWarning, match="do not seem to follow each other: the next is as far as any other"):
        loaded(tmp_path, arrays)


@pytest.mark.parametrize("stated", [{"episode_index": np.zeros(sum(MANY), int)}, {"lengths": np.array(MANY[::-1])}])
def test_what_a_file_states_against_all_else_is_told(tmp_path, stated):
    with pytest.warns(GuiderWarning, match=r"terminals marks \d ends that .* does not"):
        loaded(tmp_path, smooth(MANY) | {"terminals": ends(MANY)} | stated)


def test_bursts_lost_packets_and_clocks_set_back_are_no_ends(tmp_path):
    rng = np.random.default_rng(0)
    bursts = [i * 300 + np.arange(n) // 4 * 0.1 + np.arange(n) % 4 * 0.001 for i, n in enumerate(MANY)]
    losses = [i * 300 + np.cumsum(np.where(rng.random(n) < 0.05, 0.7, 0.1)) for i, n in enumerate(MANY)]
    set_back = [i * 300 + np.arange(n) * 0.1 - 0.15 * (np.arange(n) > n // 2) for i, n in enumerate(MANY)]
    for times in (bursts, losses, set_back):
        assert loaded(tmp_path, smooth(MANY) | {"timestamps": np.concatenate(times)}).lengths.tolist() == MANY


@pytest.mark.parametrize("flags", [{"dones": None, "timeouts": ends([400] * 4)}, {"terminals": None}])
def test_success_that_stays_on_near_the_goal_is_no_end_where_the_file_shows_that_it_goes_on(tmp_path, flags):
    lengths = [400] * 4
    arrays = smooth(lengths)
    met = np.arange(1600) % 400 // 5 == 50
    arrays |= {name: met if flag is None else flag for name, flag in flags.items()}
    with pytest.warns(GuiderWarning, match="20 rows marked by .* are followed by an ordinary step: no ends"):
        episodes = loaded(tmp_path, arrays | {"next_observations": followers(arrays, lengths)})
    assert episodes.lengths.tolist() == lengths


def test_one_flag_in_the_last_row_does_not_outweigh_the_terminals_of_a_robot_never_reset(tmp_path):
    lengths = [50] * 12
    arrays = smooth([600]) | {"terminals": ends(lengths), "timeouts": ends([600])}
    assert loaded(tmp_path, arrays).lengths.tolist() == lengths


def test_half_the_ends_marked_at_equal_lengths_are_not_all(tmp_path):
    lengths = [60] * 10
    with pytest.warns(GuiderWarning, match="jumps after 5 rows that nothing marks: taken as ends too"):
        episodes = loaded(tmp_path, smooth(lengths) | {"dones": ends([120] * 5)})
    assert episodes.lengths.tolist() == lengths


def test_a_buffer_cut_off_within_an_episode_is_no_contradiction(tmp_path):
    arrays = smooth(MANY)
    terminals = ends(MANY)
    terminals[-1] = False
    times = np.arange(sum(MANY)) * 0.1
    arrays |= {"next_observations": followers(arrays, MANY), "terminals": terminals, "timestamps": times}
    assert loaded(tmp_path, arrays).lengths.tolist() == MANY


@pytest.mark.parametrize(
    "wrong",
    [
        {"next_observations": "self"},
        {"time": -np.arange(sum(MANY), dtype=float)},
        {"dones": ends(MANY).astype(np.uint8) * 255},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_the_users_word_is_the_last(tmp_path, wrong):
    arrays = smooth(MANY) | {"terminals": ends(MANY)} | wrong
    if "next_observations" in wrong:
        arrays["next_observations"] = arrays["observations"] + 1
    with pytest.raises(GuiderError, match=r"shuffled|0 or 1"):
        loaded(tmp_path, arrays)
    assert loaded(tmp_path, arrays, episode_ends=["terminals"]).lengths.tolist() == MANY


def test_numbers_that_start_anew_in_a_second_file_are_read(tmp_path):
    numbers = np.repeat(np.arange(8) % 4, MANY)
    assert loaded(tmp_path, smooth(MANY) | {"episode_index": numbers}).lengths.tolist() == MANY


def test_half_precision_of_next_states_is_enough(tmp_path):
    arrays = smooth(MANY)
    arrays |= {"next_observations": followers(arrays, MANY).astype(np.float16), "terminals": ends(MANY)}
    assert loaded(tmp_path, arrays).lengths.tolist() == MANY


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
