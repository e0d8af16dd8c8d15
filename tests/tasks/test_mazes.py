from pathlib import Path

import numpy as np
import pytest

from guider.errors import GuiderError
from guider.tasks import TASKS, find_task
from guider.tasks.mazes import Maze, make_maze, read_maze

UMAZE = make_maze("umaze", 4.0)


FREE_CELLS = {"umaze": 7, "medium": 26, "large": 46, "ultra": 89, "giant": 86}


def test_layouts_have_the_shape_and_border_their_sources_give_them():
    shapes = {name: make_maze(name, 4.0).walls.shape for name in FREE_CELLS}
    assert shapes == {"umaze": (5, 5), "medium": (8, 8), "large": (9, 12), "ultra": (12, 16), "giant": (12, 16)}
    for name, free_cells in FREE_CELLS.items():
        maze = make_maze(name, 4.0)
        border = [maze.walls[0], maze.walls[-1], maze.walls[:, 0], maze.walls[:, -1]]
        assert np.concatenate(border).all()
        reachable = maze.distances_to(maze.goal_cell) >= 0
        assert reachable[maze.start_cell] and reachable.sum() == len(maze.free_cells) == free_cells


@pytest.mark.parametrize(
    ("cell", "xy"),
    [((1, 1), (0, 0)), ((3, 1), (0, 8)), ((1, 3), (8, 0)), ((7, 9), (32, 24)), ((0, 0), (-4, -4))],
)
def test_cell_centres_are_where_d4rl_puts_them(cell, xy):
    maze = make_maze("large", 4.0)
    np.testing.assert_array_equal(maze.cell_centre(cell), xy)
    np.testing.assert_array_equal(maze.cell_of(np.array(xy)), cell)


def test_cell_of_switches_half_way_between_centres_and_clips_to_the_grid():
    positions = np.array([[1.99, 0], [2.01, 0], [0, -1.99], [0, -2.01], [-500, 500]])
    np.testing.assert_array_equal(UMAZE.cell_of(positions), [[1, 1], [1, 2], [1, 1], [0, 1], [4, 0]])


def test_every_point_of_a_cell_counts_to_it():
    maze = make_maze("large", 1.0)
    rng = np.random.default_rng(0)
    cells = rng.integers(0, maze.walls.shape, (1000, 2))
    points = maze.cell_centre(cells) + rng.uniform(-0.499, 0.499, (1000, 2))
    np.testing.assert_array_equal(maze.cell_of(points), cells)


def test_distances_in_the_umaze():
    expected = [
        [-1, -1, -1, -1, -1],
        [-1, +6, +5, +4, -1],
        [-1, -1, -1, +3, -1],
        [-1, +0, +1, +2, -1],
        [-1, -1, -1, -1, -1],
    ]
    np.testing.assert_array_equal(UMAZE.distances_to((3, 1)), expected)


def test_evaluated_routes():
    lengths = {name: make_maze(name, 1.0).route_cells for name in FREE_CELLS}
    assert lengths == {"umaze": 6, "medium": 10, "large": 14, "ultra": 22, "giant": 30}


def test_next_cells_lower_the_distance_by_one_from_every_free_cell():
    maze = make_maze("large", 1.0)
    for goal in maze.free_cells:
        distances, following = maze.distances_to(goal), maze.next_cells_to(goal)
        for cell in map(tuple, maze.free_cells):
            assert distances[tuple(following[cell])] == max(distances[cell] - 1, 0)


def test_a_wall_leads_to_the_closest_free_cell():
    following = UMAZE.next_cells_to((3, 1))
    np.testing.assert_array_equal(following[0, 3], [1, 3])
    np.testing.assert_array_equal(following[2, 4], [2, 3])


def test_of_ways_equally_short_the_first_goes_right_then_left_then_down():
    ring = Maze("ring", ("11111", "10001", "10101", "10001", "11111"), 1.0, goal_cell=(3, 2))
    np.testing.assert_array_equal(ring.next_cells_to((3, 2))[1, 2], [1, 3])
    np.testing.assert_array_equal(ring.next_cells_to((2, 3))[2, 1], [3, 1])


def test_distances_across_a_divided_maze():
    divided = Maze("divided", ("11111", "10101", "11111"), 1.0, goal_cell=(1, 3))
    assert divided.distances_to((1, 3))[1, 1] == -1
    assert divided.route_cells == -1
    with pytest.raises(ValueError, match="is a wall"):
        divided.distances_to((1, 2))


DRAWN = """\
########
#..#..G#
#.....##
#S.#...#
########
"""


def draw(folder: Path, text: str) -> Path:
    path = folder / "maze.txt"
    path.write_text(text)
    return path


def test_a_drawn_maze_is_read_as_drawn(tmp_path):
    maze = read_maze(draw(tmp_path, DRAWN), 2.0)
    assert maze.layout == ("11111111", "10010001", "10000011", "10010001", "11111111")
    assert (maze.start_cell, maze.goal_cell, maze.cell_size_m) == ((3, 1), (1, 6), 2.0)
    assert maze.route_cells == 7  # 5 to the right and 2 up
    in_digits = "\ufeff" + DRAWN.replace("#", "1").replace(".", "0").replace("\n", "  \r\n") + "\n\n"
    assert read_maze(draw(tmp_path, in_digits), 2.0) == maze
    for change in (("#.....##", "#......#"), ("#S.#", "#.S#"), ("#..G#", "#G..#")):
        assert read_maze(draw(tmp_path, DRAWN.replace(*change)), 2.0).name != maze.name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("\n\n", "empty"),
        (DRAWN.replace("##\n#S", "#\n#S"), "line 3 has 7 cells, line 1 has 8"),
        (DRAWN.replace("#S.", "#Sx"), "line 4, column 3: 'x'"),
        (DRAWN.replace("#S.", "SS."), "line 4, column 1 is on the border"),
        (DRAWN[:-2] + ".\n", "line 5, column 8 is on the border"),
        ("#S.G#", "line 1, column 2 is on the border"),
        (DRAWN.replace("S", "."), "S must be drawn once, and is drawn 0 times"),
        (DRAWN.replace("G", "."), "G must be drawn once, and is drawn 0 times"),
        (DRAWN.replace("#..#", "#GG#", 1), "G must be drawn once, and is drawn 3 times"),
        (
            DRAWN.replace("#.....##", "#..##.##"),
            r"no way from S \(line 4, column 2\) to G \(line 2, column 7\)",
        ),
        (DRAWN.replace("#S.#...#", "#S.##.##").replace("#.....##", "#....###"), "line 4, column 6 cannot be reached"),
    ],
)
def test_a_maze_drawn_wrong_is_refused_with_the_place(tmp_path, text, message):
    with pytest.raises(GuiderError, match=message) as caught:
        read_maze(draw(tmp_path, text), 1.0)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_text_is_no_maze(tmp_path):
    with pytest.raises(GuiderError, match="no such file"):
        read_maze(tmp_path / "none.txt", 1.0)
    with pytest.raises(GuiderError, match="no such file"):
        read_maze(tmp_path, 1.0)
    binary = tmp_path / "maze.txt"
    binary.write_bytes(b"\x80\xff")
    with pytest.raises(GuiderError, match="cannot be read as text"):
        read_maze(binary, 1.0)


def test_tasks_are_found_by_name_and_unknown_names_get_a_hint():
    assert {name: task.name for name, task in TASKS.items()} == {name: name for name in TASKS}
    assert find_task("antmaze-large-diverse").paper_score == 80.8
    with pytest.raises(GuiderError, match=r"pointmaze-large.*guider tasks") as caught:
        find_task("pointmase-large")
    assert "\n" not in str(caught.value)
    with pytest.raises(
        GuiderError, match=r"'zzzz'; there are pointmaze-umaze, .* more; `guider tasks`.*MAZE\.txt and gym:ENV_ID"
    ):
        find_task("zzzz")
