"""Films: what is in them, and what is said where there can be none."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from test_plots import TASK, logs, make_policy, policy_for, small_config

import guider
from guider.cli import main
from guider.errors import GuiderError
from guider.methods import preset_config
from guider.plots import drawing as pictures
from guider.plots import film as films
from guider.plots.drawing import Look, Mark
from guider.plots.film import film, marks
from guider.tasks import find_task
from guider.tasks.mazes import floor_places

SMALL = Look(width=96, height=64)
HIGH = 64 + 16  # with the title above
SHORT = replace(TASK, horizon_steps=6)


@pytest.fixture(scope="module")
def drawing() -> None:
    """There is a library that draws without a screen."""
    try:
        with pictures.drawing(TASK, SMALL):
            pass
    except GuiderError as error:
        pytest.skip(str(error))


def test_marks_by_hand():
    """In a maze balls are a fifth of a cell large, or the radius; elsewhere the radius in metres, whatever goal units
    are; where goals are no places there are none."""
    way, subgoal, goal = [np.array([0.0, 1.0]), np.array([1.0, 1.0])], np.array([2.0, 1.0]), np.array([3.0, 1.0])
    *passed, aim, pursued = marks(TASK, way, subgoal, goal)
    assert [list(mark.place) for mark in passed] == [[0, 1, 0], [1, 1, 0]]
    assert list(aim.place) == [3, 1, 0] and aim.radius_m == 0.25 and aim.colour[0] > 0.8 > 0.2 > aim.colour[1]
    assert list(pursued.place) == [2, 1, 0] and pursued.radius_m == pytest.approx(0.15)
    assert len(marks(TASK, way, None, goal)) == 3
    wide = replace(find_task("antmaze-large-diverse"), places=floor_places)
    assert marks(wide, way, None, goal)[-1].radius_m == 0.8
    cubes = find_task("ogbench-cube-double-play-v0")
    first, second = marks(cubes, [], None, np.array([0.0, 0, 1, 0, 2, 0]))
    np.testing.assert_allclose([first.place, second.place], [[0.425, 0, 0.1], [0.425, 0.2, 0]])
    assert first.radius_m == pytest.approx(0.04)
    assert marks(replace(TASK, places=None), way, subgoal, goal) == []
    long = [np.array([float(step), 0.0]) for step in range(1000)]
    assert len(marks(TASK, long, None, goal)) == 1 + 250


@pytest.mark.usefixtures("drawing")
def test_a_mark_is_drawn_where_it_is():
    """A red ball on the left of the picture, seen from above, makes it redder there alone."""
    env = TASK.make_env(1)
    env.reset(np.array([0]))
    scene = env.scene(0)  # pyright: ignore[reportAttributeAccessIssue]
    with pictures.drawing(TASK, SMALL) as draw:
        without = draw(scene, []).astype(int)
        red = draw(scene, [Mark(np.array([0.0, 0.0, 0.2]), 0.4, (1.0, 0.0, 0.0, 1.0))]).astype(int)
        again = draw(scene, [])
    env.close()
    assert without.shape == (64, 96, 3) and np.array_equal(without, again)
    rows, columns = np.nonzero((red - without)[..., 0] > 40)
    assert len(rows) > 10 and columns.max() < 48 and rows.min() > 32, "the start lies in the lower left"


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("kind", ["gif", "mp4"])
def test_a_film_has_every_step_and_a_still_end(kind, tmp_path):
    """Two episodes of 6 steps: 7 frames each, and the last stays for a second."""
    path, told = tmp_path / f"a.{kind}", []
    met = film(make_policy(2), SHORT, path, 2, 0, SMALL, lambda done, total: told.append((done, total)))
    assert met == [False, False] and told[-1] == (12, 12)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    if kind == "mp4":
        read = [films._ffmpeg(), "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        assert len(subprocess.run(read, capture_output=True, check=True).stdout) == 2 * 27 * (96 * HIGH * 3)
        return
    with Image.open(path) as opened:
        still = 1000 // films.FRAMES_PER_SECOND
        lengths = []
        for frame in range(getattr(opened, "n_frames", 1)):
            opened.seek(frame)
            lengths.append(opened.info["duration"])
        assert opened.size == (96, HIGH) and sum(lengths) == 2 * 27 * still, "equal frames may be one that lasts"


@pytest.mark.usefixtures("drawing")
def test_long_episodes_are_thinned_and_methods_without_subgoals_filmed(tmp_path, monkeypatch):
    monkeypatch.setattr(films, "MOST_FRAMES", 3)
    config = replace(preset_config("bc", "fast", small_config().problem), hidden=(8,))
    shown = []
    monkeypatch.setattr(films, "marks", lambda task, way, subgoal, goal: shown.append((len(way) - 1, subgoal)) or [])
    film(policy_for(logs(2), "bc", config), SHORT, tmp_path / "a.gif", 1, 0, SMALL)
    assert shown == [(0, None), (2, None), (4, None), (6, None)]


@pytest.mark.usefixtures("drawing")
def test_what_cannot_be_filmed_is_said(tmp_path):
    policy = make_policy(2)

    class Blind:
        """An environment of somebody's own."""

        def __init__(self, count):
            self.env, self.count = SHORT.make_env(count), count
            self.reset, self.step, self.close = self.env.reset, self.env.step, self.env.close

    def refused(task, path, look):
        with pytest.raises(GuiderError) as error:
            film(policy, task, path, 1, 0, look)
        assert list(tmp_path.iterdir()) == []
        return str(error.value)

    assert "has no `scene`" in refused(replace(SHORT, make_env=Blind), tmp_path / "a.gif", SMALL)
    assert "no camera 'front'; it has none by name" in refused(
        SHORT, tmp_path / "a.gif", replace(SMALL, camera="front")
    )
    assert "ends in .gif or .mp4" in refused(SHORT, tmp_path / "a.avi", SMALL)
    (tmp_path / "a.gif").touch()
    with pytest.raises(GuiderError, match="never overwritten"):
        film(policy, SHORT, tmp_path / "a.gif", 1, 0, SMALL)
    for episodes, first_seed in ((0, 0), (1, -1)):
        with pytest.raises(GuiderError, match=f"not {episodes} from {first_seed}"):
            film(policy, SHORT, tmp_path / "b.gif", episodes, first_seed, SMALL)
    with pytest.raises(GuiderError, match="even numbers, not 97 x 64"):
        Look(width=97, height=64)


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(f"no {name}")

    monkeypatch.setattr(pictures.importlib, "import_module", missing)
    monkeypatch.setenv("MUJOCO_GL", "ogl")
    with pytest.raises(GuiderError, match=r"'ogl', which draws nothing"):
        film(make_policy(2), SHORT, tmp_path / "a.gif", 1, 0, SMALL)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(GuiderError, match=r"osmesa does not work \(no mujoco.osmesa\): install libegl1"):
        film(make_policy(2), SHORT, tmp_path / "a.gif", 1, 0, SMALL)
    assert os.listdir(tmp_path) == []


@pytest.mark.usefixtures("drawing")
def test_a_writer_that_fails_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(films, "_ffmpeg", lambda: "false")
    with pytest.raises(GuiderError, match=r"could not be written as \.mp4"):
        film(make_policy(2), SHORT, tmp_path / "a.mp4", 9, 0, Look())
    assert os.listdir(tmp_path) == []


@pytest.mark.usefixtures("drawing")
def test_the_command_films_a_run(tmp_path, capsys):
    data, run = tmp_path / "umaze.hdf5", tmp_path / "run"
    assert main(["collect", "pointmaze-umaze", "--steps", "600", "--out", str(data)]) == 0
    bc = {"updates": 2, "hidden": (8,), "batch_size": 16}
    guider.train("pointmaze-umaze", data=data, method="bc", settings=bc, out=run)
    capsys.readouterr()
    film_it = ["film", str(run), str(tmp_path / "a.gif"), "--size", "96", "64", "--first-seed", "3"]
    assert main(film_it) == 0
    assert "episodes 3 NOT reached" in capsys.readouterr().out and (tmp_path / "a.gif").exists()
    assert main(film_it) == 1 and "never overwritten" in capsys.readouterr().err


def test_runs_on_own_data_have_no_simulator(finished, tmp_path):
    with pytest.raises(GuiderError, match="no simulator to film"):
        guider.film(finished[1].directory, tmp_path / "a.gif")
