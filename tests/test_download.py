"""Fetching from a server on this machine that behaves as badly as servers do."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from loopback import Reply, Site, cut, error, no_http, ranges, send, serve, whole
from recordings import antmaze, walk, write_hdf5

from guider.cli import main
from guider.data import load
from guider.data.catalogue import CATALOGUE, Dataset, RemoteFile, find_dataset
from guider.data.download import Patience, fetch
from guider.data.store import Recording
from guider.data.write import write_minari
from guider.errors import GuiderError

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


def test_whole_file_its_record_and_progress(site, folder, content):
    url = f"{site.url}/logs.hdf5"
    site.replies = [whole(content)]
    progress = []
    digest = hashlib.sha256(content).hexdigest()
    wanted = dataset(url, sha256=digest)
    assert fetch(wanted, folder, report=lambda done, total: progress.append((done, total))) == [folder / "logs.hdf5"]
    check_fetched(folder, content, url)
    assert progress[0] == (0, len(content)) and progress[-1] == (len(content), len(content))
    assert load(folder / "logs.hdf5", (0, 1)).lengths.tolist() == [300, 300, 300]
    fetch(wanted, folder)
    assert len(site.requests) == 1


def test_a_server_that_does_not_tell_the_size(site, folder, content):
    site.replies = [lambda handler: send(handler, content)]
    progress = []
    fetch(dataset(site.url), folder, report=lambda done, total: progress.append((done, total)))
    check_fetched(folder, content, site.url)
    assert progress[-1] == (len(content), None)


@pytest.mark.parametrize("name", ["ETag", "Last-Modified"])
def test_resumes_where_it_broke_off(site, folder, content, name):
    mark = {"ETag": '"1"', "Last-Modified": "Fri, 05 Nov 2021 20:00:00 GMT"}[name]

    def rest(handler: BaseHTTPRequestHandler) -> None:
        size = f"bytes 50000-{len(content) - 1}/{len(content)}"
        send(handler, content[50_000:], 206, **{"Content_Range": size, name: mark})

    site.replies = [cut(content, 50_000, **{name: mark}), rest]
    fetch(dataset(site.url), folder, patience=PATIENCE)
    check_fetched(folder, content, site.url)
    assert [request.get("Range") for request in site.requests] == [None, "bytes=50000-"]
    assert site.requests[1]["If-Range"] == mark


def test_resumes_what_an_earlier_call_left(site, folder, content):
    site.replies = [cut(content, 50_000, ETag='"1"'), error(503), error(503), error(503), ranges(content, '"1"')]
    with pytest.raises(GuiderError, match="HTTP 503"):
        fetch(dataset(site.url), folder, patience=PATIENCE)
    assert names(folder) == {"logs.hdf5.part", "logs.hdf5.part.json"}
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert site.requests[-1]["Range"] == "bytes=50000-"
    check_fetched(folder, content, site.url)


def test_a_server_that_ignores_ranges_sends_it_all_again(site, folder, content):
    site.replies = [cut(content, 50_000, ETag='"1"'), whole(content, ETag='"1"')]
    progress = []
    fetch(dataset(site.url), folder, report=lambda done, total: progress.append(done), patience=PATIENCE)
    assert site.requests[1]["Range"] == "bytes=50000-"
    assert progress.count(0) == 2 and max(progress) == progress[-1] == len(content)
    check_fetched(folder, content, site.url)


def test_a_server_that_sends_another_range_is_not_believed(site, folder, content):
    size = f"bytes 0-{len(content) - 1}/{len(content)}"

    def from_the_start(handler: BaseHTTPRequestHandler) -> None:
        send(handler, content, 206, Content_Range=size, ETag='"1"')

    site.replies = [cut(content, 50_000, ETag='"1"'), from_the_start, whole(content, ETag='"1"')]
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert [request.get("Range") for request in site.requests] == [None, "bytes=50000-", None]
    check_fetched(folder, content, site.url)


@pytest.mark.parametrize("etag", [None, 'W/"1"'])
def test_without_a_strong_mark_of_its_version_a_file_is_fetched_anew(site, folder, content, etag):
    marks = {} if etag is None else {"ETag": etag}
    site.replies = [cut(content, 50_000, **marks), whole(content, **marks)]
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert "Range" not in site.requests[1]
    check_fetched(folder, content, site.url)


@pytest.mark.parametrize("rude", [False, True])
def test_a_file_that_changes_between_attempts_is_not_glued(site, folder, content, rude):
    other = recording_bytes(folder.parent, seed=1)
    assert len(other) == len(content)
    site.replies = [cut(content, 50_000, ETag='"1"'), ranges(other, '"2"', rude)]
    fetch(dataset(site.url), folder, patience=PATIENCE)
    assert site.requests[1]["Range"] == "bytes=50000-"
    check_fetched(folder, other, site.url)


def test_a_part_of_another_place_is_not_continued(site, folder, content):
    other = recording_bytes(folder.parent, seed=1)
    site.replies = [cut(content, 50_000, ETag='"1"'), error(404), whole(other)]
    fetch(dataset(f"{site.url}/a", f"{site.url}/b"), folder, patience=PATIENCE)
    assert "Range" not in site.requests[2]
    check_fetched(folder, other, f"{site.url}/b")


def test_tries_again_when_busy_or_silent(site, folder, content):
    def silent(handler: BaseHTTPRequestHandler) -> None:
        site.closing.wait()

    site.replies = [error(503), silent, whole(content)]
    fetch(dataset(site.url), folder, patience=Patience(timeout_s=0.2, attempts=3, backoff_s=0.001))
    check_fetched(folder, content, site.url)
    assert len(site.requests) == 3


def silent_in_the_middle(site: Site, content: bytes) -> Reply:
    def reply(handler: BaseHTTPRequestHandler) -> None:
        cut(content, 50_000, ETag='"1"')(handler)
        site.closing.wait()

    return reply


def test_goes_on_when_the_server_falls_silent(site, folder, content):
    site.replies = [silent_in_the_middle(site, content), ranges(content, '"1"')]
    fetch(dataset(site.url), folder, patience=Patience(timeout_s=0.2, attempts=3, backoff_s=0.001))
    assert site.requests[1]["Range"] == "bytes=50000-"
    check_fetched(folder, content, site.url)


# Limits: what has arrived is kept, and the next fetch goes on from there


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


PAGE = b"<html><body>Down for maintenance</body></html>"


def overwritten(content: bytes) -> bytes:
    return content[:-1000] + bytes(1000)


def longer(content: bytes) -> Reply:
    """Promises nine bytes that do not exist, and says so when asked for them."""
    promising = whole(content, len(content) + 9, ETag='"1"')
    return lambda handler: (error(416) if "Range" in handler.headers else promising)(handler)


BAD_REPLIES: dict[str, tuple[Callable[[bytes], Reply], str]] = {
    "longer": (longer, "shorter than what was fetched"),
    "always cut": (lambda content: cut(content, 50_000, ETag='"1"'), "connection ended after"),
    "shorter": (lambda content: whole(content, len(content) - 999), "sha256"),
    "wrong bytes": (lambda content: whole(overwritten(content)), "sha256"),
    "a page": (lambda content: whole(PAGE), "sha256"),
    "not found": (lambda content: error(404), "HTTP 404"),
    "busy": (lambda content: error(503), "HTTP 503"),
    "no HTTP": (lambda content: no_http, "no answer"),
}


@pytest.mark.parametrize("kind", BAD_REPLIES)
def test_nothing_but_the_whole_and_right_file_gets_the_name(site, folder, content, kind):
    make, reason = BAD_REPLIES[kind]
    site.replies = [lambda handler: (make(content) if handler.path == "/bad" else whole(content))(handler)]
    bad, good = f"{site.url}/bad", f"{site.url}/good"
    digest = hashlib.sha256(content).hexdigest()
    with pytest.raises(GuiderError, match=reason) as raised:
        fetch(dataset(bad, sha256=digest), folder, patience=PATIENCE)
    assert "\n" not in str(raised.value)
    assert names(folder) <= {"logs.hdf5.part", "logs.hdf5.part.json"}
    fetch(dataset(bad, good, sha256=digest), folder, patience=PATIENCE)
    check_fetched(folder, content, good)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (PAGE, "neither an HDF5 file nor an npz archive"),
        (b"", "empty"),
        (None, "damaged or cut off"),
    ],
)
def test_without_a_published_checksum_the_content_is_looked_at(site, folder, content, body, reason):
    site.replies = [whole(content[:-999] if body is None else body)]
    with pytest.raises(GuiderError, match=reason):
        fetch(dataset(site.url), folder, patience=PATIENCE)
    assert names(folder) == set()


def test_other_data_of_the_same_kind_is_refused(site, folder, tmp_path):
    site.replies = [whole(write_hdf5(tmp_path / "plain", walk([5])).read_bytes())]
    with pytest.raises(GuiderError, match="missing terminals, timeouts"):
        fetch(dataset(site.url), folder, patience=PATIENCE)
    assert names(folder) == set()


def test_what_is_kept_is_checked_against_its_record(site, folder, content):
    site.replies = [whole(content)]
    fetch(dataset(site.url), folder)
    file = folder / "logs.hdf5"
    file.write_bytes(overwritten(content))
    with pytest.raises(GuiderError, match="not the file that was published"):
        fetch(dataset(site.url), folder)
    file.unlink()
    site.replies = [whole(recording_bytes(folder.parent, seed=1))]
    with pytest.raises(GuiderError, match="sha256"):
        fetch(dataset(site.url), folder)
    assert not file.exists()


def test_two_fetches_of_one_file_do_not_meet(site, folder, content):
    site.replies = [whole(content)]
    refusals = []

    def fetch_again(done: int, total: int | None) -> None:
        with pytest.raises(GuiderError, match="another process") as raised:
            fetch(dataset(site.url), folder)
        refusals.append(raised)

    fetch(dataset(site.url), folder, report=fetch_again)
    assert refusals and len(site.requests) == 1
    check_fetched(folder, content, site.url)


def test_a_host_that_is_down_gets_one_line_with_ways_out(site, folder):
    gone = "http://127.0.0.1:1/logs.hdf5"
    with pytest.raises(GuiderError, match="cannot be reached") as raised:
        fetch(dataset(gone), folder, patience=PATIENCE)
    for words in (gone, "--mirror", "guider collect", "--data"):
        assert words in str(raised.value)
    assert "\n" not in str(raised.value) and names(folder) == set()


def test_a_mirror_is_asked_first(site, folder, content):
    site.replies = [whole(content)]
    fetch(dataset(f"{site.url}/far/logs.hdf5"), folder, f"{site.url}/near/")
    check_fetched(folder, content, f"{site.url}/near/logs.hdf5")
    assert [request["path"] for request in site.requests] == ["/near/logs.hdf5"]
    for mirror in ("file:///etc", "near"):
        with pytest.raises(GuiderError, match="--mirror must be"):
            fetch(dataset(site.url), folder, mirror)


# The catalogue and the command


def test_catalogue():
    diverse = CATALOGUE["antmaze-large-diverse"].files[0]
    assert diverse.urls[0] == (
        "https://rail.eecs.berkeley.edu/datasets/offline_rl/ant_maze_v2/"
        "Ant_maze_hardest-maze_noisy_multistart_True_multigoal_True_sparse_fixed.hdf5"
    )
    assert [file.name for file in CATALOGUE["antmaze-giant-stitch-v0"].files] == [
        "antmaze-giant-stitch-v0.npz",
        "antmaze-giant-stitch-v0-val.npz",
    ]
    files = [file for found in CATALOGUE.values() for file in found.files]
    assert len({file.name for file in files}) == len(files)
    assert all(url.startswith("https://") and url.endswith(file.name) for file in files for url in file.urls)
    assert all(file.sha256 is None or re.fullmatch("[0-9a-f]{64}", file.sha256) for file in files)
    with pytest.raises(GuiderError, match="did you mean kitchen-complete"):
        find_dataset("kitchen-completed")
    assert find_dataset("minari:any/thing-v3").source == "Minari"


def test_fetch_command(site, folder, content, capsys, monkeypatch):
    monkeypatch.setenv("GUIDER_DATA", str(folder))
    site.replies = [whole(content)]
    assert main(["data", "fetch", "antmaze-large-diverse", "--mirror", site.url, "--json"]) == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert Path(file).parent == folder and Path(file).read_bytes() == content
    assert main(["data", "fetch", "--json"]) == 0
    listed = {row["name"] for row in json.loads(capsys.readouterr().out)}
    assert {"antmaze-large-diverse", "kitchen-mixed", "cube-single-play-v0"} <= listed
    assert main(["data", "fetch", "antmaze-larg-diverse"]) == 1
    assert "did you mean antmaze-large-diverse" in capsys.readouterr().err
    assert main(["data", "inspect"]) == 1
    assert "guider data inspect SOURCE" in capsys.readouterr().err


# Minari, whose package does the work and whose word is not taken for it


@pytest.fixture
def minari_root(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def write_small_minari(directory: Path) -> None:
    arrays = walk([4, 6])
    directory.parent.mkdir(parents=True, exist_ok=True)
    recording = Recording(arrays["observations"], arrays["actions"], np.array([4, 6]))
    write_minari(directory, recording, (0, 1), 0.5, dataset_id="test/walk-v0", recipe="", description="", seed=0)


def test_minari_is_fetched_by_its_package_and_then_read(minari_root, monkeypatch, capsys):
    def download(dataset_id: str) -> None:
        print(f"Dataset {dataset_id} downloaded")
        write_small_minari(minari_root / dataset_id)

    monkeypatch.setattr("minari.download_dataset", download)
    assert main(["data", "fetch", "minari:test/walk-v0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(minari_root / "test" / "walk-v0")]
    monkeypatch.setattr("minari.download_dataset", None)
    assert fetch(find_dataset("minari:test/walk-v0")) == [minari_root / "test" / "walk-v0"]


def test_minari_that_leads_elsewhere_is_not_opened(minari_root, monkeypatch):
    write_small_minari(minari_root / "test" / "walk-v0")
    file = minari_root / "test" / "walk-v0" / "data" / "main_data.hdf5"
    file.rename(minari_root / "elsewhere")
    file.symlink_to(minari_root / "elsewhere")
    monkeypatch.setattr("minari.load_dataset", None)
    with pytest.raises(GuiderError, match=r"main_data\.hdf5 in the dataset is a symbolic link"):
        fetch(find_dataset("minari:test/walk-v0"))


@pytest.mark.parametrize("left", ["nothing", "an empty folder", "half of the data"])
def test_minari_that_says_downloaded_and_is_not(minari_root, monkeypatch, left):
    def download(dataset_id: str) -> None:
        if left == "an empty folder":
            (minari_root / dataset_id / "data").mkdir(parents=True)
        if left == "half of the data":
            write_small_minari(minari_root / dataset_id)
            file = minari_root / dataset_id / "data" / "main_data.hdf5"
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])

    monkeypatch.setattr("minari.download_dataset", download)
    for _ in range(2):
        with pytest.raises(GuiderError, match="minari:test/walk-v0 was not fetched whole") as raised:
            fetch(find_dataset("minari:test/walk-v0"))
        assert "\n" not in str(raised.value)


def test_minari_decides_where_its_data_is(folder):
    for arguments in ((folder, None), (None, "http://127.0.0.1")):
        with pytest.raises(GuiderError, match="MINARI_DATASETS_PATH"):
            fetch(find_dataset("minari:test/walk-v0"), *arguments)


@pytest.mark.parametrize("size", ["9" * 5000, "many"])
def test_a_length_that_is_none_is_as_good_as_no_length(site, folder, content, size):
    site.replies = [lambda handler: send(handler, content, Content_Length=size)]
    (path,) = fetch(dataset(site.url), folder, patience=PATIENCE)
    assert path.read_bytes() == content


def test_a_redirect_in_circles_is_one_line(site, folder, content):
    site.replies = [lambda handler: send(handler, b"", 302, Location=handler.path, Content_Length=0)]
    with pytest.raises(GuiderError, match="HTTP 302") as refused:
        fetch(dataset(site.url), folder, patience=PATIENCE)
    assert "\n" not in str(refused.value)
