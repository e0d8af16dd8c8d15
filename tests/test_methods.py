"""What every method must do: learn a small task, be the same from the same seed, resume to the bit, train several seeds
at once, and take ragged episodes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args

import jax
import numpy as np
import pytest
from conftest import make_ragged, tiny
from test_guider import corridor, crosses_corridor
from test_runs import assert_bit_equal

import guider
from guider import api, runs
from guider.config import differences, from_dict, to_dict
from guider.episodes import Episodes
from guider.errors import GuiderError
from guider.methods import METHODS
from guider.presets import Preset, preset_config
from guider.problem import Problem
from guider.runs import Run
from guider.training import Position

PROBLEM = Problem(radius=0.5, reach_radius=1.0, period_steps=5)


def settings(method: str, updates: int = 8, hidden: tuple[int, ...] = (8,), batch_size: int = 8) -> dict[str, str]:
    """--set arguments that make a run of the method small."""
    config = preset_config(method, "fast", PROBLEM)
    small = tiny(config, updates, hidden, batch_size)
    return {name: str(value) for name, value in differences(small, config).items()}


FURTHER = ("guider", "hiql", "hiql-places", "opal")
"""Methods that cross a longer corridor in tests of their own."""


def assert_whole(run: Run, resumed: Run, logs: Episodes) -> None:
    """Both are equal to the bit; two seeds differ; the second acts, shows subgoals if it has any, and is scored."""
    assert_bit_equal(run, resumed)
    first, second = run.policies()
    leaves = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    assert not all(np.array_equal(a, b) for a, b in leaves), "seeds differ"
    agent = guider.load(run, seed=1)
    action = agent.act(logs.observations[0], logs.observations[1, list(logs.goal_indices)])
    assert action.shape == logs.actions[0].shape and np.isfinite(action).all()
    if METHODS[run.spec.method].pursued:
        assert agent.subgoal.shape == (len(logs.goal_indices),)
    else:
        with pytest.raises(GuiderError, match=f"{run.spec.method} has no subgoals"):
            _ = agent.subgoal
    scores = guider.evaluate(run, data=logs)["per_seed"]
    assert all(np.isfinite(score["action_error"]) for score in scores)


@pytest.fixture(scope="module")
def stages(tmp_path_factory) -> Path:
    """Where methods that share a stage find it: `guider-` and a low level's name has Guider's high level."""
    return tmp_path_factory.mktemp("stages")


@pytest.mark.parametrize("method", [name for name in METHODS if name not in FURTHER])
def test_learns_to_walk_a_ragged_corridor_either_way_and_resumes_to_the_bit(method, stages, tmp_path):
    """Goals 6 m away, which the recorded episodes reach and pass; the corridor is 20 m long."""
    small = settings(method, updates=1000, hidden=(32, 32), batch_size=128)
    small["view.minimum_move"] = str(PROBLEM.reach_radius)  # not where it is pushed against an end
    logs = corridor([20, 25, 30] * 60)

    def copy_in_the_last_stage(chunk, state):
        if chunk.position == Position(last, 500):
            shutil.copytree(tmp_path / "run", tmp_path / "cut")

    last = len(METHODS[method].stages(preset_config(method, "fast", PROBLEM))) - 1
    run = guider.train(
        data=logs,
        radius=PROBLEM.radius,
        reach_radius=PROBLEM.reach_radius,
        period_steps=PROBLEM.period_steps,
        method=method,
        settings=small,
        seeds=2,
        out=tmp_path / "run",
        stage_cache=stages,
        pace=runs.Pace(chunk_updates=250, checkpoint_seconds=0.0),
        on_chunk=copy_in_the_last_stage,
    )
    assert crosses_corridor(run.policies()[0], distance=6, steps=25)
    assert_whole(run, guider.resume(tmp_path / "cut", logs), logs)


@pytest.mark.parametrize("preset", get_args(Preset))
@pytest.mark.parametrize("domain", [None, "antmaze", "pointmaze", "fetch", "kitchen"])
def test_figure_4_compares_equal_learners(domain, preset):
    """Alone and below Guider's high level alike."""
    for alone, below in [("gcsl", "guider-gcsl"), ("wgcsl", "guider-wgcsl"), ("cql-her", "guider-cql")]:
        flat, guided = (preset_config(method, preset, Problem(domain=domain)) for method in (alone, below))
        assert flat.learner == guided.low.learner


@pytest.mark.parametrize("method", FURTHER)
def test_two_seeds_on_ragged_episodes_resume_to_the_bit(method, tmp_path):
    def stop(chunk, state):
        if chunk.position.update == 6:
            raise KeyboardInterrupt

    own = {"goal_indices": (0, 1), "radius": 0.5, "period_steps": 4, "method": method, "settings": settings(method)}
    pace = runs.Pace(chunk_updates=3, checkpoint_seconds=0.0)
    logs = make_ragged((7, 30, 12, 25, 55, 18, 9, 40, 33, 21))
    whole = guider.train(data=logs, out=tmp_path / "whole", seeds=2, pace=pace, **own)
    with pytest.raises(KeyboardInterrupt):
        guider.train(data=logs, out=tmp_path / "cut", seeds=2, pace=pace, on_chunk=stop, **own)
    assert_whole(whole, guider.resume(tmp_path / "cut", logs), logs)


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
