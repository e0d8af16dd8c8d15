"""`guider tasks`."""

from __future__ import annotations

from typing import Any

import tyro
from rich.table import Table

from guider.commands.options import Json
from guider.commands.screen import answer


def tasks(task: tyro.conf.Positional[str | None] = None, as_json: Json = False) -> None:
    """List the benchmark tasks, or say all about one: environment, goal, protocol, data.

    Three more forms make tasks of your own: gym:ENV_ID of any Gymnasium goal environment, pointmaze:FILE and
    antmaze:FILE in a maze drawn in a text file (# wall, . free, S start, G goal). A file of Python that the environment
    variable GUIDER_TASKS names adds any other (docs/own_task.py).

    Args:
        task: The task to say all about.
        as_json: Print one JSON document instead of text.
    """
    from guider.tasks import find_task, known_tasks

    if task is not None:
        facts = _task_facts(find_task(task))
        answer(facts, "\n".join(f"{name.replace('_', ' '):>14}  {value}" for name, value in facts.items()), as_json)
        return
    listed = known_tasks().values()
    rows = [_task_facts(found) for found in listed]
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for title in ("task", "score", "steps", "c", "radius", "paper", "collect"):
        table.add_column(title, no_wrap=True)
    for row, found in zip(rows, listed, strict=True):
        columns = (row[name] for name in ("horizon_steps", "period_steps", "radius", "paper_score"))
        made = "yes" if found.collector else "-"
        table.add_row(row["task"], found.score, *("-" if value is None else str(value) for value in columns), made)
    answer(rows, table, as_json)


def _task_facts(task: Any) -> dict[str, Any]:
    from guider.tasks.types import SCORE_UNITS

    return {
        "task": task.name,
        "summary": task.summary,
        "environment": task.environment,
        "source": task.source,
        "goal_indices": list(task.goal_indices),
        "goal_parts": [list(part) for part in task.goal_parts],
        "radius": task.radius,
        "reach_radius": task.reach_radius,
        "horizon_steps": task.horizon_steps,
        "period_steps": task.period_steps,
        "score": SCORE_UNITS[task.score],
        "data": task.collector.recipe if task.collector else None,
        "paper_score": task.paper_score,
    }
