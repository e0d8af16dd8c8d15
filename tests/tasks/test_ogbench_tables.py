"""OGBench's tables are its own."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import roll

from guider.data.catalogue import CATALOGUE
from guider.errors import GuiderError
from guider.tasks import find_task
from guider.tasks.ogbench_tables import TABLE_TASKS, cubes_goal, make_env

ENVIRONMENTS = [task for task in TABLE_TASKS if "-play-v0" in task.name]


@pytest.mark.parametrize("task", ENVIRONMENTS, ids=lambda task: task.name)
def test_a_goal_is_met_where_ogbench_says_so(task):
    """Things are put about where they shall be, or somewhat off; the environment judges, and the task."""
    pytest.importorskip("ogbench")
    env_id = task.name.removeprefix("ogbench-").replace("-play", "")
    assert gymnasium.spec(env_id).max_episode_steps == task.horizon_steps
    env = task.make_env(1)
    copy = env._envs[0]
    table: Any = copy.unwrapped
    rng = np.random.default_rng(0)
    radii = np.array(task.part_radii or [task.radius])
    outcomes = []
    for seed in range(60):
        state, goal = env.reset(np.array([seed]))
        assert state.shape == (1, task.state_dim) and goal.shape == (1, len(task.goal_indices))
        put_in_place(table, rng)
        table.post_step()
        achieved = table.compute_observation()[list(task.goal_indices)]
        parts = [np.linalg.norm((achieved - goal[0])[list(part)]) for part in task.goal_parts]
        met = bool(np.all(parts <= radii))
        assert met == table._success
        outcomes.append(met)
    env.close()
    assert 10 < sum(outcomes) < 55


def put_in_place(table: Any, rng: np.random.Generator) -> None:
    """Each thing up to one and a half radii from where it shall be."""
    slack = rng.uniform(0.0, 1.5)
    for cube, target in enumerate(getattr(table, "_cube_target_mocap_ids", ())):
        away = rng.standard_normal(3)
        place = table.data.mocap_pos[target] + 0.04 * slack * away / np.linalg.norm(away)
        table.data.joint(f"object_joint_{cube}").qpos[:3] = place
    if hasattr(table, "_target_button_states"):
        table._cur_button_states = table._target_button_states.copy()
        if rng.random() < 0.3:
            table._cur_button_states[0] ^= 1
        for button in range(len(table._cur_button_states)):
            table.data.joint(f"buttonbox_joint_{button}").qpos[0] = 0.0
    if hasattr(table, "_target_drawer_pos"):
        table.data.joint("drawer_slide").qpos[0] = table._target_drawer_pos + 0.04 * slack * rng.choice([-1, 1])
        table.data.joint("window_slide").qpos[0] = table._target_window_pos + 0.04 * slack * rng.choice([-1, 1])
    table.pre_step()


def test_a_scene_counts_drawer_and_window_in_metres():
    task = find_task("ogbench-scene-play-v0")
    assert task.radius == 0.4 and task.part_radii == pytest.approx((0.4, 0.4, 0.4, 0.72, 0.6))


def test_goals_are_taken_in_turn_and_an_episode_is_determined_by_its_seed():
    pytest.importorskip("ogbench")
    task = find_task("ogbench-cube-double-play-v0")
    many, goals = roll(task, np.arange(5, 10), 8)
    np.random.seed(1)  # noqa: NPY002  (OGBench's own resets draw from it)
    again, goals_again = roll(task, np.arange(5, 10), 8)
    np.testing.assert_array_equal(many.observations, again.observations)
    np.testing.assert_array_equal(goals, goals_again)
    swapped = np.array([[0, 1, 0.2, 0, -1, 0.2], [0, -1, 0.2, 0, 1, 0.2]])  # task 4, whichever cube is which
    assert goals.shape == (5, 6) and np.any(np.all(np.isclose(goals[3], swapped, atol=1e-5), axis=1))
    stacked = goals[4].reshape(2, 3)
    np.testing.assert_allclose(np.sort(stacked[:, 2]), [0.2, 0.6], atol=1e-5)


def test_every_kind_of_data_of_these_tables_has_a_task():
    tables = "cube-single", "cube-double", "cube-triple", "scene", "puzzle-3x3", "puzzle-4x4"
    published = {name for name in CATALOGUE if name.startswith(tables) and name.endswith("-v0")}
    tasks = {task.name.removeprefix("ogbench-").replace("-states", "") for task in TABLE_TASKS}
    assert tasks == published and len(TABLE_TASKS) == 2 * len(published)


def test_whole_states_may_be_goals_and_the_same_counts():
    """An episode is the same whichever goal is shown; the whole one holds the other, and as much of it must be met."""
    pytest.importorskip("ogbench")
    objects, whole = (find_task(f"ogbench-scene-play-{states}v0") for states in ("", "states-"))
    (seen, goals), (seen_whole, shown) = (roll(task, np.arange(2), 4) for task in (objects, whole))
    np.testing.assert_array_equal(seen.observations, seen_whole.observations)
    assert shown.shape == (2, whole.state_dim)
    np.testing.assert_allclose(shown[:, list(objects.goal_indices)], goals, atol=0.05)
    np.testing.assert_array_equal(roll(whole, np.arange(2), 2)[1], shown)
    assert whole.goal_parts == ((19, 20, 21), (29,), (33,), (36,), (38,)) and whole.part_radii == objects.part_radii
    cubes, states = (find_task(f"ogbench-cube-double-play-{of}v0") for of in ("", "states-"))
    assert cubes.places and states.places
    goal = np.arange(states.state_dim) / 10
    np.testing.assert_allclose(states.places(goal), cubes.places(goal[list(cubes.goal_indices)]))


def test_without_ogbench_the_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ogbench", None)
    with pytest.raises(GuiderError, match=r'pip install "guider-rl\[ogbench\]"'):
        make_env("cube-single-v0", cubes_goal)
