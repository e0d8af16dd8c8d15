"""Tasks: what is to be done, where, and how it is scored. A row or a file each.

Yours may stand in a file of your own: see docs/own_task.py.
"""

from __future__ import annotations

from collections.abc import Callable

from guider.support import plugins
from guider.tasks import antmaze, pointmaze
from guider.tasks.antmaze import ANTMAZES
from guider.tasks.fetch import FETCH_TASKS
from guider.tasks.gymnasium_tasks import GYM_ANTMAZES, goal_task
from guider.tasks.kitchen import KITCHEN_TASKS
from guider.tasks.ogbench_mazes import MAZE_TASKS
from guider.tasks.ogbench_tables import TABLE_TASKS
from guider.tasks.pointmaze import POINTMAZES
from guider.tasks.types import Task

_FAMILIES = POINTMAZES, ANTMAZES, FETCH_TASKS, KITCHEN_TASKS, GYM_ANTMAZES, MAZE_TASKS, TABLE_TASKS

TASKS: dict[str, Task] = {task.name: task for family in _FAMILIES for task in family}
"""This package's, by name."""
OPEN_FORMS: dict[str, Callable[[str], Task]] = {
    "pointmaze": pointmaze.custom_task,
    "antmaze": antmaze.custom_task,
    "gym": goal_task,
}


def find_task(name: str) -> Task:
    """The task called `name`: one of TASKS or of your own, or made to order.

    pointmaze:FILE, antmaze:FILE: in the maze drawn in a text file, see guider.tasks.mazes.read_maze
    gym:ENV_ID: a Gymnasium goal environment, see guider.tasks.gymnasium_tasks.goal_task

    Raises GuiderError, with the names closest to it, if there is none.
    """
    form, colon, rest = name.partition(":")
    if colon and form in OPEN_FORMS:
        return OPEN_FORMS[form](rest)
    forms = (
        "`guider tasks` lists all, and pointmaze:MAZE.txt, antmaze:MAZE.txt and gym:ENV_ID make one of a maze you draw "
    )
    return plugins.find("tasks", name, TASKS, f"{forms}or of a Gymnasium goal environment; ")


def known_tasks() -> dict[str, Task]:
    """TASKS and your own, by name."""
    return plugins.known("tasks", TASKS)
