"""What every method must do: learn a small task, be the same from the same seed, resume to the bit, train several seeds
at once, and take ragged episodes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import compiled_for_long, equal, make_ragged, tiny

import guider
from guider import api, runs
from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError
from guider.evaluation.heldout import held_out_scores
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.methods import METHODS, goal_value, preset_config
from guider.methods.policy import Policy, compiled_act, initial_state
from guider.runs import Run
from guider.support.config import differences, from_dict, to_dict

PROBLEM = Problem(radius=0.5, reach_radius=1.0, period_steps=5)


def settings(method: str, updates: int = 8, hidden: tuple[int, ...] = (8,), batch_size: int = 8) -> dict[str, str]:
    """--set arguments that make a run of the method small."""
    config = preset_config(method, "fast", PROBLEM)
    small = tiny(config, updates, hidden, batch_size)
    return {name: str(value) for name, value in differences(small, config).items()}


def corridor() -> Episodes:
    """A point pushed along a line of 20 m by its action, +-1 m a step; each ragged episode walks one way, 13 m on
    average."""
    rng = np.random.default_rng(0)
    lengths = [20, 25, 30] * 60
    observations, actions = [], []
    for length in lengths:
        x, way = rng.uniform(-10, 10), rng.choice([-1.0, 1.0])
        for _ in range(length):
            action = np.clip(0.6 * way + rng.normal() * 0.4, -1, 1)
            observations.append([x])
            actions.append([action])
            x = np.clip(x + action, -10, 10)
    return make_episodes(np.array(observations), np.array(actions), lengths, (0,))


def crosses_corridor(policy: Policy, distance: float, steps: int) -> bool:
    """Whether within so many steps it comes from either side of the middle to the other, `distance` metres away."""
    position = jnp.array([[-distance / 2], [distance / 2]])
    goal = -position
    acting, met = initial_state(policy, 2), np.zeros(2, bool)
    for step in range(steps):
        actions, acting = compiled_act(policy, position, goal, acting, jnp.full(2, step == 0))
        position = jnp.clip(position + actions, -10, 10)
        met |= np.asarray(jnp.abs(position - goal)[:, 0] <= 0.5)
    return bool(met.all())


def nearer_is_better(policy: Policy) -> None:
    """HIQL's values of places on the way to a goal; a met goal is worth 0."""
    places, goal = jnp.array([[-7.5], [0.0], [7.0], [7.5]]), jnp.full((4, 1), 7.5)
    state = policy.state
    values = jax.jit(lambda value: goal_value.values(policy.config, value.params, state.scale, places, places, goal))
    means = values(state.value).mean(0)
    assert bool(jnp.all(jnp.diff(means) > 0)) and abs(float(means[-1])) < 1


class Crossing(NamedTuple):
    """What a method must do in the corridor."""

    distance: float
    """How far away the other side of the middle is that it must reach, in metres."""
    steps: int
    """Within which it must."""
    settings: dict[str, Any]
    """Apart from `settings`."""
    also: Callable[[Policy], None] = lambda policy: None
    """Checks what else must hold."""


NEAR = Crossing(6, 25, {"view.minimum_move": PROBLEM.reach_radius})  # not where it is pushed against an end
"""Of methods without subgoals or skills; the others' is longer than most recorded episodes go."""
_GUIDER = Crossing(
    15, 40, {"latent.updates": 1000, "latent.latent_dim": 1, "high.updates": 2000, "high.target_rate": 0.02}
)
_HIQL = Crossing(15, 40, {"subgoal_steps": 5, "value.updates": 3000}, nearer_is_better)
_OPAL = Crossing(
    15,
    60,
    {
        "skill_steps": 5,
        "skills.updates": 1000,
        "skills.batch_size": 20,
        "skills.latent_dim": 1,
        "skills.encoder_hidden": 16,
        "high.updates": 1500,
        "high.target_rate": 0.02,
        "high.target_divergence": 1.0,  # a mean over latent dimensions, and here is one
    },
)
_FEW = NEAR._replace(settings=NEAR.settings | {"critic.representation_dim": 8})
CROSSINGS = {name: _GUIDER for name in METHODS if name.startswith("guider")} | {
    "crl": _FEW,
    "qrl": _FEW,
    "hiql": _HIQL,
    "hiql-places": _HIQL,
    "opal": _OPAL,
}


class StageDoneError(Exception):
    """What comes after is not asked for."""


def assert_usable(run: Run, logs: Episodes) -> None:
    """Two seeds differ; the second acts, and shows subgoals if it has any; both are scored by logs."""
    first, second = run.policies()
    leaves = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    assert not all(np.array_equal(a, b) for a, b in leaves), "seeds differ"
    agent = guider.load(run, seed=1)
    action = agent.act(logs.observations[0], logs.observations[1, list(logs.goal_indices)])
    assert action.shape == logs.actions[0].shape and np.isfinite(action).all()
    if METHODS[run.spec.method].subgoals:
        assert agent.subgoal.shape == (len(logs.goal_indices),)
    else:
        with pytest.raises(GuiderError, match=f"{run.spec.method} has no subgoals"):
            _ = agent.subgoal
    errors = [held_out_scores(policy, logs)["action_error"] for policy in (first, second)]
    assert np.isfinite(np.array(errors, float)).all()


@pytest.fixture(scope="module")
def stages(tmp_path_factory) -> Path:
    """Where methods that share a stage find it: `guider-` and a low level's name has Guider's high level."""
    return tmp_path_factory.mktemp("stages")


@pytest.fixture(scope="module")
def optimised_throughout() -> Iterator[None]:
    with compiled_for_long():
        yield


@pytest.mark.usefixtures("optimised_throughout")
@pytest.mark.parametrize("method", [name for name in METHODS if name not in ("gciql-routes", "hiql-routes")])
def test_learns_to_walk_a_ragged_corridor_either_way_and_resumes_to_the_bit(method, stages, tmp_path):
    """The corridor is 20 m long. Of methods that are led through the graph, one is tried: what they add is the same."""
    crossing = CROSSINGS.get(method, NEAR)
    small = settings(method, updates=1000, hidden=(32, 32), batch_size=128)
    small |= {name: str(value) for name, value in crossing.settings.items()}
    logs = corridor()

    seen: list[Any] = []

    def watch(chunk, state):
        """Copy the run in the middle of the first stage that is trained, and keep what comes of that stage; routes are
        built at one go."""
        if chunk.stage.updates == 1:
            return
        if chunk.position.update == 500 and not seen:
            shutil.copytree(tmp_path / "run", tmp_path / "cut")
        if chunk.position.update == chunk.stage.updates and not seen:
            seen.append(jax.device_get(state))

    def compare(chunk, state):
        if chunk.position.update == chunk.stage.updates:
            assert equal(jax.device_get(state), seen[0])
            raise StageDoneError

    run = guider.train(
        data=logs,
        radius=PROBLEM.radius,
        reach_radius=PROBLEM.reach_radius,
        period_steps=PROBLEM.period_steps,
        method=method,
        settings=small,
        seeds=2,
        out=tmp_path / "run",
        # With routes, all that is trained is another method's; others have no stage in common.
        stage_cache=stages if method.startswith("guider") and method != "guider-routes" else None,
        pace=runs.Pace(chunk_updates=500, checkpoint_seconds=0.0),
        on_chunk=watch,
    )
    policy = run.policies()[0]
    assert crosses_corridor(policy, crossing.distance, crossing.steps)
    crossing.also(policy)
    with pytest.raises(StageDoneError):
        guider.resume(tmp_path / "cut", logs, on_chunk=compare)
    assert_usable(run, logs)


@pytest.mark.parametrize("preset", get_args(Preset))
@pytest.mark.parametrize("domain", [None, "antmaze", "pointmaze", "fetch", "kitchen"])
def test_figure_4_compares_equal_learners(domain, preset):
    """Alone and below Guider's high level alike."""
    for alone, below in [("gcsl", "guider-gcsl"), ("wgcsl", "guider-wgcsl"), ("cql-her", "guider-cql")]:
        flat, guided = (preset_config(method, preset, Problem(domain=domain)) for method in (alone, below))
        assert flat.learner == guided.low.learner


def test_pictures_of_a_method_without_subgoals_are_its_curves(tmp_path):
    own = {"goal_indices": (0, 1), "radius": 0.5, "period_steps": 4, "settings": settings("bc")}
    logs = make_ragged((30, 30, 30))
    run = guider.train(data=logs, out=tmp_path / "run", method="bc", **own)
    assert [path.name for path in api.plot(run, data=logs)] == ["learning.png"]


@pytest.mark.parametrize("preset", ["paper", "fast"])
@pytest.mark.parametrize("domain", [None, "antmaze", "pointmaze", "fetch", "kitchen"])
def test_settings_of_every_method_and_domain_survive_json(preset, domain):
    for method in METHODS:
        config = preset_config(method, preset, Problem(domain=domain))
        assert from_dict(METHODS[method].config_type, to_dict(config)) == config
