"""What the README promises: its snippet runs as printed, in under 15 lines, and its commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from conftest import make_ragged, tiny

from guider.commands import COMMANDS
from guider.methods import preset_config

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_the_snippet_for_own_data_runs_as_printed(tmp_path, monkeypatch, capsys):
    (snippet,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(snippet.strip().splitlines()) < 15
    monkeypatch.setattr("guider.runs.asked.preset_config", lambda *arguments: tiny(preset_config(*arguments)))
    monkeypatch.chdir(tmp_path)
    logs = make_ragged([20] * 20)
    np.savez("logs.npz", observations=logs.observations, actions=logs.actions, lengths=logs.lengths)
    names: dict = {}
    exec(snippet, names)
    assert names["action"].shape == (2,)
    assert "action_error" in capsys.readouterr().out


def test_the_commands_it_names_exist():
    named = set(re.findall(r"^guider (\w+)", README, flags=re.MULTILINE)) | set(re.findall(r"`guider (\w+)", README))
    assert named == set(COMMANDS)


def test_the_files_it_names_exist():
    root = Path(__file__).parent.parent
    (tree,) = re.findall(r"```\n(guider/\n.*?)```", README, flags=re.DOTALL)
    for name in re.findall(r"\b(\w+\.(?:py|md))\b", tree):
        assert list(root.glob(f"guider/**/{name}")) or (root / "docs" / name).exists(), name


def test_the_tests_that_equations_name_exist():
    """Each name belongs to the file named last before it."""
    tests = Path(__file__).parent
    text = (tests.parent / "docs" / "equations.md").read_text()
    names = re.findall(r"`(?:(test_\w+)\.)?(test_\w+)`", text)
    assert len(names) > 25
    file = ""
    for named, function in names:
        file = named or file
        assert f"def {function}(" in next(tests.rglob(f"{file}.py")).read_text(), f"{file}.{function}"
