"""Runs: what was trained, on disk. run.py, what a run is and how it is opened; trainer.py, training into one."""

from guider.runs.run import Pace, Run, RunSpec, as_run, open_run, policies, total_updates, versions
from guider.runs.trainer import check_free, resume, start

__all__ = [
    "Pace",
    "Run",
    "RunSpec",
    "as_run",
    "check_free",
    "open_run",
    "policies",
    "resume",
    "start",
    "total_updates",
    "versions",
]
