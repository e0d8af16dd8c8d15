"""Mazes as grids, those of the literature and one's own: cells, walls, distances and ways through them."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from guider.errors import GuiderError

Cell = tuple[int, int]

UMAZE_LAYOUT = (
    "11111",
    "10001",
    "11101",
    "10001",
    "11111",
)
MEDIUM_LAYOUT = (
    "11111111",
    "10011001",
    "10010001",
    "11000111",
    "10010001",
    "10100101",
    "10001001",
    "11111111",
)
LARGE_LAYOUT = (
    "111111111111",
    "100001000001",
    "101101010101",
    "100000010001",
    "101111011101",
    "100101000001",
    "110101010111",
    "100100010001",
    "111111111111",
)
ULTRA_LAYOUT = (
    "1111111111111111",
    "1000000010000001",
    "1011101010110101",
    "1011101000010101",
    "1000101101110101",
    "1010001000000001",
    "1000100010111011",
    "1010111010001011",
    "1000000010100001",
    "1101101000111101",
    "1101001010000001",
    "1111111111111111",
)
GIANT_LAYOUT = (
    "1111111111111111",
    "1010000001100001",
    "1010110101001101",
    "1000100100010001",
    "1011101111110101",
    "1000100010000101",
    "1110101001010111",
    "1000100100010001",
    "1010101111110101",
    "1011100010001101",
    "1000001000100001",
    "1111111111111111",
)
TELEPORT_LAYOUT = (
    "111111111111",
    "100000101001",
    "110100010011",
    "110111000001",
    "100001010101",
    "101101010101",
    "101101010101",
    "100001000101",
    "111111111111",
)


@dataclass(frozen=True)
class Maze:
    """A grid of square cells, and the route that is evaluated in it.

    Cells are (row, column). As in D4RL, x grows with the column, y with the row, and the origin is the centre
    of cell (1, 1). The border of the grid is wall.

    layout:      one string per row, "1" for a wall and "0" for a free cell
    cell_size_m: side of a cell
    start_cell, goal_cell: where an evaluation episode starts and what it aims at
    """

    name: str
    layout: tuple[str, ...]
    cell_size_m: float
    goal_cell: Cell
    start_cell: Cell = (1, 1)

    @cached_property
    def walls(self) -> np.ndarray:
        """[rows, columns] bool: True where a cell is wall."""
        return np.array([[character == "1" for character in row] for row in self.layout])

    @cached_property
    def free_cells(self) -> np.ndarray:
        """[free, 2] int: every free cell, row by row."""
        return np.argwhere(~self.walls)

    def cell_centre(self, cell: Cell | np.ndarray) -> np.ndarray:
        """[..., 2] cells (row, column) -> [..., 2] centres (x, y) in metres."""
        return self.cell_size_m * (np.asarray(cell, float)[..., ::-1] - 1.0)

    def cell_of(self, xy: np.ndarray) -> np.ndarray:
        """[..., 2] positions (x, y) in metres -> [..., 2] int cells; those outside count to the border."""
        cells = np.floor(np.asarray(xy)[..., ::-1] / self.cell_size_m + 1.5).astype(int)
        return np.clip(cells, 0, np.array(self.walls.shape) - 1)

    def distances_to(self, cell: Cell) -> np.ndarray:
        """[rows, columns] int: steps between adjacent free cells to reach `cell`; -1 for walls and dead ends.

        Raises ValueError if `cell` is a wall.
        """
        goal = (int(cell[0]), int(cell[1]))
        if self.walls[goal]:
            raise ValueError(f"cell {goal} of maze {self.name} is a wall")
        distances = np.full(self.walls.shape, -1)
        distances[goal] = 0
        frontier = deque([goal])
        while frontier:
            current = frontier.popleft()
            for neighbour in _neighbours(current):
                if not self.walls[neighbour] and distances[neighbour] < 0:
                    distances[neighbour] = distances[current] + 1
                    frontier.append(neighbour)
        return distances

    def next_cells_to(self, cell: Cell, across_walls: bool = False) -> np.ndarray:
        """[rows, columns, 2] int: the cell to enter next on a shortest way to `cell`.

        `cell` leads to itself, and a wall to the free cell closest to it (a robot leaning over the edge) or, with
        `across_walls`, to the one of them nearest to `cell`, on whichever side. Free cells from which there is no way
        lead to themselves. Ties go to the first of right, left, down (y grows), up; for walls, row by row.
        """
        distances = self.distances_to(cell)
        following = np.moveaxis(np.indices(self.walls.shape), 0, -1)
        for row, column in self.free_cells:
            here = (int(row), int(column))
            if distances[here] > 0:
                nearer = (n for n in _neighbours(here) if distances[n] == distances[here] - 1)
                following[here] = next(nearer)
        for wall in np.argwhere(self.walls):
            apart = np.abs(self.free_cells - wall).sum(axis=1)
            further = distances[tuple(self.free_cells.T)] / distances.size if across_walls else 0.0
            following[tuple(wall)] = self.free_cells[np.argmin(apart + further)]
        return following

    @property
    def route_cells(self) -> int:
        """Steps between adjacent cells on a shortest way from start to goal; -1 where there is none."""
        return int(self.distances_to(self.goal_cell)[self.start_cell])


def make_maze(name: str, cell_size_m: float) -> Maze:
    """The maze `name` (umaze, medium, large, ultra, giant or teleport) with cells of the given size.

    Source: D4RL's maze maps and evaluation targets; ultra: those of "Efficient Planning in a Compact Latent Action
    Space" (Jiang et al. 2023); giant, teleport: OGBench, with the first of its five goals.
    """
    layout, start_cell, goal_cell = {
        "umaze": (UMAZE_LAYOUT, (1, 1), (3, 1)),
        "medium": (MEDIUM_LAYOUT, (1, 1), (6, 6)),
        "large": (LARGE_LAYOUT, (1, 1), (7, 9)),
        "ultra": (ULTRA_LAYOUT, (1, 1), (10, 14)),
        "giant": (GIANT_LAYOUT, (1, 1), (10, 14)),
        "teleport": (TELEPORT_LAYOUT, (1, 10), (7, 1)),
    }[name]
    return Maze(name=name, layout=layout, cell_size_m=cell_size_m, start_cell=start_cell, goal_cell=goal_cell)


def read_maze(path: Path, cell_size_m: float) -> Maze:
    """The maze drawn in a text file: # or 1 for a wall, . or 0 for a free cell, S for the start and G for the goal.

    A line is a row. The maze is named after the file and a digest of what is drawn.
    Raises GuiderError, naming line and column (from 1), for any other character, lines of different lengths, a border
    that is not all wall, S or G missing or drawn twice, and cells that cannot be reached from S.
    """

    def fail(message: str) -> GuiderError:
        return GuiderError(f"{path}: {message}")

    if not path.is_file():
        raise fail("no such file; a maze is a text file of # and . with S and G")
    try:
        lines = [line.rstrip() for line in path.read_text(encoding="utf-8-sig").rstrip().splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise fail(f"cannot be read as text ({error})") from error
    if not lines:
        raise fail("the file is empty; draw a maze of # and . with S and G")
    for number, line in enumerate(lines, 1):
        if len(line) != len(lines[0]):
            raise fail(
                f"line {number} has {len(line)} cells, line 1 has {len(lines[0])}; all lines must be equally long"
            )
        if unknown := set(line) - set("#1.0SG"):
            column = min(map(line.index, unknown)) + 1
            raise fail(f"line {number}, column {column}: {line[column - 1]!r} is none of # 1 (wall), . 0 (free), S, G")
    drawing = np.array([list(line) for line in lines])
    walls = np.isin(drawing, ("#", "1"))
    inside = np.zeros_like(walls)
    inside[1:-1, 1:-1] = True
    if (openings := np.argwhere(~walls & ~inside)).size:
        raise fail(f"{_place(openings[0])} is on the border and must be wall")
    start, goal = (_only(np.argwhere(drawing == character), character, fail) for character in "SG")
    layout = tuple("".join("1" if wall else "0" for wall in row) for row in walls)
    digest = hashlib.sha256("\n".join([*layout, _place(start), _place(goal)]).encode()).hexdigest()[:8]
    maze = Maze(f"{path.name} ({digest})", layout, cell_size_m, goal_cell=goal, start_cell=start)
    unreachable = maze.free_cells[maze.distances_to(start)[tuple(maze.free_cells.T)] < 0]
    if maze.route_cells < 0:
        raise fail(f"there is no way from S ({_place(start)}) to G ({_place(goal)})")
    if len(unreachable):
        raise fail(f"{_place(unreachable[0])} cannot be reached from S; make it wall")
    return maze


def _only(cells: np.ndarray, character: str, fail: Callable[[str], GuiderError]) -> Cell:
    if len(cells) != 1:
        raise fail(f"{character} must be drawn once, and is drawn {len(cells)} times")
    row, column = cells[0].tolist()
    return row, column


def _place(cell: Cell | np.ndarray) -> str:
    return f"line {cell[0] + 1}, column {cell[1] + 1}"


def _neighbours(cell: Cell) -> tuple[Cell, Cell, Cell, Cell]:
    row, column = cell
    return (row, column + 1), (row, column - 1), (row + 1, column), (row - 1, column)


def floor_places(goal: np.ndarray) -> np.ndarray:
    """[1, 3]: a goal (x, y) in a scene whose floor is at height 0."""
    return np.append(goal, 0.0)[None]
