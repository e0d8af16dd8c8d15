"""`guider info`."""

from __future__ import annotations

import os
import platform
from importlib.util import find_spec

from guider.commands.options import Json
from guider.commands.screen import answer

EXTRAS = {
    "export": ("onnx", "onnxruntime", "safetensors"),
    "ogbench": ("ogbench",),
    "tensorboard": ("tensorboardX",),
    "wandb": ("wandb",),
    "hub": ("huggingface_hub",),
}


def info(as_json: Json = False) -> None:
    """Say what a bug report needs: versions, processor, cores, graphics, and which extras are installed.

    Args:
        as_json: Print one JSON document instead of text.
    """
    from guider.learning import processor
    from guider.runs import versions
    from guider.tasks.simulation import available_cores

    installed = [extra for extra, modules in EXTRAS.items() if all(map(find_spec, modules))]
    variables = ("MUJOCO_GL", "JAX_PLATFORMS", "XLA_FLAGS", "GUIDER_METHODS", "GUIDER_TASKS")
    facts = versions() | {
        "system": platform.platform(),
        "trains on": processor.describe(),
        "cores": available_cores(),
        "extras": " ".join(installed) or "none",
        "variables": " ".join(f"{name}={os.environ[name]}" for name in variables if name in os.environ) or "none",
    }
    answer(facts, "\n".join(f"{name:>12}  {value}" for name, value in facts.items()), as_json)
