"""One page about logs, to read and to send: what they hold, what is wrong with them, and what they look like.

It is a single HTML file that loads nothing; pictures stand in it.
"""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from guider.data.describe import in_words
from guider.data.episodes import Episodes, entry_name
from guider.plots import canvas

FACTS = (
    "fingerprint",
    "rows",
    "transitions",
    "episodes",
    "episode_length",
    "episode_ends",
    "rate_hz",
    "goal_indices",
    "goal_space_from",
    "suggested_radius",
    "actions_at_bounds",
    "recorded_goals",
)
_ENTRIES_SHOWN, _COLUMNS, _WAYS_SHOWN, _ROWS_SHOWN = 32, 4, 40, 20_000

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title} - Guider</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ background: Canvas; color: CanvasText; }}
body {{ margin: 0 auto; max-width: 980px; padding: 1rem; font: 16px/1.45 system-ui, sans-serif; }}
h1 {{ font-size: 1.3rem; overflow-wrap: anywhere; }} h2 {{ font-size: 1.1rem; margin-top: 1.6rem; }}
.wide {{ overflow-x: auto; }}
td {{ padding: .15rem .8rem .15rem 0; vertical-align: top; overflow-wrap: anywhere; }}
td:first-child {{ overflow-wrap: normal; }}
img {{ max-width: 100%; height: auto; background: #fff; }}
.verdict {{ font-weight: 600; }}
</style></head><body>
<h1>{title}</h1>
<p class="verdict">{verdict}</p>
<ul>{faults}</ul>
{pictures}
<h2>Entries</h2>
<div class="wide"><table>{entries}</table></div>
<h2>Facts</h2>
<table>{facts}</table>
</body></html>
"""


def inspection_page(episodes: Episodes, description: dict[str, Any]) -> str:
    """The page, as HTML. description: what `guider.data.describe` says, and what training would make of it if asked."""
    pictures = {
        "How long episodes are, and how far they go": lengths_and_travel(episodes, description),
        "Where episodes go in the goal's entries": ways(episodes),
        "What state entries hold": entries(episodes, "state"),
        "What action entries hold": entries(episodes, "action"),
    }
    images = {name: canvas.data_url(canvas.png(figure)) for name, figure in pictures.items()}
    facts = {name: description[name] for name in FACTS} | description.get("training", {})
    return _PAGE.format(
        title=html.escape(str(description["source"])),
        verdict=html.escape(description["verdict"]),
        faults="".join(f"<li>{html.escape(fault)}</li>" for fault in description["faults"]),
        pictures="".join(f'<h2>{name}</h2><img alt="{name}" src="{image}">' for name, image in images.items()),
        entries="".join(map(_line, _entry_lines(description))),
        facts="".join(_line((name.replace("_", " "), value)) for name, value in facts.items()),
    )


def _entry_lines(description: dict[str, Any]) -> Iterator[tuple[Any, ...]]:
    """A line for each entry: which, its name, least and most, and what it can be."""
    could, refused = description["could_be_goal"], description["no_goal"]
    for kind, ranges in (("state", description["state_range"]), ("action", description["action_bounds"])):
        names = description[f"{kind}_names"]
        for entry, (low, high) in enumerate(ranges):
            known = names[entry] if names else str(entry)
            use = ("could be a goal" if known in could else refused[known]) if kind == "state" else "action"
            yield f"{kind} {entry}", known, f"{low:g} to {high:g}", use


def _line(cells: Sequence[Any]) -> str:
    return f"<tr>{''.join(f'<td>{html.escape(in_words(cell))}</td>' for cell in cells)}</tr>"


def lengths_and_travel(episodes: Episodes, description: dict[str, Any]) -> Figure:
    """How many episodes are how long, and the median way between states so many steps apart, in goal units."""
    figure = canvas.new_figure("", (8.0, 2.8))
    left, right = figure.subplots(1, 2)
    least, most = episodes.lengths.min(), episodes.lengths.max()
    few = np.arange(least, most + 2) - 0.5
    left.hist(episodes.lengths, bins=40 if most - least >= 40 else list(few), color=canvas.BLUE)
    left.set_xlabel("states in an episode", fontsize=8)
    left.set_ylabel("episodes", fontsize=8)
    travel = description["goal_travel"]
    right.plot([row["steps"] for row in travel], [row["median_distance"] for row in travel], "o-", color=canvas.BLUE)
    right.set_xlabel("steps apart", fontsize=8)
    right.set_ylabel("median way, goal units", fontsize=8)
    for axes in (left, right):
        axes.tick_params(labelsize=7)
    return figure


def ways(episodes: Episodes) -> Figure:
    """Some episodes in the goal space: the first two entries over one another, or the only one over time. Where they
    begin is a ring, where they end a dot."""
    shown = np.linspace(0, len(episodes.starts) - 1, min(_WAYS_SHOWN, len(episodes.starts))).astype(int)
    figure = canvas.new_figure("", (6.0, 4.5))
    axes = figure.subplots()
    names = [entry_name(episodes.state_names, index) for index in episodes.goal_indices]
    for start, length in zip(episodes.starts[shown], episodes.lengths[shown], strict=True):
        way = episodes.achieved[start : start + length]
        x, y = (way[:, 0], way[:, 1]) if way.shape[1] > 1 else (np.arange(length), way[:, 0])
        axes.plot(x, y, color=canvas.BLUE, alpha=0.5, linewidth=0.8)
        axes.plot(x[0], y[0], "o", markersize=4, markerfacecolor="white", markeredgecolor=canvas.DARK)
        axes.plot(x[-1], y[-1], "o", markersize=4, color=canvas.RED)
    if len(names) > 1:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(names[0] if len(names) > 1 else "step", fontsize=8, parse_math=False)
    axes.set_ylabel(names[1] if len(names) > 1 else names[0], fontsize=8, parse_math=False)
    axes.tick_params(labelsize=7)
    return figure


def entries(episodes: Episodes, kind: str) -> Figure:
    """How often each entry of the states or actions has which value, at most the first 32."""
    rows = episodes.observations if kind == "state" else np.delete(episodes.actions, episodes.ends, axis=0)
    names = episodes.state_names if kind == "state" else episodes.action_names
    rows = canvas.thinned(rows[:, :_ENTRIES_SHOWN], _ROWS_SHOWN)
    lines = -(-rows.shape[1] // _COLUMNS)
    figure = canvas.new_figure("", (8.0, 1.4 * lines + 0.2))
    panels: Any = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    for entry, axes in enumerate(panels):
        if entry >= rows.shape[1]:
            axes.remove()
            continue
        axes.hist(rows[:, entry], bins=40, color=canvas.BLUE)
        axes.set_title(entry_name(names, entry, kind)[-28:], fontsize=7, parse_math=False)
        axes.tick_params(labelsize=6)
        axes.set_yticks([])
    return figure
