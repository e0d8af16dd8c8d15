"""Of batches, equations and networks, and of the engine. See `mutants.table`."""

from mutants.mutation import Table

_KEPT = "learning/test_samplers.py::test_subgoals_that_are_kept_were_chosen_up_to_a_period_ago_in_the_same_episode"
_CROSSES = "learning/test_samplers.py::test_no_sample_crosses_an_episode"
_ENDS = "learning/test_samplers.py::test_final_goals_can_be_where_episodes_end"
_FLAT_GOALS = "learners/test_learners.py::test_flat_goals_come_from_ahead_in_their_own_episode"
_SHARES = "methods/test_hiql.py::test_value_goals_come_in_their_shares_and_geometric"
_STRETCH = "methods/test_hiql.py::test_value_stretches_stay_in_their_episode"
_WAY = "methods/test_hiql.py::test_waypoints_lie_k_steps_ahead_or_at_a_nearer_goal"
_WINDOWS = "methods/test_opal.py::test_windows_stay_in_their_episode"
_UPDATES = "learning/test_training.py::test_updates_metrics_and_positions_by_hand"
_CHUNKS = "learning/test_training.py::test_chunks_end_at_multiples_wherever_training_starts"
_STOPS = "learning/test_training.py::test_training_stops_when_told_and_goes_on_from_there"
_INITIALISED = "learners/test_steps.py::test_initialisation"
_STARTS = "learning/test_training.py::test_training_starts_where_it_is_told"
_KNOWN = "learning/test_training.py::test_what_is_known_is_asked_before_a_stage_begins_alone"

TABLE: Table = {
    "guider/learning/losses.py": [
        ("parts) < radius, 0.0", "parts) <= radius, 0.0", "learning/test_losses.py"),
        ("0.0, -1.0).sum(axis=-1)", "0.0, -1.0).min(axis=-1)", "learning/test_losses.py"),
        ("jnp.exp(2 * (p.log_std - q.log_std))", "jnp.exp(p.log_std - q.log_std)", "learning/test_losses.py"),
        ("* jnp.exp(-q.log_std)) ** 2", "* jnp.exp(-p.log_std)) ** 2", "learning/test_losses.py"),
        (
            "balance * gaussian_kl(frozen_posterior",
            "(1 - balance) * gaussian_kl(frozen_posterior",
            "learning/test_losses.py",
        ),
        (
            "frozen_posterior = jax.lax.stop_gradient(posterior)",
            "frozen_posterior = posterior",
            "learning/test_losses.py",
        ),
        ("error + beta * kl, error, kl", "beta * error + kl, error, kl", "learning/test_losses.py"),
        ("kl = jnp.mean(balanced_kl", "kl = jnp.sum(balanced_kl", "learning/test_losses.py"),
        (
            "jnp.where(reward < 0, reward + discount * next_value, 0.0)",
            "reward + discount * next_value",
            "learning/test_losses.py",
        ),
        (
            "logsumexp(sampled - log_density, axis=-1)",
            "logsumexp(sampled + log_density, axis=-1)",
            "learning/test_losses.py",
        ),
        (
            "logsumexp(sampled - log_density, axis=-1) - data",
            "logsumexp(sampled - log_density, axis=-1)",
            "learning/test_losses.py",
        ),
        ("error < 0, 1 - expectile, expectile", "error < 0, expectile, 1 - expectile", "learning/test_losses.py"),
        ("advantage / temperature, 20.0", "advantage * temperature, 20.0", "learning/test_losses.py"),
        (", 20.0)), ceiling)", ", 20.0)), 100.0)", "learning/test_losses.py"),
        ("jax.lax.stop_gradient(weight) * jnp.mean", "weight * jnp.mean", "learning/test_losses.py"),
        ("jnp.mean(misses", "jnp.sum(misses", "learning/test_losses.py"),
        ('** 2 if error == "squared"', '** 2 if error != "squared"', "learning/test_losses.py"),
        (
            "        return -policy.log_prob(action)",
            "        return policy.log_prob(action)",
            "learning/test_losses.py",
        ),
        ("(misses + policy.log_std + jnp", "(misses + jnp", "learning/test_losses.py"),
    ],
    "guider/learning/networks.py": [
        ("self.mean + jnp.exp(self.log_std) * noise", "self.mean + self.log_std * noise", "learning/test_losses.py"),
        ("-0.5 * standardised**2 - self.log_std", "-0.5 * standardised**2 + self.log_std", "learning/test_losses.py"),
        ("hidden / (1 - dropout)", "hidden", "learning/test_losses.py"),
        ("LOG_STD_RANGE = (-5.0, 2.0)", "LOG_STD_RANGE = (-20.0, 2.0)", "learning/test_losses.py"),
        ("actions @ weight[context_dim:]", "actions @ weight[-1 - context_dim : -1]", "learning/test_losses.py"),
        ("* (2 * bound) - bound", "* bound", _INITIALISED),
        ("uniform(w_key, shape, fan_in**-0.5)", "uniform(w_key, shape, fan_out**-0.5)", _INITIALISED),
        (
            "jax.nn.standardize(jax.nn.gelu(outputs), axis=-1)",
            "jax.nn.gelu(outputs)",
            "methods/test_hiql.py::test_layer_norm_by_hand",
        ),
        ("_SMALL = 1e-3", "_SMALL = 1e-2", _INITIALISED),
        ("_HIDDEN_BIAS = 0.1", "_HIDDEN_BIAS = 0.0", _INITIALISED),
    ],
    "guider/learning/optimisers.py": [
        ("value - rate * step", "value + rate * step", "learning/test_optimisers.py"),
        ("0.5 * (1 + jnp.cos", "0.5 * (1 - jnp.cos", "learning/test_optimisers.py"),
        ("jnp.minimum(moments.count / updates, 1.0)", "moments.count / updates", "learning/test_optimisers.py"),
        ("if not decay", "if decay", "learning/test_optimisers.py"),
        (
            "incremental_update(params, target, rate)",
            "incremental_update(target, params, rate)",
            "learning/test_optimisers.py",
        ),
    ],
    "guider/learning/windows.py": [
        (
            "later = np.minimum(rows + period_steps, last)",
            "later = np.minimum(rows + 1, last)",
            "learning/test_samplers.py",
        ),
        ('if boundary == "drop" else 1) <= last', 'if boundary == "drop" else 1) < last', "learning/test_samplers.py"),
        ('if boundary == "drop" else 1)', 'if boundary == "drop" else 0)', "learning/test_samplers.py"),
        ("- achieved, axis=1) >= minimum_move", "- achieved, axis=1) > minimum_move", "learning/test_samplers.py"),
        ("furthest >= minimum_move", "furthest > minimum_move", "learning/test_samplers.py"),
        ("np.maximum.reduceat", "np.minimum.reduceat", "learning/test_samplers.py"),
        ("(episodes.action_high - episodes.action_low) / 2", "episodes.action_high", "learning/test_samplers.py"),
        ("(episodes.actions - centre) / half_range", "episodes.actions / half_range", "learning/test_samplers.py"),
        ('period_steps, "clip", minimum_move', "period_steps, boundary, minimum_move", "learning/test_samplers.py"),
        ("+ steps <= episodes.last_rows", "+ steps < episodes.last_rows", "learning/test_samplers.py"),
    ],
    "guider/learning/samplers.py": [
        ('furthest if ahead == "last"', 'last if ahead == "last"', "learning/test_samplers.py"),
        ('"action": data.actions[rows]', '"action": data.actions[rows + 1]', "learning/test_samplers.py"),
        (
            '"next_achieved": data.achieved[rows + 1]',
            '"next_achieved": data.achieved[rows]',
            "learning/test_samplers.py",
        ),
        (
            '"next_observation": data.observations[rows + 1]',
            '"next_observation": data.observations[rows]',
            "learning/test_samplers.py",
        ),
        ("(count,), 0, len(rows))", "(count,), 1, len(rows))", "learning/test_samplers.py"),
        ("first.shape, first, last + 1)", "first.shape, first, last)", "learning/test_samplers.py"),
        ("first - 1 + jax.random.geometric", "first + jax.random.geometric", "learners/test_learners.py"),
        ("1 / mean_steps, first.shape), last)", "1 / mean_steps, first.shape), last + 1)", "learning/test_samplers.py"),
        ("        rows = last\n", "        rows = first\n", "learners/test_learners.py"),
        (
            "anywhere_key, first.shape, 0, len(",
            "anywhere_key, first.shape, len(data.achieved) // 2, len(",
            "learning/test_samplers.py",
        ),
        ("(kind >= relabel_fraction) & (", "(kind >= random_fraction) & (", "learning/test_samplers.py"),
        (
            "recorded = kind >= relabel_fraction + random_fraction",
            "recorded = kind >= relabel_fraction",
            "learning/test_samplers.py",
        ),
        ("data.goals[first], goal)", "data.goals[last], goal)", "learning/test_samplers.py"),
        (
            "jnp.where(from_anywhere | recorded, -1, rows)",
            "jnp.where(from_anywhere, -1, rows)",
            "learners/test_learners.py",
        ),
        ("return goal, jnp.where(from_anywhere, -1, rows)", "return goal, rows", "learning/test_samplers.py"),
        ("jnp.minimum(rows + period_steps, data.last_row[rows])", "rows + period_steps", _CROSSES),
        ("later = jnp.minimum(rows + period_steps, last)\n", "later = rows + period_steps\n", _CROSSES),
        ("goal_key, later + goal_offset", "goal_key, later", _CROSSES),
        ("rows.shape, rows + 1, furthest + 1)", "rows.shape, rows, furthest + 1)", _CROSSES),
        ("jnp.minimum(chosen_at + subgoal_steps, last)", "last", _CROSSES),
        ("rows.shape, rows + 1, furthest + 1)", "rows.shape, rows + 1, furthest)", "learning/test_samplers.py"),
        ("jnp.maximum(first, rows - kept_steps + 1)", "rows - kept_steps + 1", "learning/test_samplers.py"),
        ("rows.shape, earliest, rows + 1)", "rows.shape, earliest, rows)", "learning/test_samplers.py"),
        ("chosen_at=data.achieved[chosen_at]", "chosen_at=data.achieved[rows]", "learning/test_samplers.py"),
        (
            "_goals(data, goal_key, subgoal_rows, last",
            "_goals(data, goal_key, rows + 1, last",
            "learning/test_samplers.py",
        ),
        ("relabel_fraction, random_goal_fraction, future)\n", "relabel_fraction, random_goal_fraction)\n", _ENDS),
        ("subgoal_steps=subgoal_rows - rows", "subgoal_steps=last - rows", _KEPT),
        ("        rows + 1,\n        data.last_row", "        rows,\n        data.last_row", _FLAT_GOALS),
        ("steps=jnp.where(goal_rows < 0, -1, goal_rows - rows)", "steps=goal_rows - rows", "learners/test_learners.py"),
        ("random_goal_fraction / others if", "random_goal_fraction if", _SHARES),
        ("rows.shape) < current_goal_fraction", "rows.shape) > current_goal_fraction", _SHARES),
        ("valid=rows < last[:, None]", "valid=rows <= last[:, None]", _STRETCH),
        ("ends = jnp.minimum(starts + stretch_steps, last)", "ends = starts + stretch_steps", _STRETCH),
        ("jnp.where(goal_rows < 0, last, goal_rows))", "last)", _WAY),
        ("data.actions[inside], rows < last)", "data.actions[inside], rows <= last)", _WINDOWS),
        ("inside = jnp.minimum(rows, last)", "inside = rows", _WINDOWS),
    ],
    "guider/learning/training.py": [
        ("stage_key = jax.random.fold_in(key, stage_index)", "stage_key = key", _UPDATES),
        ("fold_in(stage_key, update)", "fold_in(stage_key, 0)", _UPDATES),
        ("jax.tree.map(jnp.add, sums, metrics)", "metrics", _UPDATES),
        ("(done // chunk_updates + 1) * chunk_updates", "done + chunk_updates", _CHUNKS),
        ("n=done - first", "n=chunk_updates", _UPDATES),
        ("start.update if index == start.stage else 0", "start.update", _STARTS),
        ("while done == first or (done < last", "while (done < last", _STOPS),
        ("            if stop():\n                return state", "            stop()", _STOPS),
        ("if done == 0 and (part", "if (part", _KNOWN),
        ("Position(index, done), means", "Position(index, last), means", _STOPS),
    ],
}
