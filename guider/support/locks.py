"""Locks on what one process at a time may work on. They are the system's, which frees them when their holder dies."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from guider.errors import GuiderError
from guider.support.files import is_dead

POLL_SECONDS = 0.2


@dataclass(frozen=True)
class Holder:
    """Who holds a lock, as the lock's file says."""

    host: str
    pid: int
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} since {self.since}"

    @property
    def is_dead(self) -> bool:
        """Of other machines' processes nobody here can tell."""
        return self.host == socket.gethostname() and is_dead(self.pid)


@contextmanager
def hold(lock: Path, busy: str, waiting: Callable[[str], None] | None = None) -> Iterator[int]:
    """Hold the file `lock`, and give its descriptor: children that inherit it hold the lock too, until all have ended.

    busy: what it means that another holds it, "runs/robot is being trained". `waiting` is told so again and again until
    the lock is free; without it, GuiderError is raised at once. Raises OSError where the file cannot be made.
    """
    while (descriptor := _take(lock)) is None:
        message = f"{busy} ({_holder(lock) or 'by another process'})"
        if waiting is None:
            raise GuiderError(f"{message}; wait for that one, or end it")
        waiting(message)
        time.sleep(POLL_SECONDS)
    try:
        yield descriptor
    finally:
        if _is_at(descriptor, lock):
            lock.unlink()
        os.close(descriptor)


def clear_free(folder: Path, pattern: str) -> None:
    """Remove the lock files that nobody holds: a killed holder leaves its own behind."""
    for lock in folder.glob(pattern):
        if (descriptor := _take(lock)) is not None:
            lock.unlink(missing_ok=True)
            os.close(descriptor)


def _take(lock: Path) -> int | None:
    """The descriptor of the lock, which is ours now, or None while another holds it."""
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    try:
        if _locked(descriptor, lock) and _is_at(descriptor, lock):
            holder = Holder(socket.gethostname(), os.getpid(), datetime.now(UTC).isoformat(timespec="seconds"))
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, json.dumps(asdict(holder)).encode(), 0)
            return descriptor
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


def _locked(descriptor: int, lock: Path) -> bool:
    """Lock the file. Where the file system has no locks, what the file says about its last holder decides."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EINVAL):
            raise
        holder = _holder(lock)
        return holder is None or holder.is_dead
    return True


def _is_at(descriptor: int, lock: Path) -> bool:
    """Whether the file is still where it was: its last holder removes it."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(lock))
    except FileNotFoundError:
        return False


def _holder(lock: Path) -> Holder | None:
    """None where the file does not say, as in the moment in which it is made."""
    try:
        holder = Holder(**json.loads(lock.read_bytes()))
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    return holder if type(holder.pid) is int and holder.pid > 0 else None
