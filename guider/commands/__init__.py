"""The commands, a file each: a function whose signature is the command's options and whose docstring is its help."""

from __future__ import annotations

from collections.abc import Callable

from guider.commands.collect import collect
from guider.commands.compare import compare
from guider.commands.data import data
from guider.commands.evaluate import evaluate
from guider.commands.export import export
from guider.commands.film import film
from guider.commands.info import info
from guider.commands.plot import plot
from guider.commands.report import report
from guider.commands.reproduce import reproduce
from guider.commands.runs import runs
from guider.commands.tasks import tasks
from guider.commands.train import train

COMMANDS: dict[str, Callable[..., None]] = {
    "train": train,
    "evaluate": evaluate,
    "plot": plot,
    "report": report,
    "film": film,
    "export": export,
    "tasks": tasks,
    "data": data,
    "collect": collect,
    "runs": runs,
    "compare": compare,
    "reproduce": reproduce,
    "info": info,
}
