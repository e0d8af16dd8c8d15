import numpy as np
import pytest

from guider.errors import GuiderError
from guider.tasks import TASKS, find_task
from guider.tasks.mazes import Maze, make_maze

UMAZE = make_maze("umaze", 4.0)


def test_layouts_have_the_shape_and_border_d4rl_gives_them():
    shapes = {name: make_maze(name, 4.0).walls.shape for name in ("umaze", "medium", "large")}
    assert shapes == {"umaze": (5, 5), "medium": (8, 8), "large": (9, 12)}
    for name in shapes:
        maze = make_maze(name, 4.0)
        border = [maze.walls[0], maze.walls[-1], maze.walls[:, 0], maze.walls[:, -1]]
        assert np.concatenate(border).all()
        assert not maze.walls[maze.start_cell] and not maze.walls[maze.goal_cell]
    assert [len(make_maze(name, 4.0).free_cells) for name in shapes] == [7, 26, 46]


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
    routes = {name: make_maze(name, 1.0) for name in ("umaze", "medium", "large")}
    lengths = {name: maze.distances_to(maze.goal_cell)[maze.start_cell] for name, maze in routes.items()}
    assert lengths == {"umaze": 6, "medium": 10, "large": 14}
    path = UMAZE.path((1, 1), (3, 1))
    np.testing.assert_array_equal(path, [[1, 1], [1, 2], [1, 3], [2, 3], [3, 3], [3, 2], [3, 1]])


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


def test_distances_across_a_divided_maze():
    divided = Maze("divided", ("11111", "10101", "11111"), 1.0, goal_cell=(1, 3))
    assert divided.distances_to((1, 3))[1, 1] == -1
    with pytest.raises(ValueError, match="no way"):
        divided.path((1, 1), (1, 3))
    with pytest.raises(ValueError, match="is a wall"):
        divided.distances_to((1, 2))


@pytest.mark.parametrize(
    ("a", "b", "free"),
    [
        ((0, 0), (8, 0), True),  # along the first corridor
        ((0, 0), (0, 8), False),  # through the wall between start and goal
        ((8, 0), (8, 8), True),  # down the right side
        ((3.9, 0), (8, 4.1), False),  # cuts the corner of wall (2, 2), which is at x = 6, y = 2
        ((4.1, -1), (9.9, 4), True),  # passes that corner with x = 7.6 at y = 2
        ((0, 0), (0, 0), True),
        ((0, 4), (0, 4), False),  # a point in a wall
        ((0, 2), (4, 2), True),  # along a wall's edge
        ((0, 0), (-40, 0), False),  # out of the maze
    ],
)
def test_segments(a, b, free):
    assert UMAZE.segment_is_free(np.array(a), np.array(b)) == free
    assert UMAZE.segment_is_free(np.array(b), np.array(a)) == free


def test_segments_agree_with_points_along_them():
    maze = make_maze("large", 1.0)
    rng = np.random.default_rng(1)
    a, b = (
        maze.cell_centre(maze.free_cells[rng.integers(46, size=300)]) + rng.uniform(-0.4, 0.4, (300, 2)) for _ in "ab"
    )
    along = a[:, None] + np.linspace(0, 1, 2000)[:, None] * (b - a)[:, None]
    cells = maze.cell_of(along)
    seen_free = ~maze.walls[cells[..., 0], cells[..., 1]].any(axis=1)
    assert 30 < seen_free.sum() < 270
    np.testing.assert_array_equal(maze.segment_is_free(a, b), seen_free)


def test_wall_boxes_tile_the_walls():
    boxes = UMAZE.wall_boxes
    assert boxes.shape == (18, 4)
    np.testing.assert_array_equal(boxes[0], [-6, -6, 4, 4])
    np.testing.assert_array_equal(UMAZE.cell_of(boxes[:, :2] + 2), np.argwhere(UMAZE.walls))


def test_tasks_are_found_by_name_and_unknown_names_get_a_hint():
    assert {name: task.name for name, task in TASKS.items()} == {name: name for name in TASKS}
    assert find_task("antmaze-large-diverse").paper_score == 80.8
    with pytest.raises(GuiderError, match=r"pointmaze-large.*guider tasks") as caught:
        find_task("pointmase-large")
    assert "\n" not in str(caught.value)
    with pytest.raises(GuiderError, match="'zzzz'; `guider tasks`"):
        find_task("zzzz")
