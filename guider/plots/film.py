"""A policy at work in its simulator, as a film: the scene, and in it the goal (red), the subgoal that is pursued
(orange) and the way that was gone (blue)."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from guider.errors import GuiderError
from guider.evaluation.rollouts import rollout
from guider.methods import find_method
from guider.methods.policy import Policy
from guider.plots.drawing import Draw, Look, Mark, drawing
from guider.support import files
from guider.support.extras import extra
from guider.tasks.types import Task, VectorEnv, Visible

FORMATS = (".gif", ".mp4")
FRAMES_PER_SECOND, FRAMES_AT_THE_END = 20, 20
MOST_FRAMES = 160
"""Of an episode's whole horizon: where it is longer, every so many steps are shown."""
WAY_SHOWN = 300
Write = Callable[[np.ndarray], Any]
"""Frames are [height, width, 3] uint8."""


def film(
    policy: Policy,
    task: Task,
    path: str | Path,
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
    if (ending := Path(path).suffix) not in FORMATS:
        raise GuiderError(f"{path}: a film's name ends in {' or '.join(FORMATS)}")
    place = files.new_file(path, "name")
    met: list[bool] = []
    with files.replacing(place) as part, _writing(ending, part, look) as write, drawing(task, look) as draw:
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


def _title_height(height: int) -> int:
    """Of the strip above a frame of so many pixels: even, as films are to be."""
    return 2 * max(8, height // 28)


def _titled(frame: np.ndarray, title: str) -> np.ndarray:
    """The frame below a strip that hides nothing of it."""
    height, width, _ = frame.shape
    strip = _title_height(height)
    image = Image.new("RGB", (width, height + strip), "white")
    image.paste(Image.fromarray(frame), (0, strip))
    ImageDraw.Draw(image).text((6, strip // 2), title, "black", ImageFont.load_default(strip * 0.7), anchor="lm")
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
    size = f"{look.width}x{look.height + _title_height(look.height)}"
    command += ["-s", size, "-r", str(FRAMES_PER_SECOND), "-i", "-"]
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
