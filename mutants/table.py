"""The mutations. A line adds one: the text as it stands, the text that takes its place, and the tests that must fail.

A text stands exactly once in its file. Tests are files or ids below tests/, separated by blanks: the fewer, the faster.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """file: from the root; tests: arguments to pytest, from tests/."""

    file: str
    old: str
    new: str
    tests: str

    def __str__(self) -> str:
        return f"{self.file}: {' '.join(self.old.split())} -> {' '.join(self.new.split())}"


_REPORTED = "test_reproduce.py::test_the_table_says_mean_and_deviation_beside_the_papers"
_PROTOCOL = "test_reproduce.py::test_the_protocol_is_stated"
_KEPT = "test_samplers.py::test_subgoals_that_are_kept_were_chosen_up_to_a_period_ago_in_the_same_episode"
_CROSSES = "test_samplers.py::test_no_sample_crosses_an_episode"
_FLAT_GOALS = "test_learners.py::test_flat_goals_come_from_ahead_in_their_own_episode"

_SHARES = "test_hiql.py::test_value_goals_come_in_their_shares_and_geometric"
_STRETCH = "test_hiql.py::test_value_stretches_stay_in_their_episode"
_WAY = "test_hiql.py::test_waypoints_lie_k_steps_ahead_or_at_a_nearer_goal"
_WINDOWS = "test_opal.py::test_windows_stay_in_their_episode"
_SPEED = "test_pointmaze.py::test_ball_speeds_up_and_slows_down_as_its_mass_and_damping_say"
_SEEDED = "test_pointmaze.py::test_a_copy_is_determined_by_its_seed_alone"
_STAY = "test_pointmaze.py::test_inactive_copies_stay_as_they_are_and_do_not_disturb_the_others"
_UPDATES = "test_training.py::test_updates_metrics_and_positions_by_hand"
_CHUNKS = "test_training.py::test_chunks_end_at_multiples_wherever_training_starts"
_STOPS = "test_training.py::test_training_stops_when_told_and_goes_on_from_there"
_FIGURE_4 = "test_methods.py::test_figure_4_compares_equal_learners"
_INITIALISED = "test_updates.py::test_initialisation"
_LATENT = "test_updates.py::test_latent_model"
_CQL_LEVEL = "test_updates.py::test_high_level_with_cql"
_SAC_LEVEL = "test_updates.py::test_high_level_without_cql_is_soft_actor_critic"
_IQL_LEVEL = "test_updates.py::test_high_level_with_expectiles"
_AWR = "test_updates.py::test_awr_as_in_paper"
_AWR_FAST = "test_updates.py::test_awr_as_in_fast"
_GCSL = "test_updates.py::test_gcsl"
_IQL = "test_updates.py::test_iql"
_WGCSL = "test_updates.py::test_wgcsl"
_CQL = "test_updates.py::test_cql"
_HIQL_VALUE = "test_hiql.py::test_value_targets_masks_and_expectile_by_hand"
_HIQL_RETURN = "test_hiql.py::test_returns_of_several_steps_by_hand"
_HIQL_LEVELS = "test_hiql.py::test_each_level_weighs_its_own_advantage"
_HIQL_STEP = "test_rivals.py::test_hiql_value"
_OPAL_STEP = "test_rivals.py::test_opal_skills"
_ELBO = "test_opal.py::test_evidence_lower_bound_by_hand"
_SKILLS = "test_opal.py::test_high_transitions_by_hand"
_SKILL_TIME = "test_opal.py::test_a_new_skill_every_period_and_at_resets"
_RELABEL = "test_guider.py::test_high_relabelling_by_hand"
_LOW_INPUTS = "test_guider.py::test_low_inputs_and_reward_by_hand"
_CANDIDATES = "test_guider.py::test_candidates_are_the_priors_or_without_it_the_policys_and_the_critic_chooses"
_SUBSTITUTED = "test_guider.py::test_final_goal_is_substituted_only_within_reach"
_PERIOD = "test_guider.py::test_a_new_subgoal_every_period"
_BEGINS = "test_guider.py::test_a_new_subgoal_when_an_episode_begins"
_REACHED = "test_guider.py::test_a_new_subgoal_as_soon_as_reached"
_STALE_LATENT = "test_guider.py::test_without_decoder_z_is_encoded_where_the_subgoal_was_chosen"
_STARTS = "test_training.py::test_training_starts_where_it_is_told"
_KNOWN = "test_training.py::test_what_is_known_is_asked_before_a_stage_begins_alone"

_TABLE: dict[str, list[tuple[str, str, str]]] = {
    "guider/learning/losses.py": [
        ("parts) < radius, 0.0", "parts) <= radius, 0.0", "test_losses.py"),
        ("0.0, -1.0).sum(axis=-1)", "0.0, -1.0).min(axis=-1)", "test_losses.py"),
        ("jnp.exp(2 * (p.log_std - q.log_std))", "jnp.exp(p.log_std - q.log_std)", "test_losses.py"),
        ("* jnp.exp(-q.log_std)) ** 2", "* jnp.exp(-p.log_std)) ** 2", "test_losses.py"),
        ("balance * gaussian_kl(frozen_posterior", "(1 - balance) * gaussian_kl(frozen_posterior", "test_losses.py"),
        ("frozen_posterior = jax.lax.stop_gradient(posterior)", "frozen_posterior = posterior", "test_losses.py"),
        ("error + beta * kl, error, kl", "beta * error + kl, error, kl", "test_losses.py"),
        ("kl = jnp.mean(balanced_kl", "kl = jnp.sum(balanced_kl", "test_losses.py"),
        (
            "jnp.where(reward < 0, reward + discount * next_value, 0.0)",
            "reward + discount * next_value",
            "test_losses.py",
        ),
        ("logsumexp(sampled - log_density, axis=-1)", "logsumexp(sampled + log_density, axis=-1)", "test_losses.py"),
        (
            "logsumexp(sampled - log_density, axis=-1) - data",
            "logsumexp(sampled - log_density, axis=-1)",
            "test_losses.py",
        ),
        ("error < 0, 1 - expectile, expectile", "error < 0, expectile, 1 - expectile", "test_losses.py"),
        ("advantage / temperature, 20.0", "advantage * temperature, 20.0", "test_losses.py"),
        (", 20.0)), ceiling)", ", 20.0)), 100.0)", "test_losses.py"),
        ("jax.lax.stop_gradient(weight) * jnp.mean", "weight * jnp.mean", "test_losses.py"),
        ("jnp.mean(misses", "jnp.sum(misses", "test_losses.py"),
        ('** 2 if error == "squared"', '** 2 if error != "squared"', "test_losses.py"),
        ("        return -policy.log_prob(action)", "        return policy.log_prob(action)", "test_losses.py"),
        ("(misses + policy.log_std + jnp", "(misses + jnp", "test_losses.py"),
    ],
    "guider/learning/networks.py": [
        ("self.mean + jnp.exp(self.log_std) * noise", "self.mean + self.log_std * noise", "test_losses.py"),
        ("-0.5 * standardised**2 - self.log_std", "-0.5 * standardised**2 + self.log_std", "test_losses.py"),
        ("hidden / (1 - dropout)", "hidden", "test_losses.py"),
        ("LOG_STD_RANGE = (-5.0, 2.0)", "LOG_STD_RANGE = (-20.0, 2.0)", "test_losses.py"),
        ("actions @ weight[context_dim:]", "actions @ weight[-1 - context_dim : -1]", "test_losses.py"),
        ("* (2 * bound) - bound", "* bound", _INITIALISED),
        ("uniform(w_key, shape, fan_in**-0.5)", "uniform(w_key, shape, fan_out**-0.5)", _INITIALISED),
        (
            "jax.nn.standardize(jax.nn.gelu(outputs), axis=-1)",
            "jax.nn.gelu(outputs)",
            "test_hiql.py::test_layer_norm_by_hand",
        ),
        ("_SMALL = 1e-3", "_SMALL = 1e-2", _INITIALISED),
        ("_HIDDEN_BIAS = 0.1", "_HIDDEN_BIAS = 0.0", _INITIALISED),
    ],
    "guider/learning/optimisers.py": [
        ("value - rate * step", "value + rate * step", "test_optimisers.py"),
        ("0.5 * (1 + jnp.cos", "0.5 * (1 - jnp.cos", "test_optimisers.py"),
        ("jnp.minimum(moments.count / updates, 1.0)", "moments.count / updates", "test_optimisers.py"),
        ("if not decay", "if decay", "test_optimisers.py"),
        ("incremental_update(params, target, rate)", "incremental_update(target, params, rate)", "test_optimisers.py"),
    ],
    "guider/learning/windows.py": [
        ("later = np.minimum(rows + period_steps, last)", "later = np.minimum(rows + 1, last)", "test_samplers.py"),
        ('if boundary == "drop" else 1) <= last', 'if boundary == "drop" else 1) < last', "test_samplers.py"),
        ('if boundary == "drop" else 1)', 'if boundary == "drop" else 0)', "test_samplers.py"),
        ("- achieved, axis=1) >= minimum_move", "- achieved, axis=1) > minimum_move", "test_samplers.py"),
        ("furthest >= minimum_move", "furthest > minimum_move", "test_samplers.py"),
        ("np.maximum.reduceat", "np.minimum.reduceat", "test_samplers.py"),
        ("(episodes.action_high - episodes.action_low) / 2", "episodes.action_high", "test_samplers.py"),
        ("(episodes.actions - centre) / half_range", "episodes.actions / half_range", "test_samplers.py"),
        ('period_steps, "clip", minimum_move', "period_steps, boundary, minimum_move", "test_samplers.py"),
        ("+ steps <= episodes.last_rows", "+ steps < episodes.last_rows", "test_samplers.py"),
    ],
    "guider/learning/samplers.py": [
        ('"action": data.actions[rows]', '"action": data.actions[rows + 1]', "test_samplers.py"),
        ('"next_achieved": data.achieved[rows + 1]', '"next_achieved": data.achieved[rows]', "test_samplers.py"),
        (
            '"next_observation": data.observations[rows + 1]',
            '"next_observation": data.observations[rows]',
            "test_samplers.py",
        ),
        ("(count,), 0, len(rows))", "(count,), 1, len(rows))", "test_samplers.py"),
        ("first.shape, first, last + 1)", "first.shape, first, last)", "test_samplers.py"),
        ("first - 1 + jax.random.geometric", "first + jax.random.geometric", "test_learners.py"),
        ("1 / mean_steps, first.shape), last)", "1 / mean_steps, first.shape), last + 1)", "test_samplers.py"),
        ("        rows = last\n", "        rows = first\n", "test_learners.py"),
        (
            "anywhere_key, first.shape, 0, len(",
            "anywhere_key, first.shape, len(data.achieved) // 2, len(",
            "test_samplers.py",
        ),
        ("(kind >= relabel_fraction) & (", "(kind >= random_fraction) & (", "test_samplers.py"),
        (
            "recorded = kind >= relabel_fraction + random_fraction",
            "recorded = kind >= relabel_fraction",
            "test_samplers.py",
        ),
        ("data.goals[first], goal)", "data.goals[last], goal)", "test_samplers.py"),
        ("jnp.where(from_anywhere | recorded, -1, rows)", "jnp.where(from_anywhere, -1, rows)", "test_learners.py"),
        ("return goal, jnp.where(from_anywhere, -1, rows)", "return goal, rows", "test_samplers.py"),
        ("jnp.minimum(rows + period_steps, data.last_row[rows])", "rows + period_steps", _CROSSES),
        ("later = jnp.minimum(rows + period_steps, last)\n", "later = rows + period_steps\n", _CROSSES),
        ("goal_key, later + goal_offset", "goal_key, later", _CROSSES),
        ("rows.shape, rows + 1, furthest + 1)", "rows.shape, rows, furthest + 1)", _CROSSES),
        ("jnp.minimum(chosen_at + subgoal_steps, last)", "last", _CROSSES),
        ("rows.shape, rows + 1, furthest + 1)", "rows.shape, rows + 1, furthest)", "test_samplers.py"),
        ("jnp.maximum(first, rows - kept_steps + 1)", "rows - kept_steps + 1", "test_samplers.py"),
        ("rows.shape, earliest, rows + 1)", "rows.shape, earliest, rows)", "test_samplers.py"),
        ("chosen_at=data.achieved[chosen_at]", "chosen_at=data.achieved[rows]", "test_samplers.py"),
        ("_goals(data, goal_key, subgoal_rows, last", "_goals(data, goal_key, rows + 1, last", "test_samplers.py"),
        ("subgoal_steps=subgoal_rows - rows", "subgoal_steps=last - rows", _KEPT),
        ("        rows + 1,\n        data.last_row", "        rows,\n        data.last_row", _FLAT_GOALS),
        ("steps=jnp.where(goal_rows < 0, -1, goal_rows - rows)", "steps=goal_rows - rows", "test_learners.py"),
        ("random_goal_fraction / others if", "random_goal_fraction if", _SHARES),
        ("(batch_size,)) < current_goal_fraction", "(batch_size,)) > current_goal_fraction", _SHARES),
        ("valid=rows < last[:, None]", "valid=rows <= last[:, None]", _STRETCH),
        ("ends = jnp.minimum(starts + stretch_steps, last)", "ends = starts + stretch_steps", _STRETCH),
        ("jnp.where(goal_rows < 0, last, goal_rows))", "last)", _WAY),
        ("data.actions[inside], rows < last)", "data.actions[inside], rows <= last)", _WINDOWS),
        ("inside = jnp.minimum(rows, last)", "inside = rows", _WINDOWS),
    ],
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
        ("distances <= task.radius", "distances < task.radius", "test_evaluation.py"),
        ("parts_met |= met", "parts_met = met", "test_evaluation.py"),
        ("steps_met += met.all(axis=1)", "steps_met += met.any(axis=1)", "test_evaluation.py"),
        ("np.minimum(steps[done], step + 1)", "step + 1", "test_evaluation.py"),
        ("active &= ~done", "active &= True", "test_evaluation.py"),
        ('if task.score != "return":', "if True:", "test_evaluation.py"),
        ("reset_mask = no_reset", "reset_mask = reset_mask", "test_evaluation.py"),
        ("first_seed + first + np.arange(copies)", "first_seed + np.arange(copies)", "test_evaluation.py"),
        ("[b.score for b in batches])[:episodes]", "[b.score for b in batches])", "test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "0 < success.mean() < 1", "test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "len(success) > 1", "test_evaluation.py"),
        ("len(success) > 1 and 0 < success.mean() < 1", "False", "test_evaluation.py"),
        ("achieved=achieved[e, : steps[e]]", "achieved=achieved[e]", "test_evaluation.py"),
        ('task.horizon_steps) if task.score == "return"', "task.horizon_steps) if False", "test_evaluation.py"),
        ("z**2 / (2 * trials)", "z**2 / trials", "test_evaluation.py"),
        ("z**2 / (4 * trials**2)", "z**2 / (4 * trials)", "test_evaluation.py"),
        ("rng.integers(seeds, size=(resamples, seeds, 1))", "np.arange(seeds)[:, None]", "test_evaluation.py"),
        ("[0.025, 0.975]", "[0.05, 0.95]", "test_evaluation.py"),
    ],
    "guider/evaluation/statistics.py": [
        ("np.std(scores)", "np.std(scores, ddof=1)", "test_statistics.py"),
        ("runs.shape[-1] // 4", "runs.shape[-1] // 3", "test_statistics.py"),
        ("cut : runs.shape[-1] - cut", "cut:", "test_statistics.py"),
        ("0.5 * (ours == theirs)", "1.0 * (ours == theirs)", "test_statistics.py"),
        ("(ours > theirs)", "(ours < theirs)", "test_statistics.py"),
        ("[0.025, 0.975]", "[0.05, 0.95]", "test_statistics.py"),
        ("size=(RESAMPLES, seeds, tasks)), np", "size=(RESAMPLES, seeds, 1)), np", "test_statistics.py"),
        ("np.arange(tasks)]", "rng.permutation(tasks)]", "test_statistics.py"),
    ],
    "guider/data/episodes.py": [
        ("self.starts + lengths - 1, lengths", "self.starts + lengths, lengths", "test_episodes.py"),
        ("np.minimum(low[goal], self.goals.min(axis=0))", "low[goal]", "test_episodes.py"),
        ("np.maximum(high[goal], self.goals.max(axis=0))", "high[goal]", "test_episodes.py"),
        ("            self.goals,\n            self.action_low,", "            self.action_low,", "test_episodes.py"),
        ("indices == self.goal_indices", "set(indices) == set(self.goal_indices)", "test_episodes.py"),
        ("round(held_out * count)", "int(held_out * count)", "test_episodes.py"),
        ("np.sort(order[n_held:])", "np.sort(order)", "test_episodes.py"),
        ("is_action[np.cumsum(lengths) - 1]", "is_action[np.cumsum(lengths)[:-1] - 1]", "test_episodes.py"),
        ("keep = np.repeat(lengths >= 2, lengths)", "keep = np.repeat(lengths > 2, lengths)", "test_episodes.py"),
        ("_BOUND_TOLERANCE = 2e-3", "_BOUND_TOLERANCE = 0.0", "test_episodes.py"),
        ("low = -1.0 if in_unit_box else seen_low", "low = seen_low", "test_episodes.py"),
        ("_MOST_LOST * (high[coarse] - low[coarse])", "_MOST_LOST", "test_episodes.py"),
        ("lost = np.fmax(lost, np.fmax", "lost = np.fmin(lost, np.fmax", "test_episodes.py"),
    ],
    "guider/methods/routes.py": [
        ("place = achieved[distance.argmax()]", "place = achieved[distance.argmin()]", "test_routes.py"),
        (
            "near = jnp.where(away < distance, index, near)",
            "near = jnp.where(away > distance, index, near)",
            "test_routes.py",
        ),
        (" | (last_row[1:] != last_row[:-1])", "", "test_routes.py"),
        ("jnp.where(distance == nearest, jnp.arange", "jnp.where(distance >= nearest, jnp.arange", "test_routes.py"),
        ("passes & passes[later] & (rows", "passes & (rows", "test_routes.py"),
        (" & (rows + k <= last_row), near", ", near", "test_routes.py"),
        ("fori_loop(1, period_steps + 1, step", "fori_loop(1, period_steps, step", "test_routes.py"),
        ("seen >= crossings, total / jnp", "seen > crossings, total / jnp", "test_routes.py"),
        ("total / jnp.maximum(seen, 1)", "total", "test_routes.py"),
        ("steps[:, place, None] + steps[place]", "steps[:, place, None]", "test_routes.py"),
        ("leads_on[:, None], places", "leads_on[:, None] | True, places", "test_routes.py"),
        ("jnp.where(jnp.isfinite(routes.steps[here]), away, jnp.inf)", "away", "test_routes.py"),
        ("routes.edges[here] <= within_steps", "routes.edges[here] < within_steps", "test_routes.py"),
        ("routes.edges[here] <= within", "routes.edges[:, here] <= within", "test_routes.py"),
        ("(left <= within_steps) & (away", "(left < 0) & (away", "test_routes.py"),
        (" & (away[there] <= away.min())", "", "test_routes.py"),
        ("arrives |= jnp.isinf(routes.places[here]).any()", "arrives |= False", "test_routes.py"),
    ],
    "guider/evaluation/heldout.py": [
        ("rows + period_steps, last[rows]", "rows + 1, last[rows]", "test_heldout.py"),
        ("(episodes.action_high + episodes.action_low) / 2) / half", "0) / half", "test_heldout.py"),
        ("actions.var(axis=0)", "actions.var(axis=1)", "test_heldout.py"),
        ("episodes.achieved[last[rows]]", "episodes.achieved[later]", "test_heldout.py"),
        ("INSIDE_95 = 1.959964", "INSIDE_95 = 1.644854", "test_heldout.py"),
        ("INSIDE_95 * jnp.exp(reachable.log_std)", "INSIDE_95", "test_heldout.py"),
        ("outcome[shuffled]", "outcome", "test_heldout.py"),
        ("axis=1).min() for point", "axis=1).max() for point", "test_heldout.py"),
        ("np.quantile(travel, 0.99)", "np.quantile(travel, 0.5)", "test_heldout.py"),
        ("len(chosen) >= 3", "len(chosen) >= 2", "test_heldout.py"),
        ("np.ptp(chosen) > 0", "np.ptp(chosen) >= 0", "test_heldout.py"),
    ],
    "guider/methods/policy.py": [
        ("observation = jnp.clip(observation, policy.state_low, policy.state_high)", "pass", "test_policy.py"),
        (
            "goal = jnp.clip(goal, policy.state_low[entries]",
            "_ = jnp.clip(goal, policy.state_low[entries]",
            "test_policy.py",
        ),
        ("policy.action_high + policy.action_low", "policy.action_high - policy.action_low", "test_policy.py"),
        ("return rest + policy.config.action_scale * (", "return policy.config.action_scale * (", "test_policy.py"),
        ("half_range * actions - rest)", "half_range * actions)", "test_policy.py"),
        ("jnp.clip(0.0, low, high)", "(low + high) / 2", "test_policy.py"),
        ("self._begins = False", "self._begins = True", "test_policy.py"),
        ("1)\n        self._begins = True", "1)\n        self._begins = False", "test_policy.py"),
        ("(values < least) | (values > most)", "values < least", "test_policy.py"),
        ("self._told = True", "self._told = False", "test_policy.py"),
        ("if not np.isfinite(vector).all()", "if np.isnan(vector).all()", "test_policy.py"),
    ],
    "guider/methods/view.py": [
        ("[jnp.sin(phase), jnp.cos(phase)]", "[jnp.sin(phase), jnp.sin(phase)]", "test_view.py"),
        ("phase = self.goal(goal)[..., None]", "phase = goal[..., None]", "test_view.py"),
        ("jnp.pi / 2 * 2.0 **", "jnp.pi * 2.0 **", "test_view.py"),
        ("(state - self.state_mean) / self.state_std", "(state - self.state_mean) * self.state_std", "test_view.py"),
        ("(goal - self.goal_mean)", "(goal + self.goal_mean)", "test_view.py"),
        ("if not view.normalise:", "if view.normalise:", "test_view.py"),
        ("achieved[later] - achieved[starts]) ** 2", "achieved[later]) ** 2", "test_view.py"),
        ("np.minimum(starts + period_steps, episodes", "np.minimum(starts + 1, episodes", "test_view.py"),
        ("std[goal] = np.maximum(std[goal], smallest_spread)", "pass", "test_view.py"),
        ("dtype=np.float64), SMALLEST_SPREAD)", "dtype=np.float64), 0.0)", "test_view.py"),
        ("furthest <= problem.radius", "furthest <= 0.0", "test_view.py"),
        ("spacing > _FINEST_STEP * problem.radius", "spacing > problem.radius", "test_view.py"),
        ("(near > 0.5,", "(near > 0.9,", "test_view.py"),
        ("_LONG_STEP = 4.0", "_LONG_STEP = 8.0", "test_view.py"),
        ('"clip", move, within', '"drop", move, within', "test_view.py"),
        ("every[1] != unclipped", "every[1] == unclipped", "test_view.py"),
    ],
    "guider/learners/awr.py": [
        ("td_target(batch.reward, next_value,", "td_target(batch.reward, -next_value,", _AWR),
        ("twin_values(state.target_critic, batch.next_state", "twin_values(old.critic, batch.next_state", _AWR),
        ("next_action).min(axis=0)", "next_action).max(axis=0)", _AWR),
        ("lambda leaf: leaf[:1]", "lambda leaf: leaf[1:]", _AWR),
        ("ahead - twin_values", "ahead + twin_values", _AWR),
        ("values.min(axis=0) - twin", "values.max(axis=0) - twin", _AWR_FAST),
        ("gaussian_head(mlp(state.params.actor, inputs)).mean, -1.0", "mlp(state.params.actor, inputs), -1.0", _AWR),
        ("trail(state.target_critic", "trail(params.critic", _AWR),
        (" ** 2).mean(axis=-1).sum()", " ** 2).mean()", _AWR),
    ],
    "guider/learners/regression.py": [
        ("dropout=config.dropout, key=key", "dropout=0.0, key=key", "test_learners.py"),
        (
            "regression(weight, predicted, action, config.error)",
            'regression(weight, predicted, action, "squared")',
            _AWR_FAST,
        ),
    ],
    "guider/learners/gcsl.py": [
        ("jnp.ones_like(batch.reward)", "-batch.reward", _GCSL),
    ],
    "guider/learners/iql.py": [
        ("mlp(old.value, batch.next_state)", "mlp(old.value, batch.state)", _IQL),
        ("batch.action).min(axis=0)", "batch.action).max(axis=0)", _IQL),
        ("twin_values(state.target_critic, batch.state", "twin_values(old.critic, batch.state", _IQL),
        ("expectile_loss(error, config.expectile)", "expectile_loss(-error, config.expectile)", _IQL),
        ("advantage = jax.lax.stop_gradient(error)", "advantage = jax.lax.stop_gradient(-error)", _IQL),
        ("return td + expectile + regression", "return td + regression", _IQL),
    ],
    "guider/learners/wgcsl.py": [
        ("jnp.where(batch.reward < 0, 0.0, 1.0)", "batch.reward", _WGCSL),
        ("value(state.target, batch.next_state), -ceiling", "value(old, batch.next_state), -ceiling", _WGCSL),
        ("value(old, batch.next_state) - value(old", "value(state.target, batch.next_state) - value(old", _WGCSL),
        ("** jnp.maximum(steps - 1, 0)", "** jnp.maximum(steps, 0)", "test_learners.py"),
        ("jnp.where(steps >= 0, 1.0, 0.0)", "1.0", "test_learners.py"),
        ("1.0, config.poor_weight)", "config.poor_weight, 1.0)", "test_learners.py"),
        ("config.percentile_rise * state.optimiser.count", "config.percentile_rise", _WGCSL),
        ("jnp.arange(size) < seen, recent, jnp.nan", "jnp.arange(size) < size, recent, jnp.nan", _WGCSL),
        ("(state.seen + jnp.arange(len(advantage))) % size", "jnp.arange(len(advantage))", _WGCSL),
        ("-config.input_limit, config.input_limit", "-config.input_limit, jnp.inf", _WGCSL),
        ("trail(state.target, params,", "trail(params, params,", _WGCSL),
    ],
    "guider/learners/cql.py": [
        ("policy.log_prob(raw) - squeeze", "policy.log_prob(raw) + squeeze", "test_learners.py"),
        ("-action_dim * jnp.log(2.0)", "action_dim * jnp.log(2.0)", _CQL),
        (".min(axis=0).max(axis=-1)", ".max(axis=0).max(axis=-1)", _CQL),
        ("density.mean() - action_dim", "density.mean() + action_dim", _CQL),
        ("* density - value).mean()", "* density + value).mean()", _CQL),
        ("config.conservative_weight * gap.sum()", "config.conservative_weight * gap.mean()", _CQL),
        ("+ config.cloning_weight * cloning", "", _CQL),
        ("[uniform_density, next_density, now_density]", "[uniform_density, now_density, next_density]", _CQL),
    ],
    "guider/methods/latent_subgoals.py": [
        (
            "decode(config, params, scale, batch.achieved, posterior",
            "decode(config, params, scale, batch.achieved, reachable",
            _LATENT,
        ),
        (
            "inputs = jnp.concatenate([scale.position(achieved), latent]",
            "inputs = jnp.concatenate([scale.position(achieved), -latent]",
            _LATENT,
        ),
        ("scale.position(achieved)))", "0 * scale.position(achieved)))", _LATENT),
        ("jax.nn.gelu))", "jax.nn.relu))", _LATENT),
        (
            "scale.step_std if config.error_in_spreads",
            "scale.goal_std if config.error_in_spreads",
            _LATENT,
        ),
    ],
    "guider/methods/subgoal_policy.py": [
        (
            "params.critic, adam_init(params))",
            "twin_init(value_key, (state_dim + latent_dim, *config.hidden, 1)), adam_init(params))",
            "test_guider.py::test_targets_start_as_copies_of_the_critics",
        ),
        ("gaussian_kl(policy, prior).mean(axis=-1)", "gaussian_kl(prior, policy).mean(axis=-1)", _SAC_LEVEL),
        ("next_value - held", "next_value + held", _SAC_LEVEL),
        ("config, next_policy, batch.next_prior", "config, next_policy, batch.prior", _SAC_LEVEL),
        ("next_latent).min(axis=0)", "next_latent).max(axis=0)", _SAC_LEVEL),
        ("next_values.max(axis=-1).min(axis=0)", "next_values.min(axis=0).max(axis=-1)", _CQL_LEVEL),
        ("next_values.min(axis=0).max(axis=-1)", "next_values.max(axis=-1).min(axis=0)", _CQL_LEVEL),
        ("jnp.minimum(target, 0.0) if", "target if", _CQL_LEVEL),
        ('None if config.uniform_box == "common" else 0', "0", _CQL_LEVEL),
        ("-log_volume)", "0.0)", _CQL_LEVEL),
        (
            "Gaussian(policy.mean[:, None], policy.log_std",
            "Gaussian(next_policy.mean[:, None], policy.log_std",
            _CQL_LEVEL,
        ),
        ("fused[..., 0], fused[..., 1:]", "fused[..., 1], fused[..., 1:]", _CQL_LEVEL),
        ("config.conservative_weight * gap - config.lagrange", "gap - config.lagrange", _CQL_LEVEL),
        (
            "-lagrange * jax.lax.stop_gradient(excess).mean()",
            "-lagrange * jax.lax.stop_gradient(excess).sum()",
            _CQL_LEVEL,
        ),
        ("jax.lax.stop_gradient(lagrange) * excess.sum()", "lagrange * excess.sum()", _CQL_LEVEL),
        (
            "td + config.conservative_weight * gap.sum(), metrics",
            "td - config.conservative_weight * gap.sum(), metrics",
            _CQL_LEVEL,
        ),
        ("mlp(params.value, batch.next_state)", "mlp(params.value, batch.state)", _IQL_LEVEL),
        ("error = frozen - mlp", "error = values.min(axis=0) - mlp", _IQL_LEVEL),
        (
            "jax.lax.stop_gradient(params.critic), batch.state, latent).min",
            "jax.lax.stop_gradient(params.critic), batch.state, latent).max",
            _CQL_LEVEL,
        ),
        (
            "jax.lax.stop_gradient(params.critic), batch.state, latent)",
            "params.critic, batch.state, latent)",
            _CQL_LEVEL,
        ),
        ("float(latent.shape[-1])", "-float(latent.shape[-1])", _CQL_LEVEL),
        ("stop_gradient(alpha) * divergence - value", "stop_gradient(alpha) * divergence + value", _CQL_LEVEL),
        ("tuned = alpha if", "tuned = params.log_alpha if", _CQL_LEVEL),
        ("temperature = -tuned", "temperature = tuned", _CQL_LEVEL),
    ],
    "guider/methods/guider.py": [
        ("learner=fast_learner(goal_learner, problem.domain)", "learner=goal_learner", _FIGURE_4),
        ("reward=losses.goal_reward(batch.later,", "reward=losses.goal_reward(batch.achieved,", _RELABEL),
        ("prior(params, state.scale, batch.later)", "prior(params, state.scale, batch.achieved)", _RELABEL),
        (
            "next_state=high_inputs(state.scale, batch.later",
            "next_state=high_inputs(state.scale, batch.achieved",
            _RELABEL,
        ),
        ("goal_reward(batch.next_achieved, batch.subgoal", "goal_reward(batch.next_achieved, batch.goal", _LOW_INPUTS),
        (
            "seen_goal = (goal - achieved) / scale.goal_std",
            "seen_goal = (goal - achieved) / scale.step_std",
            _LOW_INPUTS,
        ),
        ("state.scale, batch.chosen_at, batch.subgoal", "state.scale, batch.achieved, batch.subgoal", _STALE_LATENT),
        ("state.scale, achieved) if config.high.prior else policy", "state.scale, achieved)", _CANDIDATES),
        ("values.argmax(axis=1)", "values.argmin(axis=1)", _CANDIDATES),
        ("near <= reach_radius, goal, subgoal", "near > reach_radius, goal, subgoal", _SUBSTITUTED),
        ("acting.steps_left <= 0)", "acting.steps_left <= 1)", _PERIOD),
        ("reset_mask | (acting.steps_left", "(acting.steps_left", _BEGINS),
        ('if config.replan == "reached":', 'if config.replan == "period":', _REACHED),
    ],
    "guider/methods/hiql.py": [
        ("jnp.cumprod(reward < 0, axis=1)", "(reward < 0)", _HIQL_RETURN),
        ("discount ** batch.valid.sum(axis=1)", "discount ** reward.shape[1]", _HIQL_RETURN),
        ("factor * on_the_way * reward, 0.0)", "factor * reward, 0.0)", _HIQL_RETURN),
        ("following.min(axis=0) - current", "following.max(axis=0) - current", _HIQL_VALUE),
        ("advantage >= 0, settings.expectile, 1", "advantage < 0, settings.expectile, 1", _HIQL_VALUE),
        (
            "stop_gradient(earned + carried * following)",
            "stop_gradient(earned + carried * following.min(axis=0))",
            _HIQL_VALUE,
        ),
        ("config.high, end - begin", "config.high, begin - end", _HIQL_LEVELS),
        ("config.low, end - begin", "config.low, begin - end", _HIQL_LEVELS),
        (
            "vector / length * vector.shape[-1] ** 0.5",
            "vector / length",
            "test_hiql.py::test_representation_has_length_root_of_its_dimension",
        ),
        ("(place - achieved) / scale.step_std", "(place - achieved) / scale.goal_std", "test_hiql.py"),
        (
            "target_params, scale, batch.end_observation, batch.end,",
            "params, scale, batch.end_observation, batch.end,",
            _HIQL_STEP,
        ),
        (
            "normalised(layer_norm_mlp(params.representation, seen))",
            "normalised(mlp(params.representation, seen))",
            _HIQL_STEP,
        ),
        (
            "batch.next_observation, batch.next_achieved, batch.ahead)",
            "batch.ahead_observation, batch.ahead, batch.ahead)",
            "test_rivals.py::test_hiql_low_level",
        ),
        ("trail(old.target, params, settings.target_rate)", "old.target", _HIQL_STEP),
    ],
    "guider/methods/opal.py": [
        (
            "jnp.where(window.valid[..., None], entries, 0.0)",
            "entries",
            "test_opal.py::test_nothing_beyond_the_episode_gets_in",
        ),
        ("return Gaussian(jnp.tanh(mean), log_std)", "return Gaussian(mean, log_std)", _ELBO),
        ("jnp.where(window.valid, surprise, 0.0).sum", "jnp.where(window.valid, surprise, 0.0).mean", _ELBO),
        ("window.observations[:, 0])).sum(axis=-1)", "window.observations[:, 0])).mean(axis=-1)", _ELBO),
        ("missing + config.beta * kl", "missing - config.beta * kl", _ELBO),
        ("entries, valid, reverse=True)", "entries, valid)", _OPAL_STEP),
        ("posterior.sample(sample_key)[:, None]", "posterior.mean[:, None]", _OPAL_STEP),
        (
            "prior(params, scale, window.observations[:, 0])",
            "prior(params, scale, window.observations[:, -1])",
            _OPAL_STEP,
        ),
        ("reward=losses.goal_reward(batch.later,", "reward=losses.goal_reward(batch.achieved,", _SKILLS),
        ("jnp.where(renew, config.skill_steps,", "jnp.where(renew, config.problem.period_steps,", _SKILL_TIME),
    ],
    "guider/methods/flat.py": [
        ("(goal - achieved) / scale.goal_std if", "(goal - achieved) / scale.step_std if", "test_learners.py"),
        ("goal_reward(batch.next_achieved", "goal_reward(batch.achieved", "test_learners.py"),
        ("batch.next_achieved, batch.goal),\n", "batch.achieved, batch.goal),\n", "test_learners.py"),
    ],
    "guider/collect/waypoints.py": [
        ("np.all(following == goal_cells", "np.any(following == goal_cells", "test_waypoints.py"),
        ("cell_centre(following) + offsets", "cell_centre(following)", "test_waypoints.py"),
        ("np.arange(1, steps + 1) %", "np.arange(steps) %", "test_waypoints.py"),
        ("episodes = -(-steps // recipe", "episodes = (steps // recipe", "test_waypoints.py"),
        ("np.clip(noisy, -1.0, 1.0)", "noisy", "test_waypoints.py"),
        ("reached & recipe.further_goals", "reached", "test_waypoints.py"),
        ("np.where(begins, steps, -recipe.burst_steps)", "np.where(begins, steps, 0)", "test_waypoints.py"),
        ("steps - latest < recipe.burst_steps", "steps - latest <= recipe.burst_steps", "test_waypoints.py"),
        ("[np.maximum(latest, 0)]", "[steps]", "test_waypoints.py"),
        ("log.append((observations, actions, goal))", "log.append((observations, noisy, goal))", "test_waypoints.py"),
        ("<= recipe.goal_radius_m", "<= 2 * recipe.goal_radius_m", "test_waypoints.py"),
    ],
    "guider/tasks/goal_measure.py": [
        ("goal + 1e-6 * (1 + abs(goal))", "goal", "test_goal_measure.py"),
        ("return reward == best", "return reward >= 0", "test_goal_measure.py"),
        ("0.99, 1.01, 1.1", "0.9, 1.1", "test_goal_measure.py"),
        ("for turn in (-2 * np.pi, 2 * np.pi)", "for turn in ()", "test_goal_measure.py"),
        ("yield np.clip(achieved, low, high)", "yield achieved", "test_goal_measure.py"),
        ("np.flatnonzero(np.isfinite(low) & np.isfinite(high))", "()", "test_goal_measure.py"),
        ("{found:.3g}", "{found:.2g}", "test_goal_measure.py"),
        ("np.isfinite(radius) and radius > 0 and first", "first", "test_goal_measure.py"),
    ],
    "guider/tasks/mazes.py": [
        ("/ self.cell_size_m + 1.5", "/ self.cell_size_m + 1.0", "test_mazes.py"),
        ("np.clip(cells, 0, np.array(self.walls.shape) - 1)", "cells", "test_mazes.py"),
        ("distances[current] + 1", "distances[current] + 2", "test_mazes.py"),
        ("distances = np.full(self.walls.shape, -1)", "distances = np.full(self.walls.shape, -2)", "test_mazes.py"),
        ("self.free_cells - wall).sum(axis=1)", "self.free_cells - wall).max(axis=1)", "test_mazes.py"),
        ("(row, column + 1), (row, column - 1),", "(row, column - 1), (row, column + 1),", "test_mazes.py"),
        ("(LARGE_LAYOUT, (7, 9))", "(LARGE_LAYOUT, (7, 10))", "test_mazes.py"),
        ("inside[1:-1, 1:-1]", "inside[:, 1:-1]", "test_mazes.py"),
        ("if len(cells) != 1", "if len(cells) < 1", "test_mazes.py"),
        ("_place(start), _place(goal)]", "]", "test_mazes.py"),
    ],
    "guider/tasks/simulation.py": [
        ("np.asarray(actions, float)[rows])", "np.asarray(actions, float)[: len(rows)])", _STAY),
        ("np.asarray(trajectories)[:, -1]", "np.asarray(trajectories)[:, 0]", _SPEED),
        ("default_rng(int(seed))", "default_rng(0)", _SEEDED),
        ("rows = np.flatnonzero(active)", "rows = np.arange(self.count)", _STAY),
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
    "guider/reproduce/scores.py": [
        ('["horizon_steps"] if counts_steps else 100', '["horizon_steps"]', _REPORTED),
        ("== SCORE_UNITS", "!= SCORE_UNITS", _REPORTED),
        (
            "float(probability_of_improvement(guider, ours))",
            "float(probability_of_improvement(ours, guider))",
            _REPORTED,
        ),
        ("np.array(cell.paper[0])", "cell.scores", _REPORTED),
        ("interquartile_mean(ours)),", "ours.mean()),", _REPORTED),
        ('"metrics.jsonl")) / 60', '"metrics.jsonl"))', _PROTOCOL),
        ("if all(d.get(name, ...) == value", "if any(d.get(name, ...) == value", _PROTOCOL),
        ("asked.first_seed + asked.seeds - 1", "asked.first_seed + asked.seeds", _PROTOCOL),
    ],
    "guider/reproduce/report.py": [
        ("{cell['mean']:.1f}** ± {cell['deviation']:.1f}", "{cell['deviation']:.1f}** ± {cell['mean']:.1f}", _REPORTED),
    ],
}

MUTATIONS = [Mutation(file, *mutation) for file, mutations in _TABLE.items() for mutation in mutations]
