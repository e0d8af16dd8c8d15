# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""A policy at work in its simulator, as a film: the scene, and in it the goal (red), the subgoal that is pursued
(orange) and the way that was gone (blue).

MuJoCo draws without a screen: through EGL, or what MUJOCO_GL names (osmesa, glfw).
"""

from __future__ import annotations

import copy
import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from guider.errors import GuiderError
from guider.evaluation.rollouts import rollout
from guider.methods import find_method
from guider.methods.policy import Policy
from guider.support import files
from guider.support.extras import extra
from guider.support.physics import mujoco
from guider.tasks.mazes import Maze
from guider.tasks.types import Scene, Task, VectorEnv, Visible

FORMATS = (".gif", ".mp4")
FRAMES_PER_SECOND, FRAMES_AT_THE_END = 20, 20
MOST_FRAMES = 160
"""Of an episode's whole horizon: where it is longer, every so many steps are shown."""
WAY_SHOWN, MOST_GEOMS = 300, 5_000
LIBRARIES = ("egl", "osmesa", "glfw", "cgl")


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
Write = Callable[[np.ndarray], Any]
"""Frames are [height, width, 3] uint8."""


def film(
    policy: Policy,
    task: Task,
    path: Path,
    episodes: int,
    first_seed: int,
    look: Look,
    on_steps: Callable[[int, int], None] = lambda done, total: None,
) -> list[bool]:
    """Roll out episodes with seeds first_seed, ..., write their film to the new file `path`, and return which met their
    goals. on_steps(done, total) reports progress.

    Raises GuiderError where the name's ending is none of FORMATS, where the file exists, where the task is no MuJoCo
    simulation, and where nothing can be drawn on this machine.
    """
    if episodes < 1 or first_seed < 0:
        raise GuiderError(f"films are of 1 or more episodes from seed 0 or more on, not {episodes} from {first_seed}")
    if path.suffix not in FORMATS:
        raise GuiderError(f"{path}: a film's name ends in {' or '.join(FORMATS)}")
    if os.path.lexists(path):
        raise GuiderError(f"{path} exists already and is never overwritten; choose another name")
    met: list[bool] = []
    with files.replacing(path) as part, _writing(path.suffix, part, look) as write, _drawing(task, look) as draw:
        for episode in range(episodes):

            def show(done: int, total: int, before: int = episode * task.horizon_steps) -> None:
                on_steps(before + done, episodes * total)

            met.append(_film_episode(policy, task, first_seed + episode, draw, write, show))
    return met


def marks(task: Task, way: Sequence[np.ndarray], subgoal: np.ndarray | None, goal: np.ndarray) -> list[Mark]:
    """The way so far, thinned ([G] each), the goal [G], and the subgoal [G] if there is one; none of them where goals
    are no places."""
    if task.places is None:
        return []
    nearly = goal + task.radius * np.eye(1, len(goal))[0]
    radius_m = float(np.linalg.norm(task.places(nearly) - task.places(goal)))
    if task.maze is not None:
        radius_m = max(radius_m, task.maze.cell_size_m / 5)  # smaller would not be seen from above
    drawn = [
        (way[:: 1 + len(way) // WAY_SHOWN], 0.2, (0.12, 0.47, 0.71, 0.8)),
        ([goal], 1.0, (0.84, 0.15, 0.16, 0.6)),
        ([] if subgoal is None else [subgoal], 0.6, (1.0, 0.6, 0.0, 0.9)),
    ]
    return [
        Mark(place, size * radius_m, colour)
        for goals, size, colour in drawn
        for one in goals
        for place in task.places(one)
    ]


def _film_episode(
    policy: Policy, task: Task, seed: int, draw: Draw, write: Write, on_steps: Callable[[int, int], None]
) -> bool:
    """Whether the goal was met."""
    guided = find_method(policy.method).subgoals is not None
    every = -(-task.horizon_steps // MOST_FRAMES)
    way: list[np.ndarray] = []
    end: list[np.ndarray] = []

    def watch(env: VectorEnv, achieved: np.ndarray, subgoals: np.ndarray, goals: np.ndarray, over: bool) -> None:
        way.append(achieved[0])
        if (len(way) - 1) % every and not over:
            return
        if not isinstance(env, Visible):
            raise GuiderError(f"{task.name} cannot be filmed: its environment has no `scene`, see guider.tasks.types")
        frame = draw(env.scene(0), marks(task, way, subgoals[0] if guided else None, goals[0]))
        write(_titled(frame, f"seed {seed}, step {len(way) - 1}"))
        end[:] = [frame]

    outcome = rollout(policy, replace(task, copies=1), 1, seed, on_steps=on_steps, watch=watch)
    reached = bool(outcome.success[0])
    for _ in range(FRAMES_AT_THE_END):
        write(_titled(end[0], f"seed {seed}, step {len(way) - 1}: {'reached' if reached else 'NOT reached'}"))
    return reached


def _titled(frame: np.ndarray, title: str) -> np.ndarray:
    image = Image.fromarray(frame)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(max(10, image.height // 22))
    box = pen.textbbox((6, 4), title, font)
    pen.rectangle((box[0] - 3, box[1] - 2, box[2] + 3, box[3] + 2), "white")
    pen.text((6, 4), title, "black", font)
    return np.asarray(image)


@contextmanager
def _writing(kind: str, path: Path, look: Look) -> Iterator[Write]:
    """Writes frames to the new file `path`, which is whole at the end."""
    if kind == ".gif":
        images: list[Image.Image] = []
        yield lambda frame: images.append(Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE))
        images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=1000 // FRAMES_PER_SECOND, loop=0)
        return
    command = [_ffmpeg(), "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{look.width}x{look.height}", "-r", str(FRAMES_PER_SECOND), "-i", "-"]
    command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4", str(path.absolute())]
    writer = subprocess.Popen(command, stdin=subprocess.PIPE)
    assert writer.stdin is not None
    try:
        with writer:
            yield writer.stdin.write
    except BrokenPipeError:
        pass  # it ended early
    if writer.returncode:
        raise GuiderError(f"{path} could not be written as .mp4; .gif needs no other program")


def _ffmpeg() -> str:
    """The system's, or that of the extra `film`."""
    if found := shutil.which("ffmpeg"):
        return found
    with extra("film", "ffmpeg, which writes .mp4,"):
        import imageio_ffmpeg
    return imageio_ffmpeg.get_ffmpeg_exe()


@contextmanager
def _drawing(task: Task, look: Look) -> Iterator[Draw]:
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
    library = asked if asked in LIBRARIES else {"darwin": "cgl", "win32": "glfw"}.get(sys.platform, "egl")
    try:
        context = importlib.import_module(f"mujoco.{library}").GLContext(look.width, look.height)
        context.make_current()
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
    return _Canvas(scene.model, lit, renderer, mujoco.MjvScene(lit, MOST_GEOMS), _camera(task, scene, look))


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
