"""Recordings by OGBench's protocol: who goes where, and files that OGBench itself reads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from guider import load_data
from guider.cli import main
from guider.collect.ogbench import (
    Log,
    PlayAtTable,
    Wander,
    _episodes,
    _is_in_sight,
    _not_in_corridors,
    numpys_generator,
)
from guider.tasks import find_task
from guider.tasks.ogbench_env import make_unwrapped
from guider.tasks.ogbench_mazes import go_straight, make_maze_env

ogbench = pytest.importorskip("ogbench", reason="ogbench is not installed")

# Share of the rows in each free cell, row by row: of 80,400 of pointmaze-medium-stitch that OGBench's own
# generate_locomaze.py recorded, settings as published.
PUBLISHED = """
    0.0135 0.0151 0.0160 0.0054 0.0179 0.0377 0.0526 0.0368 0.0111 0.0608 0.0923 0.1147 0.0495
    0.0435 0.1018 0.0786 0.0249 0.0338 0.0382 0.0505 0.0261 0.0164 0.0210 0.0235 0.0096 0.0088
"""


def recorded(name: str, steps: int, seed: int = 0) -> Any:
    task = find_task(f"ogbench-{name}-v0")
    assert task.collector is not None
    return task.collector.record(steps, seed, lambda done, total: None)


class Wanderer:
    """A maze as Wander sees it, and all that it is told."""

    def __init__(self, name: str):
        self.inner = make_maze_env(name)
        self.goals: list[tuple[float, float]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def set_goal(self, goal_xy: np.ndarray) -> None:
        self.goals.append(tuple(goal_xy))
        self.inner.set_goal(goal_xy=goal_xy)


def wander(kind: Any, steps: int, seed: int, noise: float = 0.5) -> tuple[dict[str, np.ndarray], Any]:
    env, log = Wanderer("pointmaze-medium-v0"), Log()
    with numpys_generator(seed):
        Wander(kind, go_straight, noise)(env, steps, seed, log)
    return log.arrays(), env


def test_navigating_takes_up_another_goal_whenever_one_is_reached():
    arrays, env = wander("navigate", 400, 3)
    assert len(env.goals) >= 2
    for goal in env.goals[:-1]:
        away = np.linalg.norm(arrays["observations"] - goal, axis=1)
        assert away.min() <= 1.1  # OGBench: within 1 m after the step
    cells = {env.inner.xy_to_ij(goal) for goal in env.goals}
    assert cells <= {tuple(cell) for cell in _not_in_corridors(env.inner.maze_map).tolist()}


def test_stitching_goes_four_cells_and_stays():
    for seed in range(6):
        arrays, env = wander("stitch", 201, seed)
        start, end = (env.inner.xy_to_ij(xy) for xy in arrays["observations"][[0, -1]])
        _, steps = env.inner.get_oracle_subgoal(*2 * [np.array(env.inner.ij_to_xy(start))])
        assert steps[end] == 4 and env.goals == []


def test_exploring_keeps_a_direction_for_ten_steps():
    arrays, _ = wander("explore", 60, 0, noise=0.0)
    actions = arrays["actions"].reshape(6, 10, 2)
    np.testing.assert_allclose(actions, actions[:, :1].repeat(10, axis=1), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(actions, axis=-1), 1.0, atol=1e-5)
    assert len(np.unique(actions[:, 0], axis=0)) == 6


def test_a_corridor_is_what_lets_through_one_way():
    walls = np.array([[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 1, 1, 0, 1], [1, 1, 1, 1, 1]])
    assert _not_in_corridors(walls).tolist() == [[1, 1], [1, 3], [2, 3]]


def test_cells_are_visited_as_often_as_the_public_generator_visits_them():
    task = find_task("ogbench-pointmaze-medium-stitch-v0")
    recording = recorded("pointmaze-medium-stitch", 80_400, seed=1)
    assert task.maze is not None
    cells = task.maze.cell_of(recording.observations)
    shares = [np.mean(np.all(cells == cell, axis=1)) for cell in task.maze.free_cells]
    # 0.06 to 0.08 between two recordings of one generator, 0.30 from it to all cells alike
    assert np.abs(np.array(shares) - np.array(PUBLISHED.split(), float)).sum() / 2 < 0.1
    np.testing.assert_allclose(recording.actions.std(axis=0), 0.708, atol=0.01)


def test_an_episode_is_determined_by_its_number_whatever_came_before():
    task = find_task("ogbench-scene-noisy-v0")
    assert task.collector is not None
    recipe = replace(task.collector.record.args[0], episode_steps=15)  # pyright: ignore[reportFunctionMemberAccess]
    third, alone = (_episodes(recipe, 3, np.array(numbers))[-1] for numbers in ([0, 1, 2], [2]))
    assert all(np.array_equal(third[name], alone[name]) for name in third)


def test_recordings_are_determined_by_their_seed_whatever_was_drawn_before():
    first = recorded("cube-double-noisy", 40, seed=5)
    np.random.seed(3)  # noqa: NPY002  (OGBench draws from it)
    before = np.random.get_state()[1].copy()  # noqa: NPY002 # pyright: ignore
    again, other = recorded("cube-double-noisy", 40, seed=5), recorded("cube-double-noisy", 40, seed=6)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002 # pyright: ignore
    np.testing.assert_array_equal(first.observations, again.observations)
    np.testing.assert_array_equal(first.actions, again.actions)
    assert np.abs(first.observations - other.observations).max() > 0.1


@pytest.mark.parametrize(
    ("name", "moves"), [("cube-single-play", slice(19, 22)), ("puzzle-3x3-play", slice(20, 55, 4))]
)
def test_oracles_move_things(name, moves):
    things = recorded(name, 400).observations[:, moves]
    assert np.ptp(things, axis=0).max() >= 0.9  # 9 cm, or a button that is now on


COMMANDS = """
    pointmaze-medium-navigate 1000 1001 0.5
    pointmaze-giant-navigate 500 2001 0.5
    pointmaze-teleport-stitch 5000 201 0.5
    antmaze-large-stitch 5000 201 0.2
    antmaze-giant-navigate 500 2001 0.2
    antmaze-medium-explore 10000 501 1.0
    cube-single-play 1000 1001 0
    cube-double-noisy 1000 1001 0.1
    cube-triple-play 3000 1001 0
    scene-noisy 1000 1001 0.1
    puzzle-3x3-noisy 1000 1001 0.2
    puzzle-4x4-play 1000 1001 0
"""
"""Of OGBench's data_gen_scripts/commands.sh: episodes, rows of each, and noise of mazes or random share of tables."""


@pytest.mark.parametrize("line", COMMANDS.strip().splitlines(), ids=lambda line: line.split()[0])
def test_as_much_is_recorded_and_as_noisily_as_by_ogbenchs_commands(line):
    name, episodes, rows, share = line.split()
    collector = find_task(f"ogbench-{name}-v0").collector
    assert collector is not None and collector.steps == int(episodes) * int(rows)
    recipe = collector.record.args[0]  # pyright: ignore[reportFunctionMemberAccess]
    assert recipe.episode_steps == int(rows)
    play = recipe.play
    assert (play.noise if isinstance(play, Wander) else play.random) == float(share)
    assert play.kind == name.split("-")[-1]


class Still:
    """A table at which nothing moves, and an oracle that asks for nothing; keeps what it is told."""

    _env_type = "double"

    def __init__(self):
        self.actions, self.stacking = [], []

    def reset(self, seed):
        return np.zeros(2), {"privileged/target_task": "cube"}

    def step(self, action):
        self.actions.append(action)
        return np.zeros(2), 0.0, False, False, {"prev_qpos": np.zeros(20), "prev_qvel": np.zeros(20)}

    def set_new_target(self, p_stack):
        self.stacking.append(p_stack)
        return self.reset(0)


class Idle:
    done = True

    def reset(self, seen, target):
        pass

    def select_action(self, seen, info):
        return [0.1] * 5


def idle_at_a_table(monkeypatch, episodes: int, **play: Any) -> list[Still]:
    monkeypatch.setattr(PlayAtTable, "_oracles", lambda self, env: {"cube": Idle()})
    tables = [Still() for _ in range(episodes)]
    for seed, table in enumerate(tables):
        PlayAtTable(**play)(table, 40, seed, Log())
    return tables


def test_noise_and_stacking_are_an_episodes_own(monkeypatch):
    """xi of U(0, 0.1), three times that for the yaw and ten times for the gripper; of two cubes, U(0, 0.25)."""
    tables = idle_at_a_table(monkeypatch, 300, kind="noisy")
    spreads = np.array([np.std(table.actions, axis=0) for table in tables])
    np.testing.assert_allclose(spreads[:, :4].mean(axis=0), [0.05, 0.05, 0.05, 0.15], rtol=0.1)
    assert 0.3 < spreads[:, 4].mean() < 0.5 and spreads[:, 0].min() < 0.01 and 0.09 < spreads[:, 0].max() < 0.15
    assert np.corrcoef(spreads[:, 0], spreads[:, 3])[0, 1] > 0.9
    chances = np.array([np.unique(table.stacking).item() for table in tables])
    np.testing.assert_allclose([chances.min(), chances.mean(), chances.max()], [0, 0.125, 0.25], atol=0.02)
    calm = idle_at_a_table(monkeypatch, 1, kind="play")[0]
    assert np.all(np.array(calm.actions) == 0.1)


def test_so_many_actions_are_random(monkeypatch):
    tables = idle_at_a_table(monkeypatch, 100, kind="play", random=0.2)
    assert np.mean([np.any(action != 0.1) for table in tables for action in table.actions]) == pytest.approx(
        0.2, abs=0.03
    )


def test_random_actions_are_uniform():
    calm, wild = PlayAtTable("noisy"), PlayAtTable("noisy", random=1.0)
    env = make_unwrapped("cube-single-v0", terminate_at_goal=False, mode="data_collection")
    actions = []
    for play in (calm, wild):
        log = Log()
        with numpys_generator(0):
            play(env, 300, 0, log)
        actions.append(log.arrays()["actions"])
    np.testing.assert_allclose(actions[1].std(axis=0), 1 / np.sqrt(3), atol=0.06)
    assert np.abs(actions[0].std(axis=0) - 1 / np.sqrt(3)).max() > 0.1


def test_an_episode_with_a_cube_out_of_sight_is_played_again(monkeypatch):
    """Only of a scene, which has a drawer."""
    seen: list[int] = []

    def refuse_once(cube: np.ndarray) -> bool:
        assert cube.shape == (40, 3)
        seen.append(len(cube))
        return len(seen) > 1

    monkeypatch.setattr("guider.collect.ogbench._is_in_sight", refuse_once)
    idle_at_a_table(monkeypatch, 1, kind="play")
    assert seen == []
    monkeypatch.setattr(Still, "_drawer_site_id", 0, raising=False)
    table, log = Still(), Log()
    PlayAtTable("noisy")(table, 40, 0, log)
    assert len(seen) == 2 and len(table.actions) == 80 and len(log.arrays()["actions"]) == 40
    np.testing.assert_array_equal(log.arrays()["actions"], np.array(table.actions[40:], np.float32))
    assert np.abs(np.array(table.actions[:40]) - table.actions[40:]).max() > 0.01


def test_what_is_out_of_sight():
    fine = np.array([[0.4, 0.0, 0.02], [0.4, -0.31, 0.07]])
    assert _is_in_sight(fine)
    assert not _is_in_sight(np.array([[0.4, 0.3, 0.02]])) and not _is_in_sight(np.array([[0.4, -0.31, 0.02]]))


def test_ogbench_reads_what_is_written(tmp_path, capsys):
    out = tmp_path / "scene-play-v0.npz"
    assert main(["collect", "ogbench-scene-play-v0", "--steps", "150", "--seed", "4", "--out", str(out)]) == 0
    train, validation = ogbench.make_env_and_datasets(
        "scene-play-v0", dataset_dir=str(tmp_path), dataset_only=True, add_info=True
    )
    recording = recorded("scene-play", 150, seed=4)
    np.testing.assert_array_equal(train["observations"], recording.observations[:-1])
    np.testing.assert_array_equal(train["next_observations"], recording.observations[1:])
    np.testing.assert_array_equal(train["actions"], recording.actions[:-1])
    np.testing.assert_array_equal(train["button_states"], recording.simulation["button_states"][:-1])
    assert len(validation["observations"]) == 14
    assert np.abs(validation["observations"] - train["observations"][:14]).max()
    inner = make_unwrapped("scene-v0")
    inner.reset(seed=0)
    for row in range(149):
        inner.set_state(train["qpos"][row], train["qvel"][row], train["button_states"][row])
        shown, logged = (np.delete(state, 18) for state in (inner.compute_observation(), train["observations"][row]))
        np.testing.assert_allclose(shown, logged, atol=1e-3)  # 18 is what the fingers feel, no part of the state
    assert len(np.unique(train["button_states"], axis=0)) > 1
    own = load_data(out, goal_indices=(19, 20, 21))
    np.testing.assert_array_equal(own.observations, recording.observations)
    assert main(["collect", "ogbench-scene-play-v0", "--steps", "150", "--out", str(out)]) == 1
    assert "never overwritten" in capsys.readouterr().err
