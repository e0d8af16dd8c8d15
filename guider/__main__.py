"""`python -m guider` is the command `guider`."""

import os
import signal
import sys
from typing import Any


def run() -> int:
    """The command. Before its code is loaded and after it has answered there is nothing to put in order: until then a
    signal ends it with a line, from then on it is about to end."""
    heeded = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) != signal.SIG_IGN]
    for number in heeded:
        signal.signal(number, _leave)
    from guider.cli import main

    if signal.SIGINT in heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return main()
    finally:
        for number in heeded:
            signal.signal(number, signal.SIG_IGN)


def _leave(number: int, frame: Any) -> None:
    os.write(2, b"guider: interrupted\n")
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(run())
