"""MuJoCo can be had wherever MUJOCO_GL points to."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import guider
from guider.support import physics

PRINT = """
import os, runpy, sys
runpy.run_path(sys.argv[1])["mujoco"].MjSpec()
assert "glfw" not in sys.modules
print(os.environ.get("MUJOCO_GL"))
"""


@pytest.mark.parametrize("renderer", ["osmesa", "egl", "glfw", "off", "no-such-library", "", None])
def test_mujoco_is_imported_without_its_renderer(renderer):
    environment = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "DISPLAY")}
    environment |= {} if renderer is None else {"MUJOCO_GL": renderer}
    command = [sys.executable, "-c", PRINT, physics.__file__]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"{renderer}\n"), done.stderr


def test_it_is_imported_in_one_place():
    imports = re.compile(r"^\s*(import mujoco|from mujoco)", re.MULTILINE)
    modules = Path(guider.__file__).parent.rglob("*.py")
    assert [path.name for path in modules if imports.search(path.read_text())] == ["physics.py"]
