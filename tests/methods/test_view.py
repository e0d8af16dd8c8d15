"""What methods see of data: scales by hand, shares of rows, and radii that cannot be meant."""

from __future__ import annotations

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

from guider.data.episodes import make_episodes
from guider.errors import GuiderError, GuiderWarning
from guider.learning.problem import Problem
from guider.methods.view import Scale, Use, ViewConfig, check_radius, data_use, prepare, wave_frequencies


def line(positions, lengths, **more):
    """Episodes on a line; the second state entry stands still."""
    observations = np.stack([np.asarray(positions, float), np.full(len(positions), 7.0)], axis=1)
    return make_episodes(observations, np.zeros((len(positions), 1)), lengths, (0,), **more)


def test_positions_and_waves_by_hand():
    """Goals of (1, -1) and (3, 3) spreads; phases are pi / 2 of that."""
    state, goal = (jnp.array([1.0]), jnp.array([4.0])), (jnp.array([1.0, 2.0]), jnp.array([2.0, 5.0]))
    scale = Scale(*state, *goal, jnp.ones(2), wave_frequencies(1))
    goals = jnp.array([[3.0, -3.0], [7.0, 17.0]])
    expected = [[1, -1, 1, 0, -1, 0], [3, 3, -1, 0, -1, 0]]
    np.testing.assert_allclose(scale.position(goals), expected, atol=1e-6)
    assert scale.state(jnp.array([9.0])).tolist() == [2.0]
    np.testing.assert_allclose(wave_frequencies(3), [np.pi / 2, np.pi, 2 * np.pi], rtol=1e-6)


def test_the_scale_of_data_by_hand():
    """Windows of two steps move 4, 4 and, cut off at the episode's end, 2."""
    episodes = line([0, 2, 4, 6], [4])
    view, problem = ViewConfig(normalise=True, smallest_spread=0.5, position_waves=2), Problem(period_steps=2)
    _, scale = prepare(view, problem, episodes)
    np.testing.assert_allclose(scale.state_mean, [3, 7], rtol=1e-6)
    np.testing.assert_allclose(scale.state_std, [5**0.5, 1e-3], rtol=1e-6)
    assert (float(scale.goal_mean[0]), float(scale.goal_std[0])) == pytest.approx((3, 5**0.5))
    assert float(scale.step_std[0]) == pytest.approx(((16 + 16 + 4) / 3) ** 0.5)
    assert scale.frequencies.shape == (2,)
    _, still = prepare(view, problem, line([1, 1, 1.5, 1.5], [4]))
    assert float(still.goal_std[0]) == float(still.state_std[0]) == 0.5 and float(still.step_std[0]) == 0.5


def test_raw_inputs_are_left_as_they_are():
    _, scale = prepare(ViewConfig(), Problem(period_steps=2), line([0, 2, 4, 6], [4]))
    assert scale.state(jnp.array([9.0, 7.0])).tolist() == [9, 7]
    assert scale.position(jnp.array([9.0])).tolist() == [9]


MOVES = "view.minimum_move=1 (rows whose goal entries move less within {})"
CUT = "view.boundary=drop (windows of 3 steps that would leave their episode)"


@pytest.mark.parametrize(
    ("view", "transitions", "windows", "settings"),
    [
        (ViewConfig(), 7, 7, ()),
        (ViewConfig("drop"), 7, 3, (CUT,)),
        (ViewConfig(minimum_move=1.0), 3, 3, (MOVES.format("3 steps"),)),
        (ViewConfig(minimum_move=1.0, move_within="episode"), 5, 5, (MOVES.format("their episode"),)),
        (ViewConfig("drop", minimum_move=1.0), 3, 1, (MOVES.format("3 steps"), CUT)),
    ],
)
def test_what_share_of_rows_is_learned_from(view, transitions, windows, settings):
    """An episode of three states that stays, and one of six whose last step goes 2; windows have three steps."""
    use = data_use(view, Problem(period_steps=3), line([0, 0, 0, 5, 5, 5, 5, 5, 7], [3, 6]))
    assert use == Use(transitions, 7, windows, 7, settings)


def test_a_radius_that_meets_every_goal_at_once_is_refused():
    episodes = line([0, 1, 0, 3], [2, 2])
    with pytest.raises(GuiderError, match=r"no episode gets further than 3 from where it starts .* radius 3 at once"):
        check_radius(Problem(radius=3.0), episodes)
    check_radius(Problem(radius=2.9), line([0, 3, 3, 0], [2, 2]))


def test_positions_that_float32_cannot_tell_apart_by_a_radius_are_refused():
    """At a million metres, float32 has steps of 1/16 m."""
    far = line([1e6, 1e6 + 1, 1e6 + 2, 1e6 + 3], [4])
    check_radius(Problem(radius=0.7), far)
    with pytest.raises(GuiderError, match=r"goal entry 0 is 1000003 in row 3, .* only steps of 0.062: too coarse"):
        check_radius(Problem(radius=0.6), far)


@pytest.mark.parametrize(
    ("positions", "radius", "message"),
    [
        ([0, 2, 0] * 3 + [0, 2, 4], 1.0, r"75% of the episodes end within the radius 1 of where they start"),
        ([0, 2, 0] * 2 + [0, 2, 4] * 2, 1.0, None),
        ([0, 2, 4] * 4, 0.4, "the median step goes 2, past the radius 0.4"),
        ([0, 2, 4] * 4, 0.5, None),
    ],
)
def test_a_radius_that_most_data_contradicts_is_told(positions, radius, message):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_radius(Problem(radius=radius), line(positions, [3] * 4))
    assert [issubclass(warning.category, GuiderWarning) for warning in said] == [True] * (message is not None)
    if message:
        assert message in str(said[0].message)
