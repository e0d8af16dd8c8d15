"""What a user is meant to read: errors, warnings, and where work stopped on request."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class GuiderError(Exception):
    """Bad input. The message is one line: what is wrong, where, and what to do."""

    def __init__(self, message: str):
        super().__init__(" ".join(message.split("\n")))


class GuiderWarning(UserWarning):
    """Something that was decided for the user and may be wrong, in one line; the command line prints it as such."""


class Stopped(BaseException):
    """Work ended because a signal asked for it, after what was done had been kept: like KeyboardInterrupt, no error.

    The message says how to go on. signal_number: SIGINT or SIGTERM; the program ends with status 128 + signal_number.
    """

    def __init__(self, message: str, signal_number: int):
        super().__init__(message)
        self.signal_number = signal_number


def names_like(name: str, names: Iterable[str]) -> str:
    """For a message about a name that is none: the names like it, or else what there is, at most a dozen."""
    names = list(map(str, names))
    if near := difflib.get_close_matches(name, names, n=3, cutoff=0.5):
        return f"did you mean {' or '.join(near)}?"
    return f"there are {', '.join(names[:12])}" + (f" and {len(names) - 12} more" if len(names) > 12 else "")
