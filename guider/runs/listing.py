"""What runs there are below a folder, how far each has come, and what it scored."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from guider.errors import GuiderError
from guider.runs.run import open_run
from guider.support import files


def run_directories(folder: Path) -> Iterator[Path]:
    """Those below `folder`, by name; links are not followed. Raises GuiderError where it is no folder."""
    if not folder.is_dir():
        raise GuiderError(f"{folder} is no folder")
    for place, below, names in os.walk(folder):
        below.sort()
        if "run.json" in names:
            below.clear()
            yield Path(place)


def facts(directory: Path) -> dict[str, Any]:
    """What one is, its updates done and in all, and its score; of one that cannot be read, why."""
    row: dict[str, Any] = {"run": str(directory), "problem": None}
    try:
        run = open_run(directory)
        spec = run.spec
        lines = files.read_lines(directory / "metrics.jsonl")
        row |= {
            "task": spec.task,
            "data": spec.data,
            "method": spec.method,
            "preset": spec.preset,
            "seeds": list(spec.seeds),
            "updates": lines[-1]["total_updates"] if lines else 0,
            "of_updates": sum(stage.updates for stage in run.stages),
        }
        result = files.read_json(directory / "evaluation.json", "score the run anew")
    except FileNotFoundError:
        return row
    except (GuiderError, OSError) as error:
        return row | {"problem": str(error)}
    if spec.task is None:
        errors = [of_seed["action_error"] for of_seed in result["per_seed"]]
        return row | {"action_error": sum(errors) / len(errors)}
    return row | {name: result[name] for name in ("score", "interval_95", "unit")}
