"""Recording on all cores: episodes are Python code, so processes make them, not threads."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread

from guider.errors import GuiderError


@contextmanager
def map_in_processes(processes: int) -> Iterator[Callable]:
    """`map`, in that many processes; in this one if that is 1.

    The processes end as soon as the context is left, by an exception too, or as this process ends, in whatever way.
    Raises GuiderError if one of them is killed.
    """
    if processes == 1:
        yield map
        return
    others = set(active_children())
    # Spawned, not forked: the parent may run threads.
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=_end_with_parent) as pool:

        def map_in_pool(*arguments):
            # Ctrl-C goes to all processes of a terminal; it is this one's to answer. A blocked signal stays blocked in
            # what is started meanwhile.
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
            try:
                return pool.map(*arguments)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

        try:
            yield map_in_pool
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)  # its thread trips over futures that are cancelled
            for worker in set(active_children()) - others:
                worker.terminate()
            if isinstance(error, BrokenProcessPool):
                raise GuiderError("a process that records was killed, perhaps for want of memory; try again") from error
            raise


def _end_with_parent() -> None:
    """Make this worker end when its parent does: a pool's workers would wait for work for ever."""

    def wait() -> None:
        parent = parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    Thread(target=wait, daemon=True).start()
