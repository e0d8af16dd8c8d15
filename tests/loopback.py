"""A server on this machine that answers as it is told: whole, cut off, in ranges, wrong."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

Reply = Callable[[BaseHTTPRequestHandler], None]


@dataclass
class Site:
    """A server that answers request i by replies[i], and by the last of them from then on."""

    url: str = ""
    replies: list[Reply] = field(default_factory=list)
    requests: list[dict[str, str]] = field(default_factory=list)
    closing: threading.Event = field(default_factory=threading.Event)


@contextmanager
def serve() -> Iterator[Site]:
    """The server, until the block ends."""
    site = Site()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            site.requests.append({"path": self.path, **self.headers})
            site.replies[min(len(site.requests), len(site.replies)) - 1](self)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    site.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield site
    site.closing.set()
    server.shutdown()
    thread.join()
    server.server_close()


def send(handler: BaseHTTPRequestHandler, body: bytes, status: int = 200, /, **headers: str | int) -> None:
    handler.send_response(status)
    for name, value in headers.items():
        handler.send_header(name.replace("_", "-"), str(value))
    handler.end_headers()
    handler.wfile.write(body)


def no_http(handler: BaseHTTPRequestHandler) -> None:
    handler.wfile.write(b"hello\r\n\r\n")


def error(status: int) -> Reply:
    return lambda handler: send(handler, b"sorry", status, Content_Length=5)


def whole(content: bytes, size: int | None = None, **headers: str) -> Reply:
    """All of it, whatever is asked for; `size` is what it says the size is."""
    return lambda handler: send(handler, content, Content_Length=len(content) if size is None else size, **headers)


def cut(content: bytes, after: int, **headers: str) -> Reply:
    """Promises all of it and goes away after some bytes."""
    return whole(content[:after], len(content), **headers)


def ranges(content: bytes, etag: str, rude: bool = False) -> Reply:
    """What is asked for, if the file is still the one meant; a rude server does not look at that."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        asked = re.fullmatch(r"bytes=(\d+)-", handler.headers.get("Range", ""))
        if asked is None or not (rude or handler.headers.get("If-Range") == etag):
            return send(handler, content, Content_Length=len(content), ETag=etag)
        first = int(asked[1])
        if first >= len(content):
            return send(handler, b"", 416, Content_Length=0)
        size = f"bytes {first}-{len(content) - 1}/{len(content)}"
        send(handler, content[first:], 206, Content_Length=len(content) - first, Content_Range=size, ETag=etag)

    return reply
