"""MuJoCo, imported without what draws: only films are drawn, with a library of their own choice (plots/drawing.py), and
there may be none. To look for one MuJoCo would also start a process, which says things of its own when interrupted."""

from __future__ import annotations

import os

_asked = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "off"
try:
    import mujoco
    import mujoco.rollout
finally:
    del os.environ["MUJOCO_GL"]
    if _asked is not None:
        os.environ["MUJOCO_GL"] = _asked  # for what draws later, and what is started from here

__all__ = ["mujoco"]
