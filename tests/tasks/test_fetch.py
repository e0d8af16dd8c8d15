"""The Fetch tasks, their experts and their data."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from guider.collect import fetch
from guider.collect.fetch import EPISODE_STEPS, Recipe, experts_episodes, record
from guider.collect.fetch_experts import (
    axes_along,
    coasting,
    first_stroke,
    launch_velocity,
    pick,
    push,
    reach,
    second_stroke,
    slide,
    way_around,
)
from guider.data.episodes import make_episodes
from guider.errors import GuiderError
from guider.tasks.fetch import FETCH_TASKS, make_env
from guider.tasks.gymnasium_tasks import make_gymnasium

TASKS = {task.name: task for task in FETCH_TASKS}
ENV_IDS = {
    "reach": "FetchReach-v4",
    "push": "FetchPush-v4",
    "slide": "FetchSlide-v4",
    "pick": "FetchPickAndPlace-v4",
}


def recipe_of(name) -> Recipe:
    collector: Any = TASKS[name].collector
    return collector.record.args[0]


def record_quietly(recipe, steps, seed) -> Any:
    return record(recipe, steps, seed, lambda done, total: None, cores=1)


@pytest.fixture(scope="module")
def push_env():
    env = make_gymnasium(ENV_IDS["push"])
    yield env
    env.close()


def test_there_are_eight_tasks_with_the_papers_scores():
    assert {name: task.paper_score for name, task in TASKS.items()} == {
        "fetch-reach-expert": 48.0,
        "fetch-reach-mixed": 47.0,
        "fetch-push-expert": 39.9,
        "fetch-push-mixed": 33.4,
        "fetch-slide-expert": 7.6,
        "fetch-slide-mixed": 4.1,
        "fetch-pick-expert": 40.9,
        "fetch-pick-mixed": 33.2,
    }
    steps = {task.collector.steps for task in FETCH_TASKS if task.collector and "reach" not in task.name}
    assert steps == {2_040_000}


@pytest.mark.parametrize("name", ENV_IDS)
def test_facts_are_those_of_the_environment(name):
    task = TASKS[f"fetch-{name}-expert"]
    env: Any = make_gymnasium(ENV_IDS[name])
    assert env.unwrapped.distance_threshold == task.radius
    assert env.spec.max_episode_steps == task.horizon_steps == EPISODE_STEPS
    np.testing.assert_array_equal(env.action_space.high, np.ones(task.action_dim))
    seen, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(10):
        assert seen["observation"].shape == (task.state_dim,)
        np.testing.assert_array_equal(seen["observation"][list(task.goal_indices)], seen["achieved_goal"])
        seen, reward, *_ = env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        distance = np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"])
        assert (reward == 0) == (distance <= task.radius)
    env.close()


@pytest.mark.parametrize(
    ("name", "expert", "episodes", "least"),
    [("reach", reach, 3, 47), ("push", push, 5, 37), ("pick", pick, 5, 37), ("slide", slide, 10, 15)],
)
def test_experts_keep_the_goal_met(name, expert, episodes, least):
    """Mean steps of 50 at the goal, below what 200 episodes give: 48, 40, 40 and 22. Random actions give 0 to 3."""
    env = make_gymnasium(ENV_IDS[name])
    met = 0
    for seed in range(episodes):
        seen, _ = env.reset(seed=seed)
        for _ in range(EPISODE_STEPS):
            action = expert(seen["observation"], seen["desired_goal"])
            seen, reward, *_ = env.step(action.astype(np.float32))
            met += reward == 0
    env.close()
    assert met / episodes >= least


@pytest.mark.parametrize("expert", [reach, push, pick, slide])
def test_experts_stay_within_bounds_wherever_things_are(expert):
    rng = np.random.default_rng(0)
    for _ in range(500):
        observation, spread = rng.normal(size=25), 10.0 ** rng.uniform(-3, 0)
        action = expert(spread * observation, spread * rng.normal(size=3))
        assert action.shape == (4,) and np.abs(action).max() <= 1.0


def test_pyramidal_friction_slows_the_faster_component_alone():
    """From (0.6, 0.2) m/s at 0.981 m/s^2: x falls to 0.2 within 0.4/0.981 s, covering 0.4 * 0.4/0.981 m, while y covers
    0.2 * 0.4/0.981; then both stop at half the rate, covering 0.2^2/0.981 m each."""
    np.testing.assert_allclose(coasting(np.array([0.6, -0.2])), np.array([0.16 + 0.04, -(0.08 + 0.04)]) / 0.981)
    for displacement in np.random.default_rng(0).uniform(-1, 1, (20, 2)):
        np.testing.assert_allclose(coasting(launch_velocity(displacement)), displacement)


def test_the_simulated_puck_coasts_as_predicted():
    env: Any = make_gymnasium(ENV_IDS["slide"])
    env.reset(seed=0)
    joint = env.unwrapped.data.joint("object0:joint")
    joint.qpos[:2] = (1.1, 0.6)
    joint.qvel[:2] = (0.5, 0.3)
    before = joint.qpos[:2].copy()
    for _ in range(30):
        env.step(np.array([0, 0, 1, 0], np.float32))
    np.testing.assert_allclose(joint.qpos[:2] - before, coasting(np.array([0.5, 0.3])), atol=0.01)
    env.close()


def test_strokes_undo_their_laws():
    for speed in (0.3, 0.9):
        action = first_stroke(speed, 0.007)
        assert 0.93 * action - 600 * 0.007**2 / action == pytest.approx(speed)
    action = second_stroke(1.1, 0.9, -0.001)
    assert 0.62 * action + 0.46 * 0.9 + 27 * 0.001 == pytest.approx(1.1 - 0.981 * 0.04)


@pytest.mark.parametrize("start", [(0.1, 0.0), (0.2, 0.02), (0.05, -0.02), (0.0, 0.15)])
def test_the_way_around_keeps_off_the_centre_and_arrives(start):
    position, target, clearance = np.array(start), np.array([-0.08, 0.0]), 0.07
    nearest = np.inf
    for _ in range(60):
        step = way_around(position, np.zeros(2), target, clearance)
        position = position + step * min(1.0, 0.033 / np.linalg.norm(step))
        nearest = min(nearest, np.linalg.norm(position))
        if np.linalg.norm(position - target) < 1e-9:
            break
    np.testing.assert_allclose(position, target, atol=1e-9)
    assert nearest >= 0.98 * min(clearance, np.linalg.norm(start))


def test_axes_are_right_handed():
    ahead, left = axes_along(np.array([3.0, 4.0]))
    np.testing.assert_allclose(ahead, [0.6, 0.8])
    np.testing.assert_allclose(left, [-0.8, 0.6])


def test_recorded_actions_lead_from_row_to_row(push_env):
    """Also checks the layout: 51 rows, the goal throughout, no last action; the third episode is cut short."""
    recording = record_quietly(recipe_of("fetch-push-mixed"), 2 * 51 + 20, seed=4)
    np.testing.assert_array_equal(recording.lengths, [51, 51, 20])
    assert recording.observations.dtype == recording.actions.dtype == recording.goals.dtype == np.float32
    for episode in range(3):
        rows = np.arange(51 * episode, min(51 * episode + 51, 122))
        seen, _ = push_env.reset(seed=int(np.random.default_rng([4, episode]).integers(2**31)))
        for row in rows:
            np.testing.assert_array_equal(recording.observations[row], seen["observation"].astype(np.float32))
            np.testing.assert_array_equal(recording.goals[row], seen["desired_goal"].astype(np.float32))
            seen, *_ = push_env.step(recording.actions[row])
    np.testing.assert_array_equal(recording.actions[[50, 101]], 0.0)
    episodes = make_episodes(
        recording.observations,
        recording.actions,
        recording.lengths,
        TASKS["fetch-push-mixed"].goal_indices,
        goals=recording.goals,
        action_low=recording.action_low,
        action_high=recording.action_high,
    )
    assert len(episodes.starts) == 3


def test_mixed_data_has_exactly_a_tenth_of_expert_episodes_in_shuffled_order():
    chosen = experts_episodes(40_000, recipe_of("fetch-pick-mixed").expert_share, seed=0)
    assert chosen.sum() == 4_000
    per_tenth = chosen.reshape(10, -1).sum(axis=1)
    assert per_tenth.min() > 330 and per_tenth.max() < 470
    assert not np.array_equal(chosen, experts_episodes(40_000, 0.1, seed=1))
    assert experts_episodes(7, recipe_of("fetch-pick-expert").expert_share, seed=0).all()


def test_experts_are_noisy_and_the_others_uniform():
    """With an expert that does nothing, what is left of its actions is the noise."""
    still = replace(recipe_of("fetch-reach-mixed"), expert=lambda observation, goal: np.zeros(4), expert_share=0.5)
    actions = record_quietly(still, 20 * 51, 0).actions.reshape(20, 51, 4)[:, :50]
    chosen = experts_episodes(20, 0.5, seed=0)
    assert actions[chosen].std() == pytest.approx(0.1, rel=0.06)
    assert actions[~chosen].std() == pytest.approx(1 / np.sqrt(3), rel=0.03)
    assert 0.99 < np.abs(actions[~chosen]).max() <= 1.0


def test_recordings_are_equal_whatever_the_cores_and_batches(monkeypatch):
    reports = []
    monkeypatch.setattr(fetch, "EPISODES_AT_ONCE", 3)
    recipe = recipe_of("fetch-reach-mixed")
    two: Any = record(recipe, 6 * 51 - 1, 5, lambda done, total: reports.append((done, total)), 2)
    monkeypatch.setattr(fetch, "EPISODES_AT_ONCE", 50)
    one = record_quietly(recipe, 6 * 51 - 1, 5)
    for field in ("observations", "actions", "goals", "lengths"):
        np.testing.assert_array_equal(getattr(one, field), getattr(two, field))
    assert reports == [(0, 305), (153, 305), (305, 305)]
    other = record_quietly(recipe, 6 * 51 - 1, 6)
    assert not np.array_equal(one.goals, other.goals)
    with pytest.raises(GuiderError, match="at least two"):
        record_quietly(recipe, 1, 0)


def test_copies_move_as_single_environments_do_and_inactive_ones_not_at_all(push_env):
    env = make_env(ENV_IDS["push"], 3)
    states, goals = env.reset(np.array([7, 8, 9]))
    assert states.shape == (3, 25) and goals.shape == (3, 3) and states.dtype == goals.dtype == np.float32
    actions = np.random.default_rng(0).uniform(-2, 2, (10, 3, 4)).astype(np.float32)
    active = np.array([True, False, True])
    trajectory = np.array([env.step(action, active) for action in actions])
    np.testing.assert_array_equal(trajectory[:, 1], np.tile(states[1], (10, 1)))
    resumed = env.step(actions[0], ~active)
    np.testing.assert_array_equal(resumed[[0, 2]], trajectory[-1, [0, 2]])
    for copy, seed in enumerate((7, 8, 9)):
        seen, _ = push_env.reset(seed=seed)
        np.testing.assert_array_equal(goals[copy], seen["desired_goal"].astype(np.float32))
        expected = []
        for action in actions[:, copy]:
            seen, *_ = push_env.step(np.clip(action, -1, 1))
            expected.append(seen["observation"])
        moved = trajectory[:, copy] if active[copy] else resumed[None, copy]
        np.testing.assert_array_equal(moved, np.array(expected, np.float32)[: len(moved)])
    with pytest.raises(ValueError, match="2 seeds for 3 copies"):
        env.reset(np.arange(2))
    env.close()


def test_what_goes_wrong_in_a_thread_is_raised():
    env = make_env(ENV_IDS["reach"], 2)
    env.reset(np.arange(2))
    with pytest.raises(ValueError):
        env.step(np.zeros((2, 3)), np.ones(2, bool))
    env.close()
