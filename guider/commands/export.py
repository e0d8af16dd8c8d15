"""`guider export`."""

from __future__ import annotations

from pathlib import Path

import tyro

from guider.commands.options import Json, RunDirectory
from guider.commands.screen import answer


def export(run: RunDirectory, out: tyro.conf.Positional[Path], seed: int | None = None, as_json: Json = False) -> None:
    """Write a trained policy as a file for the robot, which runs without guider.

    The whole controller: scaling, subgoals, bounds, and what it remembers. guider export runs/robot policy.onnx

    Args:
        run: Directory of the run.
        out: New file. Its ending names the format: .onnx, with an example of its use beside it; .npz, with a Python
            file beside it that acts by NumPy alone; .safetensors, the trained numbers without the controller.
        seed: Which trained seed to write; by default the first.
        as_json: Print one JSON document instead of text.
    """
    from guider import api

    paths = [str(path) for path in api.export(run, out, seed=seed)]
    answer({"files": paths}, "\n".join(paths), as_json)
