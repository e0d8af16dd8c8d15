"""`python -m guider` is the command `guider`."""

import signal
import sys


def run() -> int:
    """The command. While its code is loaded, nothing is begun that Ctrl-C would have to put in order."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from guider.cli import main

    signal.signal(signal.SIGINT, before)
    return main()


if __name__ == "__main__":
    sys.exit(run())
