"""docs/own-logs.md: its commands, as they stand there, take a small set of LeRobot's layout to an ONNX file that
acts."""

from __future__ import annotations

import re
import runpy
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
from small_runs import SETTINGS

from guider.cli import main
from guider.data.episodes import make_episodes
from guider.data.layouts import save

TEXT = (Path(__file__).parent.parent / "docs" / "own-logs.md").read_text()
NAMES = ("kRightShoulderPitch", "kRightShoulderRoll", "kRightShoulderYaw", "kLeftElbow")
SMALL = ["--set", *(f"{name}={value}" for name, value in SETTINGS.items())]


def write_set(folder: Path) -> None:
    """An arm that follows its joint targets, half of the way in each step; its left elbow stays where it is."""
    rng = np.random.default_rng(0)
    states, actions = [], []
    for _ in range(30):
        place, target = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
        for _ in range(30):
            states.append([*place, 0.3])
            actions.append(place + np.clip(target - place, -0.1, 0.1))
            place = place + (actions[-1] - place) / 2
    arm = make_episodes(np.array(states), np.array(actions), [30] * 30, (0, 1, 2))
    save(replace(arm, state_names=NAMES, action_names=NAMES[:3]), folder, "lerobot", fps=30)


def test_the_commands_as_they_stand(tmp_path, monkeypatch, capsys):
    commands = [
        shlex.split(line)
        for block in re.findall(r"```bash\n(.*?)```", TEXT, flags=re.DOTALL)
        for line in block.splitlines()
    ]
    assert [words[:2] for words in commands if words[0] == "guider"] == [
        *([["guider", "data"]] * 2),
        *(["guider", word] for word in ("train", "evaluate", "report", "export")),
    ]
    (tmp_path / "logs").mkdir()
    write_set(tmp_path / "logs" / "g1")
    monkeypatch.chdir(tmp_path)
    shown = {}
    for words in commands:
        if words[0] == "guider":
            assert main(words[1:] + (SMALL if words[1] == "train" else [])) == 0, words
        else:
            assert words == ["python", "g1_example.py"]
            runpy.run_path("g1_example.py")
        shown[" ".join(words[:3])] = capsys.readouterr().out
    assert "never changes: kLeftElbow" in shown["guider data inspect"]
    assert "imagined success" in shown["guider evaluate runs/g1"]
    assert (tmp_path / "runs" / "g1" / "report.html").stat().st_size > 10_000
    assert "[" in shown["python g1_example.py"]
