"""The command line: one command is run, and what was wrong is said in a line.

Exit status: 0 done; 1 bad input or a place that cannot be read or written; 2 wrong usage; 3 a fault of guider's;
130 and 143 stopped by Ctrl-C or SIGTERM; 141 nobody reads the output. GUIDER_DEBUG=1 shows the trace.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, get_origin, get_type_hints

import tyro

from guider.commands import COMMANDS
from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.learning.options import LearningOptions

_MOMENT_S = 0.05
"""Until an interruption comes again, which by then is no longer where nothing may be raised."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and say in a line what was wrong, if anything. Returns the exit status, see this file's top."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that lacks a letter shows its number
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore[reportAttributeAccessIssue]
    try:
        with _stopping_on_sigterm(), _interrupting_again(), _showing_warnings():
            tyro.extras.subcommand_cli_from_dict(
                COMMANDS,
                prog="guider",
                description="Learn long, sparse-reward tasks from logged data: get data, train, evaluate, plot.",
                args=_gathered(sys.argv[1:] if arguments is None else arguments),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
            )
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at its end
        return 141
    except (Exception, KeyboardInterrupt, Stopped) as error:
        if os.environ.get("GUIDER_DEBUG"):
            raise
        status, line = _told(error)
        print(f"guider: {line}", file=sys.stderr)
        return status
    return 0


def _told(error: BaseException) -> tuple[int, str]:
    """(exit status, what to say) of what ended a command. A library that is interrupted while it is imported may call
    that an ImportError."""
    cause: BaseException | None = error
    while not isinstance(cause, KeyboardInterrupt | Stopped | None):
        cause = cause.__cause__
    match cause or error:
        case Stopped() as stopped:
            return 128 + stopped.signal_number, str(stopped)
        case KeyboardInterrupt():
            return 128 + signal.SIGINT, "interrupted"
        case GuiderError():
            return 1, str(error)
        case OSError() as failure:
            where = f"{failure.filename}: " if failure.filename else ""
            return 1, f"{where}{failure.strerror or failure}"
        case MemoryError():
            return 1, f"there is not enough memory ({' '.join(str(error).split()) or 'none is left'})"
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return 3, f"a fault of guider's own, please report it: {what[:300]} (GUIDER_DEBUG=1 shows the trace)"


@contextmanager
def _stopping_on_sigterm() -> Iterator[None]:
    """SIGTERM ends a command as Ctrl-C does: what is open is put in order, children end too."""

    def stop(number: int, frame: Any) -> None:
        raise Stopped("ended by SIGTERM", number)

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread, where signals are for someone else
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _interrupting_again() -> Iterator[None]:
    """An interruption that comes where nothing may be raised (Python only says that it ignored it) comes once more."""
    before = sys.unraisablehook

    def look(ignored: Any) -> None:
        if not isinstance(ignored.exc_value, KeyboardInterrupt | Stopped):
            before(ignored)
            return
        number = getattr(ignored.exc_value, "signal_number", signal.SIGINT)
        threading.Timer(_MOMENT_S, signal.pthread_kill, (threading.main_thread().ident, number)).start()

    sys.unraisablehook = look
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def _showing_warnings() -> Iterator[None]:
    """Guider's warnings as lines, once each; others as Python shows them."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", GuiderWarning)
        shown, others = [], warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
            if not issubclass(category, GuiderWarning):
                others(message, category, *rest, **more)
            elif str(message) not in shown:
                shown.append(str(message))
                print(f"guider: warning: {message}", file=sys.stderr)

        warnings.showwarning = show
        yield


_OPTION = re.compile(r"--[a-z]")


def _gathered(arguments: list[str]) -> list[str]:
    """The arguments with options that take several values and were given several times put together: all that was said
    counts. Raises GuiderError for any other option given twice."""
    command = COMMANDS.get(arguments[0]) if arguments else None
    if command is None:
        return arguments
    kinds = get_type_hints(command) | get_type_hints(LearningOptions)
    several = {f"--{name.replace('_', '-')}" for name, kind in kinds.items() if get_origin(kind) in (tuple, Sequence)}
    gathered: list[list[str]] = [[]]  # positional arguments, then each option with its values
    for argument in arguments:
        if not _OPTION.match(argument):
            gathered[-1].append(argument)
            continue
        name, *value = argument.split("=", 1)
        name = name.replace("_", "-")
        earlier = next((option for option in gathered if option[:1] == [name]), None)
        if earlier is not None and name not in several:
            raise GuiderError(f"{name} is given twice; say it once")
        if earlier is not None:
            gathered.remove(earlier)
        gathered.append([*(earlier or [name]), *value])
    return [argument for option in gathered for argument in option]
