"""Gymnasium's AntMaze, and any goal environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import roll
from gymnasium import spaces

from guider.errors import GuiderError
from guider.tasks import find_task
from guider.tasks.gymnasium_tasks import make_antmaze
from guider.tasks.mazes import make_maze


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
