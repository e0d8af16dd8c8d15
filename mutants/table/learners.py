"""Of how a policy comes out of labelled transitions. See `mutants.table`."""

from mutants.mutation import Table

_AWR = "learners/test_steps.py::test_awr_as_in_paper"
_AWR_FAST = "learners/test_steps.py::test_awr_as_in_fast"
_GCSL = "learners/test_steps.py::test_gcsl"
_IQL = "learners/test_steps.py::test_iql"
_WGCSL = "learners/test_steps.py::test_wgcsl"
_CQL = "learners/test_steps.py::test_cql"

TABLE: Table = {
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
        ("dropout=config.dropout, key=key", "dropout=0.0, key=key", "learners/test_learners.py"),
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
        ("** jnp.maximum(steps - 1, 0)", "** jnp.maximum(steps, 0)", "learners/test_learners.py"),
        ("jnp.where(steps >= 0, 1.0, 0.0)", "1.0", "learners/test_learners.py"),
        ("1.0, config.poor_weight)", "config.poor_weight, 1.0)", "learners/test_learners.py"),
        ("config.percentile_rise * state.optimiser.count", "config.percentile_rise", _WGCSL),
        ("jnp.arange(size) < seen, recent, jnp.nan", "jnp.arange(size) < size, recent, jnp.nan", _WGCSL),
        ("(state.seen + jnp.arange(len(advantage))) % size", "jnp.arange(len(advantage))", _WGCSL),
        ("-config.input_limit, config.input_limit", "-config.input_limit, jnp.inf", _WGCSL),
        ("trail(state.target, params,", "trail(params, params,", _WGCSL),
    ],
    "guider/learners/cql.py": [
        ("policy.log_prob(raw) - squeeze", "policy.log_prob(raw) + squeeze", "learners/test_learners.py"),
        ("-action_dim * jnp.log(2.0)", "action_dim * jnp.log(2.0)", _CQL),
        (".min(axis=0).max(axis=-1)", ".max(axis=0).max(axis=-1)", _CQL),
        ("density.mean() - action_dim", "density.mean() + action_dim", _CQL),
        ("* density - value).mean()", "* density + value).mean()", _CQL),
        ("config.conservative_weight * gap.sum()", "config.conservative_weight * gap.mean()", _CQL),
        ("+ config.cloning_weight * cloning", "", _CQL),
        ("[uniform_density, next_density, now_density]", "[uniform_density, now_density, next_density]", _CQL),
    ],
}
