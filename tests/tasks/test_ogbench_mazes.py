"""OGBench's tasks are its own."""

from __future__ import annotations

import sys
import tempfile
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import roll

from guider.data.catalogue import CATALOGUE
from guider.errors import GuiderError
from guider.tasks import find_task
from guider.tasks.ogbench_mazes import MAZE_TASKS, make_env


@pytest.mark.parametrize("make", [lambda: find_task("gym-antmaze-umaze").make_env(1), lambda: ogbench_env("antmaze")])
def test_environments_leave_no_files_behind(make, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "inner"))
    (tmp_path / "inner").mkdir()
    make().close()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def ogbench_env(robot: str, maze: str = "large") -> gymnasium.Env:
    pytest.importorskip("ogbench", reason="ogbench is not installed")
    return make_env(f"{robot}-{maze}-v0", find_task(f"ogbench-{robot}-{maze}-navigate-v0").radius)


@pytest.mark.parametrize("task", [task for task in MAZE_TASKS if "navigate" in task.name], ids=lambda task: task.name)
def test_ogbench_is_as_the_table_says(task):
    _, robot, size, *_ = task.name.split("-")
    env = ogbench_env(robot, size)
    maze: Any = env.unwrapped
    assert env.observation_space.shape == (task.state_dim,) and env.action_space.shape == (task.action_dim,)
    assert gymnasium.spec(f"{robot}-{size}-v0").max_episode_steps == task.horizon_steps
    np.testing.assert_array_equal(maze.maze_map, task.maze.walls)
    first = maze.task_infos[0]
    assert (first["init_ij"], first["goal_ij"]) == (task.maze.start_cell, task.maze.goal_cell)
    np.testing.assert_array_equal(first["goal_xy"], task.maze.cell_centre(task.maze.goal_cell))
    env.close()


def test_every_kind_of_data_has_a_task_with_the_name_that_ogbench_gives_it():
    published = {name for name in CATALOGUE if name.split("-")[0] in ("pointmaze", "antmaze", "humanoidmaze")}
    ours = {task.name.removeprefix("ogbench-") for task in MAZE_TASKS}
    assert ours == {name for name in published if name.endswith("-v0") and CATALOGUE[name].source == "OGBench"}


def test_a_teleporter_leads_to_any_of_its_exits_and_the_seed_says_to_which():
    pytest.importorskip("ogbench")
    env = make_env("pointmaze-teleport-v0", 1.0)
    maze: Any = env.unwrapped
    entrance = 4.0 * (np.array([6, 4]) - 1)
    exits = []
    for seed in [*range(40), *range(40)]:
        env.reset(seed=seed)
        maze.set_xy(entrance + 1.0)
        seen, *_ = env.step(np.zeros(2))
        assert np.linalg.norm(seen["observation"] - entrance) < 2  # this step sees where it was
        seen, *_ = env.step(np.zeros(2))
        exits.append(np.round(seen["observation"]).tolist())
    assert exits[:40] == exits[40:]
    counts = [exits[:40].count(xy) for xy in ([24, 0], [0, 20], [36, 20])]
    assert sum(counts) == 40 and min(counts) > 5
    env.close()


def test_ogbench_episodes_take_the_five_goals_in_turn():
    pytest.importorskip("ogbench")
    task = find_task("ogbench-pointmaze-large-navigate-v0")
    routes = np.array(
        [[(0, 0), (36, 24)], [(12, 16), (0, 24)], [(12, 24), (36, 0)], [(28, 8), (12, 16)], [(0, 0), (12, 16)]]
    )
    env = task.make_env(5)
    resets = [env.reset(np.arange(5 * i, 5 * i + 5)) for i in range(30)]
    env.close()
    starts, goals = (np.stack(arrays) for arrays in zip(*resets, strict=True))
    shifts = starts - routes[:, 0], goals - routes[:, 1]
    for shift in shifts:
        assert np.abs(shift).max() <= 1.0
        np.testing.assert_allclose(shift.std(axis=(0, 1)), 1 / np.sqrt(3), rtol=0.15)
    assert abs(np.corrcoef(shifts[0].ravel(), shifts[1].ravel())[0, 1]) < 0.2


def test_an_ogbench_episode_is_determined_by_its_seed():
    pytest.importorskip("ogbench")
    task = find_task("ogbench-antmaze-medium-navigate-v0")
    many, goals = roll(task, np.arange(3, 7), 12)
    np.random.seed(1)  # noqa: NPY002  (OGBench's own resets draw from it)
    again, goals_again = roll(task, np.arange(3, 7), 12)
    np.testing.assert_array_equal(many.observations, again.observations)
    np.testing.assert_array_equal(goals, goals_again)
    assert len(np.unique(goals)) == 8


def test_ogbenchs_success_is_the_tasks():
    for robot, reach in ("antmaze", 0.7), ("pointmaze", 1.4), ("humanoidmaze", 0.7):
        env = ogbench_env(robot)
        task = find_task(f"ogbench-{robot}-large-navigate-v0")
        maze: Any = env.unwrapped
        rng = np.random.default_rng(0)
        outcomes = []
        for seed in range(40):
            goal = env.reset(seed=seed)[0]["desired_goal"]
            maze.set_xy(goal + rng.uniform(-reach, reach, 2))
            observation, _, _, _, info = env.step(np.zeros(task.action_dim))
            distance = np.linalg.norm(observation["observation"][list(task.goal_indices)] - goal)
            assert bool(info["success"]) == (distance <= task.radius)
            outcomes.append(info["success"])
        env.close()
        assert 5 < sum(outcomes) < 35


def test_ogbenchs_ant_is_d4rls():
    pytest.importorskip("ogbench")
    task = find_task("ogbench-antmaze-large-navigate-v0")
    episodes, _ = roll(task, np.arange(5), 25)
    task.check_data(episodes)
    find_task("antmaze-large-diverse").check_data(episodes)


def test_another_tolerance_is_no_ogbench_task():
    pytest.importorskip("ogbench")
    with pytest.raises(GuiderError, match=r"counts a goal as met within 0\.5 m, Guider within 1 m"):
        make_env("antmaze-medium-v0", 1.0)


def test_without_ogbench_the_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ogbench", None)
    with pytest.raises(GuiderError, match=r'pip install "guider-rl\[ogbench\]"'):
        find_task("ogbench-antmaze-large-navigate-v0").make_env(1)
