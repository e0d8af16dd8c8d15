"""Tasks beyond the paper: Gymnasium's AntMaze, any goal environment, OGBench, and mazes of one's own."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import roll

from guider.data.catalogue import CATALOGUE, find_dataset
from guider.data.episodes import Episodes, make_episodes
from guider.data.write import write_d4rl
from guider.errors import GuiderError
from guider.tasks import TASKS, antmaze, find_task, pointmaze
from guider.tasks.mazes import make_maze
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
