"""Goals that no log has an entry for: angles on a circle, and the functions of docs/own_goal.py."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import guider
from guider.cli import main
from guider.data.episodes import make_episodes
from guider.data.goal_spaces import extended, goals_of, with_goals
from guider.errors import GuiderError
from guider.exporting import actor
from guider.plots.report import training_command
from guider.support import plugins
from guider.support.files import parse_json

FILE = Path(__file__).parent.parent / "docs" / "own_goal.py"
BC = {"updates": 12, "hidden": (8,), "batch_size": 16}


@pytest.fixture
def own(monkeypatch) -> None:
    monkeypatch.setenv("GUIDER_GOALS", str(FILE))


def arm(names: tuple[str, ...] = ("shoulder", "elbow", "w", "x", "y", "z")) -> guider.Episodes:
    """An arm that turns, its shoulder past pi, and a quaternion."""
    rng = np.random.default_rng(0)
    states = np.concatenate([np.cumsum(rng.uniform(-0.2, 0.4, (200, 2)), axis=0), rng.normal(size=(200, 4))], axis=1)
    logs = make_episodes(states, rng.uniform(-1, 1, (200, 2)), [20] * 10, (0, 1), source="arm")
    return replace(logs, state_names=names)


def test_angles_are_on_their_circle_by_hand():
    logs = with_goals(arm(), ("elbow", "angle:shoulder"))
    assert logs.goal_indices == (1, 6, 7) and logs.state_names[6:] == ("cos shoulder", "sin shoulder")
    shoulder = arm().observations[:, 0]
    np.testing.assert_allclose(logs.achieved[:, 1:], np.stack([np.cos(shoulder), np.sin(shoulder)], 1), atol=1e-6)
    assert logs.computed == ("angle:0",) and logs.computed_widths == (2,) and logs.goal_space_from == "asked for"
    assert goals_of(logs.spaces) == ["1", "angle:0"]
    assert goals_of(with_goals(arm(), ("angle:shoulder", "elbow", "w")).spaces) == ["angle:0", "1", "2"]
    several = with_goals(arm(), ("angle:*o*",))
    assert several.computed == ("angle:0", "angle:1") and several.goal_indices == (6, 7, 8, 9)
    assert with_goals(arm(()), ("angle:1",)).state_names == ("0", "1", "2", "3", "4", "5", "cos 1", "sin 1")
    twice = with_goals(with_goals(arm(), ("angle:0",)), ("angle:0", "angle:shoulder", "angle:elbow"))
    assert twice.computed == ("angle:0", "angle:1") and twice.goal_indices == (6, 7, 8, 9)
    with pytest.raises(GuiderError, match="no state entry is called 'wrist'"):
        with_goals(arm(), ("angle:wrist",))


def test_what_was_computed_is_not_written_without_a_word(tmp_path):
    with pytest.warns(guider.GuiderWarning, match="leave --goal out here"):
        guider.save_data(with_goals(arm(), ("angle:shoulder",)), tmp_path / "logs.npz")


def test_functions_of_ones_own_by_hand(own):
    straight = np.array([[0, 0, 1, 0, 0, 0], [np.pi / 2, 0, -1, 0, 0, 0], [0, np.pi / 2, 0, 0, 0, 2]], np.float32)
    for states in (straight, jnp.asarray(straight)):
        found = np.asarray(extended(states, ("hand", "turned")))
        assert found.shape == (3, 14) and np.array_equal(found[:, :6], straight)
        np.testing.assert_allclose(found[:, 6:8], [[0.5, 0], [0, 0.5], [0.3, 0.2]], atol=1e-6)
        same, half_turn = [1, 0, 0, 0, 1, 0], [-1, 0, 0, 0, -1, 0]
        np.testing.assert_allclose(found[:, 8:], [same, same, half_turn], atol=1e-6)


def test_a_run_computes_its_goal_wherever_it_goes(own, tmp_path, monkeypatch):
    """Trained, scored, drawn and exported; the robot sends what it logged, and its goal in the goal's terms."""
    path = tmp_path / "arm.npz"
    guider.save_data(arm(), path)
    run = tmp_path / "run"
    small = ["updates=12", "hidden=(8,)", "batch_size=16"]
    asked = ["--data", str(path), "--goal", "hand", "angle:elbow", "--radius", "0.2", "--held-out", "0.4"]
    assert main(["train", *asked, "--method", "bc", "--out", str(run), "--set", *small]) == 0
    spaces = parse_json(run / "run.json")["spaces"]
    assert spaces["computed"] == ["hand", "angle:1"] and spaces["goal_indices"] == [6, 7, 8, 9]
    assert main(["evaluate", str(run)]) == 0 and main(["plot", str(run)]) == 0
    agent, seen = guider.load(run), np.array([0.3, 0.1, 1, 0, 0, 0], np.float32)
    goal = np.array([0.2, 0.3, 1, 0], np.float32)
    action = agent.act(seen, goal)
    with pytest.raises(GuiderError, match=r"shape \(10,\).*of shape \(6,\)"):
        agent.act(np.zeros(10), goal)
    guider.export(run, tmp_path / "policy.npz")
    away = actor.Actor(tmp_path / "policy.npz")
    assert away.about["state_dim"] == 6 and away.about["goal_names"] == ["hand.0", "hand.1", "cos elbow", "sin elbow"]
    away.reset()
    np.testing.assert_allclose(away.act(seen, goal), action, atol=1e-6)
    monkeypatch.delenv("GUIDER_GOALS")
    with pytest.raises(GuiderError, match=r"no goal 'hand'.*GUIDER_GOALS names its file"):
        guider.evaluate(run)
    assert main(["evaluate", str(run)]) == 1


def test_another_function_under_the_same_name_is_noticed(tmp_path, monkeypatch):
    file, run = tmp_path / "goals.py", tmp_path / "run"
    monkeypatch.setenv("GUIDER_GOALS", str(file))
    file.write_text("GOALS = {'double': lambda states: 2 * states[..., :1]}")
    guider.train(data=arm(), goal=("double",), radius=0.2, out=run, method="bc", settings=BC)
    changed = tmp_path / "changed.py"
    for factor, entries in ((3, 1), (2, 2)):
        changed.write_text(f"GOALS = {{'double': lambda states: {factor} * states[..., :{entries}]}}")
        monkeypatch.setenv("GUIDER_GOALS", str(changed))
        plugins._offered.cache_clear()
        for use in (guider.load, lambda run: guider.evaluate(run, data=arm())):
            with pytest.raises(GuiderError, match="double computes something else than when this was trained"):
                use(run)


def test_a_goal_is_not_an_entry_too(own):
    with pytest.raises(GuiderError, match="hand is a state entry and a goal of GUIDER_GOALS"):
        with_goals(arm(("hand", "b", "c", "d", "e", "f")), ("hand",))


def test_what_comes_out_as_nan_is_refused_when_acting(tmp_path, monkeypatch):
    file = tmp_path / "goals.py"
    file.write_text(
        "import jax.numpy as jnp\nGOALS = {'up': lambda s: jnp.where(s[..., :1] < -50, jnp.nan, s[..., :1])}"
    )
    monkeypatch.setenv("GUIDER_GOALS", str(file))
    logs = arm()
    run = guider.train(data=logs, goal=("up",), radius=0.2, out=tmp_path / "run", method="bc", settings=BC)
    with (
        pytest.raises(GuiderError, match="what is computed of the observation holds NaN or inf"),
        np.errstate(all="ignore"),
    ):
        guider.load(run).act(np.full(6, -99), np.zeros(1))


def test_episodes_in_memory_have_computed_goals_too(tmp_path):
    run = guider.train(data=arm(), goal=("angle:shoulder",), radius=0.2, out=tmp_path / "run", method="bc", settings=BC)
    assert run.spec.spaces.computed == ("angle:0",)
    assert "--goal angle:0 --radius" in training_command(run.spec)
    for again in (arm(), with_goals(arm(), ("angle:shoulder",))):
        assert len(guider.evaluate(run, data=again)["per_seed"]) == 1


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("states[..., 0]", r"must be numbers \[rows, entries\], a row for each of 200 states; got \(200,\)"),
        ("states[..., :0]", r"must be numbers .* got \(200, 0\)"),
        ("states[..., :1] + 1j", r"must be numbers \[rows, entries\]"),
        ("states[..., :1] / 0", "is NaN or infinite in 200 of 200 states"),
        ("states[:, :2]", r"of states \[rows, S\] and of one state \[S\], under jax.jit"),
        ("states[..., :1] if states.sum() > 0 else states[..., 1:2]", "under jax.jit.*TracerBool"),
        ("states[..., :1] - states[..., :1].mean()", "gives one state alone something else"),
        ("states.nothing", "AttributeError"),
    ],
)
def test_what_a_function_does_wrong_is_a_line(body, message, tmp_path, monkeypatch):
    file = tmp_path / "goals.py"
    file.write_text(f"GOALS = {{'odd': lambda states: {body}}}")
    monkeypatch.setenv("GUIDER_GOALS", str(file))
    with pytest.raises(GuiderError, match=message) as error, np.errstate(all="ignore"):
        with_goals(arm(), ("odd",))
    assert "\n" not in str(error.value)
