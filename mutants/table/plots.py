"""Of pictures, films and pages. See `mutants.table`."""

from mutants.mutation import Table

TABLE: Table = {
    "guider/plots/film.py": [
        ("way[:: 1 + len(way) // WAY_SHOWN]", "way", "plots/test_film.py"),
        ("max(radius_m, task.maze.cell_size_m / 5)", "radius_m", "plots/test_film.py"),
        ("if (len(way) - 1) % every and", "if len(way) % every and", "plots/test_film.py"),
        ("for _ in range(FRAMES_AT_THE_END):", "for _ in range(1):", "plots/test_film.py"),
        ("subgoals[0] if guided else None", "subgoals[0]", "plots/test_film.py"),
    ],
    "guider/plots/drawing.py": [
        ("return frame[::-1]", "return frame", "plots/test_film.py"),
        ("side % 2 == 0", "side % 1 == 0", "plots/test_film.py"),
    ],
    "guider/plots/inspection.py": [
        ("np.delete(episodes.actions, episodes.ends, axis=0)", "episodes.actions", "plots/test_inspection.py"),
        ("if way.shape[1] > 1 else", "if way.shape[1] > 2 else", "plots/test_inspection.py"),
        ("html.escape(in_words(cell))", "in_words(cell)", "plots/test_inspection.py"),
        ('verdict=html.escape(description["verdict"])', 'verdict=""', "plots/test_inspection.py"),
    ],
}
