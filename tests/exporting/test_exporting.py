"""What leaves for the robot acts as the policy does here, of every method and in every format."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import make_ragged, tiny

import guider
from guider.cli import main
from guider.errors import GuiderError
from guider.exporting import actor, export_policy
from guider.exporting.controller import controller, parameters
from guider.exporting.program import read
from guider.learning.problem import Problem
from guider.methods import METHODS, preset_config
from guider.methods.policy import Agent, Policy
from guider.methods.routes import Routes, shortest_steps
from guider.methods.view import prepare
from guider.support.config import override

EPISODES = make_ragged((30, 40, 50))
ABOUT = {"goal_dim": 2, "state_dim": 4, "goal_indices": [0, 1], "goal_names": ["x", "y"]}


def policy_of(method: str, preset: Any = "fast", domain: str | None = "antmaze", **changes: Any) -> Policy:
    """Of random numbers, in the bounds and with the limits of real ones."""
    config = tiny(preset_config(method, preset, Problem(0.5, 1.0, 5, domain=domain)), hidden=(8, 8))
    config = override(config, changes)
    _, scale = prepare(config.view, config.problem, EPISODES)
    spaces, rng = EPISODES.spaces, np.random.default_rng(0)
    shapes = jax.eval_shape(lambda: METHODS[method].init(config, spaces, scale, jax.random.key(0)))
    state = jax.tree.map(lambda leaf: jnp.asarray(0.4 * rng.standard_normal(leaf.shape), leaf.dtype), shapes)
    state = state._replace(scale=scale)
    if method == "guider-routes":
        places = jnp.asarray(rng.normal(0, 4, (12, 2)), jnp.float32).at[-1].set(jnp.inf)
        steps = jnp.asarray(rng.uniform(1, 6, (12, 12)), jnp.float32).at[0].set(jnp.inf)
        state = state._replace(high=Routes(places, steps, shortest_steps(steps)))
    low, high = jnp.asarray([-2.0, 0.0]), jnp.asarray([1.0, 0.5])
    limits = jnp.full(4, -9.0), jnp.full(4, 60.0)
    return Policy(state, low, high, method, config, (0, 1), 4, *limits)


class InOnnxruntime:
    """The same as `actor.Actor`, by the session's own names alone."""

    def __init__(self, path: Path):
        self.session = pytest.importorskip("onnxruntime").InferenceSession(str(path))
        self.about = json.loads(self.session.get_modelmeta().custom_metadata_map["guider"])
        self.reset()

    def reset(self) -> None:
        types = {"tensor(float)": np.float32, "tensor(int32)": np.int32}
        memory = [given for given in self.session.get_inputs() if given.name.startswith("memory_")]
        self.memory = {given.name: np.zeros(given.shape, types[given.type]) for given in memory}
        self.begins = True

    def act(self, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
        given = {"observation": observation, "goal": goal, "begins": np.array(self.begins), **self.memory}
        names = [output.name for output in self.session.get_outputs()]
        results = dict(zip(names, self.session.run(None, given), strict=True))
        self.memory, self.begins = {name: results[f"next_{name}"] for name in self.memory}, False
        self.subgoal = results.get("subgoal")
        return results["action"]


def assert_acts_alike(policy: Policy, other: Any, episodes: int = 6, steps: int = 12) -> None:
    """In episodes that jump about, so that subgoals are reached, kept and run out."""
    agent, rng = Agent(policy), np.random.default_rng(1)
    guided = METHODS[policy.method].subgoals is not None
    for episode in range(episodes):
        agent.reset()
        other.reset()
        goal = rng.normal(0, 3, 2).astype(np.float32)
        for step in range(steps):
            observation = rng.normal(0, 3 if episode % 2 else 0.2, 4).astype(np.float32)
            expected = agent.act(observation, goal)
            np.testing.assert_allclose(other.act(observation, goal), expected, rtol=1e-5, atol=1e-5)
            if guided:
                np.testing.assert_allclose(other.subgoal, agent.subgoal, rtol=1e-5, atol=1e-5, err_msg=f"step {step}")


CASES = [
    *((method, {}) for method in METHODS),
    *((method, {"preset": "paper"}) for method in ("guider", "guider-routes", "bc", "hiql", "opal")),
    ("guider", {"domain": "kitchen"}),
    ("guider", {"domain": "kitchen", "high.prior": False}),
    ("guider", {"domain": "fetch", "low.subgoal_input": "latent"}),
]


@pytest.mark.parametrize(("method", "changes"), CASES)
def test_numpy_alone_acts_as_jax_does(method, changes, tmp_path):
    policy = policy_of(method, **changes)
    export_policy(policy, ABOUT, tmp_path / "policy.npz")
    there = runpy.run_path(str(tmp_path / "guider_actor.py"))
    other = there["Actor"](tmp_path / "policy.npz")
    assert other.about == ABOUT
    assert_acts_alike(policy, other)


@pytest.mark.parametrize(("method", "changes"), CASES)
def test_onnxruntime_acts_as_jax_does(method, changes, tmp_path):
    pytest.importorskip("onnx")
    policy = policy_of(method, **changes)
    export_policy(policy, ABOUT, tmp_path / "policy.onnx")
    other = InOnnxruntime(tmp_path / "policy.onnx")
    assert other.about == ABOUT
    assert_acts_alike(policy, other)


def test_what_is_trained_leaves_as_safetensors(tmp_path):
    load_file = pytest.importorskip("safetensors.numpy").load_file
    policy = policy_of("guider")
    export_policy(policy, ABOUT, tmp_path / "policy.safetensors")
    found, expected = load_file(tmp_path / "policy.safetensors"), parameters(policy)
    assert found.keys() == expected.keys() and "latent.params.prior.0.0" in found
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array)


def test_the_file_beside_needs_numpy_alone(tmp_path):
    """In a process of its own, where nothing else can be imported from here."""
    policy = policy_of("bc")
    export_policy(policy, ABOUT, tmp_path / "policy.npz")
    expected = Agent(policy).act(np.ones(4), np.zeros(2))
    script = (
        "import sys; from guider_actor import Actor; actor = Actor('policy.npz');"
        "print(*actor.act([1, 1, 1, 1], [0, 0])); assert not {'jax', 'guider', 'onnx'} & sys.modules.keys()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True, env={"PATH": ""}
    )
    np.testing.assert_allclose(np.array(done.stdout.split(), float), expected, atol=1e-5)
    other = actor.Actor(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match="observation must be 4 finite numbers"):
        other.act([1, 2, np.nan, 3], [0, 0])
    with pytest.raises(ValueError, match="goal must be 2 finite numbers"):
        other.act([1, 2, 3, 4], [0, 0, 0])


def test_the_example_beside_an_onnx_file_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnxruntime")
    export_policy(policy_of("guider"), ABOUT, tmp_path / "walker.onnx")
    example = tmp_path / "walker_example.py"
    assert len(example.read_text().splitlines()) <= 24
    (tmp_path / "second_example.py").write_text("mine")
    with pytest.raises(GuiderError, match=r"second_example\.py is there already and holds something else"):
        export_policy(policy_of("bc"), ABOUT, tmp_path / "second.onnx")
    assert not (tmp_path / "second.onnx").exists() and (tmp_path / "second_example.py").read_text() == "mine"
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example))
    assert len(capsys.readouterr().out.splitlines()) == 10


def test_a_trained_run_is_exported_by_the_command(finished, tmp_path, capsys):
    _, run = finished
    out = tmp_path / "new" / "policy.npz"
    assert main(["export", str(run.directory), str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"files": [str(out), str(out.with_name("guider_actor.py"))]}
    other, agent = actor.Actor(out), guider.load(run)
    np.testing.assert_allclose(other.act(np.ones(4), np.zeros(2)), agent.act(np.ones(4), np.zeros(2)), atol=1e-5)
    assert (other.about["method"], other.about["goal_indices"], other.about["radius"]) == ("bc", [0, 1], 0.5)
    for arguments, message in (
        ([str(out)], "never overwritten; choose another name"),
        ([str(tmp_path / "policy.onxn")], "did you mean .onnx"),
        ([str(tmp_path / "a.npz"), "--seed", "9"], "trained seeds 0, not 9"),
    ):
        assert main(["export", str(run.directory), *arguments]) == 1
        assert message in capsys.readouterr().err


def program_of(function: Any, *inputs: np.ndarray) -> list[np.ndarray]:
    """What NumPy makes of a function's program."""
    names = [f"x{index}" for index in range(len(inputs))]
    program = read(lambda *given: [function(*given)], dict(zip(names, inputs, strict=True)), ["result"])
    values = program.constants | program.inputs
    for node in program.nodes:
        with np.errstate(all="ignore"):
            result = actor.OPERATORS[node.operator](node.attributes, *(values[name] for name in node.inputs))
        values.update(zip(node.outputs, result if isinstance(result, list) else [result], strict=True))
    return [values[name] for name in program.outputs]


ROWS = np.arange(24, dtype=np.float32).reshape(2, 3, 4) - 7.5


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x[:, jnp.array([2, 0])],
        lambda x: x[..., jnp.array([3, 1])],
        lambda x: x[jnp.argmax(x.sum((1, 2)))],
        lambda x: x[:, jnp.argmin(x[0].sum(axis=1)), 1],
        lambda x: jax.vmap(lambda one: one[jnp.argmax(one.sum(axis=1))])(x),
        lambda x: jax.vmap(lambda one: one[:, jnp.argmax(one.sum(axis=0))])(x),
        lambda x: jax.vmap(lambda one: one[1, jnp.argmin(one[1])])(x),
        lambda x: jnp.take_along_axis(x, jnp.argmin(x, axis=1)[:, None], axis=1),
        lambda x: jnp.take_along_axis(x, jnp.argmax(x, axis=2)[..., None], axis=2),
        lambda x: jnp.einsum("bij,bkj->bik", x, x),
        lambda x: jnp.einsum("bij,kj->kbi", x, x[0]),
        lambda x: jnp.stack([x, -x], axis=1)[:, :, 1:, ::2],
        lambda x: jnp.concatenate(jnp.split(x, [1, 3], axis=2)[::-1], axis=2),
        lambda x: jnp.where((x > 3).any(axis=1, keepdims=True) & (x < 9).all(axis=2, keepdims=True), x**3, x**-2.0),
        lambda x: jnp.clip(x, -2, 5).T.reshape(4, 6) + jax.nn.sigmoid(x).T.reshape(4, 6),
        lambda x: jnp.where(jnp.isfinite(1 / (x - 0.5)), jnp.sign(x) * jnp.floor(x), jnp.sqrt(jnp.abs(x))),
        lambda x: jax.lax.rsqrt(jnp.square(x) + 1) + jax.scipy.special.erf(x) + jax.nn.gelu(x) + jnp.log(x**2),
        lambda x: x.max(axis=(0, 2)) - x.min(axis=(0, 2)) + jnp.where(x != 0.5, x, 0).sum(axis=(0, 2)),
    ],
)
def test_operations_mean_what_jaxs_do(function):
    (result,) = program_of(function, ROWS)
    np.testing.assert_allclose(result, function(jnp.asarray(ROWS)), rtol=1e-5, atol=1e-6)


def test_what_is_known_before_is_worked_out_before():
    noise = jax.random.normal(jax.random.key(3), (4,))
    program = read(lambda x: [x + jax.random.normal(jax.random.key(3), (4,))], {"x": ROWS[0, 0]}, ["result"])
    assert [node.operator for node in program.nodes] == ["Add", "Identity"]
    np.testing.assert_array_equal(next(iter(program.constants.values())), noise)


def test_what_no_operator_is_known_for_is_refused():
    with pytest.raises(GuiderError, match="uses JAX's while cannot be exported"):
        read(
            lambda x: [jax.lax.while_loop(lambda v: v < 9, lambda v: v + 1, x)],
            {"x": np.ones((), np.float32)},
            ["result"],
        )
    with pytest.raises(GuiderError, match="parts of slices by computed indices"):
        window = jax.vmap(lambda x, i: jax.lax.dynamic_slice(x, (i,), (2,)))
        read(lambda x: [window(x, jnp.argmax(x, axis=1))], {"x": ROWS[0]}, ["result"])
    with pytest.raises(GuiderError, match="select by truth values"):
        read(lambda x: [jax.lax.select_n(jnp.argmax(x), x, -x, 2 * x)], {"x": ROWS[0, 0]}, ["result"])


def test_memory_and_outputs_have_the_shapes_of_one_robot():
    program = controller(policy_of("guider"))
    assert {name: array.shape for name, array in program.inputs.items()} == {
        "observation": (4,),
        "goal": (2,),
        "begins": (),
        "memory_0": (2,),
        "memory_1": (2,),
        "memory_2": (),
    }
    assert list(program.outputs) == ["action", "next_memory_0", "next_memory_1", "next_memory_2", "subgoal"]


def test_names_from_data_and_of_files_stay_words_in_the_example(tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnxruntime")
    hostile = ABOUT | {"goal_names": ["x\nraise SystemExit('run')  #", 'y"""\u2028raise SystemExit']}
    export_policy(policy_of("bc"), hostile, tmp_path / 'a"""b.onnx')
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(tmp_path / 'a"""b_example.py'))
    assert len(capsys.readouterr().out.splitlines()) == 10
