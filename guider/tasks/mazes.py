"""The three mazes of D4RL's antmaze, as grids: cells, walls, distances and ways through them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np

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

    def next_cells_to(self, cell: Cell) -> np.ndarray:
        """[rows, columns, 2] int: the cell to enter next on a shortest way to `cell`.

        `cell` leads to itself, and a wall to the free cell closest to it (a robot leaning over the edge).
        Free cells from which there is no way lead to themselves. Ties go to the first of right, left, down
        (y grows), up.
        """
        distances = self.distances_to(cell)
        following = np.moveaxis(np.indices(self.walls.shape), 0, -1)
        for row, column in self.free_cells:
            here = (int(row), int(column))
            if distances[here] > 0:
                nearer = (n for n in _neighbours(here) if distances[n] == distances[here] - 1)
                following[here] = next(nearer)
        for wall in np.argwhere(self.walls):
            following[tuple(wall)] = self.free_cells[np.argmin(np.abs(self.free_cells - wall).sum(axis=1))]
        return following

    def path(self, start: Cell, goal: Cell) -> np.ndarray:
        """[steps + 1, 2] int: the cells of a shortest way, both ends included.

        Raises ValueError if there is none.
        """
        steps = self.distances_to(goal)[start]
        if steps < 0:
            raise ValueError(f"maze {self.name} has no way from {start} to {goal}")
        following = self.next_cells_to(goal)
        cells = [np.array(start)]
        for _ in range(steps):
            cells.append(following[tuple(cells[-1])])
        return np.stack(cells)

    @cached_property
    def wall_boxes(self) -> np.ndarray:
        """[walls, 4] in metres: x and y of the lower corner, width and height of every wall cell."""
        corners = self.cell_centre(np.argwhere(self.walls)) - self.cell_size_m / 2
        return np.hstack([corners, np.full_like(corners, self.cell_size_m)])

    def segment_is_free(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """[..., 2], [..., 2] positions in metres -> [...] bool: the straight line between them meets no wall.

        Touching a wall's edge does not count as meeting it. Clips the line against every wall (slab method).
        """
        a, b = np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float))
        a, along = a[..., None, :], (b - a)[..., None, :]
        low, high = self.wall_boxes[:, :2], self.wall_boxes[:, :2] + self.wall_boxes[:, 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low, to_high = (low - a) / along, (high - a) / along
        parallel = along == 0
        inside = (a > low) & (a < high)
        enter = np.where(parallel, np.where(inside, -np.inf, np.inf), np.minimum(to_low, to_high))
        leave = np.where(parallel, np.where(inside, np.inf, -np.inf), np.maximum(to_low, to_high))
        first, last = enter.max(axis=-1), leave.min(axis=-1)
        meets = (first < last) & (first < 1) & (last > 0)
        return ~meets.any(axis=-1)


def make_maze(name: str, cell_size_m: float) -> Maze:
    """The maze `name` (umaze, medium or large) with cells of the given size.

    Source: D4RL's maze maps and evaluation targets.
    """
    layout, goal_cell = {
        "umaze": (UMAZE_LAYOUT, (3, 1)),
        "medium": (MEDIUM_LAYOUT, (6, 6)),
        "large": (LARGE_LAYOUT, (7, 9)),
    }[name]
    return Maze(name=name, layout=layout, cell_size_m=cell_size_m, goal_cell=goal_cell)


def _neighbours(cell: Cell) -> tuple[Cell, Cell, Cell, Cell]:
    row, column = cell
    return (row, column + 1), (row, column - 1), (row + 1, column), (row - 1, column)
