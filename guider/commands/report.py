"""`guider report`."""

from __future__ import annotations

from pathlib import Path

import tyro

from guider.commands.options import Json
from guider.commands.screen import answer


def report(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    out: Path | None = None,
    first_seed: int = 0,
    data: str | None = None,
    as_json: Json = False,
) -> None:
    """Write one HTML page about finished, scored runs: it loads nothing, and can be sent as it is.

    What was trained on what, the score and its interval (on own data the verdict), learning curves over one another,
    episodes to scrub through with their subgoals and what the prior holds for reachable, the run's pictures, departures
    from the paper, versions, and the command.

    Args:
        runs: Directories of the runs; pictures are the first one's.
        out: The page, new; by default report.html in the first run.
        first_seed: On a task: seeds of the episodes shown count up from here.
        data: Where the first run's data is now, if it has moved.
    """
    from guider import api

    path = api.report(runs, out, first_seed=first_seed, data=data)
    answer({"report": str(path)}, f"{path} is complete; open it in a browser", as_json)
