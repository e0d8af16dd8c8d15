"""The kitchen: its tasks against the simulator, its demonstrator against its tasks, its recordings against both."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from guider.collect import kitchen as collect
from guider.collect.kitchen import OTHER_CHAINS, PLAY_DECK, WHOLE, Recipe, record, solved_rows
from guider.collect.kitchen_demos import EPISODE_STEPS, FINGER_NOISE, NOISE_SPREADS, PLANS, _tremor, demonstrate
from guider.collect.reaching import LIMIT_MARGIN_RAD, Hand, joint_step
from guider.data import load
from guider.data.readers.kitchen import kitchen_states
from guider.data.write import write_d4rl
from guider.errors import GuiderError
from guider.evaluation import rollouts as evaluation
from guider.tasks import find_task
from guider.tasks.kitchen import GOAL_INDICES, KITCHEN_TASKS, MIXED, RADIUS, SUBTASKS, goal_vector, make_simulator

COMPLETE, PARTIAL, MIXED_TASK, *_ = KITCHEN_TASKS
RECIPE = Recipe(
    make_env=partial(make_simulator, "D4RL"),
    deck=(WHOLE,),
    goal=goal_vector(WHOLE),
    goal_indices=GOAL_INDICES,
    goal_parts=COMPLETE.goal_parts,
    radius=RADIUS,
    solved_only=True,
)


@pytest.fixture(scope="module")
def simulator():
    env = make_simulator("D4RL")
    yield env
    env.close()


@pytest.fixture(scope="module")
def whole_demo(simulator):
    """States and actions of a demonstration of WHOLE, and the seed of its reset."""
    states, actions = demonstrate(simulator, WHOLE, np.random.default_rng(3))
    return states, actions, int(np.random.default_rng(3).integers(2**31))


# The tasks


def test_goals_are_the_simulators(simulator):
    for name, subtask in SUBTASKS.items():
        np.testing.assert_array_equal(simulator.goal[name], subtask.values)
    marks = np.arange(30.0)
    simulator.data.qpos[:] = marks
    achieved = simulator._get_obs(np.zeros(18))["achieved_goal"]
    for name, subtask in SUBTASKS.items():
        np.testing.assert_array_equal(achieved[name], marks[list(GOAL_INDICES)][list(subtask.entries)])


def test_states_and_goals_of_an_episode(simulator):
    env = MIXED_TASK.make_env(1)
    try:
        states, goals = env.reset(np.array([7]))
    finally:
        env.close()
    simulator.reset(seed=7)
    np.testing.assert_allclose(states[0], simulator.data.qpos, atol=1.01e-2)  # sensors are noisy
    named = sorted(entry for part in MIXED_TASK.goal_parts for entry in part)
    assert named == [2, 3, 8, 9, 13, *range(14, 21)]
    others = np.delete(np.arange(21), named)
    np.testing.assert_array_equal(goals[0, others], 0.0)
    np.testing.assert_allclose(states[0, 9:][others], 0.0, atol=0.007 + 1.01e-2)
    np.testing.assert_allclose(goals[0, [2, 8, 13, 15]], [-0.88, -0.69, -0.75, 0.75])


@pytest.mark.parametrize(("name", "arm", "objects"), [("", 1e-2, 1e-2), ("-gymnasium", 1e-3, 5e-5)])
def test_sensors_are_as_noisy_as_in_the_kitchen_named(name, arm, objects):
    """Seen at rest: the arm's nine positions have one amplitude, the objects' at most the one given (rad, m)."""
    task = find_task(f"kitchen-partial{name}")
    assert task.environment.endswith(f"{'Gymnasium' if name else 'D4RL'}'s sensor noise")
    env = task.make_env(1)
    try:
        states = np.concatenate([env.reset(np.array([seed]))[0] for seed in range(60)])
    finally:
        env.close()
    spreads = np.ptp(states, axis=0) / 2
    assert np.all((0.9 * arm < spreads[:9]) & (spreads[:9] <= 1.001 * arm))
    assert 0.9 * objects < spreads[9:].max() <= 1.001 * objects


def test_importing_is_cheap_and_building_is_silent():
    program = (
        "import sys, guider.tasks.kitchen as kitchen\n"
        "assert 'gymnasium_robotics' not in sys.modules\n"
        "kitchen.make_simulator('D4RL').close()\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def replayed(monkeypatch, task, actions: np.ndarray, seed: int) -> tuple[float, int]:
    """Score and steps that evaluation gives an episode of these actions, and of none after them."""
    schedule = iter([*actions, *np.zeros((EPISODE_STEPS, 9))])
    monkeypatch.setattr(evaluation, "initial_state", lambda policy, count: None)
    monkeypatch.setattr(evaluation, "compiled_act", lambda *inputs: (next(schedule)[None], None))
    policy: Any = SimpleNamespace(method="gcsl")  # `actions` answer in its place
    rollouts = evaluation.rollout(policy, task, 1, seed)
    return float(rollouts.score[0]), int(rollouts.steps[0])


def completions(simulator, actions: np.ndarray, seed: int) -> dict[str, int]:
    """The simulator's own account: subtask -> step after which it was first done."""
    simulator.reset(seed=seed)
    steps: dict[str, int] = {}
    for step, action in enumerate(actions, start=1):
        *_, info = simulator.step(action)
        steps |= {subtask: step for subtask in info["step_task_completions"] if subtask not in steps}
    return steps


def test_scores_agree_with_the_simulator(monkeypatch, simulator, whole_demo):
    _, actions, seed = whole_demo
    done = completions(simulator, actions, seed)
    assert set(done) == set(WHOLE)
    assert replayed(monkeypatch, PARTIAL, actions, seed) == (100.0, max(done.values()))
    assert replayed(monkeypatch, PARTIAL, actions[: done["kettle"]], seed) == (50.0, EPISODE_STEPS)
    assert replayed(monkeypatch, MIXED_TASK, actions, seed) == (75.0, EPISODE_STEPS)


# The demonstrator


def test_hand_axes():
    np.testing.assert_allclose(Hand(np.zeros(3)).rotation, [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    np.testing.assert_allclose(Hand(np.zeros(3), yaw_rad=np.pi / 2).ahead(2.0).position, [-2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(Hand(np.zeros(3), pitch_rad=np.pi / 2).ahead(2.0).position, [0, 0, 2], atol=1e-12)
    rotation = Hand(np.zeros(3), yaw_rad=0.4, pitch_rad=-0.7).rotation
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_joint_step_by_hand():
    """Six joints that each move one coordinate, and a seventh that moves nothing and so goes to its posture."""
    jacobian = np.eye(6, 7)
    limits = np.tile([-1.0, 1.0], (7, 1))
    motion = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.1])
    posture = np.array([0.0] * 6 + [0.4])
    step = joint_step(jacobian, motion, np.zeros(7), posture, limits)
    damped_move = 0.1 / (1 + 0.02**2)
    damped_turn = 0.1 * 0.3**2 / (0.3**2 + 0.02**2)
    np.testing.assert_allclose(step, [damped_move, 0, 0, 0, 0, damped_turn, 0.05 * 0.4], atol=1e-12)


def test_joints_at_their_limits_leave_the_motion_to_others():
    """Joints 0 and 6 both move coordinate 0; joint 0 is at its upper limit, so joint 6 does it alone."""
    jacobian = np.eye(6, 7)
    jacobian[0, 6] = 1.0
    limits = np.tile([-1.0, 1.0], (7, 1))
    joints = np.array([1.0 - LIMIT_MARGIN_RAD, 0, 0, 0, 0, 0, 0])
    motion = np.array([0.1, 0, 0, 0, 0, 0])
    step = joint_step(jacobian, motion, joints, joints, limits)
    assert step[0] == 0.0
    assert step[6] == pytest.approx(0.1, rel=1e-3)
    back = joint_step(jacobian, -motion, joints, joints, limits)  # the limit bars no way back
    np.testing.assert_allclose(back[[0, 6]], -0.05, rtol=1e-3)


def test_tremor_is_a_stationary_autoregression():
    noise = np.stack([_tremor(np.random.default_rng(seed)) for seed in range(400)])
    joints, fingers = noise[..., :7], noise[..., 7:]
    low, high = NOISE_SPREADS
    expected = np.sqrt((low**2 + low * high + high**2) / 3)  # root of the mean square of a uniform spread
    for part in joints[:, 0], joints[:, -1], joints:
        assert part.std() == pytest.approx(expected, rel=0.06)
    assert fingers.std() == pytest.approx(FINGER_NOISE * expected, rel=0.06)
    assert (joints[:, 1:] * joints[:, :-1]).mean() / (joints**2).mean() == pytest.approx(0.7, abs=0.01)


@pytest.mark.parametrize("subtask", PLANS)
def test_demonstrator_does_every_subtask(simulator, subtask):
    states, actions = demonstrate(simulator, (subtask,), np.random.default_rng(0))
    assert simulator.episode_task_completions == [subtask]
    assert states.shape == (len(actions) + 1, 30)
    assert np.abs(actions).max() <= 1.0


def test_demonstrations_can_be_replayed_and_differ(simulator, whole_demo):
    states, actions, seed = whole_demo
    observation, _ = simulator.reset(seed=seed)
    np.testing.assert_array_equal(kitchen_states(observation["observation"]).astype(np.float32), states[0])
    for action, state in zip(actions, states[1:], strict=True):
        observation, *_ = simulator.step(action)
        np.testing.assert_array_equal(kitchen_states(observation["observation"]).astype(np.float32), state)
    other_states, _ = demonstrate(simulator, ("microwave",), np.random.default_rng(4))
    assert np.abs(other_states[:40] - states[:40]).max() > 0.02


# Recordings


def test_play_deck_is_made_up_as_d4rls():
    assert len(PLAY_DECK) == 601
    assert sum(set(chain) == set(WHOLE) for chain in PLAY_DECK) == 19
    assert not any(set(chain) >= set(MIXED) for chain in PLAY_DECK)
    assert len(set(OTHER_CHAINS)) == len(OTHER_CHAINS)
    assert all(len(set(chain)) == 4 and set(chain) <= set(PLANS) for chain in PLAY_DECK)


def test_solved_rows_by_hand():
    states = np.zeros((9, 30))
    goal = np.array(RECIPE.goal)
    for row, subtask in zip((2, 3, 6, 5), WHOLE, strict=True):
        entries = list(SUBTASKS[subtask].entries)
        states[row, [9 + entry for entry in entries]] = goal[entries]  # done in this row, then undone
    assert solved_rows(RECIPE, states) == 7
    assert solved_rows(RECIPE, states[:6]) == 0


def test_recordings_are_whole_reproducible_and_readable(tmp_path):
    """Two worker processes record what one process records in any order, each demonstration up to its success."""
    recipe = replace(RECIPE, deck=(("light switch",),), goal_parts=(SUBTASKS["light switch"].entries,))
    steps, reports = 290, []
    recording = record(recipe, steps, 11, lambda done, total: reports.append((done, total)), cores=2)
    demos = collect._demonstrations(recipe, 11, np.arange(len(recording.lengths))[::-1])[::-1]
    np.testing.assert_array_equal(recording.observations, np.concatenate([states for states, _ in demos])[:steps])
    np.testing.assert_array_equal(recording.actions[: len(demos[0][1])], demos[0][1])
    assert recording.lengths[:-1].tolist() == [len(states) for states, _ in demos[:-1]]
    assert recording.lengths.sum() == len(recording.actions) == steps
    assert recording.goals is not None
    np.testing.assert_array_equal(recording.goals, np.array([RECIPE.goal] * steps, np.float32))
    for states, _ in demos:
        assert solved_rows(recipe, states) == len(states) and solved_rows(recipe, states[:-1]) == 0
    assert reports[0] == (0, steps) and reports[-1] == (steps, steps)

    write_d4rl(tmp_path / "kitchen.hdf5", recording, GOAL_INDICES, RADIUS, COMPLETE.goal_parts)
    episodes = load(tmp_path / "kitchen.hdf5", GOAL_INDICES)
    assert episodes.lengths.tolist() == recording.lengths.tolist()
    np.testing.assert_array_equal(episodes.observations, recording.observations)
    np.testing.assert_array_equal(episodes.goals, recording.goals)


def test_unsolved_demonstrations_are_left_out_or_kept():
    """A deck that cannot solve the goal: nothing is kept of it, or everything."""
    unsolved = replace(RECIPE, deck=(("light switch",),))
    assert collect._demonstrations(unsolved, 0, np.array([0])) == []
    ((states, actions),) = collect._demonstrations(replace(unsolved, solved_only=False), 0, np.array([0]))
    assert len(states) == len(actions) + 1


def test_too_few_steps_are_refused():
    with pytest.raises(GuiderError, match="cannot record 1 steps"):
        record(RECIPE, 1, 0, lambda done, total: None, cores=1)


def test_task_facts():
    names = ["kitchen-complete", "kitchen-partial", "kitchen-mixed"]
    assert [task.name for task in KITCHEN_TASKS] == [*names, *(f"{name}-gymnasium" for name in names)]
    assert COMPLETE.goal_parts == PARTIAL.goal_parts != MIXED_TASK.goal_parts
    assert [task.collector.steps for task in KITCHEN_TASKS if task.collector] == 2 * [3_680, 136_950, 136_950]
