"""What the method is trained on, against hand-worked cases, its presets and its switches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import make_ragged, plain_scale, tiny

from guider.data.episodes import make_episodes
from guider.errors import GuiderError
from guider.learners import GcslConfig, IqlConfig
from guider.learning.problem import Problem
from guider.learning.samplers import HighBatch, LowBatch
from guider.methods import METHODS, latent_subgoals
from guider.methods import guider as method
from guider.methods.guider import GuiderConfig, guider_config
from guider.methods.policy import Policy, act, initial_state
from guider.methods.view import Scale, ViewConfig, prepare
from guider.support.config import differences, from_dict, override, to_dict

SWITCHES = {
    "paper": {},
    "without prior (Table 2)": {"high.prior": "False"},
    "without CQL (Table 2)": {"high.critic": "td"},
    "without decoder (Figure 5)": {"low.subgoal_input": "latent"},
    "without decoder, as acting substitutes the goal": {
        "low.subgoal_input": "latent",
        "final_goal_substitution": "True",
    },
    "expectile critic": {"high.critic": "expectile"},
    "fixed conservative weight": {"high.lagrange_threshold": "None"},
    "strict relabelling": {"high.goal_offset": "1", "view.boundary": "drop"},
    "subgoal slack of the authors": {"low.subgoal_slack_steps": "5"},
}


def shapes(tree):
    return jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree)


@pytest.mark.parametrize("preset", ["paper", "fast"])
@pytest.mark.parametrize("switches", SWITCHES.values(), ids=SWITCHES)
def test_every_switch_trains_and_acts(switches, preset):
    """Traced, not run: compiling each combination would take minutes, and test_updates.py has their numbers."""
    config = override(tiny(guider_config(preset, Problem(0.5, 1.0, period_steps=5))), switches)
    episodes = make_ragged()
    data, scale = prepare(config.view, config.problem, episodes)
    state = jax.eval_shape(lambda key: method.init(config, episodes.spaces, scale, key), jax.random.key(0))
    for stage in method.stages(config):
        part, metrics = jax.eval_shape(stage.update, state, data, jax.random.key(1))
        assert shapes(part) == shapes(getattr(state, stage.part)), "what is carried from update to update"
        assert all(metric.shape == () for metric in metrics.values())
    policy = Policy(state, -jnp.ones(2), jnp.ones(2), "guider", config, (0, 1), 4)
    begun = initial_state(policy, 3)
    actions, acting = jax.eval_shape(act, policy, jnp.zeros((3, 4)), jnp.ones((3, 2)), begun, jnp.ones(3, bool))
    assert actions.shape == (3, 2) and shapes(acting) == shapes(begun)


def test_presets_are_what_they_say():
    paper = guider_config("paper", Problem(0.5, 1.0, 50))
    assert paper == GuiderConfig()
    assert differences(replace(paper, replan="reached"), paper) == {"replan": "reached"}
    assert (paper.latent.updates, paper.high.updates, paper.low.updates) == (500_000, 200_000, 500_000)
    fast = guider_config("fast", Problem(0.5, 1.0, 50))
    assert {"view.normalise", "low.relative"} < set(differences(fast, paper))
    parts = guider_config("fast", Problem(0.3, 0.3, 40, goal_parts=((0,), (1, 2)), domain="kitchen"))
    assert parts.problem.goal_parts == ((0,), (1, 2)) and parts.latent.latent_dim == 8


def test_what_routes_need_not_learn_is_not_trained_at_length():
    def changed(domain: str | None) -> dict:
        problem = Problem(0.5, 1.0, 50, domain=domain)
        return differences(guider_config("fast", problem, planner="routes"), guider_config("fast", problem))

    antmaze = {"planner": "routes", "latent.updates": 3_000, "low.learner.temperature": 0.02}
    assert changed("antmaze") == antmaze
    assert changed(None) == {"planner": "routes"}, "whether a goal lies within reach is the latent model's to say"


def test_configs_survive_json_and_name_their_faults():
    config = guider_config("fast", Problem(0.25, 0.5, 20))
    assert from_dict(GuiderConfig, to_dict(config)) == config
    assert override(config, {"low.hidden": "(8, 8)", "replan": "reached"}).low.hidden == (8, 8)
    for change, message in {
        ("high.critic", "magic"): "must be one of cql, td, expectile",
        ("low.updates", "many"): "must be of type int, got 'many'",
        ("high.relabel_fraction", "1.5"): "relabel_fraction must lie between 0 and 1",
        ("action_scale", "1.5"): "action_scale must lie between 0 and 1",
        ("precision", "float16"): "must be one of auto, float32, bfloat16",
        ("problem.radius", "-1"): "radius must be above 0",
        ("low.learner.discount", "2"): "discount must lie between 0 and 1",
        ("low.learner.kind", "magic"): "must be one of awr, cql, gcsl, iql, wgcsl",
        ("hihg.samples", "1"): "did you mean high.samples",
        ("low.hidden", "()"): "hidden must name one or more layers",
        ("low.updates", "0"): "updates must be above 0",
        ("view.normalise", "false"): "position_waves needs normalise",
    }.items():
        with pytest.raises(GuiderError, match=message):
            override(config, dict([change]))


def test_another_learner_comes_with_its_own_settings():
    config = guider_config("fast", Problem(0.25, 0.5, 20))
    assert override(config, {"low.learner.kind": "gcsl"}).low.learner == GcslConfig()
    assert override(config, {"low.learner.discount": "0.5", "low.learner.kind": "iql"}).low.learner == IqlConfig(
        discount=0.5
    )
    assert override(config, {"low.learner.kind": "awr"}) == config, "what it is already keeps its settings"
    departures = differences(override(config, {"low.learner.kind": "cql"}), config)
    assert departures["low.learner.kind"] == "cql" and "low.learner.samples" in departures
    with pytest.raises(GuiderError, match="kind must be one of awr"):
        override(config, {"low.learner.kind": ["gcsl"]})
    with pytest.raises(GuiderError, match="no setting is called"):
        override(config, {"low.learner.kind": "gcsl", "low.learner.temperature": "1"})


def test_low_inputs_and_reward_by_hand():
    config = replace(guider_config("paper", Problem(0.5, 1.0, 5)), low=replace(GuiderConfig().low, relative=True))
    scale = Scale(jnp.zeros(3), jnp.full(3, 2.0), jnp.zeros(2), jnp.full(2, 10.0), jnp.full(2, 4.0), jnp.zeros(0))
    spaces = make_ragged().spaces
    state = method.init(config, replace(spaces, state_dim=3), scale, jax.random.key(0))
    batch = LowBatch(
        observation=jnp.array([[1.0, 2.0, 6.0]]),
        action=jnp.zeros((1, 2)),
        next_observation=jnp.array([[2.0, 2.0, 6.0]]),
        achieved=jnp.array([[1.0, 2.0]]),
        next_achieved=jnp.array([[2.0, 2.0]]),
        subgoal=jnp.array([[2.4, 2.0]]),
        subgoal_steps=jnp.array([3]),
        chosen_at=jnp.array([[0.0, 2.0]]),
        goal=jnp.array([[11.0, 2.0]]),
    )
    seen = method.relabel_low(config, state, batch, jax.random.key(0))
    np.testing.assert_allclose(seen.state, [[0.5, 1.0, 3.0, 1.4 / 4, 0.0, 1.0, 0.0]], rtol=1e-6)
    np.testing.assert_allclose(seen.next_state, [[1.0, 1.0, 3.0, 0.1, 0.0, 0.9, 0.0]], rtol=1e-5)
    assert seen.steps.tolist() == [3]
    assert seen.reward.tolist() == [0.0], "0.4 m from the subgoal after the step"


def test_high_relabelling_by_hand():
    """z is drawn from the posterior of the true pair, and the reward is for meeting the goal after c steps."""
    config = guider_config("paper", Problem(0.5, 1.0, 5))
    state = method.init(config, make_ragged().spaces, plain_scale(), jax.random.key(0))
    now, later = jnp.zeros((2, 2)), jnp.array([[3.0, 0.0], [3.0, 0.0]])
    goal = jnp.array([[3.3, 0.0], [4.0, 0.0]])
    seen = method.relabel_high(config, state, HighBatch(now, later, goal), jax.random.key(1))
    assert seen.reward.tolist() == [0.0, -1.0]
    np.testing.assert_array_equal(seen.state, [[0, 0, np.float32(3.3), 0], [0, 0, 4, 0]])
    np.testing.assert_array_equal(seen.next_state, [[3, 0, np.float32(3.3), 0], [3, 0, 4, 0]])
    posterior = latent_subgoals.encode(config.latent, state.latent.params, state.scale, now, later)
    np.testing.assert_array_equal(seen.latent, posterior.sample(jax.random.key(1)))
    for prior, place in ((seen.prior, now), (seen.next_prior, later)):
        expected = latent_subgoals.prior(state.latent.params, state.scale, place)
        np.testing.assert_array_equal(prior.mean, expected.mean)


@pytest.mark.parametrize("name", ["guider", "hiql", "gcsl"])
def test_little_data_of_ones_own_is_not_learned_by_heart(name):
    """120 passes over 25,600 transitions in batches of 256 are 12,000 updates."""

    def updates(transitions: int | None, preset: Any = "fast") -> int:
        config: Any = METHODS[name].config(preset, Problem(transitions=transitions))
        return (config.low if hasattr(config, "low") else config).updates

    assert updates(25_600) == 12_000 and updates(100) == 2_000
    assert updates(10**7) == updates(None) > 20_000
    assert updates(100, "paper") > 20_000


def test_own_data_has_a_latent_for_each_goal_entry_up_to_eight():
    dims = [guider_config("fast", Problem(goal_dim=n)).latent.latent_dim for n in (None, 1, 3, 8, 21)]
    assert dims == [2, 2, 3, 8, 8]
    assert guider_config("fast", Problem(domain="kitchen", goal_dim=2)).latent.latent_dim == 8


def test_where_episodes_end_is_what_ones_own_data_says():
    """The low level has no other final goals there, nor is the robot kept from a goal within reach; and both levels
    mean the same by a subgoal."""
    for domain in (None, "gym"):
        config = guider_config("fast", Problem(domain=domain))
        assert (config.low.random_goal_fraction, config.low.future) == (0, "last") and config.final_goal_within_reach
        assert (config.low.ahead, config.replan) == ("last", "step")
    elsewhere = guider_config("fast", Problem(domain="antmaze"))
    assert (elsewhere.low.random_goal_fraction, elsewhere.low.future) == (0.5, "uniform")
    assert (elsewhere.low.ahead, elsewhere.replan) == ("uniform", "reached") and not elsewhere.final_goal_within_reach


@pytest.mark.parametrize(("ahead", "future"), [("uniform", "uniform"), ("uniform", "last"), ("last", "uniform")])
def test_the_low_level_learns_of_the_goals_that_are_asked_for(monkeypatch, ahead, future):
    episodes, seen = make_ragged(recorded_goals=False), []
    settings = {"low.ahead": ahead, "low.future": future}
    config = tiny(override(guider_config("fast", Problem(0.5, 1.0, 5)), settings))
    data, scale = prepare(config.view, config.problem, episodes)
    state = method.init(config, episodes.spaces, scale, jax.random.key(0))
    relabel = method.relabel_low
    monkeypatch.setattr(method, "relabel_low", lambda c, s, batch, key: seen.append(batch) or relabel(c, s, batch, key))
    method.stages(config)[-1].update(state, data, jax.random.key(1))
    ends = episodes.achieved[episodes.ends]

    def at_an_end(places: jax.Array) -> np.ndarray:
        return (np.asarray(places)[:, None] == ends).all(axis=-1).any(axis=1)

    assert at_an_end(seen[0].goal).all() == (future == "last")
    assert ((seen[0].subgoal_steps == 5) | at_an_end(seen[0].subgoal)).all() == (ahead == "last")


def test_targets_start_as_copies_of_the_critics():
    state = method.init(
        guider_config("paper", Problem(0.5, 1.0, 5)), make_ragged().spaces, plain_scale(), jax.random.key(1)
    )
    for part in (state.high, state.low):
        pairs = zip(jax.tree.leaves(part.params.critic), jax.tree.leaves(part.target_critic), strict=True)
        assert all(jnp.array_equal(a, b) for a, b in pairs)


def test_without_decoder_z_is_encoded_where_the_subgoal_was_chosen():
    config = override(guider_config("paper", Problem(0.5, 1.0, 5)), {"low.subgoal_input": "latent"})
    state = method.init(config, make_ragged().spaces, plain_scale(), jax.random.key(0))
    state = state._replace(latent=jax.tree.map(lambda leaf: leaf + 0.1, state.latent))
    here, chosen_at, subgoal = jnp.ones((1, 2)), jnp.array([[-3.0, 2.0]]), jnp.array([[4.0, 0.0]])
    batch = LowBatch(
        jnp.ones((1, 4)), jnp.zeros((1, 2)), jnp.ones((1, 4)), here, here, subgoal, jnp.array([3]), chosen_at, here
    )
    seen = method.relabel_low(config, state, batch, jax.random.key(1))
    posterior = latent_subgoals.encode(config.latent, state.latent.params, state.scale, chosen_at, subgoal)
    np.testing.assert_array_equal(seen.state[:, 4:6], posterior.sample(jax.random.key(1)))
    np.testing.assert_array_equal(seen.next_state[:, 4:6], seen.state[:, 4:6])


def test_small_spreads_of_goal_entries_are_not_blown_up():
    ragged = make_ragged()
    observations = np.asarray(ragged.observations) * [1.0, 1e-4, 1e-4, 1.0]
    episodes = make_episodes(observations, ragged.actions, ragged.lengths, (0, 1))
    _, scale = prepare(ViewConfig(normalise=True, smallest_spread=0.1), Problem(period_steps=5), episodes)
    plain = prepare(ViewConfig(normalise=True), Problem(period_steps=5), episodes)[1]
    assert scale.goal_std[1] == scale.state_std[1] == scale.step_std[1] == np.float32(0.1)
    assert scale.goal_std[0] == plain.goal_std[0] > 0.1
    np.testing.assert_array_equal(scale.state_std[2:], plain.state_std[2:])
