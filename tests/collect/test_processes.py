"""Processes that record end with the one that started them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from guider.collect.processes import map_in_processes
from guider.errors import GuiderError

WAIT = """
import os, signal, sys, time
from guider.collect.processes import map_in_processes

def work(folder):
    open(f"{folder}/{os.getpid()}", "w").close()
    time.sleep(600)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what starts the tests may have it ignored
    with map_in_processes(2) as map:
        list(map(work, [sys.argv[1]] * 4))
"""
SIGNALS = (signal.SIGINT, signal.SIGKILL)
PATIENCE_S = 60


def wait_until(true) -> bool:
    end = time.monotonic() + PATIENCE_S
    while not true() and time.monotonic() < end:
        time.sleep(0.05)
    return true()


def is_alive(process: int) -> bool:
    """Whether it runs: one that has ended may wait to be buried."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc")
def test_workers_end_however_their_parent_does(tmp_path):
    (tmp_path / "wait.py").write_text(WAIT)
    parents, folders = [], [tmp_path / sent.name for sent in SIGNALS]
    try:
        for folder in folders:
            folder.mkdir()
            with (tmp_path / f"{folder.name}.err").open("w") as errors:
                command = [sys.executable, tmp_path / "wait.py", folder]
                parents.append(subprocess.Popen(command, stderr=errors, start_new_session=True))
        assert wait_until(lambda: all(len(list(folder.iterdir())) == 2 for folder in folders))
        workers = [int(path.name) for folder in folders for path in folder.iterdir()]
        assert all(map(is_alive, workers))
        for sent, parent in zip(SIGNALS, parents, strict=True):
            os.kill(-parent.pid if sent == signal.SIGINT else parent.pid, sent)  # Ctrl-C is sent to all
        assert [parent.wait(PATIENCE_S) for parent in parents] == [-sent for sent in SIGNALS]
        assert wait_until(lambda: not any(map(is_alive, workers)))
    finally:
        for parent in parents:
            parent.kill()
    shown = (tmp_path / "SIGINT.err").read_text()
    assert "Process " not in shown and shown.endswith("KeyboardInterrupt\n")  # no worker has a word to say


def test_a_worker_that_is_killed_is_one_line():
    with pytest.raises(GuiderError, match="was killed"), map_in_processes(2) as map_in_pool:
        list(map_in_pool(os._exit, [1, 1]))
