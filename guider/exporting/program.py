"""What a policy computes in one step, as a list of ONNX's operators.

The list is read off the program that JAX traces, so every method has one, your own included: what depends on nothing
that is given is worked out here and kept as a constant, the rest is one operator after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from guider.errors import GuiderError


class Node(NamedTuple):
    """One operator, as ONNX defines it (opset 18): https://onnx.ai/onnx/operators; types are named as NumPy does."""

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class Program:
    """inputs: an array of the shape and type of each, by name; outputs: shape and type of each, by the name that a node
    gives it; constants: what nodes refer to besides."""

    inputs: dict[str, np.ndarray]
    outputs: dict[str, jax.ShapeDtypeStruct]
    nodes: tuple[Node, ...]
    constants: dict[str, np.ndarray]


Value = Any
"""The name (str) of what is computed in a step, or an array that is known before."""


def read(function: Callable[..., Sequence[jax.Array]], inputs: dict[str, np.ndarray], outputs: list[str]) -> Program:
    """The program of function(*inputs) -> outputs. Raises GuiderError for an operation that none is known for."""
    traced = jax.make_jaxpr(function)(*inputs.values())
    writer = _Writer()
    results = writer.follow(traced, list(inputs))
    named = {}
    for name, value, variable in zip(outputs, results, traced.jaxpr.outvars, strict=True):
        # An output has a name of its own, even where it is an input.
        writer.nodes.append(Node("Identity", (writer.name(value),), (name,), {}))
        named[name] = jax.ShapeDtypeStruct(variable.aval.shape, variable.aval.dtype)
    nodes, needed = [], set(named)
    for node in reversed(writer.nodes):
        if needed.intersection(node.outputs):
            nodes.append(node)
            needed.update(node.inputs)
    constants = {name: array for name, array in writer.constants.items() if name in needed}
    return Program(inputs, named, tuple(reversed(nodes)), constants)


class _Writer:
    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.constants: dict[str, np.ndarray] = {}
        self._known: dict[tuple[str, tuple[int, ...], bytes], str] = {}

    def node(self, operator: str, *inputs: Value, **attributes: Any) -> str:
        """The name of what it computes."""
        return self.several(operator, 1, *inputs, **attributes)[0]

    def several(self, operator: str, count: int, *inputs: Value, **attributes: Any) -> list[str]:
        names = [f"v{len(self.nodes)}" + (f"_{index}" if count > 1 else "") for index in range(count)]
        plain = {name: np.asarray(value).tolist() for name, value in attributes.items()}
        self.nodes.append(Node(operator, tuple(map(self.name, inputs)), tuple(names), plain))
        return names

    def name(self, value: Value) -> str:
        if isinstance(value, str):
            return value
        array = np.asarray(value)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._known:
            self._known[key] = f"c{len(self.constants)}"
            self.constants[self._known[key]] = array
        return self._known[key]

    def follow(self, program: ClosedJaxpr, given: list[Value]) -> list[Value]:
        """What the program's outputs are, with what it is given."""
        values: dict[Any, Value] = dict(zip(program.jaxpr.constvars, program.consts, strict=True))
        values |= dict(zip(program.jaxpr.invars, given, strict=True))

        def value(of: Any) -> Value:
            return np.asarray(of.val, getattr(of.aval, "dtype", None)) if isinstance(of, Literal) else values[of]

        for equation in program.jaxpr.eqns:
            operands = [value(of) for of in equation.invars]
            inner = next((equation.params[name] for name in ("jaxpr", "call_jaxpr") if name in equation.params), None)
            if equation.primitive.name in _CALLS and isinstance(inner, ClosedJaxpr):
                results = self.follow(inner, operands)
            elif not any(isinstance(operand, str) for operand in operands):
                found = equation.primitive.bind(*operands, **equation.params)
                results = list(found) if equation.primitive.multiple_results else [found]
            else:
                results = self.translate(equation, operands)
            values |= dict(zip(equation.outvars, results, strict=True))
        return [value(of) for of in program.jaxpr.outvars]

    def translate(self, equation: Any, operands: list[Value]) -> list[Value]:
        name = equation.primitive.name
        if name in _ELEMENTWISE:
            return [self.node(_ELEMENTWISE[name], *operands)]
        if name not in _RULES:
            raise GuiderError(f"a policy that uses JAX's {name} cannot be exported: no operator is known for it")
        result = _RULES[name](self, equation, *operands)
        return result if isinstance(result, list) else [result]

    # What several rules use

    def reshaped(self, operand: Value, shape: Sequence[int]) -> str:
        return self.node("Reshape", operand, np.array(shape, np.int64))

    def cast(self, operand: Value, to: Any) -> str:
        return self.node("Cast", operand, to=np.dtype(to).name)


_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat")
_ELEMENTWISE = {
    "abs": "Abs",
    "add": "Add",
    "and": "And",
    "copy": "Identity",
    "cos": "Cos",
    "div": "Div",
    "eq": "Equal",
    "erf": "Erf",
    "exp": "Exp",
    "floor": "Floor",
    "ge": "GreaterOrEqual",
    "gt": "Greater",
    "le": "LessOrEqual",
    "log": "Log",
    "logistic": "Sigmoid",
    "lt": "Less",
    "max": "Max",
    "min": "Min",
    "mul": "Mul",
    "neg": "Neg",
    "not": "Not",
    "or": "Or",
    "pow": "Pow",
    "sign": "Sign",
    "sin": "Sin",
    "sqrt": "Sqrt",
    "stop_gradient": "Identity",
    "sub": "Sub",
    "tanh": "Tanh",
}
"""JAX's primitive -> ONNX's operator, where both do the same entry by entry. (`and`, `or`, `not`: of truth values.)"""


def _shape(equation: Any, operand: int = 0) -> tuple[int, ...]:
    return equation.invars[operand].aval.shape


def _result(equation: Any) -> Any:
    return equation.outvars[0].aval


def _not_equal(writer: _Writer, equation: Any, first: Value, second: Value) -> Value:
    return writer.node("Not", writer.node("Equal", first, second))


def _is_finite(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.node("Not", writer.node("Or", writer.node("IsInf", operand), writer.node("IsNaN", operand)))


def _rsqrt(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.node("Reciprocal", writer.node("Sqrt", operand))


def _square(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.node("Mul", operand, operand)


def _integer_pow(writer: _Writer, equation: Any, operand: Value) -> Value:
    power = equation.params["y"]
    return writer.node("Mul", operand, operand) if power == 2 else writer.node("Pow", operand, np.float32(power))


def _clamp(writer: _Writer, equation: Any, least: Value, operand: Value, most: Value) -> Value:
    return writer.node("Min", writer.node("Max", operand, least), most)


def _convert(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.cast(operand, equation.params["new_dtype"])


def _select(writer: _Writer, equation: Any, which: Value, *cases: Value) -> Value:
    if len(cases) != 2 or equation.invars[0].aval.dtype != bool:
        raise GuiderError("a policy that selects by numbers cannot be exported; select by truth values")
    return writer.node("Where", which, cases[1], cases[0])


def _broadcast(writer: _Writer, equation: Any, operand: Value) -> Value:
    shape, kept = equation.params["shape"], equation.params["broadcast_dimensions"]
    before = dict(zip(kept, _shape(equation), strict=True))
    spread = writer.reshaped(operand, [before.get(axis, 1) for axis in range(len(shape))])
    return writer.node("Expand", spread, np.array(shape, np.int64))


def _reshape(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.reshaped(operand, _result(equation).shape)


def _transpose(writer: _Writer, equation: Any, operand: Value) -> Value:
    return writer.node("Transpose", operand, perm=list(equation.params["permutation"]))


def _concatenate(writer: _Writer, equation: Any, *operands: Value) -> Value:
    """Without what is empty, which runtimes do not all know how to reshape."""
    shapes = [variable.aval.shape for variable in equation.invars]
    parts = [operand for operand, shape in zip(operands, shapes, strict=True) if 0 not in shape]
    return writer.node("Concat", *parts, axis=equation.params["dimension"])


def _stack(writer: _Writer, equation: Any, *operands: Value) -> Value:
    axis, shape = equation.params["axis"], list(_result(equation).shape)
    shape[axis] = 1
    return writer.node("Concat", *(writer.reshaped(operand, shape) for operand in operands), axis=axis)


def _slice(writer: _Writer, equation: Any, operand: Value) -> Value:
    begin, end, stride = (equation.params[name] for name in ("start_indices", "limit_indices", "strides"))
    axes = range(len(begin))
    places = [np.array(numbers, np.int64) for numbers in (begin, end, axes, stride or [1] * len(begin))]
    return writer.node("Slice", operand, *places)


def _split(writer: _Writer, equation: Any, operand: Value) -> Value:
    sizes = equation.params["sizes"]
    return writer.several("Split", len(sizes), operand, np.array(sizes, np.int64), axis=equation.params["axis"])


def _reduce(operator: str) -> Callable[..., Value]:
    def rule(writer: _Writer, equation: Any, operand: Value) -> Value:
        return writer.node(operator, operand, np.array(equation.params["axes"], np.int64), keepdims=0)

    return rule


def _reduce_truths(operator: str) -> Callable[..., Value]:
    def rule(writer: _Writer, equation: Any, operand: Value) -> Value:
        axes = np.array(equation.params["axes"], np.int64)
        return writer.cast(writer.node(operator, writer.cast(operand, np.int32), axes, keepdims=0), bool)

    return rule


def _argument(operator: str) -> Callable[..., Value]:
    def rule(writer: _Writer, equation: Any, operand: Value) -> Value:
        (axis,) = equation.params["axes"]
        return writer.cast(writer.node(operator, operand, axis=axis, keepdims=0), equation.params["index_dtype"])

    return rule


def _dot(writer: _Writer, equation: Any, first: Value, second: Value) -> Value:
    (of_first, of_second), (batch_first, batch_second) = equation.params["dimension_numbers"]
    ranks = len(_shape(equation, 0)), len(_shape(equation, 1))
    if not batch_first and of_first == (ranks[0] - 1,) and of_second == (0,) and ranks[1] <= 2:
        return writer.node("MatMul", first, second)
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    left, right = [""] * ranks[0], [""] * ranks[1]
    for one, other in zip((*batch_first, *of_first), (*batch_second, *of_second), strict=True):
        left[one] = right[other] = next(letters)
    left, right = ([letter or next(letters) for letter in side] for side in (left, right))
    batch = [left[axis] for axis in batch_first]
    rest = [*(letter for letter in left if letter not in right), *(letter for letter in right if letter not in left)]
    equation_text = f"{''.join(left)},{''.join(right)}->{''.join(batch + rest)}"
    return writer.node("Einsum", first, second, equation=equation_text)


def _gather(writer: _Writer, equation: Any, operand: Value, indices: Value) -> Value:
    """Where one entry or all of an axis are taken, which is what indexing comes to."""
    numbers, sizes, at = equation.params["dimension_numbers"], equation.params["slice_sizes"], _shape(equation, 1)[:-1]
    columns = {int(axis): column for column, axis in enumerate(numbers.start_index_map)}
    batched, collapsed = list(map(int, numbers.operand_batching_dims)), set(map(int, numbers.collapsed_slice_dims))
    axes = [axis for axis in columns if sizes[axis] < _shape(equation)[axis] or axis in collapsed]
    if isinstance(indices, str):
        parts = writer.several("Split", len(columns), indices, np.ones(len(columns), np.int64), axis=len(at))
    else:
        parts = np.split(np.asarray(indices), len(columns), axis=-1)
    rows = [np.indices(at)[axis][..., None] for axis in numbers.start_indices_batching_dims]
    places = dict(zip(batched, rows, strict=True)) | {axis: parts[columns[axis]] for axis in axes}
    found, others = _taken(writer, equation, operand, places, len(at))
    window = [axis for axis in range(len(sizes)) if axis not in collapsed and axis not in batched]
    offsets = dict(zip(map(int, numbers.offset_dims), window, strict=True))
    ahead, order = iter(range(len(at))), []
    for axis in range(len(_result(equation).shape)):
        if axis not in offsets:
            order.append(next(ahead))
        elif offsets[axis] in others:
            order.append(len(at) + others.index(offsets[axis]))
    turned = found if order == sorted(order) else writer.node("Transpose", found, perm=order)
    return writer.reshaped(turned, _result(equation).shape)


def _dynamic_slice(writer: _Writer, equation: Any, operand: Value, *begins: Value) -> Value:
    sizes = equation.params["slice_sizes"]
    axes = [axis for axis, size in enumerate(sizes) if size < _shape(equation)[axis]]
    places = {axis: writer.reshaped(begins[axis], [1]) for axis in axes}
    found, _ = _taken(writer, equation, operand, places, 0)
    return writer.reshaped(found, _result(equation).shape)


def _taken(
    writer: _Writer, equation: Any, operand: Value, places: dict[int, Value], rank: int
) -> tuple[Value, list[int]]:
    """(entries of some axes at places [..., 1], whose shape comes first and has so many axes, and all of the others;
    which these are)."""
    shape, sizes = _shape(equation), equation.params["slice_sizes"]
    others = [axis for axis in range(len(shape)) if axis not in places]
    if any(sizes[axis] != shape[axis] for axis in others) or any(sizes[axis] != 1 for axis in places) or not places:
        raise GuiderError("a policy that takes parts of slices by computed indices cannot be exported")
    limited = []
    for axis, place in places.items():
        if isinstance(place, str):
            above = writer.node("Max", writer.cast(place, np.int64), np.int64(0))
            limited.append(writer.node("Min", above, np.int64(shape[axis] - 1)))
        else:
            limited.append(np.clip(np.asarray(place, np.int64), 0, shape[axis] - 1))
    order = [*places, *others]
    if order != sorted(order):
        known = not isinstance(operand, str)
        operand = np.transpose(operand, order) if known else writer.node("Transpose", operand, perm=order)
    together = limited[0] if len(limited) == 1 else writer.node("Concat", *limited, axis=rank)
    return writer.node("GatherND", operand, together), others


_RULES: dict[str, Callable[..., Value]] = {
    "argmax": _argument("ArgMax"),
    "argmin": _argument("ArgMin"),
    "broadcast_in_dim": _broadcast,
    "clamp": _clamp,
    "concatenate": _concatenate,
    "convert_element_type": _convert,
    "dot_general": _dot,
    "dynamic_slice": _dynamic_slice,
    "expand_dims": _reshape,
    "gather": _gather,
    "integer_pow": _integer_pow,
    "is_finite": _is_finite,
    "ne": _not_equal,
    "reduce_and": _reduce_truths("ReduceMin"),
    "reduce_max": _reduce("ReduceMax"),
    "reduce_min": _reduce("ReduceMin"),
    "reduce_or": _reduce_truths("ReduceMax"),
    "reduce_sum": _reduce("ReduceSum"),
    "reshape": _reshape,
    "rsqrt": _rsqrt,
    "select_n": _select,
    "slice": _slice,
    "split": _split,
    "square": _square,
    "squeeze": _reshape,
    "stack": _stack,
    "transpose": _transpose,
}
