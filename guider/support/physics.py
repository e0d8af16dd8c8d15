"""MuJoCo, imported even where it has no renderer: nothing but films is drawn with it."""

from __future__ import annotations

import os

try:
    import mujoco
except Exception:
    # MUJOCO_GL names an OpenGL library that cannot be loaded, as on many servers, or none that there is.
    renderer = os.environ.get("MUJOCO_GL")
    if renderer is None:
        raise
    os.environ["MUJOCO_GL"] = "off"
    try:
        import mujoco
    finally:
        os.environ["MUJOCO_GL"] = renderer  # for what is started from here

import mujoco.rollout

__all__ = ["mujoco"]
