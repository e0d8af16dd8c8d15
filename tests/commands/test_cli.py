"""The command line: one clear line for bad input, JSON on request, help that teaches."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from jax import tree

import guider
from guider import cli, runs
from guider.cli import main
from guider.commands import COMMANDS
from guider.errors import Stopped
from guider.support import files
from tools import results

TINY = [
    "--set",
    "latent.updates=4",
    "high.updates=4",
    "low.updates=4",
    "latent.hidden=(8,)",
    "high.hidden=(8,)",
    "low.hidden=(8,)",
    "low.batch_size=16",
    "high.batch_size=16",
]


@pytest.fixture
def recorded(tmp_path):
    path = tmp_path / "data" / "umaze.hdf5"
    assert main(["collect", "pointmaze-umaze", "--steps", "600", "--out", str(path)]) == 0
    return path


def test_collect_train_evaluate_plot(recorded, tmp_path, capsys):
    run = str(tmp_path / "run")
    capsys.readouterr()
    arguments = ["train", "pointmaze-umaze", "--data", str(recorded), "--seeds", "2", "--out", run, "--json", *TINY]
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out) == {"run": run, "seeds": [0, 1]}
    assert main(["evaluate", run, "--episodes", "3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["task"] == "pointmaze-umaze" and "MuJoCo" in result["environment"]
    assert len(result["per_seed"]) == 2 and result["episode_seeds"] == [0, 5]
    assert result["departures"]["low.updates"] == 4 and result["preset"] == "fast"
    assert [len(seed["episodes"][of]) for seed in result["per_seed"] for of in ("score", "met", "steps", "ending")] == [
        3
    ] * 8
    kept = results.kept(runs.open_run(run), "guider collect pointmaze-umaze --steps 600 --out DATA.hdf5")
    assert kept["per_seed"] == result["per_seed"] and str(tmp_path) not in json.dumps(kept)
    collect, train, evaluate = kept["commands"]
    assert collect == "guider collect pointmaze-umaze --steps 600 --out DATA.hdf5"
    assert train.startswith("guider train pointmaze-umaze --data DATA.hdf5 --method guider --preset fast --seeds 2 ")
    assert {"low.updates=4", f"precision={result['precision']}"} <= set(train.partition(" --set ")[2].split())
    assert evaluate == "guider evaluate RUN --episodes 3 --first-seed 0"
    assert main(["plot", run, "--json"]) == 0
    plots = json.loads(capsys.readouterr().out)["plots"]
    assert len(plots) >= 5
    assert main(["evaluate", run, "--episodes", "2"]) == 0
    assert "success" in capsys.readouterr().out


def test_evaluation_during_training_changes_nothing(recorded, tmp_path):
    import numpy as np

    base = ["train", "pointmaze-umaze", "--data", str(recorded), "--seeds", "2", "--json"]
    for name, extra in (("plain", []), ("watched", ["--evaluate-every", "2"])):
        assert main([*base, "--out", str(tmp_path / name), *extra, *TINY]) == 0
    plain, watched = (runs.open_run(tmp_path / name).policies()[0] for name in ("plain", "watched"))
    for a, b in zip(tree.leaves(plain), tree.leaves(watched), strict=True):
        np.testing.assert_array_equal(a, b)
    (line,) = files.read_lines(tmp_path / "watched" / "evaluations.jsonl")
    assert line["update"] == 4 and 0 <= line["score"][0] <= 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "pointmaze-larg", "--data", "x.hdf5"], "did you mean pointmaze-large"),
        (["train", "pointmaze-large", "--data", "missing.hdf5"], "missing.hdf5"),
        (["train", "pointmaze-large"], "no data given"),
        (["train", "--data", "x.npz"], "--goal-indices"),
        (["train", "--resume", "nowhere"], "is not a run"),
        (["evaluate", "nowhere"], "is not a run"),
        (["plot", "nowhere"], "is not a run"),
        (["data", "inspect", "nowhere.npz"], "nowhere.npz"),
        (["collect", "antmaze-large-play", "--out", "x.hdf5"], "cannot be collected here"),
        (["collect", "nothing", "--out", "x.hdf5"], "there is no task 'nothing'"),
        (["collect", "pointmaze-umaze", "--seed", "-1", "--out", "x.hdf5"], "--seed at least 0"),
        (["collect", "pointmaze-umaze", "--steps", "1", "--out", "x.hdf5"], "--steps must be at least 2"),
        (["evaluate", "nowhere", "--episodes", "0"], "--episodes must be 1 or more"),
        (["train", "pointmaze-umaze", "--data", "x", "--seeds", "0"], "--seeds must be 1 or more"),
        (["train", "pointmaze-umaze", "--data", "x", "--set", "problem.radius=3"], "problem.radius is no setting"),
        (["train", "--resume", "nowhere", "--seeds", "2"], "--resume takes all settings from the run"),
    ],
)
def test_bad_input_gets_one_line_and_a_status(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    error = [line for line in capsys.readouterr().err.splitlines() if line.strip().startswith("guider:")]
    assert len(error) == 1 and message in error[0]
    assert list(tmp_path.iterdir()) == []


def test_foreign_and_existing_files_are_refused(recorded, tmp_path, capsys):
    foreign = tmp_path / "notes.txt"
    foreign.write_text("hello")
    assert main(["data", "inspect", str(foreign)]) == 1
    assert "neither" in capsys.readouterr().err
    assert main(["collect", "pointmaze-umaze", "--steps", "60", "--out", str(recorded)]) == 1
    assert "never overwritten" in capsys.readouterr().err
    inside_a_file = ["train", "pointmaze-umaze", "--data", str(recorded), "--out", str(foreign / "run"), *TINY]
    assert main(inside_a_file) == 1
    assert "notes.txt" in capsys.readouterr().err
    run = tmp_path / "run"
    run.mkdir()
    assert main(["train", "pointmaze-umaze", "--data", str(recorded), "--out", str(run), *TINY]) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["train", "pointmaze-umaze", "--data", str(recorded), "--set", "high.sample=3"]) == 1
    assert "did you mean high.samples" in capsys.readouterr().err


def test_inspect_says_what_a_file_holds(tmp_path, capsys):
    path = tmp_path / "log.hdf5"
    with h5py.File(path, "w") as file:
        file["observations"] = np.random.default_rng(0).normal(size=(30, 3))
        file["actions"] = np.zeros((30, 1)) + np.linspace(-1, 1, 30)[:, None]
        file["lengths"] = [10, 20]
    assert main(["data", "inspect", str(path), "--goal-indices", "0", "--json"]) == 0
    description = json.loads(capsys.readouterr().out)
    assert (description["rows"], description["episodes"]) == (30, 2)


def test_tasks_lists_every_task(capsys):
    assert main(["tasks", "--json"]) == 0
    names = [row["task"] for row in json.loads(capsys.readouterr().out)]
    assert "pointmaze-large" in names and "antmaze-large-diverse" in names


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches_every_command(command):
    answer = subprocess.run(
        [sys.executable, "-m", "guider", command, "--help"], capture_output=True, text=True, check=True
    )
    first_words = str(COMMANDS[command].__doc__).split(".")[0].split(":")[0].split()[:4]
    assert " ".join(first_words) in " ".join(answer.stdout.split())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_interrupted_while_it_is_loaded_says_so_in_a_line(number):
    script = f"from guider.__main__ import _leave; _leave({int(number)}, None)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (128 + number, "guider: interrupted\n")


def raises_where_nothing_may_be_raised() -> None:
    class Gone:
        def __del__(self):
            raise KeyboardInterrupt

    Gone()
    time.sleep(20)


def fails_to_load(interruption: BaseException) -> None:
    raise ImportError("initialization failed") from interruption


@pytest.mark.parametrize(
    ("command", "status", "line"),
    [
        (raises_where_nothing_may_be_raised, 130, "interrupted"),
        (partial(fails_to_load, KeyboardInterrupt()), 130, "interrupted"),
        (partial(fails_to_load, Stopped("ended by SIGTERM", signal.SIGTERM)), 143, "ended by SIGTERM"),
    ],
    ids=["swallowed", "Ctrl-C within an import", "SIGTERM within an import"],
)
def test_an_interruption_is_heeded_wherever_it_comes(command, status, line, monkeypatch, capsys):
    monkeypatch.setattr(cli.tyro.extras, "subcommand_cli_from_dict", lambda *_, **__: command())
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # tests that run in the background ignore it
    try:
        assert main(["tasks"]) == status and capsys.readouterr().err == f"guider: {line}\n"
    finally:
        signal.signal(signal.SIGINT, before)


def test_importing_guider_loads_nothing_until_a_name_is_used():
    script = "import guider, sys; guider.make_episodes; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True)
    script = "import guider; assert all(getattr(guider, name) for name in guider.__all__); guider.nothing"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert "has no attribute 'nothing'" in done.stderr


def test_every_module_can_be_imported_first():
    """Whoever starts a process or uses a part alone imports that part first: there is no circle."""
    package = Path(guider.__file__).parent
    modules = [
        ".".join(("guider", *path.relative_to(package).with_suffix("").parts)).removesuffix(".__init__")
        for path in sorted(package.rglob("*.py"))
        if path.stem not in ("__main__", "hdf5_worker")
    ]
    script = """if True:
    import importlib, os, sys
    for name in sys.argv[1:]:
        for known in [known for known in sys.modules if known.split(".")[0] == "guider"]:
            del sys.modules[known]
        importlib.import_module(name)"""
    subprocess.run([sys.executable, "-c", script, *modules], check=True)
