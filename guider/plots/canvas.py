"""What pictures share: colours, figures and how they are saved, the map of a maze, marks and legends.

Positions are in goal units, which are metres in mazes. A function that takes `axes` draws on them.
"""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke

from guider.data.episodes import Episodes
from guider.support.files import write_bytes
from guider.tasks.mazes import Maze

# Okabe and Ito's colours, which colour-blind readers tell apart.
BLUE, ORANGE, RED, GREEN = "#0072B2", "#E69F00", "#D55E00", "#009E73"
LOGGED, WALL, DARK, GRID = "#A3B1BF", "#8D949B", "#202428", "#E4E7EA"
TIME_COLOURS = "viridis"
FLAG = Outline([(0, 0), (0.08, 0), (0.08, 0.45), (0.75, 0.72), (0, 1), (0, 0)])
DOTS_PER_INCH = 120
LOGGED_SHOWN = 20_000


def new_figure(title: str, size: tuple[float, float]) -> Figure:
    """An empty figure; size: width and height in inches. Bytes of a file's name that are no text are shown as `?`."""
    figure = Figure(figsize=size, layout="compressed")
    figure.suptitle(title.encode(errors="replace").decode(), fontsize=10, parse_math=False)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write `figure` as PNG; a picture is never half there."""
    write_bytes(path, png(figure))


def png(figure: Figure) -> bytes:
    """The figure as PNG."""
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # of names in scripts that the font lacks
        figure.savefig(drawn, format="png", dpi=DOTS_PER_INCH, bbox_inches="tight")
    return drawn.getvalue()


def data_url(image: bytes) -> str:
    """A PNG as a page's own, which nothing is loaded for."""
    return f"data:image/png;base64,{base64.b64encode(image).decode()}"


def seed_range(first: int, count: int) -> str:
    """In words, the seeds of `count` episodes from `first` on."""
    return f"episode seeds {first} to {first + count - 1}" if count > 1 else f"episode seed {first}"


def panel_size(maze: Maze, width: float) -> tuple[float, float]:
    """Inches of a panel of the given width that shows the whole maze, with room for its title."""
    rows, columns = maze.walls.shape
    return width, width * (rows - 1) / (columns - 1) + 0.3


def ground(axes: Axes, maze: Maze, logged: Episodes) -> None:
    """The layer below all maze pictures: walls and logged positions, in metres."""
    size = maze.cell_size_m
    corners = maze.cell_centre(maze.free_cells) - size / 2
    cells = [Rectangle((x, y), size, size) for x, y in corners]
    axes.set_facecolor(WALL)
    axes.add_collection(PatchCollection(cells, facecolor="white", edgecolor="white", linewidth=0.5, zorder=0))
    logged_dots(axes, logged)
    rows, columns = maze.walls.shape
    low, high = maze.cell_centre((0, 0)), maze.cell_centre((rows - 1, columns - 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)


def logged_dots(axes: Axes, logged: Episodes) -> None:
    """Dots where the logged robot was, thinned to about LOGGED_SHOWN; the goal space has two entries."""
    axes.plot(*thinned(logged.achieved, LOGGED_SHOWN).T, ",", color=LOGGED, zorder=1)


def timed_path(axes: Axes, achieved: np.ndarray, last_step: int) -> LineCollection:
    """A line through achieved [steps, 2], coloured by time from step 0 to `last_step`."""
    line = LineCollection(
        list(np.stack([achieved[:-1], achieved[1:]], axis=1)), cmap=TIME_COLOURS, linewidths=1.8, zorder=3
    )
    line.set_array(np.arange(len(achieved) - 1))
    line.set_clim(0, last_step)
    axes.add_collection(line)
    axes.plot(*achieved[0], "o", color="white", markeredgecolor=DARK, markersize=6, zorder=4)
    return line


def numbered_stars(axes: Axes, subgoals: np.ndarray) -> None:
    """A star at each of subgoals [N, 2], numbered from 1 in their order."""
    axes.plot(*subgoals.T, "*", color=ORANGE, markersize=11, markeredgecolor=DARK, markeredgewidth=0.5, zorder=5)
    for number, position in enumerate(subgoals, start=1):
        axes.annotate(
            str(number),
            position,
            (4, 4),
            textcoords="offset points",
            fontsize=8,
            color=DARK,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=6,
        )


def flag(axes: Axes, goal: np.ndarray, radius: float) -> None:
    """The final goal, and the circle within which it counts as met."""
    axes.add_patch(Circle((goal[0], goal[1]), radius, facecolor="none", edgecolor=RED, zorder=6))
    axes.plot(*goal, marker=FLAG, color=RED, markersize=20, markeredgecolor=DARK, markeredgewidth=0.5, zorder=7)


def thinned(points: np.ndarray, count: int) -> np.ndarray:
    """Points [N, ...] evenly chosen from `points`: fewer than twice `count`, all where there are no more."""
    return points[:: max(1, len(points) // count)]


def spaced(points: np.ndarray, spacing: float) -> np.ndarray:
    """[kept] indices of points [N, G] that lie further than `spacing` from all kept before them."""
    kept: list[int] = []
    for index, point in enumerate(points):
        if (np.linalg.norm(points[kept] - point, axis=1) > spacing).all():
            kept.append(index)
    return np.array(kept, int)


def colour_bar(figure: Figure, drawn: ScalarMappable, panels: Sequence[Axes], label: str) -> None:
    """A colour bar beside `panels` for what is `drawn` in colours."""
    bar = figure.colorbar(drawn, ax=panels, fraction=0.025, pad=0.01)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=8)


def legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """One row of entries below all panels."""
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)


def dot_handle(colour: str, label: str) -> Line2D:
    """Legend entry of dots of a colour."""
    return Line2D([], [], marker="o", color=colour, linestyle="", markersize=4, label=label)


def logged_handle() -> Line2D:
    """Legend entry of `logged_dots`."""
    return dot_handle(LOGGED, "logged positions")


def star_handle(label: str) -> Line2D:
    """Legend entry of stars, such as `numbered_stars`."""
    return Line2D([], [], marker="*", color=ORANGE, markeredgecolor=DARK, linestyle="", markersize=9, label=label)


def flag_handle() -> Line2D:
    """Legend entry of `flag`."""
    return Line2D([], [], marker=FLAG, color=RED, linestyle="", markersize=9, label="final goal")
