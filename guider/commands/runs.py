"""`guider runs`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tyro
from rich.table import Table

from guider.commands.options import Json
from guider.commands.screen import answer
from guider.support.files import user_path


def runs(folder: tyro.conf.Positional[Path] = Path("runs"), as_json: Json = False) -> None:
    """List the runs below a folder: what each is, how far it has come, what it scored.

    Args:
        folder: Where to look; by default where `guider train` puts them.
        as_json: Print one JSON document instead of text.
    """
    from guider.runs.listing import facts, run_directories

    rows = [facts(directory) for directory in run_directories(user_path(folder))]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("run", "task or data", "method", "preset", "seeds", "updates", "score"):
        table.add_column(title)
    for row in rows:
        if "method" not in row:
            table.add_row(row["run"], row["problem"])
            continue
        done, total = row["updates"], row["of_updates"]
        shown = (row["task"] or Path(row["data"]).name, row["method"], row["preset"], str(len(row["seeds"])))
        table.add_row(row["run"], *shown, "done" if done == total else f"{done} of {total}", _score(row))
    answer(rows, table if rows else f"there are no runs below {folder}", as_json)


def _score(row: dict[str, Any]) -> str:
    if row["problem"]:
        return row["problem"]
    if "action_error" in row:
        return f"action error {row['action_error']:.3f} on held-out episodes"
    if "score" not in row:
        return "-"
    low, high = row["interval_95"]
    return f"{row['score']:.1f} ({low} to {high}) {row['unit']}"
