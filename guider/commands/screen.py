"""What commands show: an answer as text or JSON, and how far long work has come."""

from __future__ import annotations

import json
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def answer(document: Any, text: Any, as_json: bool) -> None:
    if as_json:
        print(json.dumps(document))
    else:
        Console(highlight=False, soft_wrap=isinstance(text, str)).print(text)


def _progress(*columns: Any) -> Progress:
    return Progress(
        TextColumn("{task.description:>16}"),
        BarColumn(),
        MofNCompleteColumn(),
        *columns,
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


@contextmanager
def bar(description: str, unit: str):
    with _progress(TextColumn(unit)) as progress:
        bar = progress.add_task(description, total=None)
        yield lambda done, total: progress.update(bar, completed=done, total=total)


@contextmanager
def plan_bar():
    """A bar over all runs of a plan, and a line for each that ends."""
    from guider.reproduce.runner import Watch

    with _progress() as progress:
        bar = progress.add_task("", total=None)

        def show(done: float, total: int, doing: str) -> None:
            progress.update(bar, completed=done, total=total, description=doing)

        yield Watch(lambda line: progress.console.print(line, highlight=False, markup=False, soft_wrap=True), show)


@contextmanager
def stage_bars():
    """(a way to say a line, a bar per stage, fed by the engine's chunks: updates done, rate, time left)."""
    with _progress(TextColumn("{task.fields[rate]:.0f}/s")) as progress:
        bars: dict[int, Any] = {}

        def show(chunk: Any, state: Any) -> None:
            index = chunk.position.stage
            if index not in bars:
                bars[index] = progress.add_task(chunk.stage.name, total=chunk.stage.updates, rate=0.0)
            progress.update(bars[index], completed=chunk.position.update, rate=chunk.updates / chunk.seconds)

        yield lambda line: progress.console.print(line, highlight=False, markup=False, soft_wrap=True), show
