"""Ending on request: what happens when SIGINT (Ctrl-C) or SIGTERM arrives."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def on_signals(handle: Callable[[int], None], *numbers: int) -> Iterator[None]:
    """Within, `handle` is called with the number of each of these signals that arrives.

    Only in the main thread, which alone may; a signal that the process was started to ignore (nohup) stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in found.items() if handler not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, lambda arrived, frame: handle(arrived))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
