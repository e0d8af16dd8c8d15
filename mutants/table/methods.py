"""Of what is learned. See `mutants.table`."""

from mutants.mutation import Table

_OTHER_KIND = "methods/test_guider.py::test_another_learner_comes_with_its_own_settings"
_ROUTES_LEARN = "methods/test_guider.py::test_what_routes_need_not_learn_is_not_trained_at_length"
_FIGURE_4 = "methods/test_methods.py::test_figure_4_compares_equal_learners"
_LATENT = "methods/test_updates.py::test_latent_model"
_CQL_LEVEL = "methods/test_updates.py::test_high_level_with_cql"
_SAC_LEVEL = "methods/test_updates.py::test_high_level_without_cql_is_soft_actor_critic"
_IQL_LEVEL = "methods/test_updates.py::test_high_level_with_expectiles"
_HIQL_VALUE = "methods/test_hiql.py::test_value_targets_masks_and_expectile_by_hand"
_HIQL_RETURN = "methods/test_hiql.py::test_returns_of_several_steps_by_hand"
_HIQL_LEVELS = "methods/test_hiql.py::test_each_level_weighs_its_own_advantage"
_HIQL_STEP = "methods/test_rivals.py::test_hiql_value"
_OPAL_STEP = "methods/test_rivals.py::test_opal_skills"
_ELBO = "methods/test_opal.py::test_evidence_lower_bound_by_hand"
_SKILLS = "methods/test_opal.py::test_high_transitions_by_hand"
_SKILL_TIME = "methods/test_opal.py::test_a_new_skill_every_period_and_at_resets"
_RELABEL = "methods/test_guider.py::test_high_relabelling_by_hand"
_LOW_INPUTS = "methods/test_guider.py::test_low_inputs_and_reward_by_hand"
_WITHIN = "methods/test_latent_subgoals.py::test_within_reach_is_what_the_prior_holds_for_likely_and_decodes_to"
_COVERAGE = "methods/test_latent_subgoals.py::test_coverage_is_the_share_within_the_priors_central_95_percent"
_NAMED = "methods/test_hiql.py::test_a_place_that_is_named_is_found_again_and_shown_as_the_subgoal"
_CANDIDATES = (
    "methods/test_guider_acting.py::test_candidates_are_the_priors_or_without_it_the_policys_and_the_critic_chooses"
)
_GOALS_ASKED = "methods/test_guider.py::test_the_low_level_learns_of_the_goals_that_are_asked_for"
_SUBSTITUTED = "methods/test_guider_acting.py::test_final_goal_is_substituted_only_within_reach"
_PERIOD = "methods/test_guider_acting.py::test_a_new_subgoal_every_period"
_BEGINS = "methods/test_guider_acting.py::test_a_new_subgoal_when_an_episode_begins"
_EACH_STEP = "methods/test_guider_acting.py::test_a_new_subgoal_at_every_step"
_REACHED = "methods/test_guider_acting.py::test_a_new_subgoal_as_soon_as_reached"
_STALE_LATENT = "methods/test_guider.py::test_without_decoder_z_is_encoded_where_the_subgoal_was_chosen"

TABLE: Table = {
    "guider/methods/routes.py": [
        ("place = achieved[distance.argmax()]", "place = achieved[distance.argmin()]", "methods/test_routes.py"),
        (
            "near = jnp.where(away < distance, index, near)",
            "near = jnp.where(away > distance, index, near)",
            "methods/test_routes.py",
        ),
        (" | (last_row[1:] != last_row[:-1])", "", "methods/test_routes.py"),
        (
            "jnp.where(distance == nearest, jnp.arange",
            "jnp.where(distance >= nearest, jnp.arange",
            "methods/test_routes.py",
        ),
        ("passes & passes[later] & (rows", "passes & (rows", "methods/test_routes.py"),
        (" & (rows + k <= last_row), near", ", near", "methods/test_routes.py"),
        ("fori_loop(1, period_steps + 1, step", "fori_loop(1, period_steps, step", "methods/test_routes.py"),
        ("seen >= crossings, total / jnp", "seen > crossings, total / jnp", "methods/test_routes.py"),
        ("total / jnp.maximum(seen, 1)", "total", "methods/test_routes.py"),
        ("steps[:, place, None] + steps[place]", "steps[:, place, None]", "methods/test_routes.py"),
        ("leads_on[:, None], places", "leads_on[:, None] | True, places", "methods/test_routes.py"),
        ("jnp.where(jnp.isfinite(routes.steps[nearest]), away, jnp.inf)", "away", "methods/test_routes.py"),
        ("edges[place] <= within_steps", "edges[place] < within_steps", "methods/test_routes.py"),
        ("edges[place] <= within", "edges[:, place] <= within", "methods/test_routes.py"),
        ("to_go[after(nearest)] <= to_go[reached]", "True", "methods/test_routes.py"),
        ("to_go[after(nearest)] <= to_go[reached]", "False", "methods/test_routes.py"),
        ("(found.steps <= within_steps) |", "(found.steps < 0) |", "methods/test_routes.py"),
        ("<= jnp.maximum(away.min(), LAST_LEG * problem.reach_radius)", "< jnp.inf", "methods/test_routes.py"),
        ("LAST_LEG * problem.reach_radius", "problem.reach_radius", "methods/test_routes.py"),
        ("| jnp.isinf(routes.places[found.here]).any(axis=1)", "", "methods/test_routes.py"),
    ],
    "guider/methods/policy.py": [
        ("np.array_equal(goal, self._aim)", "False", "methods/test_routes.py"),
        ("bool(found[0][0])", "False", "methods/test_routes.py"),
        ("observation = jnp.clip(observation, policy.state_low, policy.state_high)", "pass", "methods/test_policy.py"),
        (
            "goal = jnp.clip(goal, policy.state_low[entries]",
            "_ = jnp.clip(goal, policy.state_low[entries]",
            "methods/test_policy.py",
        ),
        ("policy.action_high + policy.action_low", "policy.action_high - policy.action_low", "methods/test_policy.py"),
        (
            "return rest + policy.config.action_scale * (",
            "return policy.config.action_scale * (",
            "methods/test_policy.py",
        ),
        ("half_range * actions - rest)", "half_range * actions)", "methods/test_policy.py"),
        ("jnp.clip(0.0, low, high)", "(low + high) / 2", "methods/test_policy.py"),
        ("self._begins = False", "self._begins = True", "methods/test_policy.py"),
        ("1)\n        self._begins = True", "1)\n        self._begins = False", "methods/test_policy.py"),
        ("(values < least) | (values > most)", "values < least", "methods/test_policy.py"),
        ("self._told = True", "self._told = False", "methods/test_policy.py"),
        ("if not np.isfinite(vector).all()", "if np.isnan(vector).all()", "methods/test_policy.py"),
    ],
    "guider/methods/view.py": [
        ("[jnp.sin(phase), jnp.cos(phase)]", "[jnp.sin(phase), jnp.sin(phase)]", "methods/test_view.py"),
        ("phase = self.goal(goal)[..., None]", "phase = goal[..., None]", "methods/test_view.py"),
        ("jnp.pi / 2 * 2.0 **", "jnp.pi * 2.0 **", "methods/test_view.py"),
        (
            "(state - self.state_mean) / self.state_std",
            "(state - self.state_mean) * self.state_std",
            "methods/test_view.py",
        ),
        ("(goal - self.goal_mean)", "(goal + self.goal_mean)", "methods/test_view.py"),
        ("if not view.normalise:", "if view.normalise:", "methods/test_view.py"),
        ("achieved[later] - achieved[starts]) ** 2", "achieved[later]) ** 2", "methods/test_view.py"),
        ("np.minimum(starts + period_steps, episodes", "np.minimum(starts + 1, episodes", "methods/test_view.py"),
        ("std[goal] = np.maximum(std[goal], smallest_spread)", "pass", "methods/test_view.py"),
        ("dtype=np.float64), SMALLEST_SPREAD)", "dtype=np.float64), 0.0)", "methods/test_view.py"),
        ("furthest <= problem.radius", "furthest <= 0.0", "methods/test_view.py"),
        ("spacing > _FINEST_STEP * problem.radius", "spacing > problem.radius", "methods/test_view.py"),
        ("(near > 0.5,", "(near > 0.9,", "methods/test_view.py"),
        ("_LONG_STEP = 4.0", "_LONG_STEP = 8.0", "methods/test_view.py"),
        ('"clip", move, within', '"drop", move, within', "methods/test_view.py"),
        ("every[1] != unclipped", "every[1] == unclipped", "methods/test_view.py"),
    ],
    "guider/methods/latent_subgoals.py": [
        ("return likely.all(axis=-1) & (", "return likely.any(axis=-1) & (", _WITHIN),
        ("likely.all(axis=-1) & (largest_distance(told, place, parts) <= radius)", "likely.all(axis=-1)", _WITHIN),
        ("INSIDE_95 = 1.959964", "INSIDE_95 = 1.644854", _COVERAGE),
        ("INSIDE_95 * jnp.exp(expected.log_std)", "INSIDE_95", _COVERAGE),
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
            "methods/test_guider.py::test_targets_start_as_copies_of_the_critics",
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
        ("latents).argmax(axis=1)", "latents).argmin(axis=1)", _CANDIDATES),
    ],
    "guider/methods/goal_policy.py": [
        ("goal_reward(batch.next_achieved, batch.subgoal", "goal_reward(batch.next_achieved, batch.goal", _LOW_INPUTS),
        (
            "seen_goal = (goal - achieved) / scale.goal_std",
            "seen_goal = (goal - achieved) / scale.step_std",
            _LOW_INPUTS,
        ),
    ],
    "guider/support/config.py": [
        (" and value != inner[name]", "", _OTHER_KIND),
        ("name not in theirs or ", "", _OTHER_KIND),
        ('not assignment[0].endswith(".kind")', 'assignment[0].endswith(".kind")', _OTHER_KIND),
    ],
    "guider/methods/guider.py": [
        ("learner=fast_learner(goal_learner, problem.domain)", "learner=goal_learner", _FIGURE_4),
        ("ROUTES_FAST_IN_DOMAIN.get(problem.domain, {})", "{}", _ROUTES_LEARN),
        ("reward=losses.goal_reward(batch.later,", "reward=losses.goal_reward(batch.achieved,", _RELABEL),
        ("prior(params, state.scale, batch.later)", "prior(params, state.scale, batch.achieved)", _RELABEL),
        (
            "next_state=subgoal_policy.inputs(state.scale, batch.later",
            "next_state=subgoal_policy.inputs(state.scale, batch.achieved",
            _RELABEL,
        ),
        ("state.scale, batch.chosen_at, batch.subgoal", "state.scale, batch.achieved, batch.subgoal", _STALE_LATENT),
        ("state.scale, achieved) if config.high.prior else policy", "state.scale, achieved)", _CANDIDATES),
        ("            settings.ahead,\n", '            "uniform",\n', _GOALS_ASKED),
        ("            settings.future,\n", '            "uniform",\n', _GOALS_ASKED),
        ("near = distance <= reach_radius", "near = distance > reach_radius", _SUBSTITUTED),
        ("acting.steps_left <= 0)", "acting.steps_left <= 1)", _PERIOD),
        ("reset_mask | (acting.steps_left", "(acting.steps_left", _BEGINS),
        ('if config.replan == "reached":', 'if config.replan == "period":', _REACHED),
        ("renew = jnp.ones_like(renew)", "renew = renew", _EACH_STEP),
    ],
    "guider/methods/goal_value.py": [
        ("jnp.cumprod(reward < 0, axis=1)", "(reward < 0)", _HIQL_RETURN),
        ("discount ** batch.valid.sum(axis=1)", "discount ** reward.shape[1]", _HIQL_RETURN),
        ("factor * on_the_way * reward, 0.0)", "factor * reward, 0.0)", _HIQL_RETURN),
        ("following.min(axis=0) - current", "following.max(axis=0) - current", _HIQL_VALUE),
        ("expectile_weight(advantage, settings", "expectile_weight(-advantage, settings", _HIQL_VALUE),
        (
            "stop_gradient(earned + carried * following)",
            "stop_gradient(earned + carried * following.min(axis=0))",
            _HIQL_VALUE,
        ),
        (
            "vector / length * vector.shape[-1] ** 0.5",
            "vector / length",
            "methods/test_hiql.py::test_representation_has_length_root_of_its_dimension",
        ),
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
        ("trail(old.target, params, settings.target_rate)", "old.target", _HIQL_STEP),
    ],
    "guider/methods/hiql.py": [
        ("achieved + z * scale.step_std", "achieved + z", _NAMED),
        ("scale, achieved, z), value", "scale, achieved, -z), value", _NAMED),
        ("config.high, end - begin", "config.high, begin - end", _HIQL_LEVELS),
        ("config.low, end - begin", "config.low, begin - end", _HIQL_LEVELS),
        ("(place - achieved) / scale.step_std", "(place - achieved) / scale.goal_std", "methods/test_hiql.py"),
        (
            "batch.next_observation, batch.next_achieved, batch.ahead)",
            "batch.ahead_observation, batch.ahead, batch.ahead)",
            "methods/test_rivals.py::test_hiql_low_level",
        ),
    ],
    "guider/methods/opal.py": [
        (
            "jnp.where(window.valid[..., None], entries, 0.0)",
            "entries",
            "methods/test_opal.py::test_nothing_beyond_the_episode_gets_in",
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
        ("(goal - achieved) / scale.goal_std if", "(goal - achieved) / scale.step_std if", "learners/test_learners.py"),
        ("goal_reward(batch.next_achieved", "goal_reward(batch.achieved", "learners/test_learners.py"),
        ("batch.next_achieved, batch.goal),\n", "batch.achieved, batch.goal),\n", "learners/test_learners.py"),
    ],
}
