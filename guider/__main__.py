"""`python -m guider` is the command `guider`."""

import os
import signal
import sys
from typing import Any


def run() -> int:
    """The command. While its code is being loaded, nothing is begun that would have to be put in order."""
    before = {number: signal.signal(number, _leave) for number in (signal.SIGINT, signal.SIGTERM)}
    from guider.cli import main

    for number, handler in before.items():
        signal.signal(number, handler)
    return main()


def _leave(number: int, frame: Any) -> None:
    os.write(2, b"guider: interrupted\n")
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(run())
