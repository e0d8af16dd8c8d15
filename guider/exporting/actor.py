"""A Guider policy without Guider: this file needs Python and NumPy alone, and the .npz file that it is written beside.

    actor = Actor("policy.npz")
    actor.reset()  # before each episode
    action = actor.act(observation, goal)

`actor.about` says what the policy is; `actor.subgoal` where it now heads, of a policy that has subgoals.
"""

import json
from math import erf

import numpy as np


def _reduced(function):
    return lambda a, operand, axes: function(operand, axis=tuple(axes.tolist()), keepdims=bool(a["keepdims"]))


def _slice(a, operand, begins, ends, axes, strides):
    where = [slice(None)] * operand.ndim
    for begin, end, axis, stride in zip(begins, ends, axes, strides, strict=True):
        where[axis] = slice(begin, end, stride)
    return operand[tuple(where)]


OPERATORS = {
    "Abs": lambda a, x: np.abs(x),
    "Add": lambda a, x, y: x + y,
    "And": lambda a, x, y: x & y,
    "ArgMax": lambda a, x: np.argmax(x, axis=a["axis"]),
    "ArgMin": lambda a, x: np.argmin(x, axis=a["axis"]),
    "Cast": lambda a, x: x.astype(a["to"]),
    "Concat": lambda a, *x: np.concatenate(x, axis=a["axis"]),
    "Cos": lambda a, x: np.cos(x),
    "Div": lambda a, x, y: x / y,
    "Einsum": lambda a, x, y: np.einsum(a["equation"], x, y),
    "Equal": lambda a, x, y: x == y,
    "Erf": lambda a, x: np.vectorize(erf, otypes=[x.dtype])(x),
    "Exp": lambda a, x: np.exp(x),
    "Expand": lambda a, x, shape: np.broadcast_to(x, shape),
    "Floor": lambda a, x: np.floor(x),
    "GatherND": lambda a, x, places: x[tuple(np.moveaxis(places, -1, 0))],
    "Greater": lambda a, x, y: x > y,
    "GreaterOrEqual": lambda a, x, y: x >= y,
    "Identity": lambda a, x: x,
    "IsInf": lambda a, x: np.isinf(x),
    "IsNaN": lambda a, x: np.isnan(x),
    "Less": lambda a, x, y: x < y,
    "LessOrEqual": lambda a, x, y: x <= y,
    "Log": lambda a, x: np.log(x),
    "MatMul": lambda a, x, y: x @ y,
    "Max": lambda a, x, y: np.maximum(x, y),
    "Min": lambda a, x, y: np.minimum(x, y),
    "Mul": lambda a, x, y: x * y,
    "Neg": lambda a, x: -x,
    "Not": lambda a, x: ~x,
    "Or": lambda a, x, y: x | y,
    "Pow": lambda a, x, y: x**y,
    "Reciprocal": lambda a, x: 1 / x,
    "ReduceMax": _reduced(np.max),
    "ReduceMin": _reduced(np.min),
    "ReduceSum": _reduced(np.sum),
    "Reshape": lambda a, x, shape: np.reshape(x, shape),
    "Sigmoid": lambda a, x: 1 / (1 + np.exp(-x)),
    "Sign": lambda a, x: np.sign(x),
    "Sin": lambda a, x: np.sin(x),
    "Slice": _slice,
    "Split": lambda a, x, sizes: np.split(x, np.cumsum(sizes)[:-1], axis=a["axis"]),
    "Sqrt": lambda a, x: np.sqrt(x),
    "Sub": lambda a, x, y: x - y,
    "Tanh": lambda a, x: np.tanh(x),
    "Transpose": lambda a, x: np.transpose(x, a["perm"]),
    "Where": lambda a, which, x, y: np.where(which, x, y),
}
"""ONNX's operators, as far as policies use them: (attributes, *inputs) -> output, or a list of outputs."""


class Actor:
    """A policy for one robot, with the memory that it needs between steps."""

    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            told = json.loads(str(file["program"]))
            self._constants = {name: file[name] for name in told["constants"]}
        self.about = told["about"]
        self._nodes = [(OPERATORS[operator], *rest) for operator, *rest in told["nodes"]]
        self._outputs = told["outputs"]
        self._first = {name: np.array(value, dtype) for name, (value, dtype) in told["inputs"].items()}
        self._sizes = {name: self._first[name].shape for name in ("observation", "goal")}
        self.reset()

    def reset(self):
        """A new episode begins."""
        self._memory = {name: value for name, value in self._first.items() if name.startswith("memory_")}
        self._begins, self.subgoal = np.array(True), None

    def act(self, observation, goal):
        """The action [A] for a state [S] and a goal [G], in the units of the data."""
        given = {"observation": observation, "goal": goal}
        values = dict(self._constants)
        for name, size in self._sizes.items():
            values[name] = np.asarray(given[name], np.float32)
            if values[name].shape != size or not np.isfinite(values[name]).all():
                raise ValueError(f"{name} must be {size[0]} finite numbers, got {given[name]!r}")
        values |= self._memory | {"begins": self._begins}
        with np.errstate(all="ignore"):
            for function, inputs, outputs, attributes in self._nodes:
                result = function(attributes, *(values[name] for name in inputs))
                values.update(zip(outputs, result if isinstance(result, list) else [result], strict=True))
        results = {name: values[name] for name in self._outputs}
        self._memory = {name: results[f"next_{name}"] for name in self._memory}
        self._begins, self.subgoal = np.array(False), results.get("subgoal")
        return results["action"]
