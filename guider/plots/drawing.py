# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""A simulator's scene as a picture, with marks in it, drawn by MuJoCo without a screen: through EGL, or what MUJOCO_GL
names."""

from __future__ import annotations

import copy
import importlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from guider.errors import GuiderError, names_like
from guider.support.physics import mujoco
from guider.tasks.mazes import Maze
from guider.tasks.types import Scene, Task

LIBRARIES = ("egl", "osmesa", "glfw", "cgl")
_OFF = ("", "off", "disable", "disabled", "0", "false")
"""What MUJOCO_GL says where MuJoCo shall load no library by itself."""
_MOST_GEOMS = 5_000


@dataclass(frozen=True)
class Look:
    """camera: one of the model's, by name; None for how the environment shows itself, a maze from above. width, height:
    of a frame, pixels."""

    camera: str | None = None
    width: int = 480
    height: int = 360

    def __post_init__(self) -> None:
        if not all(32 <= side <= 4096 and side % 2 == 0 for side in (self.width, self.height)):
            raise GuiderError(
                f"a film is 32 to 4096 pixels wide and high, even numbers, not {self.width} x {self.height}"
            )


class Mark(NamedTuple):
    """A ball in the scene: where, how large (metres), and its colour (red, green, blue, how opaque; 0 to 1)."""

    place: np.ndarray
    radius_m: float
    colour: tuple[float, float, float, float]


Draw = Callable[[Scene, Sequence[Mark]], np.ndarray]
"""Pictures are [height, width, 3] uint8."""


@contextmanager
def drawing(task: Task, look: Look) -> Iterator[Draw]:
    """Draws scenes off screen. Raises GuiderError where there is no library for it."""
    context = _open_context(look)
    canvas: list[_Canvas] = []  # of the model that was drawn last

    def draw(scene: Scene, marks: Sequence[Mark]) -> np.ndarray:
        if not canvas or canvas[0].model is not scene.model:
            for old in canvas:
                old.renderer.free()
            canvas[:] = [_canvas(task, scene, look)]
        return _draw(canvas[0], scene, marks, look)

    try:
        yield draw
    finally:
        for last in canvas:
            last.renderer.free()
        context.free()


def _open_context(look: Look) -> Any:
    """An OpenGL context without a window, made current."""
    asked = os.environ.get("MUJOCO_GL", "").lower()
    if asked not in (*LIBRARIES, *_OFF):
        raise GuiderError(f"MUJOCO_GL names {asked!r}, which draws nothing; {names_like(asked, LIBRARIES)}")
    usual = {"darwin": "cgl", "win32": "glfw"}.get(sys.platform, "egl")
    library = asked if asked in LIBRARIES else usual
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW warns, and goes on, where there is no screen
            context = importlib.import_module(f"mujoco.{library}").GLContext(look.width, look.height)
        context.make_current()
        mujoco.MjrContext(mujoco.MjSpec().compile(), mujoco.mjtFontScale.mjFONTSCALE_100).free()
    except Exception as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise GuiderError(
            f"nothing can be drawn here, {library} does not work ({why}): install libegl1 and libgl1-mesa-dri, "
            "as Debian and Ubuntu call them, or libosmesa6 and set MUJOCO_GL=osmesa"
        ) from None
    return context


class _Canvas(NamedTuple):
    """What draws one model: MuJoCo's MjModel, a copy of it that is lit, MjrContext, MjvScene and MjvCamera."""

    model: Any
    lit: Any
    renderer: Any
    shapes: Any
    camera: Any


def _canvas(task: Task, scene: Scene, look: Look) -> _Canvas:
    lit = copy.copy(scene.model)
    lit.vis.global_.offwidth, lit.vis.global_.offheight = look.width, look.height
    lit.vis.headlight.ambient, lit.vis.headlight.diffuse = [0.45] * 3, [0.4] * 3
    renderer = mujoco.MjrContext(lit, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, renderer)
    return _Canvas(scene.model, lit, renderer, mujoco.MjvScene(lit, _MOST_GEOMS), _camera(task, scene, look))


def _camera(task: Task, scene: Scene, look: Look) -> Any:
    model, camera = scene.model, mujoco.MjvCamera()
    if look.camera is not None:
        names = [model.cam(number).name for number in range(model.ncam)]
        if look.camera not in names:
            raise GuiderError(f"{task.name} has no camera {look.camera!r}; it has {', '.join(names) or 'none by name'}")
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, names.index(look.camera)
        return camera
    mujoco.mjv_defaultFreeCamera(model, camera)
    for name, value in (_from_above(task.maze, look) if task.maze else scene.camera).items():
        if name in ("azimuth", "elevation", "distance", "lookat"):
            setattr(camera, name, value)
    return camera


def _from_above(maze: Maze, look: Look) -> dict[str, Any]:
    """All of a maze, so steeply that walls hide little."""
    rows, columns = maze.walls.shape
    centre = maze.cell_centre(np.array([(rows - 1) / 2, (columns - 1) / 2]))
    distance = 1.2 * maze.cell_size_m * max(rows, columns * look.height / look.width)
    return {"azimuth": 90.0, "elevation": -65.0, "lookat": [*centre, 0.0], "distance": distance}


def _draw(canvas: _Canvas, scene: Scene, marks: Sequence[Mark], look: Look) -> np.ndarray:
    shapes, everything = canvas.shapes, mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(canvas.lit, scene.data, mujoco.MjvOption(), None, canvas.camera, everything, shapes)
    for mark in marks:
        size, turned = np.full(3, mark.radius_m), np.eye(3).ravel()
        ball = shapes.geoms[shapes.ngeom]
        mujoco.mjv_initGeom(
            ball, mujoco.mjtGeom.mjGEOM_SPHERE, size, mark.place, turned, np.array(mark.colour, np.float32)
        )
        ball.emission = 0.5
        shapes.ngeom += 1
    frame = np.empty((look.height, look.width, 3), np.uint8)
    area = mujoco.MjrRect(0, 0, look.width, look.height)
    mujoco.mjr_render(area, shapes, canvas.renderer)
    mujoco.mjr_readPixels(frame, None, area, canvas.renderer)
    return frame[::-1]
