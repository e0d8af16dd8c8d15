"""What is wrong with logs is found where it was put, and not where nothing is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from guider.data import describe, findings, suggestions
from guider.data.episodes import Episodes, make_episodes

EPISODES, STEPS = 40, 80
NAMES = ("x", "y", "speed_x", "heading", "lamp")


def cart(delay: int = 0) -> Episodes:
    """A cart driven to places in a plane: x, y, x's speed, a heading that turns slowly, and a lamp that is never lit.

    delay: rows by which actions stand after the steps they cause; below 0 before.
    """
    rng = np.random.default_rng(0)
    states, actions = [], []
    for _ in range(EPISODES):
        place, goal, speed = rng.uniform(-5, 5, 2), rng.uniform(-5, 5, 2), 0.0
        heading = rng.uniform(-1, 1)
        for _ in range(STEPS):
            action = np.clip(0.1 * (goal - place) + rng.normal(0, 0.1, 2), -1, 1)
            states.append([*place, speed, heading, 0.0])
            actions.append(action)
            speed = action[0]
            place = place + action
            heading += rng.normal(0, 0.02)
    actions = np.roll(actions, delay, axis=0)
    made = make_episodes(np.array(states), actions, [STEPS] * EPISODES, (0, 1), action_low=-1, action_high=1)
    return replace(made, state_names=NAMES, action_names=("push_x", "push_y"))


def changed(episodes: Episodes, entry: int, rows: slice | list[int], value: float | np.ndarray) -> Episodes:
    observations = episodes.observations.copy()
    observations[rows, entry] = value
    return replace(episodes, observations=observations)


def test_nothing_is_found_where_nothing_is_wrong_but_a_lamp():
    assert findings.find_faults(cart()) == ["never changes: lamp; leave it out, or see why"]
    assert describe(cart())["verdict"] == "look at the finding above, then train"


@pytest.mark.parametrize("delay", [-4, -2, 1, 3])
def test_actions_that_stand_before_or_after_what_they_cause(delay):
    (line,) = findings.alignment(cart(delay))
    words = f"actions stand {delay} rows after" if delay > 0 else f"the state answers {-delay} rows after the action"
    assert line.startswith(words)
    assert findings.alignment(cart()) == []


def test_time_with_gaps_and_time_that_goes_back():
    times = np.tile(0.1 * np.arange(STEPS), EPISODES)
    assert findings.timing(replace(cart(), times=times)) == [] == findings.timing(cart())
    assert suggestions.rate(replace(cart(), times=times)) == 10
    late, back = times.copy(), times.copy()
    late[3 * STEPS + 7 : 4 * STEPS] += 2.0
    back[5 * STEPS + 9] -= 0.5
    (gap,) = findings.timing(replace(cart(), times=late))
    assert gap == "gaps in time after 1 rows (first row 246; in episodes 3): up to 2.1 s, usually 0.1 s"
    lines = findings.timing(replace(cart(), times=back))
    assert lines[0] == "time stands still or goes back after 1 rows (first row 408; in episodes 5)"


def test_copies_leaps_wraps_and_stills():
    plain = cart()
    rows = plain.observations.copy()
    rows[STEPS : 2 * STEPS] = rows[7 * STEPS : 8 * STEPS]
    assert findings.duplicates(replace(plain, observations=rows)) == [
        "1 episodes are copies of others (episodes 1, 7 are one)"
    ]
    (leap,) = findings.jumps(changed(plain, 1, [2 * STEPS + 30], 9.0))
    assert leap == f"y: leaps, after 2 rows (first row {2 * STEPS + 29}; in episodes 2)"
    wrapped = np.mod(plain.observations[:, 3] * 8 + np.pi, 2 * np.pi) - np.pi
    (wrap,) = findings.jumps(changed(plain, 3, slice(None), wrapped))
    assert wrap.startswith("heading: whole range crossed in a step")
    frozen = plain.observations.copy()
    frozen[4 * STEPS + 5 : 4 * STEPS + 75] = frozen[4 * STEPS + 5]
    assert findings.stills(replace(plain, observations=frozen)) == [
        "2% of the steps change nothing in the state, 69 in a row in episode 4: a robot at rest, or a sensor that froze"
    ]
    assert findings.jumps(plain) == findings.stills(plain) == findings.duplicates(plain) == []


def test_limits_oddities_and_little_data():
    plain = cart()
    pushed = plain.actions.copy()
    pushed[: len(pushed) // 2, 1] = 1.0
    assert findings.saturation(replace(plain, actions=pushed)) == ["push_y is at a limit in 50% of the steps"]
    (odd,) = findings.odd_ones(changed(plain, 0, slice(9 * STEPS, 10 * STEPS), 400.0))
    assert odd == "episodes 9 differ much from the others in place"
    few = plain.select(np.arange(3))
    assert findings.scarcity(few) == ["3 episodes of 237 steps in all are few: expect little away from them"]


def test_what_could_be_a_goal_and_how_near_is_near():
    good, refused = suggestions.goal_candidates(cart())
    assert {0, 1} <= set(good) and 3 in good
    assert refused == {2: "the speed of x", 4: "never changes"}
    hardly = changed(
        cart(), 1, slice(None), np.repeat(np.arange(EPISODES), STEPS) + 0.01 * np.tile(np.arange(STEPS), EPISODES)
    )
    assert suggestions.goal_candidates(hardly)[1][1] == "hardly moves within an episode"
    same = changed(cart(), 1, slice(None), np.tile(np.sin(np.arange(STEPS)), EPISODES))
    assert suggestions.goal_candidates(same)[1][1] == "ends at much the same value in every episode"
    radius = suggestions.suggested_radius(cart())
    assert radius == 0.4  # of a plane of 10 by 10, of which it covers 13.4 across
    in_millimetres = cart()
    in_millimetres = replace(in_millimetres, observations=in_millimetres.observations * 1000)
    assert suggestions.suggested_radius(in_millimetres) == 400


def test_what_lies_between_episodes_is_no_fault():
    """The next begins where the last one stopped, an hour later."""
    plain = cart()
    states = plain.observations.copy()
    starts = np.arange(10, len(states), 10)
    states[starts] = states[starts - 1]
    times = 0.1 * np.arange(len(states)) + 3600 * (np.arange(len(states)) // 10)
    short = make_episodes(states, plain.actions, [10] * (len(states) // 10), (0, 1), times=times)
    assert findings.stills(short) == findings.timing(short) == []


def test_a_lag_behind_smooth_motion():
    """Push and speed change slowly, so that every row goes with those near it: only what is new in each row tells."""
    rng = np.random.default_rng(0)
    push, speed, place, states, actions = 0.0, 0.0, 0.0, [], []
    for _ in range(4000):
        push = 0.98 * push + rng.normal()
        speed += 0.3 * (push - speed)
        states.append([place])
        actions.append([push])
        place += speed

    def logged(delay: int) -> Episodes:
        return make_episodes(np.array(states), np.roll(actions, delay, axis=0), [1000] * 4, (0,))

    assert findings.alignment(logged(0)) == []
    (line,) = findings.alignment(logged(3))
    assert line.startswith("actions stand 3 rows after")


@pytest.mark.parametrize("unit", [0.001, 1.0, 1000.0])
def test_a_period_in_which_what_moves_goes_three_radii(unit):
    """Three radii in 28 steps; rests in between do not count."""
    way = np.concatenate([np.arange(60) * 0.11, np.full(60, 59 * 0.11), 59 * 0.11 + np.arange(60) * 0.11])
    rows = np.tile(way * unit, 4)[:, None]
    episodes = make_episodes(rows, np.zeros((720, 1)), [180] * 4, (0,))
    assert suggestions.suggested_period(episodes, 1.0 * unit) == 28
    assert suggestions.suggested_period(episodes, 0.01 * unit) == 20  # at least
    assert suggestions.suggested_period(episodes, 12 * unit) == 60  # at most a third of an episode
    for length, period in ((45, 15), (12, 5), (4, 3)):  # however short
        short = make_episodes(rows[:length], np.zeros((length, 1)), [length], (0,))
        assert suggestions.suggested_period(short, 0.01 * unit) == period
