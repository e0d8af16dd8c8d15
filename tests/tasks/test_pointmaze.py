import os

import h5py
import numpy as np
import pytest

from guider.collect import waypoints
from guider.collect.waypoints import Guide
from guider.data.write import write_d4rl
from guider.errors import GuiderError
from guider.tasks import find_task
from guider.tasks.mazes import Maze, make_maze
from guider.tasks.pointmaze import BALL_RADIUS_M, drive, point_model, sample_start, sample_start_anywhere
from guider.tasks.simulation import MujocoVectorEnv, Start

NAMES = ["umaze", "medium", "large"]


def task_and_maze(name):
    task = find_task(f"pointmaze-{name}")
    assert task.maze is not None
    return task, task.maze


def env_at(maze: Maze, xy, count=1) -> MujocoVectorEnv:
    start = Start(qpos=np.array(xy, float), qvel=np.zeros(2), goal=np.zeros(2))
    env = MujocoVectorEnv(point_model(maze), 5, lambda _: start, count)
    env.reset(np.zeros(count, int))
    return env


def collect(name, steps, seed, path):
    task, _ = task_and_maze(name)
    assert task.collector is not None
    reports = []
    recording = task.collector.record(steps, seed, lambda done, total: reports.append((done, total)))
    write_d4rl(path, recording, task.goal_indices, task.radius)
    return reports


def test_ball_speeds_up_and_slows_down_as_its_mass_and_damping_say():
    """m dv/dt = F - b v: t seconds of full force give v = 1.4 (1 - exp(-2.5 t)) m/s, then it decays alike."""
    env = env_at(make_maze("large", 1.0), (0.0, 0.0))
    on = np.ones(1, bool)
    states = np.array([env.step(np.array([[1.0, 0.0]]), on)[0] for _ in range(10)])
    expected = 1.4 * (1 - np.exp(-2.5 * 0.1 * np.arange(1, 11)))
    np.testing.assert_allclose(states[:, 2], expected, atol=0.03)
    np.testing.assert_array_equal(states[:, [1, 3]], 0.0)
    coasting = env.step(np.zeros((1, 2)), on)[0, 2]
    assert coasting == pytest.approx(states[-1, 2] * np.exp(-0.25), abs=0.03)


def test_actions_beyond_the_motors_range_are_clipped():
    maze = make_maze("large", 1.0)
    on = np.ones(1, bool)
    strong = env_at(maze, (0.0, 0.0)).step(np.array([[50.0, -50.0]]), on)
    full = env_at(maze, (0.0, 0.0)).step(np.array([[1.0, -1.0]]), on)
    np.testing.assert_array_equal(strong, full)


@pytest.mark.parametrize(
    ("push", "axis", "stop"),
    [
        ((-1.0, 0.0), 0, -0.5 + BALL_RADIUS_M),
        ((1.0, 0.0), 0, 3.5 - BALL_RADIUS_M),
        ((0.0, 1.0), 1, 4.5 - BALL_RADIUS_M),
    ],
)
def test_walls_stop_the_ball(push, axis, stop):
    env = env_at(make_maze("large", 1.0), (0.0, 0.0))
    states = np.array([env.step(np.array([push]), np.ones(1, bool))[0] for _ in range(60)])
    assert states[-1, axis] == pytest.approx(stop, abs=0.01)
    assert abs(states[-1, 2 + axis]) < 1e-3
    assert np.abs(states[:, axis]).max() <= abs(stop) + 0.05  # how far an impact at full speed sinks in


def test_random_driving_never_leaves_the_free_cells():
    task, maze = task_and_maze("medium")
    env = task.make_env(32)
    env.reset(np.arange(32))
    rng = np.random.default_rng(0)
    for _ in range(20):
        push = rng.choice([-1.0, 1.0], (32, 2))
        for _ in range(10):
            cells = maze.cell_of(env.step(push, np.ones(32, bool))[:, :2])
            assert not maze.walls[tuple(cells.T)].any()
    env.close()


def test_a_copy_is_determined_by_its_seed_alone():
    task, _ = task_and_maze("large")
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 8, 2))
    many, few = task.make_env(8), task.make_env(1)
    first, goals = many.reset(np.arange(8))
    trajectory = np.array([first, *(many.step(a, np.ones(8, bool)) for a in actions)])
    again, goals_again = many.reset(np.arange(8))
    np.testing.assert_array_equal(goals, goals_again)
    assert len(np.unique(goals, axis=0)) == 8
    rerun = np.array([again, *(many.step(a, np.ones(8, bool)) for a in actions)])
    np.testing.assert_array_equal(trajectory, rerun)
    alone, goal = few.reset(np.array([3]))
    np.testing.assert_array_equal(goal[0], goals[3])
    rerun = np.array([alone, *(few.step(a[3:4], np.ones(1, bool)) for a in actions)])
    np.testing.assert_array_equal(rerun[:, 0], trajectory[:, 3])


def test_inactive_copies_stay_as_they_are_and_do_not_disturb_the_others():
    task, _ = task_and_maze("large")
    env, reference = task.make_env(6), task.make_env(6)
    before, _ = env.reset(np.arange(6))
    reference.reset(np.arange(6))
    active = np.array([True, False, True, True, False, False])
    actions = np.random.default_rng(0).uniform(-1, 1, (15, 6, 2))
    after = np.array([env.step(action, active) for action in actions])
    expected = np.array([reference.step(action, np.ones(6, bool)) for action in actions])
    np.testing.assert_array_equal(after[:, ~active], np.tile(before[~active], (15, 1, 1)))
    np.testing.assert_array_equal(after[:, active], expected[:, active])
    np.testing.assert_array_equal(env.step(np.ones((6, 2)), np.zeros(6, bool)), after[-1])


def test_reset_needs_a_seed_per_copy():
    task, _ = task_and_maze("umaze")
    with pytest.raises(ValueError, match="3 seeds for 2 copies"):
        task.make_env(2).reset(np.arange(3))


@pytest.mark.parametrize("name", NAMES)
def test_evaluation_starts_and_goals_lie_in_their_cells(name):
    _, maze = task_and_maze(name)
    starts = [sample_start(maze, np.random.default_rng(seed)) for seed in range(500)]
    xy, goals = (np.array([getattr(s, key) for s in starts]) for key in ("qpos", "goal"))
    assert 0.09 < np.abs(xy).max() <= 0.1
    offsets = goals - maze.cell_centre(maze.goal_cell)
    assert 0.24 < np.abs(offsets).max() <= 0.25
    np.testing.assert_allclose(offsets.std(axis=0), 0.25 / np.sqrt(3), rtol=0.1)


def test_recording_starts_in_every_free_cell():
    maze = make_maze("umaze", 1.0)
    starts = np.array([sample_start_anywhere(maze, np.random.default_rng(seed)).qpos for seed in range(700)])
    cells, counts = np.unique(maze.cell_of(starts), axis=0, return_counts=True)
    np.testing.assert_array_equal(cells, maze.free_cells)
    assert counts.min() > 70 and counts.max() < 130


def test_guide_heads_for_the_next_centre_then_for_the_goal():
    guide = Guide(make_maze("umaze", 1.0))
    positions = np.array([[0.1, 0.2], [1.9, 0.4], [1.2, 2.1], [0.3, 2.2]])
    goals = np.tile([0.1, 1.9], (4, 1))
    expected = [[1.0, 0.0], [2.0, 1.0], [0.1, 1.9], [0.1, 1.9]]
    np.testing.assert_allclose(guide.waypoints(positions, goals), expected)


def test_guide_from_centre_to_centre_turns_past_a_centre_and_leads_out_of_walls_forward():
    """As D4RL's: 1.9 m along a row is still the cell of 1 m; on the way back 0.9 m is already that of 0 m."""
    guide = Guide(make_maze("umaze", 1.0), centre_to_centre=True)
    positions = [[-0.3, 0.2], [0.9, 0.2], [1.9, 0.4], [2.1, 0.9], [2.1, 2.3], [1.5, 1.2], [1.2, 1.9], [0.9, 2.2]]
    expected = [[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [0.1, 2.1]]
    goals = np.tile([0.1, 2.1], (len(positions), 1))
    np.testing.assert_allclose(guide.waypoints(np.array(positions), goals), expected)


@pytest.mark.parametrize("name", NAMES)
def test_without_noise_the_controller_takes_the_route_in_time(name):
    task, maze = task_and_maze(name)
    guide, env = Guide(maze), task.make_env(20)
    states, goals = env.reset(np.arange(20))
    steps = np.zeros(20, int)
    for _ in range(task.horizon_steps):
        apart = np.linalg.norm(states[:, :2] - goals, axis=1) > task.radius
        states = env.step(drive(states, guide.waypoints(states[:, :2], goals)), apart)
        steps += apart
    assert np.linalg.norm(states[:, :2] - goals, axis=1).max() <= task.radius
    assert 0.5 < steps.mean() / task.horizon_steps < 0.7


@pytest.mark.parametrize("name", NAMES)
def test_no_recorded_episode_shows_the_evaluated_route(name, tmp_path):
    _, maze = task_and_maze(name)
    collect(name, 30_000, 0, tmp_path / "data.hdf5")
    with h5py.File(tmp_path / "data.hdf5") as file:
        xy, ends = np.array(file["observations"])[:, :2], np.array(file["timeouts"])
    cells = maze.cell_of(xy)
    episode = np.cumsum(ends) - ends
    starting = np.unique(episode[np.all(cells == maze.start_cell, axis=1)])
    arriving = np.unique(episode[np.all(cells == maze.goal_cell, axis=1)])
    assert len(starting) > 10 and len(arriving) > 10
    assert len(np.intersect1d(starting, arriving)) == 0
    assert len(np.unique(cells, axis=0)) == len(maze.free_cells)


def test_recorded_file_is_consistent(tmp_path):
    reports = collect("large", 20_030, 3, tmp_path / "new" / "data.hdf5")
    assert reports == [(0, 20_030), (256 * 60, 20_030), (20_030, 20_030)]
    with h5py.File(tmp_path / "new" / "data.hdf5") as file:
        data = {key: np.array(file[key]) for key in ("observations", "actions", "rewards", "terminals", "timeouts")}
        goals = np.array(file["infos/goal"])
    assert data["observations"].shape == (20_030, 4) and data["observations"].dtype == np.float32
    assert data["actions"].shape == (20_030, 2) and np.abs(data["actions"]).max() <= 1.0
    assert not data["terminals"].any()
    np.testing.assert_array_equal(np.flatnonzero(data["timeouts"]), [*range(59, 20_030, 60), 20_029])

    inside = np.flatnonzero(~data["timeouts"])
    reached = np.linalg.norm(data["observations"][inside + 1, :2] - goals[inside], axis=1) <= 0.25
    np.testing.assert_array_equal(data["rewards"][inside] == 1, reached)
    changed = np.any(goals[inside + 1] != goals[inside], axis=1)
    np.testing.assert_array_equal(changed, reached)
    assert reached.sum() > 50

    _, maze = task_and_maze("large")
    rows = inside[::40]
    states = iter(data["observations"][rows].astype(float))

    def next_start(_rng):
        state = next(states)
        return Start(qpos=state[:2], qvel=state[2:], goal=state[:2])

    env = MujocoVectorEnv(point_model(maze), 5, next_start, len(rows))
    env.reset(np.zeros(len(rows), int))
    landed = env.step(data["actions"][rows], np.ones(len(rows), bool))
    np.testing.assert_allclose(landed, data["observations"][rows + 1], atol=1e-4)


def test_recording_is_reproducible_whatever_the_cores_and_batches(tmp_path, monkeypatch):
    collect("umaze", 3_000, 5, tmp_path / "a.hdf5")
    monkeypatch.setattr("guider.tasks.simulation.available_cores", lambda: 1)
    monkeypatch.setattr(waypoints, "EPISODES_AT_ONCE", 33)
    collect("umaze", 3_000, 5, tmp_path / "b.hdf5")
    collect("umaze", 3_000, 6, tmp_path / "c.hdf5")
    assert (tmp_path / "a.hdf5").read_bytes() == (tmp_path / "b.hdf5").read_bytes()
    assert (tmp_path / "a.hdf5").read_bytes() != (tmp_path / "c.hdf5").read_bytes()


def test_noise_and_bursts_have_the_stated_rates():
    task, _ = task_and_maze("large")
    recipe = task.collector.record.args[0]  # pyright: ignore[reportFunctionMemberAccess, reportOptionalMemberAccess]
    scripts = [waypoints._draw_script(recipe, np.random.default_rng(seed)) for seed in range(400)]
    _, _, noise, held, on = (np.stack(parts) for parts in zip(*scripts, strict=True))
    assert noise.std() == pytest.approx(recipe.noise_spread, rel=0.02)
    late = on[:, recipe.burst_steps :]
    assert late.mean() == pytest.approx(1 - (1 - recipe.burst_chance) ** recipe.burst_steps, abs=0.02)
    assert np.abs(held).max() <= 1.0
    same_burst = on[:, 1:] & on[:, :-1] & np.all(held[:, 1:] == held[:, :-1], axis=2)
    assert same_burst.sum() > 0.7 * on.sum()


def test_a_failed_recording_leaves_nothing_behind(tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(GuiderError, match="cannot be written: no space"):
        collect("umaze", 100, 0, tmp_path / "data.hdf5")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(GuiderError, match="at least two"):
        collect("umaze", 1, 0, tmp_path / "data.hdf5")
