"""Recording on all cores: episodes are Python code, so processes make them, not threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context


@contextmanager
def map_in_processes(processes: int) -> Iterator[Callable]:
    """`map`, in that many processes; in this one if that is 1."""
    if processes == 1:
        yield map
        return
    # Spawned, not forked: the parent may run threads.
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield pool.map
