"""Critics and the policy they guide against their published descriptions, written anew in NumPy (tests/reference.py),
in float64."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference as ref
from reference import normal, plain, shaken

from guider.critics import (
    ContrastiveConfig,
    CriticConfig,
    ImplicitQConfig,
    ImplicitVConfig,
    QuasimetricConfig,
    Steps,
    critic,
    quasimetric,
)
from guider.methods import critic_guided
from guider.methods.critic_guided import CriticGuidedConfig, Params

ROWS, STATES, PLACES, ACTIONS = 5, 3, 2, 2
HIDDEN = (4,)
DISCOUNT = 0.9


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


STEPS = dict(state=(1, ROWS, STATES), next_state=(2, ROWS, STATES), place=(3, ROWS, PLACES))


def some_steps() -> Steps:
    return Steps(
        **{name: normal(*shape) for name, shape in STEPS.items()},
        action=jnp.tanh(normal(5, ROWS, ACTIONS)),
        goal=normal(6, ROWS, PLACES),
        unmet=jnp.array([1.0, 1, 0, 1, 1]),
    )


class Asked(NamedTuple):
    """A critic with parameters, what trails them, and a batch."""

    config: Any
    params: Any
    target: Any
    steps: Steps

    def check(self, loss) -> None:
        """Whether value and gradient of the critic's loss are those of `loss`(parameters)."""
        found = critic(self.config)
        (value, _), slopes = jax.value_and_grad(
            lambda params: found.loss(self.config, params, self.target, self.steps, DISCOUNT), has_aux=True
        )(self.params)
        assert float(value) == pytest.approx(loss(plain(self.params)), rel=1e-9)
        jax.tree.map(
            lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7),
            slopes,
            ref.gradients(loss, self.params),
        )


def asked(config: CriticConfig) -> Asked:
    fresh = critic(config).init(jax.random.key(0), config, HIDDEN, STATES, PLACES, ACTIONS)
    return Asked(config, shaken(fresh), shaken(fresh, 8), some_steps())


def joined(*parts):
    return np.concatenate(parts, axis=-1)


def both(twins, seen):
    """[2, B] outputs of twin networks with one output, or [2, B, Z]."""
    outputs = np.stack([ref.layer_norm_mlp(ref.twin(twins, index), seen) for index in range(2)])
    return outputs[..., 0] if outputs.shape[-1] == 1 else outputs


def test_implicit_v_learning():
    learned = asked(ImplicitVConfig(expectile=0.8))
    learned = learned._replace(target=shaken(learned.target, 6, 1.0))
    s, target = plain(learned.steps), plain(learned.target)
    now, then = joined(s.state, s.goal), joined(s.next_state, s.goal)
    following = -s.unmet + DISCOUNT * s.unmet * both(target, then)
    better = following.min(0) >= both(target, now).mean(0)
    assert 0 < better.sum() < ROWS and np.any(better != (following.max(0) >= both(target, now).mean(0)))

    def loss(params):
        error = (following - both(params, now)) ** 2
        return (np.where(better, 0.8, 0.2) * error).mean(-1).sum()

    learned.check(loss)
    found = critic(learned.config)
    gain = (both(plain(learned.params), then) - both(plain(learned.params), now)).mean(0)
    assert found.advantage is not None
    np.testing.assert_allclose(found.advantage(learned.config, learned.params, learned.steps), gain, rtol=1e-9)


def test_implicit_q_learning():
    learned = asked(ImplicitQConfig(expectile=0.8))
    s, old = plain(learned.steps), plain(learned.params)
    pair = joined(s.state, s.goal, s.action)
    logged = both(plain(learned.target).twins, pair).min(0)
    following = ref.layer_norm_mlp(old.value, joined(s.next_state, s.goal))[:, 0]
    target = s.unmet * (-1 + DISCOUNT * following)

    def loss(params):
        miss = logged - ref.layer_norm_mlp(params.value, joined(s.state, s.goal))[:, 0]
        error = ((both(params.twins, pair) - target) ** 2).mean(1).sum()
        return (np.where(miss < 0, 0.2, 0.8) * miss**2).mean() + error

    learned.check(loss)
    found = critic(learned.config)
    assert found.quality is not None
    np.testing.assert_allclose(
        found.quality(learned.config, learned.params, s.state, s.action, s.goal),
        both(old.twins, pair).min(0),
        rtol=1e-9,
    )


def test_contrastive():
    learned = asked(ContrastiveConfig(representation_dim=3))
    s = plain(learned.steps)

    def logits(params):
        phi, psi = both(params.doing, joined(s.state, s.action)), both(params.goal, s.goal)
        return np.array([[[np.dot(a, b) / np.sqrt(3) for b in psi[e]] for a in phi[e]] for e in range(2)])

    def loss(params):
        chance = 1 / (1 + np.exp(-logits(params)))
        own = np.eye(ROWS, dtype=bool)
        return -np.where(own, np.log(chance), np.log(1 - chance)).mean()

    learned.check(loss)
    found = critic(learned.config)
    assert found.quality is not None
    smaller = np.diagonal(logits(plain(learned.params)), axis1=1, axis2=2).min(0)
    np.testing.assert_allclose(
        found.quality(learned.config, learned.params, s.state, s.action, s.goal), smaller, rtol=1e-9
    )


def union_length(start, end) -> float:
    """Of the intervals [start_i, end_i] that go up, by cutting the line at all their ends."""
    cuts = np.sort(np.concatenate([start, end]))
    return sum(b - a for a, b in pairwise(cuts) if ((start <= a) & (b <= end)).any())


def quasidistance(start, end, intervals, share):
    """[B, Z] each -> [B]."""
    lengths = np.array(
        [
            [union_length(a, b) for a, b in zip(x.reshape(-1, intervals), y.reshape(-1, intervals), strict=True)]
            for x, y in zip(start, end, strict=True)
        ]
    )
    weight = 1 / (1 + np.exp(-share))
    return weight * lengths.mean(-1) + (1 - weight) * lengths.max(-1)


def test_an_interval_quasimetric_is_the_length_of_unions_and_a_quasimetric():
    config = QuasimetricConfig(representation_dim=12, intervals=3)
    x, y, z = (normal(seed, 200, 12) for seed in (1, 2, 3))

    def distance(a, b):
        return np.asarray(quasimetric.interval_distance(config, jnp.array(0.4), a, b))

    np.testing.assert_allclose(distance(x, y), quasidistance(np.array(x), np.array(y), 3, 0.4), rtol=1e-9)
    assert np.all(distance(x, z) <= distance(x, y) + distance(y, z) + 1e-12)
    assert np.all(distance(x, x) == 0) and np.abs(distance(x, y) - distance(y, x)).max() > 0.1
    one = QuasimetricConfig(representation_dim=3, intervals=3)
    starts = jnp.array([[0.0, 1.0, 5.0], [0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 0.0, 3.0]])
    # [0, 2] and [1, 3], the third goes down; all end at 2; 2 is where two touch; twice the same, and one apart
    ends = jnp.array([[2.0, 3.0, 4.0], [2.0, 2.0, 2.0], [2.0, 3.0, 1.0], [2.0, 2.0, 4.0]])
    lengths = quasimetric.interval_distance(one, jnp.zeros(()), starts, ends)
    assert lengths.tolist() == [3.0, 2.0, 3.0, 3.0]


def test_quasimetric():
    config = QuasimetricConfig(representation_dim=4, intervals=2, slack=0.05)
    learned = asked(config)
    s, old = plain(learned.steps), plain(learned.params)

    def embedded(params):
        state, following = (ref.layer_norm_mlp(params.state, seen) for seen in (s.state, s.next_state))
        place, goal = (ref.layer_norm_mlp(params.place, seen) for seen in (s.place, s.goal))
        guess = state + ref.layer_norm_mlp(params.dynamics, joined(state, s.action))
        return state, following, place, goal, guess

    def excess_of(params):
        state, following, place, _, _ = embedded(params)
        step = quasidistance(state, following, 2, params.mean_share)
        own = quasidistance(state, place, 2, params.mean_share)
        return (np.maximum(step - 1, 0) ** 2 + own**2).mean()

    held_multiplier, held_excess = np.exp(old.log_multiplier), excess_of(old)
    assert held_excess > 0.05

    def loss(params):
        state, following, _, goal, guess = embedded(params)
        away = quasidistance(state, goal, 2, params.mean_share)
        pushed = 100 * np.log1p(np.exp(5 - away / 100)).mean()
        held = excess_of(params) * held_multiplier + np.exp(params.log_multiplier) * (0.05 - held_excess)
        there = quasidistance(following, guess, 2, params.mean_share)
        back = quasidistance(guess, following, 2, params.mean_share)
        return pushed + held + (there + back).mean() / 2

    learned.check(loss)
    _, _, _, goal, guess = embedded(old)
    found = critic(config)
    assert found.quality is not None
    np.testing.assert_allclose(
        found.quality(config, learned.params, s.state, s.action, s.goal),
        -quasidistance(guess, goal, 2, old.mean_share),
        rtol=1e-9,
    )


@pytest.mark.parametrize("kind", [ImplicitVConfig(), ImplicitQConfig()], ids=["weighed", "climbing"])
def test_the_policy_follows_its_critic(kind):
    """Weighed: exp(A / temperature) up to 100 times half the squared miss. Climbing: minus Q of its own, clipped action
    as a share of mean |Q|, and `cloning` times half the squared miss."""
    config = CriticGuidedConfig(critic=kind, temperature=0.5, cloning=0.7)
    learned = asked(kind)
    s, judge = plain(learned.steps), plain(learned.params)
    actor = shaken(jax.tree.map(jnp.zeros_like, mlp_like()), 4, 1.0)
    params = Params(actor, learned.params)

    def acted(layers):
        return ref.mlp(layers, joined(s.state, s.goal), ref.gelu)

    def quality(action):
        return both(judge.twins, joined(s.state, s.goal, np.clip(action, -1, 1))).min(0)

    assert np.abs(acted(plain(actor))).max() > 1
    then, now = joined(s.next_state, s.goal), joined(s.state, s.goal)

    def loss(layers):
        surprise = 0.5 * ((acted(layers) - s.action) ** 2).sum(-1)
        if isinstance(kind, ImplicitVConfig):
            gain = (both(judge, then) - both(judge, now)).mean(0)
            return (np.minimum(np.exp(gain / 0.5), 100) * surprise).mean()
        size = np.abs(quality(acted(plain(actor)))).mean() + 1e-6
        return -quality(acted(layers)).mean() / size + 0.7 * surprise.mean()

    (value, _), slopes = jax.value_and_grad(
        lambda params: critic_guided.actor_loss(config, params, learned.steps), has_aux=True
    )(params)
    assert float(value) == pytest.approx(loss(plain(actor)), rel=1e-9)
    jax.tree.map(
        lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7),
        slopes.actor,
        ref.gradients(loss, actor),
    )
    assert all(not np.any(slope) for slope in jax.tree.leaves(slopes.critic)), "the critic is not moved by the policy"


def mlp_like() -> Any:
    widths = (STATES + PLACES, *HIDDEN, ACTIONS)
    return tuple((jnp.zeros((a, b)), jnp.zeros(b)) for a, b in pairwise(widths))
