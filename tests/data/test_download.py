"""Fetching from a server on this machine that behaves as badly as servers do."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler

import pytest
from loopback import Reply, Site, cut, error, no_http, ranges, send, whole
from recordings import walk, write_hdf5
from served import PATIENCE, check_fetched, dataset, names, recording_bytes

from guider.data import load
from guider.data.download import Patience, fetch
from guider.errors import GuiderError


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
