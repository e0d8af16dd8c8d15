"""Adam, its rate over time and trailing targets, by hand and by an independent Adam."""

import jax.numpy as jnp
import numpy as np
import pytest

from guider.learning.optimisers import adam_init, adam_step, cosine_rate, trail


def test_adam_is_that_of_its_paper():
    """Kingma and Ba 2015, Algorithm 1, with beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8."""
    gradients = np.array([[0.5, -2.0], [1.5, 0.1], [-0.3, 0.0]])
    ours, moments = {"w": jnp.array([1.0, 2.0])}, adam_init({"w": jnp.zeros(2)})
    expected, mean, square = np.array([1.0, 2.0]), np.zeros(2), np.zeros(2)
    for step, gradient in enumerate(gradients, start=1):
        ours, moments = adam_step(0.1, ours, {"w": jnp.asarray(gradient, jnp.float32)}, moments)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        expected -= 0.1 * (mean / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
        np.testing.assert_allclose(ours["w"], expected, rtol=1e-5)
    assert moments.count == 3


@pytest.mark.parametrize(("done", "share"), [(0, 1.0), (25, 0.853553), (50, 0.5), (100, 0.0), (150, 0.0)])
def test_the_rate_falls_along_half_a_cosine_and_stays_at_zero(done, share):
    moments = adam_init(jnp.zeros(1))._replace(count=jnp.asarray(done))
    assert float(cosine_rate(0.2, True, 100, moments)) == pytest.approx(0.2 * share, abs=1e-6)
    assert cosine_rate(0.2, False, 100, moments) == 0.2


def test_targets_trail_by_hand():
    moved = trail({"w": jnp.array([1.0, 0.0])}, {"w": jnp.array([5.0, 4.0])}, 0.25)
    assert moved["w"].tolist() == [2.0, 1.0]
