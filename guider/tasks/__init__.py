"""The benchmark tasks, by name."""

from __future__ import annotations

import difflib

from guider.errors import GuiderError
from guider.tasks.antmaze import ANTMAZES
from guider.tasks.pointmaze import POINTMAZES
from guider.tasks.types import Task

TASKS: dict[str, Task] = {task.name: task for task in (*POINTMAZES, *ANTMAZES)}


def find_task(name: str) -> Task:
    """The task called `name`. Raises GuiderError, with the names closest to it, if there is none."""
    if name in TASKS:
        return TASKS[name]
    near = difflib.get_close_matches(name, TASKS, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise GuiderError(f"no task is called {name!r}; {hint}`guider tasks` lists them all")
