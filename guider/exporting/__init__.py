"""The way out to the robot: a trained policy as a file that runs without this package.

controller.py says what goes in and out in a step; program.py reads off what is computed between; formats.py writes it
down; actor.py, which is copied beside .npz files, runs it with NumPy alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from guider.data.episodes import entry_name
from guider.errors import GuiderError, names_like
from guider.exporting.formats import FORMATS
from guider.methods.policy import Policy
from guider.runs import RunSpec, versions
from guider.support import files

__all__ = ["FORMATS", "about", "export_policy"]


def export_policy(policy: Policy, told: dict[str, Any], path: Path) -> list[Path]:
    """Write a policy in the format that the path's ending names, with what is told of it, and return what was written.

    Raises GuiderError for an ending that is none, for a place that has a file already, and where a library is missing.
    """
    if path.suffix not in FORMATS:
        raise GuiderError(f"{path}: the name must end in a format; {names_like(path.suffix, FORMATS)}")
    return FORMATS[path.suffix](files.new_file(path, "name"), policy, told)


def about(spec: RunSpec, seed: int, policy: Policy) -> dict[str, Any]:
    """What whoever runs a policy must know of it."""
    problem = spec.config.problem
    return {
        "task": spec.task,
        "data": Path(spec.data).name,
        "fingerprint": spec.fingerprint,
        "method": spec.method,
        "state_names": list(spec.spaces.state_names[: policy.logged_dim]),
        "action_names": list(spec.spaces.action_names),
        "preset": spec.preset,
        "seed": seed,
        "state_dim": policy.logged_dim,
        "goal_dim": policy.goal_dim,
        "goal_indices": list(policy.goal_indices),
        "goal_names": [entry_name(spec.spaces.state_names, index) for index in policy.goal_indices],
        "action_low": policy.action_low.tolist(),
        "action_high": policy.action_high.tolist(),
        "radius": problem.radius,
        "reach_radius": problem.reach_radius,
        "period_steps": problem.period_steps,
        "versions": versions(),
    }
