"""`guider compare`."""

from __future__ import annotations

from pathlib import Path

import tyro
from rich.table import Table

from guider.commands.options import Json
from guider.commands.screen import answer
from guider.support.files import user_path


def compare(runs: tyro.conf.Positional[tuple[Path, ...]], as_json: Json = False) -> None:
    """Put scored runs of one task beside each other: is one better than the first, or luckier?

    Differences are from the first run's score, with 95 % intervals over training seeds and episodes; of one seed alone
    they say nothing about other seeds. The chance is that one of its training seeds scores above one of the first's.

    Args:
        runs: Directories of runs that `guider evaluate` has scored, on the same task in the same way.
        as_json: Print one JSON document instead of text.
    """
    from guider.evaluation.comparison import compare as compared

    rows = compared([user_path(run) for run in runs])
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("run", "method", "seeds", "score", "95 % interval", "difference", "95 % interval", "chance"):
        table.add_column(title)
    for row in rows:
        low, high = row["interval_95"]
        cells = [row["run"], row["method"], str(row["seeds"]), f"{row['score']:.1f}", f"{low} to {high}"]
        if "difference" in row:
            low, high = row["difference_interval_95"]
            cells += [f"{row['difference']:+.1f}", f"{low:+.1f} to {high:+.1f}"]
            cells += [f"{100 * row['probability_of_improvement']:.0f} %"]
        table.add_row(*cells)
    answer(rows, table, as_json)
