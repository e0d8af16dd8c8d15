"""Each equation against numbers worked out by hand or an independent reference."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from guider.goals import largest_distance
from guider.learning import losses
from guider.learning.networks import Gaussian, gaussian_head, hidden_product, mlp, mlp_init, twin_init, twin_values


def gaussian(mean, std):
    return Gaussian(jnp.asarray(mean, jnp.float32), jnp.log(jnp.asarray(std, jnp.float32)))


def test_goal_reward_by_hand():
    achieved = jnp.array([[0.0, 0.0], [3.0, 4.0], [0.3, 0.4]])
    reward = losses.goal_reward(achieved, jnp.zeros((3, 2)), radius=0.5001)
    assert reward.tolist() == [0.0, -1.0, 0.0]
    assert losses.goal_reward(achieved[2:], jnp.zeros((1, 2)), radius=0.5).tolist() == [-1.0], "strict (Eq. 1)"


def test_gaussian_kl_by_hand():
    # KL(N(1, 2^2) || N(0, 1)) = (4 + 1 - 1)/2 - ln 2 ; KL(N(0,1) || N(0, 2^2)) = (1/4 - 1)/2 + ln 2
    kl = losses.gaussian_kl(gaussian([[1.0, 0.0]], [[2.0, 1.0]]), gaussian([[0.0, 0.0]], [[1.0, 2.0]]))
    np.testing.assert_allclose(kl, [[2 - np.log(2), -0.375 + np.log(2)]], rtol=1e-6)


def test_gaussian_kl_agrees_with_sampling():
    p, q = gaussian([0.3, -1.0], [0.5, 1.5]), gaussian([0.0, 0.5], [1.0, 0.8])
    draws = p.sample(jax.random.key(0), (400_000,))
    estimate = jnp.mean(p.log_prob(draws) - q.log_prob(draws))
    assert float(losses.gaussian_kl(p, q).sum()) == pytest.approx(float(estimate), rel=0.01)


@pytest.mark.parametrize("balance", [0.0, 0.3, 0.8, 1.0])
def test_balanced_kl_splits_the_gradient_and_keeps_the_value(balance):
    posterior, prior = gaussian([[0.5]], [[0.7]]), gaussian([[-0.2]], [[1.1]])
    value = losses.balanced_kl(posterior, prior, balance)
    np.testing.assert_allclose(value, losses.gaussian_kl(posterior, prior), rtol=1e-6)
    whole = jax.grad(lambda p, q: losses.gaussian_kl(p, q).sum(), (0, 1))(posterior, prior)
    split = jax.grad(lambda p, q: losses.balanced_kl(p, q, balance).sum(), (0, 1))(posterior, prior)
    np.testing.assert_allclose(split[0].mean, (1 - balance) * whole[0].mean, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(split[1].log_std, balance * whole[1].log_std, rtol=1e-5, atol=1e-7)


def test_negative_elbo_by_hand():
    # error: mean(1, 9) = 5; KL per dimension as above, mean (2 - 0.375) / 2 = 0.8125; beta 0.1
    loss, error, kl = losses.negative_elbo(
        jnp.array([[1.0, 3.0]]),
        jnp.zeros((1, 2)),
        gaussian([[1.0, 0.0]], [[2.0, 1.0]]),
        gaussian([[0.0, 0.0]], [[1.0, 2.0]]),
        beta=0.1,
        balance=0.8,
    )
    np.testing.assert_allclose([error[0], kl[0], loss[0]], [5.0, 0.8125, 5.08125], rtol=1e-6)


def test_td_target_stops_at_a_met_goal():
    target = losses.td_target(jnp.array([-1.0, 0.0]), jnp.array([-10.0, -10.0]), discount=0.9)
    np.testing.assert_allclose(target, [-10.0, 0.0])


def test_conservative_gap_by_hand():
    # log(exp(1 - ln .5) + exp(3 - ln .25)) - 2 = ln(2e + 4e^3) - 2
    gap = losses.conservative_gap(jnp.array([[1.0, 3.0]]), jnp.log(jnp.array([[0.5, 0.25]])), jnp.array([2.0]))
    np.testing.assert_allclose(gap, [np.log(2 * np.e + 4 * np.e**3) - 2], rtol=1e-6)


def test_conservative_gap_estimates_the_log_integral():
    """With Q constant over a box of volume V, log-sum-exp over z of Q is Q + log V, whatever the proposals, but for the
    log of their number: a sum is taken, as in the authors' unit."""
    uniform = jnp.full((1, 5000), 0.7)
    gap = losses.conservative_gap(uniform, jnp.full((1, 5000), -jnp.log(6.0)), jnp.array([0.7]))
    np.testing.assert_allclose(gap, [np.log(6.0) + np.log(5000)], rtol=1e-5)


def test_expectile_loss_by_hand_and_fixed_point():
    np.testing.assert_allclose(losses.expectile_loss(jnp.array([2.0, -2.0]), 0.7), [2.8, 1.2], rtol=1e-6)
    # The 0.7-expectile of {0, 1} is 0.7: its gradient vanishes there.
    gradient = jax.grad(lambda m: losses.expectile_loss(jnp.array([0.0, 1.0]) - m, 0.7).sum())(0.7)
    assert float(gradient) == pytest.approx(0.0, abs=1e-6)


def test_advantage_weight_by_hand():
    weight = losses.advantage_weight(jnp.array([0.0, 1.0, 5.0, 1e9, -1e9]), temperature=2.0, ceiling=10.0)
    np.testing.assert_allclose(weight, [1.0, np.exp(0.5), 10.0, 10.0, 0.0], rtol=1e-6)


def test_weighted_regression_is_a_gaussian_log_likelihood():
    """Eq. 6: its gradient is that of -w log N(a; mu, 1), up to the mean over dimensions and the factor 2."""
    action, weight = jnp.array([[0.5, -0.5]]), jnp.array([3.0])
    predicted = jnp.array([[0.1, 0.2]])

    def likelihood(mean):
        return -(weight * Gaussian(mean, jnp.zeros_like(mean)).log_prob(action)).sum()

    ours = jax.grad(lambda m: losses.weighted_regression(weight, m, action, "squared").sum())(predicted)
    np.testing.assert_allclose(ours, jax.grad(likelihood)(predicted), rtol=1e-6)
    assert jax.grad(lambda w: losses.weighted_regression(w, predicted, action, "squared").sum())(weight).tolist() == [
        0.0
    ]


def test_absolute_regression_pulls_alike_however_far():
    """A Laplace distribution: the gradient is the weight over the number of dimensions, with the error's sign."""
    action, weight = jnp.array([[0.5, -0.5]]), jnp.array([3.0])
    predicted = jnp.array([[0.1, 0.2]])
    gradient = jax.grad(lambda m: losses.weighted_regression(weight, m, action, "absolute").sum())(predicted)
    np.testing.assert_allclose(gradient, [[-1.5, 1.5]], rtol=1e-6)


def test_log_prob_by_hand():
    expected = -0.5 * (1.0 / 2) ** 2 - np.log(2) - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(gaussian([0.0], [2.0]).log_prob(jnp.array([1.0])), expected, rtol=1e-6)


def test_mlp_by_hand():
    layers = (
        (jnp.array([[1.0, -1.0]]), jnp.array([0.0, 0.5])),
        (jnp.array([[2.0], [3.0]]), jnp.array([1.0])),
    )
    # x = 2: hidden relu(2, -1.5) = (2, 0); out 2*2 + 1
    assert mlp(layers, jnp.array([2.0])).tolist() == [5.0]


def rounded(values) -> np.ndarray:
    return np.asarray(jnp.asarray(values).astype(jnp.bfloat16), np.float64)


@pytest.mark.parametrize("seeds", [None, 2])
def test_bfloat16_rounds_both_factors_and_adds_up_exactly(seeds):
    """Forwards and backwards, alone and with many seeds at once: the float64 product of rounded factors."""
    shape = () if seeds is None else (seeds,)
    keys = jax.random.split(jax.random.key(0), 3)
    hidden, weight, pull = (
        jax.random.normal(k, (*shape, *s)) for k, s in zip(keys, [(6, 5), (5, 4), (6, 4)], strict=True)
    )
    product = hidden_product if seeds is None else jax.vmap(hidden_product)
    with jax.default_matmul_precision("bfloat16"):
        value, pullback = jax.vjp(product, hidden, weight)
        to_hidden, to_weight = pullback(pull)
    h, w, p = rounded(hidden), rounded(weight), rounded(pull)
    np.testing.assert_allclose(value, h @ w, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(to_hidden, p @ w.swapaxes(-1, -2), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(to_weight, h.swapaxes(-1, -2) @ p, rtol=1e-5, atol=1e-6)
    assert np.abs(np.asarray(value) - np.asarray(hidden @ weight)).max() > 1e-3


def test_first_and_last_layers_stay_float32():
    x = jax.random.normal(jax.random.key(1), (3, 7))
    for sizes, rounds in (((7, 32, 2), False), ((7, 32, 32, 2), True)):
        layers = mlp_init(jax.random.key(0), sizes)
        with jax.default_matmul_precision("bfloat16"):
            answers = mlp(layers, x)
        assert jnp.array_equal(answers, mlp(layers, x)) != rounds
        np.testing.assert_allclose(answers, mlp(layers, x), atol=0.02)


def test_dropout_keeps_the_mean_and_needs_a_key():
    """64 hidden units of 1, whose mean is the output: half of them doubled."""
    layers = ((jnp.ones((1, 64)), jnp.zeros(64)), (jnp.ones((64, 1)) / 64, jnp.zeros(1)))
    x = jnp.ones(1)
    assert mlp(layers, x, dropout=0.5) == mlp(layers, x) == 1
    dropped = jax.vmap(lambda k: mlp(layers, x, dropout=0.5, key=k))(jax.random.split(jax.random.key(1), 20_000))
    assert float(dropped.mean()) == pytest.approx(1, abs=0.01)
    assert float(dropped.std()) == pytest.approx(64**-0.5, abs=0.01)


def test_gaussian_head_clips_log_std():
    head = gaussian_head(jnp.array([1.0, 2.0, -100.0, 100.0]))
    assert head.mean.tolist() == [1.0, 2.0] and head.log_std.tolist() == [-5.0, 2.0]


def test_shared_first_layer_is_the_plain_network():
    """twin_values computes the context's product once; the result is that of the concatenated input."""
    twins = twin_init(jax.random.key(0), (5, 8, 8, 1))
    context = jax.random.normal(jax.random.key(1), (4, 3))
    actions = jax.random.normal(jax.random.key(2), (4, 6, 2))
    wide = jnp.broadcast_to(context[:, None], (4, 6, 3))
    for twin in range(2):
        layers = jax.tree.map(lambda leaf, t=twin: leaf[t], twins)
        plain = mlp(layers, jnp.concatenate([wide, actions], axis=-1))[..., 0]
        np.testing.assert_allclose(twin_values(twins, context, actions)[twin], plain, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(twin_values(twins, context, actions[:, 0])[twin], plain[:, 0], rtol=1e-4, atol=1e-5)


def test_goal_reward_counts_the_parts_in_place():
    """Kitchen: objects (0,) and (1, 2) each within 0.3 of their goal; 0 only when both are."""
    goal = jnp.zeros((3, 3))
    achieved = jnp.array([[0.2, 0.1, 0.2], [0.2, 0.3, 0.1], [0.4, 0.3, 0.1]])
    assert losses.goal_reward(achieved, goal, 0.3, ((0,), (1, 2))).tolist() == [0.0, -1.0, -2.0]
    assert jnp.allclose(largest_distance(achieved, goal, ((0,), (1, 2))), jnp.array([0.05**0.5, 0.1**0.5, 0.4]))


def test_surprise_by_hand():
    """At 0.5 of a mean 0 and a spread of 2: Gaussian, (1/4)^2 / 2 + ln 2 + ln(2 pi) / 2; Laplace, 1/4 + ln 2 + ln 2."""
    policy, action = Gaussian(jnp.zeros((1, 2)), jnp.full((1, 2), jnp.log(2.0))), jnp.full((1, 2), 0.5)
    gaussian = 1 / 32 + np.log(2) + np.log(2 * np.pi) / 2
    np.testing.assert_allclose(losses.surprise(policy, action, "squared"), [2 * gaussian], rtol=1e-6)
    np.testing.assert_allclose(losses.surprise(policy, action, "absolute"), [2 * (1 / 4 + 2 * np.log(2))], rtol=1e-6)
