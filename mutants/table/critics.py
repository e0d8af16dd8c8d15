"""Of what says which actions lead to a goal, and of the policy that it guides. See `mutants.table`."""

from mutants.mutation import Table

_IVL = "critics/test_critics.py::test_implicit_v_learning"
_IQL = "critics/test_critics.py::test_implicit_q_learning"
_CONTRASTIVE = "critics/test_critics.py::test_contrastive"
_INTERVALS = "critics/test_critics.py::test_an_interval_quasimetric_is_the_length_of_unions_and_a_quasimetric"
_QUASIMETRIC = "critics/test_critics.py::test_quasimetric"
_POLICY = "critics/test_critics.py::test_the_policy_follows_its_critic"
_GOALS = "learning/test_samplers.py::test_a_critic_and_its_policy_have_goals_of_their_own"
_GUIDED = "methods/test_critic_guided.py"

TABLE: Table = {
    "guider/critics/ivl.py": [
        ("following.min(axis=0) - steps.unmet - values", "following.max(axis=0) - steps.unmet - values", _IVL),
        ("values(target, steps.state, steps.goal).mean", "values(params, steps.state, steps.goal).mean", _IVL),
        ("discount * steps.unmet * values", "discount * values", _IVL),
        ("error.mean(axis=-1).sum(),", "error.mean(),", _IVL),
        ("(after - before)", "(before - after)", _IVL),
    ],
    "guider/critics/iql.py": [
        ("steps.goal).min(axis=0)\n    current", "steps.goal).max(axis=0)\n    current", _IQL),
        ("qualities(target, steps.state", "qualities(params, steps.state", _IQL),
        ("jax.lax.stop_gradient(value(params", "(value(params", _IQL),
        ("steps.unmet * (discount * following - 1)", "discount * following - 1", _IQL),
        (".sum(axis=0).mean()", ".mean()", _IQL),
        ("action, goal).min(axis=0)", "action, goal).max(axis=0)", _IQL),
    ],
    "guider/critics/contrastive.py": [
        ("psi / psi.shape[-1] ** 0.5", "psi", _CONTRASTIVE),
        ("- own * logits", "- own * logits * 2", _CONTRASTIVE),
        ("(phi * psi).sum(axis=-1).min", "(phi * psi).sum(axis=-1).max", _CONTRASTIVE),
    ],
    "guider/critics/quasimetric.py": [
        ("(other_start < here) & (here <= other_end)", "(other_start < here)", _INTERVALS),
        ("(other_start == here) & earlier", "False", _INTERVALS),
        ("share * components.mean", "(1 - share) * components.mean", _INTERVALS),
        ("return rises & ~covered", "return ~covered", _INTERVALS),
        ("_left_ends(-end, -start)", "_left_ends(start, end)", _INTERVALS),
        ("next_state) - 1) ** 2", "next_state)) ** 2", _QUASIMETRIC),
        ("+ distance(state, place) ** 2", "", _QUASIMETRIC),
        (
            "jax.lax.stop_gradient(multiplier) + multiplier",
            "jax.lax.stop_gradient(multiplier) - multiplier",
            _QUASIMETRIC,
        ),
        ("FAR - away / SCALE", "FAR + away / SCALE", _QUASIMETRIC),
        (
            "distance(next_state, predicted) + distance(predicted, next_state)",
            "2 * distance(next_state, predicted)",
            _QUASIMETRIC,
        ),
        ("return -interval_distance", "return interval_distance", _QUASIMETRIC),
    ],
    "guider/methods/critic_guided.py": [
        ("jax.lax.stop_gradient(params.critic)", "params.critic", _POLICY),
        ("jnp.clip(action, -1.0, 1.0), steps.goal", "action, steps.goal", _POLICY),
        ("0.5 * ((action", "1.0 * ((action", _POLICY),
        ("-quality.mean() / size", "-quality.mean()", _POLICY),
        ("(weight * surprise).mean()", "surprise.mean()", _POLICY),
        ("(reward < 0).astype", "(reward > -2).astype", _GUIDED),
        (
            "label(config, state.scale, batch, batch.actor_goal)",
            "label(config, state.scale, batch, batch.goal)",
            _GUIDED,
        ),
        ("trail(old.target, params.critic", "trail(old.target, old.params.critic", _GUIDED),
        ("known.get(domain or", "{}.get(domain or", _GUIDED),
    ],
    "guider/learning/samplers.py": [
        ("1 - anywhere, anywhere)\n", "1.0, 0.0)\n", _GOALS),
    ],
}
