"""Of what was logged. See `mutants.table`."""

from mutants.mutation import Table

TABLE: Table = {
    "guider/data/episodes.py": [
        ("self.starts + self.lengths - 1", "self.starts + self.lengths", "data/test_episodes.py"),
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
    ],
    "guider/data/arrays.py": [
        ("_BOUND_TOLERANCE = 2e-3", "_BOUND_TOLERANCE = 0.0", "data/test_episodes.py"),
        ("as_seen = ~in_box.all() |", "as_seen = ~in_box |", "data/test_episodes.py"),
        ("_MOST_LOST * (high[coarse] - low[coarse])", "_MOST_LOST", "data/test_episodes.py"),
        ("lost = np.fmax(lost, np.fmax", "lost = np.fmin(lost, np.fmax", "data/test_episodes.py"),
    ],
    "guider/data/recording.py": [
        ("len(actions) != rows - len(lengths)", "len(actions) != rows - 1", "data/test_readers.py"),
        ("np.cumsum(lengths - 1)", "np.cumsum(lengths)", "data/test_readers.py"),
        ("known = own if asked is None else asked", "known = asked if own is None else own", "data/test_readers.py"),
        ("_same_space(indices, own, observations)", "_same_space(own, own, observations)", "data/test_layouts.py"),
    ],
    "guider/data/columns.py": [
        ("return tuple(dict.fromkeys(found))", "return tuple(sorted(set(found)))", "data/test_readers.py"),
        ("keys = single[:1] or grouped", "keys = single or grouped", "data/test_readers.py"),
        ("rows if column is None else rows[:, column : column + 1]", "rows", "data/test_readers.py"),
    ],
    "guider/data/store.py": [
        (
            "if len(item) == rows else np.concatenate",
            "if len(item) >= rows - 1 else np.concatenate",
            "data/test_readers.py",
        ),
    ],
    "guider/data/readers/folders.py": [
        ('(int(part), "") if part.isdecimal()', "(-1, part) if part.isdecimal()", "data/test_readers.py"),
        ('relative_to(folder).parts[0] == "data"', 'relative_to(folder).parts[0] != "x"', "data/test_readers.py"),
    ],
    "guider/data/findings.py": [
        ("if best > 0:", "if best < 0:", "data/test_findings.py"),
        ("left = now - weight * before", "left = now", "data/test_findings.py"),
        ("gaps = inside & (steps", "gaps = (steps", "data/test_findings.py"),
        ("still = inside & (np.diff", "still = (np.diff", "data/test_findings.py"),
    ],
    "guider/data/suggestions.py": [
        ("low = min(_LEAST_PERIOD, high)", "low = high", "data/test_findings.py"),
        ("episodes.lengths)) // 3), longest", "episodes.lengths)) // 2), longest", "data/test_findings.py"),
        ("varied[entry] < _LEAST_ENDS", "varied[entry] < 0", "data/test_findings.py"),
        (
            "travelled[entry] < _LEAST_TRAVEL * spans[entry]",
            "travelled[entry] < _LEAST_TRAVEL",
            "data/test_findings.py",
        ),
    ],
    "guider/data/layouts.py": [
        ("actions[-1] = actions[-2]", "pass", "data/test_layouts.py"),
    ],
    "guider/data/write.py": [
        (
            "last[np.cumsum(recording.lengths) - 1] = True",
            "last[np.cumsum(recording.lengths)[:-1]] = True",
            "data/test_layouts.py",
        ),
        ("goals | dict(recording.simulation)", "goals", "collect/test_ogbench.py"),
        ("arrays | goals |", "arrays |", "data/test_write.py"),
    ],
    "guider/data/readers/bags.py": [
        ("clock = max(often,", "clock = min(often,", "data/test_bags.py"),
        ("max(_SILENT_SPACINGS * spacing[name], _SILENT_S * 1e9)", "np.inf", "data/test_bags.py"),
        ("rows >= max(column.times[0]", "rows >= min(column.times[0]", "data/test_bags.py"),
        (
            'np.searchsorted(np.array(column.times), rows, side="right")',
            'np.searchsorted(np.array(column.times), rows, side="left")',
            "data/test_bags.py",
        ),
        ("if len(column.times) < len(topic.times)", "if not topic.times", "data/test_bags.py"),
        ("< _LEAST_PART * (ended - began)", "< 0", "data/test_bags.py"),
        ("if times[name][0] > middle:", "if times[name][0] > ended:", "data/test_bags.py"),
        ('if bare[name.strip("/")] == 1 else name', "if bare else name", "data/test_bags.py"),
    ],
    "guider/data/readers/rlds.py": [
        ("crc >> 15 | crc << 17", "crc >> 17 | crc << 15", "data/test_rlds.py"),
        (' and "/ragged_" not in key', "", "data/test_rlds.py"),
        ("np.array(found, np.uint64).astype(np.int64)", "np.array(found, np.uint64)", "data/test_rlds.py"),
        ("(byte & 0x7F) << shift", "byte << shift", "data/test_rlds.py"),
        ('int.from_bytes(part, "little")', 'int.from_bytes(part, "big")', "data/test_rlds.py"),
        ("file.seek(4, 1)", "file.seek(0, 1)", "data/test_rlds.py"),
    ],
    "guider/data/goal_spaces.py": [
        ("[space.cos(angle), space.sin(angle)]", "[space.sin(angle), space.cos(angle)]", "test_own_goal.py"),
        ("sum(spaces.computed_widths[:place])", "place", "test_own_goal.py"),
        ("tuple(dict.fromkeys(indices))", "tuple(sorted(set(indices)))", "test_own_goal.py"),
        ("if computed not in episodes.computed:", "if computed:", "test_own_goal.py"),
        ("or not np.allclose(found, example", "and not np.allclose(found, example", "test_own_goal.py"),
        ("or not np.allclose(alone,", "and not np.allclose(alone,", "test_own_goal.py"),
    ],
}
