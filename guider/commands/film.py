"""`guider film`."""

from __future__ import annotations

from pathlib import Path

import tyro

from guider.commands.options import Json, RunDirectory
from guider.commands.screen import answer, bar


def film(
    run: RunDirectory,
    out: tyro.conf.Positional[Path],
    episodes: int = 1,
    first_seed: int = 0,
    seed: int | None = None,
    camera: str | None = None,
    size: tuple[int, int] = (480, 360),
    as_json: Json = False,
) -> None:
    """Film a policy in its simulator, with the subgoal it pursues (orange), its goal (red) and its way (blue).

    No screen is needed: MuJoCo draws through EGL, or OSMesa with MUJOCO_GL=osmesa. guider film runs/ant ant.gif

    Args:
        run: Directory of a run on a task.
        out: New file, .gif or .mp4 (which takes the extra `film`).
        episodes: How many, one after another.
        first_seed: Their environment seeds count up from here.
        seed: Which trained seed's policy; by default the first.
        camera: One of the simulation's, by name; by default as the environment shows itself, a maze from above.
        size: Width and height of the scene in pixels; a strip above it says which step it is.
        as_json: Print one JSON document instead of text.
    """
    from guider import api

    with bar("filming", "steps") as show:
        met = api.film(
            run,
            out,
            seed=seed,
            episodes=episodes,
            first_seed=first_seed,
            camera=camera,
            size=size,
            on_steps=show,
        )
    told = ", ".join(f"{first_seed + e} {'reached' if reached else 'NOT reached'}" for e, reached in enumerate(met))
    answer({"film": str(out), "reached": met}, f"{out}: episodes {told}", as_json)
