"""A server on this machine, and what is fetched from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from loopback import Site, serve
from recordings import antmaze, write_hdf5

from guider.data.catalogue import Dataset, RemoteFile
from guider.data.download import Patience

KEYS = ("observations", "actions", "terminals", "timeouts")
PATIENCE = Patience(timeout_s=5.0, attempts=3, backoff_s=0.001)


@pytest.fixture
def site(monkeypatch) -> Iterator[Site]:
    monkeypatch.setenv("no_proxy", "*")
    with serve() as site:
        yield site


def recording_bytes(folder: Path, seed: int = 0) -> bytes:
    path = write_hdf5(folder / f"content{seed}", antmaze([300, 300, 300], state_dim=29, action_dim=8, seed=seed))
    content = path.read_bytes()
    path.unlink()
    return content


@pytest.fixture
def content(tmp_path) -> bytes:
    return recording_bytes(tmp_path)


@pytest.fixture
def folder(tmp_path) -> Path:
    return tmp_path / "data"


def dataset(*urls: str, sha256: str | None = None) -> Dataset:
    return Dataset("logs", "a test", (RemoteFile("logs.hdf5", urls, KEYS, sha256),))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def check_fetched(folder: Path, content: bytes, url: str) -> None:
    """The file is there to the byte, with its record, and nothing else."""
    assert (folder / "logs.hdf5").read_bytes() == content
    record = json.loads((folder / "logs.hdf5.json").read_text())
    assert record["sha256"] == hashlib.sha256(content).hexdigest()
    assert (record["url"], record["size_bytes"]) == (url, len(content))
    assert names(folder) == {"logs.hdf5", "logs.hdf5.json"}
