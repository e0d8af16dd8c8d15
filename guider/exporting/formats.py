"""Files that a policy leaves in: ONNX, NumPy arrays with an actor beside them, safetensors."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from guider.errors import GuiderError
from guider.exporting import actor
from guider.exporting.controller import controller, parameters
from guider.methods.policy import Policy
from guider.support import files
from guider.support.extras import extra

ABOUT = "guider"
"""Under this name what `about` says stands in the metadata of ONNX and safetensors, as JSON."""
_OPSET, _IR_VERSION = 18, 10

EXAMPLE = """# One step after another of {name!a}, with onnxruntime and NumPy alone: pip install onnxruntime

import json

import numpy as np
import onnxruntime

session = onnxruntime.InferenceSession({name!a})
about = json.loads(session.get_modelmeta().custom_metadata_map["guider"])  # what it was trained on, units, bounds
types = {{"tensor(float)": np.float32, "tensor(int32)": np.int32, "tensor(bool)": bool}}
memory = {{given.name: np.zeros(given.shape, types[given.type])
          for given in session.get_inputs() if given.name.startswith("memory_")}}
begins = True  # an episode does, or the goal is another one
goal = np.zeros({goal_dim}, np.float32)  # where to go: {goal}
for step in range(10):
    observation = np.zeros({state_dim}, np.float32)  # what the robot sees
    given = {{"observation": observation, "goal": goal, "begins": np.array(begins), **memory}}
    results = dict(zip([output.name for output in session.get_outputs()], session.run(None, given)))
    memory, begins = {{name: results[f"next_{{name}}"] for name in memory}}, False
    print(step, results["action"])  # to the robot
"""


def write_onnx(path: Path, policy: Policy, about: dict[str, Any]) -> list[Path]:
    """The whole controller, and beside it a Python file that runs it."""
    onnx = _imported("onnx")
    helper, program = onnx.helper, controller(policy)

    def tensor(name: str, shape: tuple[int, ...], dtype: Any) -> Any:
        return helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape)

    nodes = [
        helper.make_node(node.operator, node.inputs, node.outputs, **_onnx_attributes(helper, node.attributes))
        for node in program.nodes
    ]
    graph = helper.make_graph(
        nodes,
        "policy",
        [tensor(name, array.shape, array.dtype) for name, array in program.inputs.items()],
        [tensor(name, kind.shape, kind.dtype) for name, kind in program.outputs.items()],
        [onnx.numpy_helper.from_array(array, name) for name, array in program.constants.items()],
    )
    opset = helper.make_opsetid("", _OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=_IR_VERSION, producer_name="guider")
    helper.set_model_props(model, {ABOUT: json.dumps(about)})
    onnx.checker.check_model(model, full_check=True)
    named = ", ".join(map(ascii, about["goal_names"]))  # by whoever recorded the data: a name must stay a comment
    example = _beside(path, f"{path.stem}_example.py", EXAMPLE.format(name=path.name, goal=named, **about))
    files.write_bytes(path, model.SerializeToString())
    return [path, example]


def write_npz(path: Path, policy: Policy, about: dict[str, Any]) -> list[Path]:
    """The whole controller as arrays and JSON, and beside it the file that acts by it."""
    program = controller(policy)
    told = {
        "about": about,
        "inputs": {name: (array.tolist(), array.dtype.name) for name, array in program.inputs.items()},
        "outputs": list(program.outputs),
        "nodes": program.nodes,
        "constants": list(program.constants),
    }
    beside = _beside(path, "guider_actor.py", Path(actor.__file__).read_text())
    with files.replacing(path) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, program=np.array(json.dumps(told)), **program.constants)
    return [path, beside]


def write_safetensors(path: Path, policy: Policy, about: dict[str, Any]) -> list[Path]:
    """What was trained, array by array, to be built upon elsewhere."""
    save = _imported("safetensors.numpy").save
    arrays = {name: np.ascontiguousarray(array) for name, array in parameters(policy).items()}
    files.write_bytes(path, save(arrays, {ABOUT: json.dumps(about)}))
    return [path]


FORMATS: dict[str, Callable[[Path, Policy, dict[str, Any]], list[Path]]] = {
    ".onnx": write_onnx,
    ".npz": write_npz,
    ".safetensors": write_safetensors,
}
"""By the ending of the file's name."""


def _beside(path: Path, name: str, text: str) -> Path:
    """The file of that name in the same folder, written; one that holds something else is left alone."""
    beside = path.with_name(name)
    if beside.exists() and beside.read_bytes() != text.encode():
        raise GuiderError(f"{beside} is there already and holds something else; remove it, or export to another folder")
    files.write_text(beside, text)
    return beside


def _onnx_attributes(helper: Any, attributes: dict[str, Any]) -> dict[str, Any]:
    if "to" not in attributes:
        return attributes
    return attributes | {"to": helper.np_dtype_to_tensor_dtype(np.dtype(attributes["to"]))}


def _imported(name: str) -> Any:
    from importlib import import_module

    with extra("export", f"{name.partition('.')[0]}, which .npz does without,"):
        return import_module(name)
