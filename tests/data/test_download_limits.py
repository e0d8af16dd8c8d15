"""Fetching has limits: what has arrived is kept, and the next fetch goes on from there."""

from __future__ import annotations

import contextlib
import resource
import signal
import subprocess
import sys
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from types import SimpleNamespace

import pytest
from loopback import cut, error, ranges, send, whole
from served import KEYS, PATIENCE, check_fetched, dataset, names

from guider.data.download import fetch
from guider.errors import GuiderError


def refused(folder: Path, url: str, **limits) -> str:
    with pytest.raises(GuiderError) as raised:
        fetch(dataset(url), folder, patience=replace(PATIENCE, **limits))
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"rate_s": 0.5, "least_rate": 1e12}, "it brings less than 1 TB a second"),
        ({"most_s": 0.0}, "it takes longer than 0 s"),
    ],
)
def test_a_server_that_is_too_slow(site, folder, content, limits, reason):
    def trickle(handler: BaseHTTPRequestHandler) -> None:
        cut(content, 50_000, ETag='"1"')(handler)
        with contextlib.suppress(OSError):  # the other side is gone
            for byte in content[50_000:]:
                handler.wfile.write(bytes([byte]))
                site.closing.wait(0.02)

    site.replies = [trickle, ranges(content, '"1"')]
    message = refused(folder, site.url, **limits)
    assert reason in message and "what has arrived is kept" in message
    arrived = (folder / "logs.hdf5.part").stat().st_size
    assert 0 < arrived < len(content) and len(site.requests) == 1
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert site.requests[1]["Range"] == f"bytes={arrived}-"
    check_fetched(folder, content, site.url)


def test_a_server_whose_headers_do_not_end(site, folder, content):
    def trickle(handler: BaseHTTPRequestHandler) -> None:
        with contextlib.suppress(OSError):  # the other side is gone
            while not site.closing.wait(0.01):
                handler.wfile.write(b"H")

    site.replies = [trickle, whole(content)]
    fetch(dataset(site.url), folder, patience=replace(PATIENCE, rate_s=0.2))
    assert len(site.requests) == 2
    check_fetched(folder, content, site.url)


def test_time_is_limited_over_all_attempts_together(site, folder, content):
    site.replies = [cut(content, 50_000, ETag='"1"')]
    assert "it takes longer than 0 s" in refused(folder, site.url, most_s=0.0)
    site.replies = [error(503)]
    assert "it takes longer than 0 s (HTTP 503" in refused(folder, site.url, most_s=0.0)


def test_a_file_that_is_too_large_is_not_begun(site, folder, content, monkeypatch):
    site.replies = [whole(content)]
    assert "it is larger than 1 kB, the limit" in refused(folder, site.url, most_bytes=1000)
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=2000))
    assert "it is larger than 2 kB, all that the disk has room for" in refused(folder, site.url)
    assert names(folder) == set()


@pytest.mark.parametrize("what", ["limit", "disk"])
def test_a_body_without_end(site, folder, monkeypatch, what):
    def endless(handler: BaseHTTPRequestHandler) -> None:
        send(handler, b"")
        with contextlib.suppress(OSError):  # the other side is gone
            while True:
                handler.wfile.write(bytes(10_000))

    site.replies = [endless]
    if what == "disk":
        monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=1_000_000))
    message = refused(folder, site.url, **({"most_bytes": 1_000_000} if what == "limit" else {}))
    assert "it is larger than 1 MB" in message
    assert names(folder) == set()  # nothing says what a part of it would lack


def test_a_disk_that_is_full(site, folder, content):
    site.replies = [ranges(content, '"1"')]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        message = refused(folder, site.url)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "cannot be written or read (File too large)" in message and "what has arrived is kept" in message
    assert names(folder) == {"logs.hdf5.part", "logs.hdf5.part.json"}
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert site.requests[1]["Range"] == "bytes=10000-"
    check_fetched(folder, content, site.url)


def test_a_folder_that_is_none(site, folder, content):
    folder.write_bytes(b"")
    assert f"{folder}: cannot be written or read (File exists)" in refused(folder, site.url)


def test_interrupted(site, folder, content):
    def interrupt(done: int, total: int | None) -> None:
        if done:
            raise KeyboardInterrupt

    site.replies = [ranges(content, '"1"')]
    with pytest.raises(KeyboardInterrupt):
        fetch(dataset(site.url), folder, report=interrupt)
    arrived = (folder / "logs.hdf5.part").stat().st_size
    assert arrived and names(folder) == {"logs.hdf5.part", "logs.hdf5.part.json"}
    fetch(dataset(site.url), folder)
    assert arrived == len(content) or site.requests[1]["Range"] == f"bytes={arrived}-"
    check_fetched(folder, content, site.url)


def test_terminated(site, folder, content):
    program = f"""
import os, signal
from pathlib import Path
from guider.data.catalogue import Dataset, RemoteFile
from guider.data.download import fetch
logs = Dataset("logs", "a test", (RemoteFile("logs.hdf5", ({site.url!r},), {KEYS!r}, None),))
fetch(logs, Path({str(folder)!r}), report=lambda done, total: done > 20_000 and os.kill(os.getpid(), signal.SIGTERM))
"""
    site.replies = [cut(content, 50_000, ETag='"1"'), ranges(content, '"1"')]
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.returncode == -signal.SIGTERM, ended.stderr
    arrived = (folder / "logs.hdf5.part").stat().st_size
    assert 0 < arrived <= 50_000
    fetch(dataset(site.url), folder)
    assert site.requests[1]["Range"] == f"bytes={arrived}-"
    check_fetched(folder, content, site.url)
