"""`guider plot`."""

from __future__ import annotations

from guider.commands.options import Json, RunDirectory
from guider.commands.screen import answer


def plot(run: RunDirectory, seed: int | None = None, data: str | None = None, as_json: Json = False) -> None:
    """Draw a finished run into RUN/plots: learning curves, and what its subgoals look like.

    Args:
        run: Directory of the run.
        seed: Which trained seed to draw; by default the first.
        data: Where the run's data is now, if it has moved.
        as_json: Print one JSON document instead of text.
    """
    from guider import api

    paths = [str(path) for path in api.plot(run, seed=seed, data=data)]
    answer({"plots": paths}, "\n".join(paths), as_json)
