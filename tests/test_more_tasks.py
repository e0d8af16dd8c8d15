"""Tasks beyond the paper: Gymnasium's AntMaze, any goal environment, OGBench, and mazes of one's own."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from guider.data.catalogue import CATALOGUE, find_dataset
from guider.data.episodes import Episodes, make_episodes
from guider.data.write import write_d4rl
from guider.errors import GuiderError
from guider.tasks import TASKS, Task, antmaze, find_task, pointmaze
from guider.tasks.gymnasium_tasks import make_antmaze
from guider.tasks.mazes import make_maze
from guider.tasks.ogbench_tasks import OGBENCH_TASKS, make_env
from guider.tasks.replay import check_replay


def test_tasks_are_listed_without_loading_their_simulators():
    heavy = "gymnasium_robotics", "ogbench", "minari"
    code = f"import sys, guider.tasks; print([name for name in {heavy} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


@pytest.mark.parametrize("find, names", [(find_task, TASKS), (find_dataset, CATALOGUE)])
def test_a_name_that_is_none_is_answered_by_those_like_it_or_a_few(find, names):
    with pytest.raises(GuiderError, match=r"'antmaze-large-diverze'; did you mean antmaze-large-diverse"):
        find("antmaze-large-diverze")
    with pytest.raises(
        GuiderError, match=rf"'zzz'; there are {next(iter(names))}, .* and {len(names) - 12} more( \(|;)"
    ):
        find("zzz")


def roll(task: Task, seeds: np.ndarray, steps: int) -> tuple[Episodes, np.ndarray]:
    """Random actions in the task's environment: the episodes [len(seeds)], and their goals."""
    rng = np.random.default_rng(0)
    env = task.make_env(len(seeds))
    first, goals = env.reset(seeds)
    everyone = np.ones(len(seeds), bool)
    actions = rng.uniform(-1, 1, (steps, len(seeds), task.action_dim)).astype(np.float32)
    observations = np.stack([first, *(env.step(action, everyone) for action in actions[:-1])])
    env.close()
    observations, actions = (np.swapaxes(array, 0, 1).reshape(-1, array.shape[2]) for array in (observations, actions))
    lengths = [steps] * len(seeds)
    return make_episodes(observations, actions, lengths, task.goal_indices, source="random.hdf5"), goals


# Whose robot recorded the data


@pytest.fixture(scope="module")
def recorded() -> Episodes:
    return roll(find_task("antmaze-large-diverse"), np.arange(20), steps=15)[0]


def test_data_of_the_same_robot_is_accepted(recorded):
    find_task("antmaze-large-diverse").check_data(recorded)
    find_task("antmaze-large-play").check_data(recorded)


def test_data_of_another_robot_is_refused(recorded):
    strong = antmaze.ant_model(make_maze("large", 4.0)).__copy__()
    strong.actuator_gear[:, 0] = 150.0
    with pytest.raises(GuiderError, match=r"random\.hdf5 was recorded on another robot") as caught:
        check_replay(lambda: strong, antmaze.FRAME_SKIP, "the strong ant", recorded)
    assert "the strong ant" in str(caught.value) and "\n" not in str(caught.value)


def test_data_from_inside_the_walls_is_refused(recorded):
    """Steps from around the start cell, moved 8 m along y: there, medium has a wall, cell (3, 1)."""
    shifted = recorded.observations + 8.0 * np.eye(29, dtype=np.float32)[1]
    with pytest.raises(GuiderError, match="another maze"):
        find_task("antmaze-medium-play").check_data(replace(recorded, observations=shifted))


def test_the_whole_data_is_looked_at(recorded):
    """Actions that were not those taken, in the first or the last 60 % of episodes."""
    for wrong in (slice(0, 180), slice(120, 300)):
        actions = recorded.actions.copy()
        actions[wrong] *= -1
        with pytest.raises(GuiderError, match="another robot"):
            find_task("antmaze-large-diverse").check_data(replace(recorded, actions=actions))


def test_steps_between_episodes_are_no_steps(recorded):
    """Two-row episodes: a quarter of the steps is wrong, which the median bears; with the jumps it would be most."""
    pairs = np.arange(300).reshape(-1, 15)[:, :14].reshape(-1)
    actions = recorded.actions[pairs]
    actions[::8] *= -1
    split = make_episodes(recorded.observations[pairs], actions, [2] * 140, (0, 1))
    shuffled = split.select(np.random.default_rng(0).permutation(140))
    find_task("antmaze-large-diverse").check_data(shuffled)


# Gymnasium-Robotics' AntMaze


@pytest.mark.parametrize(
    ("name", "start_xy", "goal_xy"),
    [  # the origin is the centre of the map, y points up: cell (1, 1) of the 9 x 12 maze is at (-18, 12)
        ("gym-antmaze-umaze", (-4, -4), (-4, 4)),
        ("gym-antmaze-umaze-diverse", (-4, 4), (-4, -4)),
        ("gym-antmaze-medium-play", (-10, 10), (10, -10)),
        ("gym-antmaze-large-diverse", (-18, 12), (14, -12)),
    ],
)
def test_gymnasium_ants_start_and_aim_within_a_metre_of_their_cells(name, start_xy, goal_xy):
    env = find_task(name).make_env(2)
    resets = [env.reset(np.array([2 * i, 2 * i + 1])) for i in range(40)]
    env.close()
    observations, goals = (np.concatenate(arrays) for arrays in zip(*resets, strict=True))
    for offsets in observations[:, :2] - start_xy, goals - goal_xy:
        assert np.abs(offsets).max() <= 1.0
        assert (offsets.min(axis=0) < -0.8).all() and (offsets.max(axis=0) > 0.8).all()


def test_each_robot_refuses_data_of_the_other():
    d4rl, gym = find_task("antmaze-umaze-diverse"), find_task("gym-antmaze-umaze-diverse")
    weak, strong = (roll(task, np.arange(8), 15)[0] for task in (d4rl, gym))
    d4rl.check_data(weak)
    gym.check_data(strong)
    for task, foreign in (d4rl, strong), (gym, weak):
        with pytest.raises(GuiderError, match="another robot"):
            task.check_data(foreign)


def test_gymnasiums_radius_is_the_tasks_and_the_goal_outlives_success():
    task = find_task("gym-antmaze-umaze")
    env = make_antmaze("AntMaze_UMaze-v5", make_maze("umaze", 4.0))
    ant: Any = env.unwrapped
    rng = np.random.default_rng(0)
    outcomes = []
    first, _ = env.reset(seed=0)
    for _ in range(60):
        qpos = ant.data.qpos.copy()
        qpos[:2] = first["desired_goal"] + rng.uniform(-0.6, 0.6, 2)
        ant.ant_env.set_state(qpos, 0 * ant.data.qvel)
        observation, _, terminated, _, info = env.step(np.zeros(8))
        distance = np.linalg.norm(observation["achieved_goal"] - first["desired_goal"])
        assert info["success"] == (distance <= task.radius) and not terminated
        np.testing.assert_array_equal(observation["desired_goal"], first["desired_goal"])
        outcomes.append(info["success"])
    env.close()
    assert 10 < sum(outcomes) < 50


@pytest.mark.parametrize("make", [lambda: find_task("gym-antmaze-umaze").make_env(1), lambda: ogbench_env("antmaze")])
def test_environments_leave_no_files_behind(make, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "inner"))
    (tmp_path / "inner").mkdir()
    make().close()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


# Any goal environment


class Toy(gymnasium.Env):
    """Two numbers that actions move; their first is the third entry of `observation`, their second the first."""

    action_space = spaces.Box(-1, 1, (2,), np.float64)
    observation_space = spaces.Dict(
        {
            "observation": spaces.Box(-np.inf, np.inf, (3,), np.float64),
            "achieved_goal": spaces.Box(-np.inf, np.inf, (2,), np.float64),
            "desired_goal": spaces.Box(-np.inf, np.inf, (2,), np.float64),
        }
    )

    def __init__(self, scale: float = 1.0):
        self.scale = scale  # of the second number in `observation`; unless 1, it is not the achieved goal

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = self.np_random.normal(size=2)
        self.goal = self.np_random.normal(size=2)
        return self.observe(), {}

    def step(self, action):
        self.position = self.position + action
        return self.observe(), 0.0, False, False, {}

    def observe(self):
        entries = np.array([self.scale * self.position[1], 7.0, self.position[0]])
        return {"observation": entries, "achieved_goal": self.position, "desired_goal": self.goal}


def make_toy(**options: float) -> gymnasium.Env:
    return Toy(**options)


@pytest.fixture
def toys():
    gymnasium.register("Toy-v0", make_toy, max_episode_steps=200)
    gymnasium.register("ScaledToy-v0", make_toy, max_episode_steps=200, kwargs={"scale": 2.0})
    gymnasium.register("EndlessToy-v0", make_toy)
    yield
    for name in ("Toy-v0", "ScaledToy-v0", "EndlessToy-v0"):
        del gymnasium.registry[name]


def test_goal_entries_are_found_in_the_state(toys):
    task = find_task("gym:Toy-v0?radius=0.25")
    assert (task.goal_indices, task.state_dim, task.action_dim) == ((2, 0), 3, 2)
    assert (task.radius, task.reach_radius, task.horizon_steps, task.period_steps) == (0.25, 0.5, 200, 10)
    assert (task.score, task.name) == ("return", "gym:Toy-v0?radius=0.25")
    episodes, goals = roll(task, np.arange(3), 4)
    moves = np.diff(episodes.achieved[:4], axis=0)
    np.testing.assert_allclose(moves, episodes.actions[:3], atol=1e-6)
    assert len(np.unique(goals)) == 6


def test_a_goal_outside_the_state_is_put_in_front(toys):
    task = find_task("gym:ScaledToy-v0?radius=0.25")
    assert (task.goal_indices, task.state_dim) == ((0, 1), 5)
    rows = roll(task, np.arange(3), 4)[0].observations
    np.testing.assert_allclose(rows[:, 2:], np.stack([2 * rows[:, 1], np.full(12, 7.0), rows[:, 0]], axis=1))


def test_what_an_environment_does_not_say_must_be_given(toys):
    with pytest.raises(GuiderError, match=r"its radius; add it: gym:Toy-v0\?radius=NUMBER"):
        find_task("gym:Toy-v0")
    with pytest.raises(GuiderError, match=r"its horizon; add it: gym:EndlessToy-v0\?radius=1&horizon=NUMBER"):
        find_task("gym:EndlessToy-v0?radius=1")
    assert find_task("gym:EndlessToy-v0?radius=1&horizon=30").horizon_steps == 30


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gym:Toy-v0?radius=near", "radius=near is neither"),
        ("gym:Toy-v0?radius=", "radius= is neither"),
        ("gym:Toy-v0?radius=-1", "radius must be above 0"),
        ("gym:Toy-v0?radius=inf", "radius must be above 0 and finite"),
        ("gym:Toy-v0?radius=nan", "radius must be above 0 and finite"),
        ("gym:Toy-v0?period=3", "period=3 is neither"),
        ("gym:NoSuchThing-v0", "NoSuchThing-v0 cannot be made"),
        ("gym:no_such_module:Thing-v0", "no_such_module:Thing-v0 cannot be made"),
        ("gym:CartPole-v1", "gym:CartPole-v1 is no goal environment"),
    ],
)
def test_environments_that_are_no_task_are_refused(toys, name, message):
    with pytest.raises(GuiderError, match=message) as caught:
        find_task(name)
    assert "\n" not in str(caught.value)


def test_a_module_may_register_the_environment(toys, tmp_path, monkeypatch):
    (tmp_path / "my_robot.py").write_text(
        "import gymnasium\ngymnasium.register('Mine-v0', gymnasium.spec('Toy-v0').entry_point, max_episode_steps=20)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    task = find_task("gym:my_robot:Mine-v0?radius=1")
    assert (task.horizon_steps, task.period_steps) == (20, 5)


@pytest.mark.parametrize(
    ("name", "state_dim", "goal_indices", "radius", "horizon_steps"),
    [
        ("gym:FetchReach-v4", 10, (0, 1, 2), 0.05, 50),
        ("gym:FetchPush-v4", 25, (3, 4, 5), 0.05, 50),
        ("gym:PointMaze_UMaze-v3?radius=0.45", 4, (0, 1), 0.45, 300),
        ("gym:AntMaze_Open-v5?radius=0.45", 107, (0, 1), 0.45, 700),
    ],
)
def test_gymnasium_robotics_environments_describe_themselves(name, state_dim, goal_indices, radius, horizon_steps):
    pytest.importorskip("gymnasium_robotics")
    task = find_task(name)
    assert (task.state_dim, task.goal_indices, task.radius, task.horizon_steps) == (
        state_dim,
        goal_indices,
        radius,
        horizon_steps,
    )


# OGBench


def ogbench_env(robot: str, maze: str = "large") -> gymnasium.Env:
    pytest.importorskip("ogbench", reason="ogbench is not installed")
    return make_env(f"{robot}-{maze}-v0", find_task(f"ogbench-{robot}-{maze}-navigate-v0").radius)


@pytest.mark.parametrize("task", OGBENCH_TASKS, ids=lambda task: task.name)
def test_ogbench_is_as_the_table_says(task):
    _, robot, size, *_ = task.name.split("-")
    env = ogbench_env(robot, size)
    maze: Any = env.unwrapped
    assert env.observation_space.shape == (task.state_dim,) and env.action_space.shape == (task.action_dim,)
    assert env.spec is not None and env.spec.max_episode_steps == task.horizon_steps
    np.testing.assert_array_equal(maze.maze_map, task.maze.walls)
    first = maze.task_infos[0]
    assert (first["init_ij"], first["goal_ij"]) == (task.maze.start_cell, task.maze.goal_cell)
    np.testing.assert_array_equal(first["goal_xy"], task.maze.cell_centre(task.maze.goal_cell))
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


# Mazes of one's own


def test_a_drawn_maze_is_recorded_and_evaluated_like_the_others(tmp_path):
    path = tmp_path / "bend.txt"
    path.write_text("######\n#S...#\n####.#\n#G...#\n######\n")
    task = find_task(f"pointmaze:{path}")
    assert (task.name, task.horizon_steps) == (f"pointmaze:{path}", 105)  # 8 cells: 12.5 * 8 + 5
    assert task.maze is not None and task.collector is not None

    recording = task.collector.record(2_000, 0, lambda done, total: None)
    cells = task.maze.cell_of(recording.observations[:, :2])
    assert not task.maze.walls[tuple(cells.T)].any()
    assert len(np.unique(cells, axis=0)) == len(task.maze.free_cells)
    assert recording.lengths[0] == 37  # (15 * 8 + 30) / 4: too short for the route
    write_d4rl(tmp_path / "bend.hdf5", recording, task.goal_indices, task.radius)
    episodes = make_episodes(recording.observations, recording.actions, recording.lengths, (0, 1))
    task.check_data(episodes)
    strong = pointmaze.point_model(task.maze).__copy__()
    strong.actuator_gear[:, 0] *= 2
    with pytest.raises(GuiderError, match="another robot"):
        check_replay(lambda: strong, pointmaze.FRAME_SKIP, "a strong ball", episodes)
    resting = make_episodes(np.zeros((50, 4)), np.zeros((50, 2)), [50], (0, 1))
    task.check_data(resting)

    env = task.make_env(20)
    starts, goals = env.reset(np.arange(20))
    env.close()
    assert np.abs(starts[:, :2]).max() <= 0.1
    assert np.abs(goals - [0.0, 2.0]).max() <= 0.25


def test_the_horizons_of_the_known_mazes_follow_from_their_routes():
    horizons = {name: TASKS[name].horizon_steps for name in TASKS if name.startswith("pointmaze-")}
    assert horizons == {"pointmaze-umaze": 80, "pointmaze-medium": 130, "pointmaze-large": 180}
