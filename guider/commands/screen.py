"""What commands show: an answer as text or JSON, and how far long work has come: bars, or lines where nobody
watches."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

SECONDS_BETWEEN_LINES = 30.0
"""Into a file or pipe, where a bar would not move."""


def answer(document: Any, text: Any, as_json: bool) -> None:
    if as_json:
        print(json.dumps(document))
    else:
        Console(highlight=False, soft_wrap=isinstance(text, str)).print(text)


Show = Callable[..., None]


@contextmanager
def _shown() -> Iterator[tuple[Callable[[str], None], Show]]:
    """(a way to say a line, a way to show how much of something is done).

    The second takes (what, done, total, words): a bar for each `what`; or, where nobody watches, a line at once, every
    half minute and at its end.
    """
    console = Console(stderr=True)

    def say(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    if not console.is_terminal:
        yield say, _lines(say)
        return
    columns = (TextColumn("{task.fields[words]}"), TextColumn("left"), TimeRemainingColumn())
    with Progress(
        TextColumn("{task.description:>16}"), BarColumn(), MofNCompleteColumn(), *columns, console=console
    ) as progress:
        bars: dict[str, Any] = {}

        def show(what: str, done: float, total: float | None, words: str = "", title: str | None = None) -> None:
            if what not in bars:
                bars[what] = progress.add_task(title or what, total=total, words=words)
            progress.update(bars[what], completed=done, total=total, words=words, description=title or what)

        yield say, show


def _lines(say: Callable[[str], None]) -> Show:
    last: dict[str, float] = {}
    begun: dict[str, tuple[float, float]] = {}

    def show(what: str, done: float, total: float | None, words: str = "", title: str | None = None) -> None:
        now = time.monotonic()
        started, first = begun.setdefault(what, (now, done))
        ended = total is not None and done >= total
        if not ended and now - last.get(what, -SECONDS_BETWEEN_LINES) < SECONDS_BETWEEN_LINES:
            return
        last[what] = now
        of = "" if total is None else f" of {total:,.0f}"
        left = ""
        if total is not None and done > first and not ended:
            left = f", {(now - started) * (total - done) / (done - first):.0f} s left"
        say(f"{title or what}: {done:,.0f}{of}{' ' if words else ''}{words}{left}")

    return show


@contextmanager
def bar(description: str, unit: str):
    with _shown() as (_, show):
        yield lambda done, total: show(description, done, total, unit)


@contextmanager
def plan_bar():
    """A bar over all runs of a plan, and a line for each that ends."""
    from guider.reproduce.runner import Watch

    with _shown() as (say, show):
        yield Watch(say, lambda done, total, doing: show("plan", done, total, title=doing))


@contextmanager
def stage_bars():
    """(a way to say a line, a bar per stage, fed by the engine's chunks: updates done, rate, time left)."""
    with _shown() as (say, show):

        def show_chunk(chunk: Any, state: Any) -> None:
            rate = f"{chunk.updates / chunk.seconds:.0f}/s"
            show(chunk.stage.name, chunk.position.update, chunk.stage.updates, rate)

        yield say, show_chunk
