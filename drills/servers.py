"""Servers that behave badly: slow, endless, lying about lengths, cut off, pointing elsewhere.

Fetching ends within its limits with one line, leaves no file under the asked name, and the same call succeeds once the
server is well. The limits are made small for the drill.
"""

from __future__ import annotations

import hashlib
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import h5py

from drills.common import Drill, Outcome, ask, d4rl, walk
from tests.loopback import Reply, Site, cut, error, no_http, ranges, send, serve, whole

LIMITS = {"timeout_s": 0.5, "attempts": 3, "backoff_s": 0.01, "most_bytes": 4_000_000, "most_s": 4.0, "rate_s": 1.0}
MOST_SECONDS = 20.0
OTHER = "bytes of another file"
KEYS = ("observations", "actions", "terminals", "timeouts")


@dataclass(frozen=True)
class Scene:
    """content: the file as it should be; secret: a file of this machine that no server may have read for it."""

    content: bytes
    secret: Path


def prepare(folder: Path) -> Scene:
    for name, seed in (("content", 0), ("secret", 1)):
        with h5py.File(folder / name, "w") as file:
            for key, array in d4rl(walk(100, seed=seed)).items():
                file[key] = array
    return Scene((folder / "content").read_bytes(), folder / "secret")


def drip(site: Site, content: bytes, size: int, pause_s: float, **headers: str | int) -> Reply:
    """Send `size` bytes of the content at a time, over and over, until nobody listens."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        send(handler, b"", 200, **headers)
        place = 0
        while not site.closing.wait(pause_s):
            try:
                handler.wfile.write(content[place : place + size])
            except OSError:
                return
            place = (place + size) % len(content)

    return reply


def lines(count: int) -> Reply:
    """An endless head."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        handler.wfile.write(b"HTTP/1.0 200 OK\r\n")
        handler.wfile.writelines(b"X-%d: y\r\n" % number for number in range(count))

    return reply


def silent(site: Site) -> Reply:
    def reply(handler: BaseHTTPRequestHandler) -> None:
        site.closing.wait()

    return reply


def to(where: str) -> Reply:
    return lambda handler: send(handler, b"", 302, Location=where, Content_Length=0)


def chunked(handler: BaseHTTPRequestHandler) -> None:
    """Chunks whose sizes make no sense."""
    handler.protocol_version = "HTTP/1.1"
    send(handler, b"fffffffffffff\r\nfew\r\nzz\r\n", 200, Transfer_Encoding="chunked")


def range_of(content: bytes, text: str) -> Reply:
    """Break off half way, and answer the rest by something else."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        if "Range" in handler.headers:
            send(handler, content[100:], 206, Content_Range=text, ETag='"1"', Content_Length=len(content) - 100)
        else:
            cut(content, len(content) // 2, ETag='"1"')(handler)

    return reply


CASES: dict[str, Callable[[Site, Scene], Reply]] = {
    "a byte every 0.3 s": lambda site, s: drip(site, s.content, 1, 0.3, Content_Length=len(s.content), ETag='"1"'),
    "a byte every 0.01 s": lambda site, s: drip(site, s.content, 1, 0.01, Content_Length=len(s.content), ETag='"1"'),
    "an endless body": lambda site, s: drip(site, s.content, 2**16, 0.01),
    "an endless body that seems sound": lambda site, s: drip(site, s.content, 2**16, 0.01, ETag='"1"'),
    "a length of 1e15": lambda site, s: drip(site, s.content, 2**16, 0.01, Content_Length=10**15, ETag='"1"'),
    "a length too long": lambda site, s: whole(s.content, len(s.content) + 9, ETag='"1"'),
    "a length too short": lambda site, s: whole(s.content, len(s.content) - 999),
    "a negative length": lambda site, s: whole(s.content, -1),
    "a length that is no number": lambda site, s: lambda h: send(h, s.content, Content_Length="many"),
    "a length of 5,000 digits": lambda site, s: lambda h: send(h, s.content, Content_Length="9" * 5000),
    "always cut off": lambda site, s: cut(s.content, 20_000),
    "always cut off, with a mark": lambda site, s: cut(s.content, 20_000, ETag='"1"'),
    "cut off at once": lambda site, s: cut(s.content, 0),
    "nothing at all": lambda site, s: whole(b""),
    "silence": lambda site, s: silent(site),
    "no HTTP": lambda site, s: no_http,
    "an endless head": lambda site, s: lines(100_000),
    "senseless chunks": lambda site, s: chunked,
    "a page": lambda site, s: whole(b"<html>Sign in</html>" * 100),
    OTHER: lambda site, s: whole(s.content[:-5000] + bytes(5000), ETag='"1"'),
    "HTTP 500": lambda site, s: error(500),
    "HTTP 404": lambda site, s: error(404),
    "HTTP 416": lambda site, s: error(416),
    "HTTP 999": lambda site, s: error(999),
    "a range that is none": lambda site, s: range_of(s.content, "bytes many"),
    "a range of another place": lambda site, s: range_of(s.content, f"bytes 100-{len(s.content) - 1}/{len(s.content)}"),
    "a range of 5,000 digits": lambda site, s: range_of(s.content, "bytes " + "9" * 5000 + "-/*"),
    "redirected to a file": lambda site, s: to(s.secret.as_uri()),
    "redirected to ftp": lambda site, s: to("ftp://127.0.0.1:9/x"),
    "redirected to nonsense": lambda site, s: to("http://[::1/\u00fc"),
    "redirected in circles": lambda site, s: to("/again"),
    "redirected to data": lambda site, s: to("data:,some"),
}


def trial(scene: Scene, number: int, rng: random.Random, folder: Path) -> Outcome:
    from guider.data.catalogue import Dataset, RemoteFile
    from guider.data.download import Patience, fetch

    name, make = list(CASES.items())[number // 2 % len(CASES)]
    sha256 = hashlib.sha256(scene.content).hexdigest() if number % 2 else None  # as some publish it and others do not
    known = {each.name for each in fields(Patience)}
    patience = Patience(**{limit: value for limit, value in LIMITS.items() if limit in known})  # pyright: ignore
    with serve() as site:
        wanted = Dataset("logs", "a drill", (RemoteFile("logs.hdf5", (f"{site.url}/logs.hdf5",), KEYS, sha256),))
        site.replies = [make(site, scene)]
        began = time.monotonic()
        answer = ask(lambda: fetch(wanted, folder, patience=patience))
        seconds, size = time.monotonic() - began, sum(path.stat().st_size for path in folder.iterdir())
        outcome = _judge(scene, folder, answer.fault(), answer.kind, seconds, size)
        if outcome.fault == "silent" and name == OTHER and sha256 is None:
            return Outcome("another file, which no checksum tells apart")
        if outcome.fault is None and answer.kind == "refused":
            site.replies = [ranges(scene.content, '"1"')]
            again = ask(lambda: fetch(wanted, folder, patience=patience))
            if again.kind != "value" or (folder / "logs.hdf5").read_bytes() != scene.content:
                outcome = Outcome("does not recover", "lost", again.text)
    return Outcome(outcome.what, outcome.fault, f"{name}: {outcome.detail or answer.text}")


def _judge(scene: Scene, folder: Path, fault: Outcome | None, kind: str, seconds: float, size: int) -> Outcome:
    target = folder / "logs.hdf5"
    if fault:
        return fault
    if seconds > MOST_SECONDS or size > 2 * LIMITS["most_bytes"]:
        return Outcome("over its limits", "hangs", f"{seconds:.0f} s, {size} bytes")
    if target.exists() and target.read_bytes() != scene.content:
        return Outcome("another file got the name", "silent")
    if kind == "refused" and target.exists():
        return Outcome("refused, and yet there", "silent")
    return Outcome("one line, then fetched whole" if kind == "refused" else "fetched whole")


DRILL = Drill(trials=2 * len(CASES), prepare=prepare, trial=trial, limit_s=30)
