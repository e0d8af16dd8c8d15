"""Locks: one holder, whom the others learn of; a dead one holds nothing."""

from __future__ import annotations

import errno
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import dead_pid

from guider.errors import GuiderError
from guider.support import locks
from guider.support.locks import hold


@pytest.fixture
def lock(tmp_path: Path) -> Path:
    return tmp_path / ".lock"


def test_a_lock_is_held_by_one_and_names_it(lock):
    with hold(lock, "the run is being trained"):
        words = rf"the run is being trained \(process {os.getpid()} on {socket.gethostname()} since \d+-.*\); wait"
        with pytest.raises(GuiderError, match=words), hold(lock, "the run is being trained"):
            pass
    assert not lock.exists()
    with hold(lock, "free again"):
        pass


def test_another_process_holds_it_until_it_is_killed(lock):
    script = f"""
import sys
from pathlib import Path
from guider.support.locks import hold
with hold(Path({str(lock)!r}), "busy"):
    print("held", flush=True)
    sys.stdin.read()
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None and process.stdout is not None
    with process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(GuiderError, match=rf"busy \(process {process.pid} on"), hold(lock, "busy"):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
    with hold(lock, "busy"):
        assert json.loads(lock.read_text())["pid"] == os.getpid()


def test_who_waits_is_told_and_gets_it(lock, monkeypatch):
    monkeypatch.setattr(locks, "POLL_SECONDS", 0.0)
    first = hold(lock, "busy")
    first.__enter__()
    told = []

    def waiting(message: str) -> None:
        told.append(message)
        if len(told) == 2:
            first.__exit__(None, None, None)

    with hold(lock, "busy", waiting):
        assert len(told) == 2 and f"process {os.getpid()}" in told[0]


def test_a_child_that_got_it_keeps_it(lock, monkeypatch):
    """Its starter was killed, and could not end it."""
    script = f"""
import os, signal, subprocess
from pathlib import Path
from guider.support.locks import hold
with hold(Path({str(lock)!r}), "busy") as descriptor:
    print(subprocess.Popen(["sleep", "600"], pass_fds=(descriptor,), stdout=subprocess.DEVNULL).pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    child = int(subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE).stdout)
    monkeypatch.setattr(locks, "POLL_SECONDS", 0.01)
    with pytest.raises(GuiderError, match="busy"), hold(lock, "busy"):
        pass
    os.kill(child, signal.SIGKILL)
    with hold(lock, "busy", lambda message: None):
        pass


@pytest.mark.parametrize(("holder", "free"), [("dead", True), ("alive", False), ("elsewhere", False), ("unsaid", True)])
def test_without_locks_of_the_system_what_the_file_says_decides(lock, monkeypatch, holder, free):
    def flock(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOTSUP, "no locks here")

    monkeypatch.setattr(locks.fcntl, "flock", flock)
    pid = dead_pid() if holder in ("dead", "elsewhere") else os.getpid()
    host = "another" if holder == "elsewhere" else socket.gethostname()
    lock.write_text("" if holder == "unsaid" else json.dumps({"host": host, "pid": pid, "since": "today"}))
    if free:
        with hold(lock, "busy"):
            assert json.loads(lock.read_text())["pid"] == os.getpid()
    else:
        with pytest.raises(GuiderError, match=rf"busy \(process {pid} on {host} since today\)"), hold(lock, "busy"):
            pass


def test_a_link_in_a_locks_place_is_not_followed(lock, tmp_path):
    (tmp_path / "target").write_text("mine")
    lock.symlink_to(tmp_path / "target")
    with pytest.raises(OSError), hold(lock, "busy"):
        pass
    assert (tmp_path / "target").read_text() == "mine"
