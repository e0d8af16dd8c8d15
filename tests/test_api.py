"""What is asked of training is done, or refused before any work: data, goal space, names, numbers, places."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from recordings import GOAL, ends, walk, write_npz

import guider
from guider import api, runs
from guider.cli import main
from guider.data.episodes import make_episodes
from guider.errors import GuiderError, GuiderWarning
from guider.learning.processor import settled

LENGTHS = [60] * 10


class Started(Exception):  # noqa: N818 - ends a test's training before it begins
    pass


@pytest.fixture
def started(monkeypatch) -> list[tuple]:
    """What `runs.start` was called with; nothing is trained."""
    seen: list[tuple] = []

    def start(*arguments):
        seen.append(arguments)
        raise Started

    monkeypatch.setattr(runs, "start", start)
    return seen


def episodes(goal_indices=GOAL, lengths=LENGTHS, **changes):
    arrays = walk(lengths) | changes
    return make_episodes(arrays["observations"], arrays["actions"], lengths, goal_indices)


def plan(started, **options) -> Any:
    """The RunSpec that training would begin with."""
    with pytest.raises(Started):
        api.train(**{"data": episodes(), "radius": 0.5, "method": "bc"} | options)
    return started[-1][1]


@pytest.mark.filterwarnings("ignore:.*the median step goes")
def test_the_goal_space_asked_for_is_trained(started):
    assert plan(started).spaces.goal_indices == (0, 1)
    assert plan(started, goal_indices=(2, 3)).spaces.goal_indices == (2, 3)
    other = episodes((2, 3))
    assert plan(started, data=other).spaces.goal_indices == (2, 3)
    recorded = guider.Episodes(**{**vars(other), "goals": np.ones((600, 2), np.float32)})
    assert recorded.with_goal_space((2, 3)) is recorded
    assert recorded.with_goal_space((0, 1)).goals is None


def test_a_task_takes_episodes_of_its_own_goal_space(started):
    from guider.tasks import find_task

    task = find_task("pointmaze-umaze")
    assert task.collector is not None
    recording = task.collector.record(600, 0, lambda done, total: None)
    data = make_episodes(recording.observations, recording.actions, recording.lengths, (2, 3))
    with pytest.raises(GuiderError, match=r"goal entries of pointmaze-umaze are \(0, 1\), those of .* \(2, 3\)"):
        api.train("pointmaze-umaze", data, method="bc")
    with pytest.raises(Started):
        api.train("pointmaze-umaze", data.with_goal_space((0, 1)), method="bc")
    assert started[-1][1].spaces.goal_indices == (0, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preset": "Paper"}, "there is no preset 'Paper'; did you mean paper"),
        ({"method": "guidr"}, "there is no method 'guidr'; did you mean guider"),
        ({"settings": {"hiden": (16,)}}, "no setting is called 'hiden'; did you mean hidden"),
        ({"period_steps": 2.5}, "period_steps must be a whole number, got 2.5"),
        ({"seeds": 1.5}, "seeds must be a whole number, got 1.5"),
        ({"seeds": [0, 0]}, "distinct"),
        ({"radius": None}, "say how near to a goal counts as met"),
        ({"radius": 100.0}, r"no episode gets further than .* in goal space, .* choose a smaller radius"),
        ({"held_out": 1.0}, "--held-out is a fraction"),
        ({"format": "arrays"}, "say how to read a file"),
        ({"out": "\0"}, "is no path"),
    ],
)
def test_what_is_none_is_refused(started, options, message):
    with pytest.raises(GuiderError, match=message):
        plan(started, **options)
    assert not started


def test_numpy_numbers_are_numbers(started):
    options = {
        "radius": np.float32(0.5),
        "seeds": np.arange(2),
        "period_steps": np.int64(5),
        "held_out": np.float32(0.1),
        "reach_radius": np.float64(1),
    }
    spec = plan(started, **options)
    assert spec.seeds == (0, 1) and spec.config.problem.period_steps == 5
    json.dumps([spec.seeds, spec.held_out, spec.config.problem.radius])
    assert plan(started, seeds=np.int64(2)).seeds == (0, 1)


def test_own_data_is_learned_from_whole(started):
    """No row is left out but where that was shown to help."""

    def said(**options: Any) -> str:
        lines: list[str] = []
        spec = plan(started, method="guider", say=lines.append, held_out=0.0, **options)
        assert lines[1].startswith("a goal counts as met within 0.5, a subgoal as reached within 1 (--reach-radius)")
        assert f"subgoals {spec.config.problem.period_steps} steps ahead" in lines[1]
        assert lines[0] == f"{started[-1][2]['data_use']}; training multiplies in {settled('auto')}"
        return lines[0]

    whole = said()
    assert whole.startswith("590 of 590 transitions (100%)")
    assert "view.boundary=drop" in whole and "minimum_move" not in whole
    part = said(settings={"view.minimum_move": 1.0})
    assert "left out by view.minimum_move=1 (rows whose goal entries move less within 20 steps)" in part
    assert int(part.split()[0]) < 590


def test_no_window_says_what_would_help():
    settings = {"view.minimum_move": 1.5}
    straight = episodes(observations=np.tile(np.arange(60.0) / 20, 10)[:, None] * [1, 0, 0, 0, 0])
    with pytest.raises(GuiderError, match=r"no window of 5 steps moves 1.5 .*furthest moves 0.25; .*--period-steps 40"):
        api.train(data=straight, radius=0.5, period_steps=5, method="bc", settings=settings, held_out=0, out="never")


def test_held_out_episodes_that_cannot_be_scored_are_told_before_training(started):
    lengths = [60, *[4] * 15]
    with pytest.raises(GuiderError, match=r"episodes held out could not be scored: .*--held-out 0"):
        plan(started, data=episodes(lengths=lengths), radius=0.1, held_out=0.1, settings={"view.boundary": "drop"})
    assert not started


def test_map_coordinates_are_refused_with_what_to_do(started):
    arrays = walk(LENGTHS)
    observations = arrays["observations"].astype(np.float64)
    observations[:, 1] = observations[:, 1] / 50 + 5411932.6
    with pytest.warns(GuiderWarning, match=r"observations column 1 varies by .* around 541193.*subtract an origin"):
        data = make_episodes(observations, arrays["actions"], LENGTHS, GOAL)
    with pytest.raises(
        GuiderError, match=r"goal entry 1 .*only steps of 0.5: too coarse for the radius 0.1; .*subtract"
    ):
        plan(started, data=data, radius=0.1)


def test_a_run_knows_its_data_from_anywhere(started, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_npz(tmp_path / "logs.npz", walk(LENGTHS) | {"lengths": np.array(LENGTHS)})
    assert plan(started, data="logs.npz", goal_indices=GOAL).data == str(tmp_path / "logs.npz")


def test_data_that_has_moved_is_asked_for(tmp_path, monkeypatch):
    path = write_npz(tmp_path / "logs.npz", walk(LENGTHS) | {"lengths": np.array(LENGTHS)})
    settings = {"updates": 2, "hidden": (8,), "batch_size": 8}
    run = api.train(data=path, goal_indices=GOAL, radius=0.5, method="bc", settings=settings, out=tmp_path / "run")
    facts = json.loads((tmp_path / "run" / "run.json").read_text())["facts"]
    assert facts["episode_ends"][0] == {"name": "lengths", "ends": 10, "used": True}
    path.rename(tmp_path / "moved.npz")
    with pytest.raises(GuiderError, match=r"no such file \(what .* was trained on; if it has moved: --data PLACE\)"):
        api.evaluate(run)
    assert api.evaluate(run, data=tmp_path / "moved.npz")["held_out_episodes"] == 1


@pytest.mark.parametrize(
    ("radius", "message"),
    [
        (0.01, r"the median step goes .*, past the radius 0.01; is that its unit"),
        (4.0, r"\d+% of the episodes end within"),
    ],
)
def test_a_radius_in_another_unit_is_told(started, radius, message):
    with pytest.warns(GuiderWarning, match=message):
        plan(started, radius=radius)


def test_the_period_fits_the_longest_episode(started):
    assert plan(started, data=episodes(lengths=[4] * 40), radius=0.1).config.problem.period_steps == 3


def test_a_run_on_arrays_asks_for_them(tmp_path):
    data = episodes()
    settings = {"updates": 2, "hidden": (8,), "batch_size": np.int64(8)}
    run = api.train(data=data, radius=0.5, method="bc", settings=settings, out=tmp_path / "run")
    with pytest.raises(GuiderError, match=r"was trained on arrays in memory; give the same Episodes \(data=episodes\)"):
        api.evaluate(run)
    with pytest.raises(GuiderError, match="leave --episodes and --first-seed out"):
        api.evaluate(run, data=data, episodes=3)
    api.evaluate(run, data=data)
    agent = guider.load(run)
    agent.act(data.observations[0], [1, 1])
    with pytest.warns(GuiderWarning, match=r"goal entry 0 is 3000, far from anything in the data .*units and frame"):
        agent.act(data.observations[0], [3000, 4000])
    agent.act(data.observations[0], [3000, 4000])  # once is enough


@pytest.mark.parametrize("indices", [(0.0, 1.7), "01"])
def test_goal_indices_are_whole_numbers(indices):
    with pytest.raises(GuiderError, match="goal indices must be whole numbers"):
        episodes(indices)


# The command line


@pytest.fixture
def logs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    write_npz(tmp_path / "logs.npz", walk(LENGTHS) | {"lengths": np.array(LENGTHS)})
    return ["train", "--data", "logs.npz", "--radius", "0.5"]


def test_options_said_twice_add_up_or_are_refused(started, logs, capsys):
    main([*logs, "--goal-indices", "0", "--set", "latent.updates=7", "--goal-indices=1", "--set", "high.updates=9"])
    spec = started[-1][1]
    assert spec.spaces.goal_indices == (0, 1)
    assert (spec.config.latent.updates, spec.config.high.updates) == (7, 9)
    for twice, message in (
        (["--radius", "1"], "--radius is given twice"),
        (["--set", "latent.updates=7", "latent.updates=8"], "--set gives latent.updates twice"),
    ):
        assert main([*logs, "--goal-indices", "0", "1", *twice]) == 1
        assert message in capsys.readouterr().err
    assert len(started) == 1


@pytest.mark.parametrize(
    "option",
    [
        *(["--method", "guider"], ["--preset", "fast"], ["--seeds", "1"], ["--first-seed", "0"], ["--held-out", "0"]),
        *(["--radius", "0"], ["--period-steps", "0"], ["--reach-radius", "0"], ["--format", "arrays"]),
        *(["--episode-ends", "jumps"], ["--goal-indices", "0"], ["--set", "a=1"], ["--out", "x"]),
    ],
    ids=lambda option: option[0],
)
def test_resume_refuses_every_setting(option, capsys):
    assert main(["train", "--resume", "run", *option]) == 1
    assert "--resume takes all settings from the run" in capsys.readouterr().err


def test_a_tilde_is_the_home_directory_everywhere(started, logs, tmp_path):
    main(["train", "--data=~/logs.npz", "--radius", "0.5", "--goal-indices", "0", "1", "--out=~/runs/x"])
    assert started[-1][0] == tmp_path / "runs" / "x"


def test_a_taken_place_is_refused_before_the_data_is_read(logs, tmp_path, capsys):
    (tmp_path / "taken").mkdir()
    assert main(["train", "--data", "nowhere.npz", "--radius", "1", "--out", "taken"]) == 1
    assert "exists already" in capsys.readouterr().err


def test_inspect_says_who_named_the_goal_space_and_what_training_would_use(logs, capsys):
    assert main(["data", "inspect", "logs.npz", "--json"]) == 0
    description = json.loads(capsys.readouterr().out)
    assert (description["goal_indices"], description["goal_space_from"]) == ([0, 1], "assumed")
    assert "training" not in description
    assert main(["data", "inspect", "logs.npz", "--goal-indices", "0", "1", "--radius", "0.5", "--json"]) == 0
    description = json.loads(capsys.readouterr().out)
    assert description["goal_space_from"] == "asked for"
    assert description["training"]["data_use"].startswith("590 of 590 transitions")
    assert description["resting_action"] == [0, 0]
    assert main(["data", "inspect", "logs.npz"]) == 0
    assert "episode ends  lengths 10 (not taken: jumps 9)" in capsys.readouterr().out
    assert main(["data", "inspect", "logs.npz", "--radius", "0.5"]) == 0
    assert main(["data", "inspect", "logs.npz", "--out", "x"]) == 1
    assert main(["data", "inspect", "logs.npz", "--period-steps", "5"]) == 1
    assert main(["data", "fetch", "--out", "x"]) == 1
    assert main(["reproduce", "table2", "--dry-run", "--report-only"]) == 1
    assert main(["data", "fetch", "--radius", "1"]) == 1


def test_warnings_are_lines(tmp_path, capsys):
    lengths = [30, 40]
    arrays = walk(lengths) | {"timeouts": ends(lengths), "terminals": ~ends(lengths)}
    write_npz(tmp_path / "logs.npz", arrays)
    assert main(["data", "inspect", str(tmp_path / "logs.npz")]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"guider: warning: {tmp_path / 'logs.npz'}: 68 rows marked by terminals are followed by")


def test_faults_of_our_own_are_one_line_and_traces_on_request(monkeypatch, capsys):
    from guider import tasks

    def broken(name):
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(tasks, "find_task", broken)
    assert main(["tasks", "x"]) == 3
    assert "a fault of guider's own, please report it: RuntimeError: two lines" in capsys.readouterr().err
    monkeypatch.setenv("GUIDER_DEBUG", "1")
    with pytest.raises(RuntimeError):
        main(["tasks", "x"])


def test_output_that_nobody_reads_ends_quietly(logs, tmp_path):
    import subprocess
    import sys

    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m guider tasks --json | head -c 1; exit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        text=True,
    )
    assert done.stderr == "" and done.returncode in (0, 141)


def test_letters_that_a_terminal_lacks_are_no_error(logs, tmp_path):
    import os
    import subprocess
    import sys

    (tmp_path / "logs.npz").rename(tmp_path / "ünï.npz")
    done = subprocess.run(
        [sys.executable, "-m", "guider", "data", "inspect", "ünï.npz"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr and "\\xfc" in done.stdout


def test_an_option_that_is_none_is_told_with_those_like_it(tmp_path):
    with pytest.raises(TypeError, match="no option 'radus'; did you mean radius"):
        api.train(data=tmp_path / "logs.npz", radus=0.5)  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError, match="no option 'periods'"):
        api.inspect(tmp_path / "logs.npz", periods=5)  # pyright: ignore[reportCallIssue]
