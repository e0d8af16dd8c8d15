"""Of what was logged. See `mutants.table`."""

from mutants.mutation import Table

TABLE: Table = {
    "guider/data/episodes.py": [
        ("self.starts + lengths - 1, lengths", "self.starts + lengths, lengths", "data/test_episodes.py"),
        ("np.minimum(low[goal], self.goals.min(axis=0))", "low[goal]", "data/test_episodes.py"),
        ("np.maximum(high[goal], self.goals.max(axis=0))", "high[goal]", "data/test_episodes.py"),
        (
            "            self.goals,\n            self.action_low,",
            "            self.action_low,",
            "data/test_episodes.py",
        ),
        ("indices == self.goal_indices", "set(indices) == set(self.goal_indices)", "data/test_episodes.py"),
        ("round(held_out * count)", "int(held_out * count)", "data/test_episodes.py"),
        ("np.sort(order[n_held:])", "np.sort(order)", "data/test_episodes.py"),
        ("is_action[np.cumsum(lengths) - 1]", "is_action[np.cumsum(lengths)[:-1] - 1]", "data/test_episodes.py"),
        ("keep = np.repeat(lengths >= 2, lengths)", "keep = np.repeat(lengths > 2, lengths)", "data/test_episodes.py"),
        ("_BOUND_TOLERANCE = 2e-3", "_BOUND_TOLERANCE = 0.0", "data/test_episodes.py"),
        ("as_seen = ~in_box.all() |", "as_seen = ~in_box |", "data/test_episodes.py"),
        ("_MOST_LOST * (high[coarse] - low[coarse])", "_MOST_LOST", "data/test_episodes.py"),
        ("lost = np.fmax(lost, np.fmax", "lost = np.fmin(lost, np.fmax", "data/test_episodes.py"),
    ],
}
