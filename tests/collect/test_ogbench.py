"""Recordings by OGBench's protocol: who goes where, and files that OGBench itself reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from guider import load_data
from guider.cli import main
from guider.collect.ogbench import Log, PlayAtTable, Wander, _is_in_sight, _not_in_corridors, numpys_generator
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


def test_a_share_of_noisy_actions_is_random():
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


def test_a_cube_that_would_be_out_of_sight_is_played_again():
    fine = np.array([[0.4, 0.0, 0.02], [0.4, -0.31, 0.07]])
    assert _is_in_sight(fine)
    assert not _is_in_sight(np.array([[0.4, 0.3, 0.02]])) and not _is_in_sight(np.array([[0.4, -0.31, 0.02]]))


def test_ogbench_reads_what_is_written(tmp_path, capsys):
    out = tmp_path / "scene-play-v0.npz"
    assert main(["collect", "ogbench-scene-play-v0", "--steps", "60", "--seed", "4", "--out", str(out)]) == 0
    train, validation = ogbench.make_env_and_datasets(
        "scene-play-v0", dataset_dir=str(tmp_path), dataset_only=True, add_info=True
    )
    recording = recorded("scene-play", 60, seed=4)
    np.testing.assert_array_equal(train["observations"], recording.observations[:-1])
    np.testing.assert_array_equal(train["next_observations"], recording.observations[1:])
    np.testing.assert_array_equal(train["actions"], recording.actions[:-1])
    np.testing.assert_array_equal(train["button_states"], recording.simulation["button_states"][:-1])
    assert len(validation["observations"]) == 5 and np.abs(validation["observations"] - train["observations"][:5]).max()
    inner = make_unwrapped("scene-v0")
    inner.reset(seed=0)
    inner.set_state(train["qpos"][20], train["qvel"][20], train["button_states"][20])
    np.testing.assert_allclose(inner.compute_observation()[:18], train["observations"][20, :18], atol=1e-4)
    own = load_data(out, goal_indices=(19, 20, 21))
    np.testing.assert_array_equal(own.observations, recording.observations)
    assert main(["collect", "ogbench-scene-play-v0", "--steps", "60", "--out", str(out)]) == 1
    assert "never overwritten" in capsys.readouterr().err
