"""Of where robots live, and who records them. See `mutants.table`."""

from mutants.mutation import Table

_SPEED = "tasks/test_pointmaze.py::test_ball_speeds_up_and_slows_down_as_its_mass_and_damping_say"
_SEEDED = "tasks/test_pointmaze.py::test_a_copy_is_determined_by_its_seed_alone"
_STAY = "tasks/test_pointmaze.py::test_inactive_copies_stay_as_they_are_and_do_not_disturb_the_others"

TABLE: Table = {
    "guider/collect/waypoints.py": [
        ("np.all(following == goal_cells", "np.any(following == goal_cells", "collect/test_waypoints.py"),
        ("cell_centre(following) + offsets", "cell_centre(following)", "collect/test_waypoints.py"),
        ("np.arange(1, steps + 1) %", "np.arange(steps) %", "collect/test_waypoints.py"),
        ("episodes = -(-steps // recipe", "episodes = (steps // recipe", "collect/test_waypoints.py"),
        ("np.clip(noisy, -1.0, 1.0)", "noisy", "collect/test_waypoints.py"),
        ("reached & recipe.further_goals", "reached", "collect/test_waypoints.py"),
        ("np.where(begins, steps, -recipe.burst_steps)", "np.where(begins, steps, 0)", "collect/test_waypoints.py"),
        ("steps - latest < recipe.burst_steps", "steps - latest <= recipe.burst_steps", "collect/test_waypoints.py"),
        ("[np.maximum(latest, 0)]", "[steps]", "collect/test_waypoints.py"),
        (
            "log.append((observations, actions, goal))",
            "log.append((observations, noisy, goal))",
            "collect/test_waypoints.py",
        ),
        ("<= recipe.goal_radius_m", "<= 2 * recipe.goal_radius_m", "collect/test_waypoints.py"),
    ],
    "guider/collect/ogbench.py": [
        ('if self.kind == "stitch" else ends', "if False else ends", "collect/test_ogbench.py"),
        ("np.argwhere(steps == count)", "np.argwhere(steps <= count)", "collect/test_ogbench.py"),
        ("step % EXPLORE_STEPS == 0", "step % 2 == 0", "collect/test_ogbench.py"),
        ('info["success"] and self.kind == "navigate"', "False", "collect/test_ogbench.py"),
        ("rng.uniform(0.0, 0.1) * np.array", "0.05 * np.array", "collect/test_ogbench.py"),
        ("np.array([1, 1, 1, 3, 10])", "np.array([1, 1, 1, 1, 1])", "collect/test_ogbench.py"),
        ("log.rows.clear()", "pass", "collect/test_ogbench.py"),
        ('"double": (0.0, 0.25)', '"double": (0.0, 0.5)', "collect/test_ogbench.py"),
        ("if rng.random() < self.random", "if False", "collect/test_ogbench.py"),
        ("== [(0, 0), (1, 1)]", "== [(1, 1), (1, 1)]", "collect/test_ogbench.py"),
        ("with numpys_generator(own)", "with nullcontext()", "collect/test_ogbench.py"),
        ("return not (side >= RIGHT_M).any() and", "return", "collect/test_ogbench.py"),
    ],
    "guider/tasks/ogbench_tables.py": [
        ("part_radii=(radius, radius, radius, *slide_radii)", "part_radii=()", "tasks/test_ogbench_tables.py"),
        ("UNITS_TO_METRE * (places - CENTRE_M)", "UNITS_TO_METRE * places", "tasks/test_ogbench_tables.py"),
        ("CUBE_ENTRIES, BUTTON_ENTRIES = 9, 4", "CUBE_ENTRIES, BUTTON_ENTRIES = 8, 4", "tasks/test_ogbench_tables.py"),
        ("table.action_space.seed(seed)", "pass", "tasks/test_ogbench_tables.py"),
        ("tuple(objects[entry] for entry in part)", "part", "tasks/test_ogbench_tables.py"),
        ("BUTTON_ENTRIES * button + 1 for", "BUTTON_ENTRIES * button for", "tasks/test_ogbench_tables.py"),
    ],
    "guider/tasks/ogbench_mazes.py": [
        ("exits[self._rng.integers(len(exits))]", "exits[0]", "tasks/test_ogbench_mazes.py"),
        (
            "maze._teleport_info = maze._teleport_info, None",
            "maze._teleport_info = 2 * (maze._teleport_info,)",
            "tasks/test_ogbench_mazes.py",
        ),
    ],
    "guider/tasks/goal_measure.py": [
        ("goal + 1e-6 * (1 + abs(goal))", "goal", "tasks/test_goal_measure.py"),
        ("return reward == best", "return reward >= 0", "tasks/test_goal_measure.py"),
        ("0.99, 1.01, 1.1", "0.9, 1.1", "tasks/test_goal_measure.py"),
        ("for turn in (-2 * np.pi, 2 * np.pi)", "for turn in ()", "tasks/test_goal_measure.py"),
        ("yield np.clip(achieved, low, high)", "yield achieved", "tasks/test_goal_measure.py"),
        ("np.flatnonzero(np.isfinite(low) & np.isfinite(high))", "()", "tasks/test_goal_measure.py"),
        ("{found:.3g}", "{found:.2g}", "tasks/test_goal_measure.py"),
        ("np.isfinite(radius) and radius > 0 and first", "first", "tasks/test_goal_measure.py"),
    ],
    "guider/tasks/mazes.py": [
        ("/ self.cell_size_m + 1.5", "/ self.cell_size_m + 1.0", "tasks/test_mazes.py"),
        ("np.clip(cells, 0, np.array(self.walls.shape) - 1)", "cells", "tasks/test_mazes.py"),
        ("distances[current] + 1", "distances[current] + 2", "tasks/test_mazes.py"),
        (
            "distances = np.full(self.walls.shape, -1)",
            "distances = np.full(self.walls.shape, -2)",
            "tasks/test_mazes.py",
        ),
        ("self.free_cells - wall).sum(axis=1)", "self.free_cells - wall).max(axis=1)", "tasks/test_mazes.py"),
        ("(row, column + 1), (row, column - 1),", "(row, column - 1), (row, column + 1),", "tasks/test_mazes.py"),
        ("(LARGE_LAYOUT, (1, 1), (7, 9))", "(LARGE_LAYOUT, (1, 1), (7, 10))", "tasks/test_mazes.py"),
        ("inside[1:-1, 1:-1]", "inside[:, 1:-1]", "tasks/test_mazes.py"),
        ("if len(cells) != 1", "if len(cells) < 1", "tasks/test_mazes.py"),
        ("_place(start), _place(goal)]", "]", "tasks/test_mazes.py"),
    ],
    "guider/tasks/simulation.py": [
        ("np.asarray(actions, float)[rows])", "np.asarray(actions, float)[: len(rows)])", _STAY),
        ("np.asarray(trajectories)[:, -1]", "np.asarray(trajectories)[:, 0]", _SPEED),
        ("default_rng(int(seed))", "default_rng(0)", _SEEDED),
        ("rows = np.flatnonzero(active)", "rows = np.arange(self.count)", _STAY),
    ],
}
