"""Of what a policy is worth, and when a goal is met. See `mutants.table`."""

from mutants.mutation import Table

_COMPARED = "evaluation/test_comparison.py"

TABLE: Table = {
    "guider/goals.py": [
        ("arrays.sqrt(arrays.stack(sums, axis=-1))", "arrays.stack(sums, axis=-1)", "test_goals.py"),
        ("for entry in part) for part", "for entry in part[:1]) for part", "test_goals.py"),
        ("parts).max(axis=-1)", "parts).min(axis=-1)", "test_goals.py"),
        ("equal[entries] = False", "equal[entries] = True", "test_goals.py"),
        ("(slice(100), slice(None))", "(slice(100),)", "test_goals.py"),
        ("atol=1e-5", "atol=1e-2", "test_goals.py"),
        ("int(np.argmax(equal))", "int(np.flatnonzero(equal)[-1])", "test_goals.py"),
    ],
    "guider/evaluation/rollouts.py": [
        ("distances <= radii", "distances < radii", "evaluation/test_evaluation.py"),
        ("task.part_radii or [task.radius]", "[task.radius]", "evaluation/test_evaluation.py"),
        ("parts_met |= met", "parts_met = met", "evaluation/test_evaluation.py"),
        ("steps_met += met.all(axis=1)", "steps_met += met.any(axis=1)", "evaluation/test_evaluation.py"),
        ("np.minimum(steps[done], step + 1)", "step + 1", "evaluation/test_evaluation.py"),
        ("active &= ~done", "active &= True", "evaluation/test_evaluation.py"),
        ('if task.score != "return":', "if True:", "evaluation/test_evaluation.py"),
        ("reset_mask = no_reset", "reset_mask = reset_mask", "evaluation/test_evaluation.py"),
        ("first_seed + first + np.arange(copies)", "first_seed + np.arange(copies)", "evaluation/test_evaluation.py"),
        ("[b.score for b in batches])[:episodes]", "[b.score for b in batches])", "evaluation/test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "0 < success.mean() < 1", "evaluation/test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "len(success) > 1", "evaluation/test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "False", "evaluation/test_evaluation.py"),
        ("achieved=achieved[e, : steps[e]]", "achieved=achieved[e]", "evaluation/test_evaluation.py"),
        (
            'task.horizon_steps) if task.score == "return"',
            "task.horizon_steps) if False",
            "evaluation/test_evaluation.py",
        ),
        ("z**2 / (2 * trials)", "z**2 / trials", "evaluation/test_evaluation.py"),
        ("z**2 / (4 * trials**2)", "z**2 / (4 * trials)", "evaluation/test_evaluation.py"),
        (
            "rng.integers(seeds, size=(resamples, seeds, 1))",
            "np.arange(seeds)[:, None]",
            "evaluation/test_evaluation.py",
        ),
        ("[0.025, 0.975]", "[0.05, 0.95]", "evaluation/test_evaluation.py"),
    ],
    "guider/evaluation/statistics.py": [
        ("np.std(scores)", "np.std(scores, ddof=1)", "evaluation/test_statistics.py"),
        ("runs.shape[-1] // 4", "runs.shape[-1] // 3", "evaluation/test_statistics.py"),
        ("cut : runs.shape[-1] - cut", "cut:", "evaluation/test_statistics.py"),
        ("0.5 * (ours == theirs)", "1.0 * (ours == theirs)", "evaluation/test_statistics.py"),
        ("(ours > theirs)", "(ours < theirs)", "evaluation/test_statistics.py"),
        ("[0.025, 0.975]", "[0.05, 0.95]", "evaluation/test_statistics.py"),
        ("size=(RESAMPLES, seeds, tasks)), np", "size=(RESAMPLES, seeds, 1)), np", "evaluation/test_statistics.py"),
        ("np.arange(tasks)]", "rng.permutation(tasks)]", "evaluation/test_statistics.py"),
    ],
    "guider/evaluation/comparison.py": [
        ("result.get(name) != first.get(name)", "name == 'task' and result.get(name) != first.get(name)", _COMPARED),
        ("size=(500, seeds, 1))", "size=(500, 1, 1)) * 0 + np.arange(seeds)[None, :, None]", _COMPARED),
        ("if paired and len", "if not paired and len", _COMPARED),
        ("[0.025, 0.975]", "[0.05, 0.95]", _COMPARED),
    ],
    "guider/evaluation/heldout.py": [
        ("rows + period_steps, last[rows]", "rows + 1, last[rows]", "evaluation/test_heldout.py"),
        ("(episodes.action_high + episodes.action_low) / 2) / half", "0) / half", "evaluation/test_heldout.py"),
        ("actions.var(axis=0)", "actions.var(axis=1)", "evaluation/test_heldout.py"),
        ("episodes.achieved[last[rows]]", "episodes.achieved[later]", "evaluation/test_heldout.py"),
        ("outcome[shuffled]", "outcome", "evaluation/test_heldout.py"),
        ("axis=1).min() for point", "axis=1).max() for point", "evaluation/test_heldout.py"),
        ("np.quantile(travel, 0.99)", "np.quantile(travel, 0.5)", "evaluation/test_heldout.py"),
        ("len(chosen) >= 3", "len(chosen) >= 2", "evaluation/test_heldout.py"),
        ("np.ptp(chosen) > 0", "np.ptp(chosen) >= 0", "evaluation/test_heldout.py"),
    ],
    "guider/evaluation/imagined.py": [
        ("jnp.round(changes / around)", "0", "evaluation/test_imagined.py"),
        ("self.first_met < self.first_off", "self.first_met <= self.first_off", "evaluation/test_imagined.py"),
        ("later = states + model.change + ", "later = states + ", "evaluation/test_imagined.py"),
        ("> max(problem.reach_radius, apart)", "> np.inf", "evaluation/test_imagined.py"),
        (
            "largest_distance(places, goals, problem.goal_parts) <= problem.radius",
            "largest_distance(places, goals, problem.goal_parts) <= 0",
            "evaluation/test_imagined.py",
        ),
    ],
    "guider/evaluation/trust.py": [
        ("error > MOST_MODEL_ERROR", "error < MOST_MODEL_ERROR", "evaluation/test_imagined.py"),
        ("< LEAST_SUCCESS", "> LEAST_SUCCESS", "evaluation/test_imagined.py"),
        ("> MOST_LEFT", "> 1", "evaluation/test_imagined.py"),
        ("< LEAST_COVERAGE", "< 0", "evaluation/test_imagined.py"),
        ("< LEAST_IN_RANGE", "< 0", "evaluation/test_imagined.py"),
    ],
}
