"""Fetching published data: a broken download resumes, and a file gets its name only when it is whole and checked."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from email.message import Message
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from guider.data.catalogue import MINARI_PREFIX, Dataset, RemoteFile
from guider.data.safety import check_minari, size_text
from guider.data.store import open_store
from guider.errors import GuiderError
from guider.support.files import user_path
from guider.support.locks import hold

Report = Callable[[int, int | None], None]
"""report(done, total): progress in bytes; total is None where the server does not say."""

_CHUNK_BYTES = 1 << 18
_BUSY = (408, 429, 500, 502, 503, 504)


@dataclass(frozen=True)
class Patience:
    """How much is borne of a server. Past a limit what has arrived is kept, and the next fetch goes on from there.

    timeout_s:  for a connection, and for its next bytes
    attempts:   how many in a row may bring nothing new
    backoff_s:  pause after the first of these; each further pause is twice as long
    most_bytes: size of a file
    most_s:     time for a file from one place
    least_rate: bytes a second, on average over any `rate_s` seconds; an answer begins within that time
    """

    timeout_s: float = 20.0
    attempts: int = 4
    backoff_s: float = 1.0
    most_bytes: int = 200_000_000_000
    most_s: float = 24 * 3600.0
    least_rate: float = 1000.0
    rate_s: float = 60.0


@dataclass(frozen=True)
class _Origin:
    """Which version of a file the bytes in a part come from.

    validator:  the server's mark of this version (ETag or Last-Modified), None if it gave none
    size_bytes: size of the whole file, None if the server did not say
    """

    url: str
    validator: str | None
    size_bytes: int | None


class _AttemptError(Exception):
    """Why an attempt ended early; another may go on from there."""


class _PlaceError(Exception):
    """Why a place is given up."""


def cache_directory() -> Path:
    """Where fetched files are kept: GUIDER_DATA, else `guider` in the user's cache folder."""
    if chosen := os.environ.get("GUIDER_DATA"):
        return user_path(chosen)
    return user_path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "guider"


def fetch(
    dataset: Dataset,
    directory: Path | None = None,
    mirror: str | None = None,
    *,
    report: Report = lambda done, total: None,
    patience: Patience = Patience(),
) -> list[Path]:
    """Fetch all files of `dataset`; those that are there already are checked and kept. Returns where they are.

    directory: where to keep them; None is cache_directory(). Minari's go where Minari keeps its own.
    mirror: URL of a folder that holds the files under their names; tried before the catalogue's

    Beside each file, NAME.json records where it came from, its size and its sha256. When the file is asked for again
    it is checked against the published sha256, or else that one. Raises GuiderError, with what else can be done, where
    no place has the file.
    """
    if not dataset.files:
        if directory is not None or mirror is not None:
            raise GuiderError(
                f"{dataset.name}: Minari decides where its data comes from and goes to (MINARI_REMOTE and "
                "MINARI_DATASETS_PATH); leave out --out and --mirror"
            )
        return [_fetch_minari(dataset.name.removeprefix(MINARI_PREFIX))]
    if mirror is not None and not mirror.startswith(("http://", "https://")):
        raise GuiderError(f"--mirror must be the http or https URL of a folder, not {mirror!r}")
    directory = cache_directory() if directory is None else user_path(directory)
    try:
        return [_fetch_file(file, directory, mirror, report, patience) for file in dataset.files]
    except OSError as error:  # the network's are told apart where they happen
        raise GuiderError(
            f"{error.filename or directory}: cannot be written or read ({error.strerror or error}); mend that or name "
            "another folder with --out, and fetch again: what has arrived is kept"
        ) from error


def _fetch_file(file: RemoteFile, directory: Path, mirror: str | None, report: Report, patience: Patience) -> Path:
    target = directory / file.name
    part, record = _beside(target, ".part"), _beside(target, ".json")
    directory.mkdir(parents=True, exist_ok=True)
    with hold(_beside(target, ".lock"), f"{target} is being fetched by another process"):
        expected = file.sha256 or _read_json(record).get("sha256")
        if target.exists():
            if fault := _fault(file, target, _sha256(target), expected):
                raise GuiderError(f"{target} is not the file that was published: {fault}; move it away to fetch it")
            return target
        failures = []
        for url in (*([f"{mirror.rstrip('/')}/{file.name}"] if mirror else []), *file.urls):
            try:
                _download(url, part, report, patience)
            except _PlaceError as failed:
                failures.append(f"{url}: {failed}")
                continue
            digest = _sha256(part)
            if fault := _fault(file, part, digest, expected):
                _discard(part)
                failures.append(f"{url}: {fault}")
                continue
            fetched = datetime.now(UTC).isoformat(timespec="seconds")
            _write_json(record, {"url": url, "size_bytes": _size(part), "sha256": digest, "fetched": fetched})
            os.replace(part, target)
            _discard(part)
            return target
    raise GuiderError(
        f"{file.name} cannot be fetched now ({'; '.join(failures)}). Try again later (what has arrived is kept), name "
        "another place with --mirror URL, record data here with `guider collect`, or give a file you have with --data"
    )


def _fault(file: RemoteFile, path: Path, digest: str, expected: str | None) -> str | None:
    """What is wrong with the content of `path`, whose sha256 is `digest`; None if nothing is."""
    if expected is not None and digest != expected:
        return f"its sha256 is {digest}, not {expected} as {'published' if file.sha256 else 'first fetched'}"
    try:
        with open_store(path) as store:
            store.require(*file.keys)
    except GuiderError as error:
        return str(error).removeprefix(f"{path}: ")
    return None


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _download(url: str, part: Path, report: Report, patience: Patience) -> None:
    """Bring `part` to the whole of `url`. Raises _PlaceError when that does not work."""
    most, idle, deadline = _size(part), 0, time.monotonic() + patience.most_s
    while True:
        try:
            return _attempt(url, part, report, patience, deadline)
        except _AttemptError as interrupted:
            idle = 0 if _size(part) > most else idle + 1
            most = max(most, _size(part))
            if idle == patience.attempts:
                raise _PlaceError(str(interrupted)) from None
            if time.monotonic() > deadline:
                raise _PlaceError(f"it takes longer than {patience.most_s:g} s ({interrupted})") from None
            time.sleep(patience.backoff_s * 2 ** max(idle - 1, 0))


def _attempt(url: str, part: Path, report: Report, patience: Patience, deadline: float) -> None:
    """One request. It asks only for what `part` lacks, if that is known to be of the same version of the file."""
    origin_file = _beside(part, ".json")
    origin = _read_origin(origin_file)
    done = _size(part)
    headers = {}
    if origin is not None and origin.url == url and done:
        if done == origin.size_bytes:
            return
        if origin.validator is not None:
            headers = {"Range": f"bytes={done}-", "If-Range": origin.validator}
    with _open(url, headers, part, patience) as response:
        resumed = response.status == 206
        served = _Origin(url, _validator(response.headers), _whole_size(response))
        if resumed and (served != origin or _first_byte(response) != done):
            _discard(part)
            raise _AttemptError("the file changed while it was fetched")
        fits = shutil.disk_usage(part.parent).free + _size(part)
        if fault := _excess(served.size_bytes or 0, patience.most_bytes, fits):
            raise _PlaceError(fault)
        done = done if resumed else 0
        with part.open("ab" if resumed else "wb") as file:
            if not resumed:
                _write_json(origin_file, asdict(served))
            report(done, served.size_bytes)
            for chunk in _chunks(response, patience, deadline):
                if fault := _excess(done + len(chunk), patience.most_bytes, fits):
                    _discard(part)  # no end was declared, so that nothing says how much is lacking
                    raise _PlaceError(fault)
                file.write(chunk)
                done += len(chunk)
                report(done, served.size_bytes)
    if served.size_bytes is not None and done != served.size_bytes:
        raise _AttemptError(f"the connection ended after {done} of {served.size_bytes} bytes")


@contextmanager
def _open(url: str, headers: dict[str, str], part: Path, patience: Patience) -> Iterator[HTTPResponse]:
    try:
        response = _answer(Request(url, headers=headers), patience)
    except HTTPError as error:
        error.close()
        if error.code == 416:  # the server has no byte where the part ends
            _discard(part)
            raise _AttemptError("the file is shorter than what was fetched") from None
        reason = f"HTTP {error.code} {error.reason}"
        raise (_AttemptError if error.code in _BUSY else _PlaceError)(reason) from None
    except (URLError, ValueError) as error:
        raise _PlaceError(f"cannot be reached ({getattr(error, 'reason', error)})") from None
    except (OSError, HTTPException) as error:
        raise _AttemptError(f"no answer ({error!r})") from None
    with response:
        yield response


def _answer(request: Request, patience: Patience) -> HTTPResponse:
    """What the server answers, without its body. Raises what urlopen does, and TimeoutError after `rate_s`: a server
    that sends its headers byte by byte is in time for each of them."""
    asked: Future[HTTPResponse] = Future()

    def ask() -> None:
        try:
            response = urlopen(request, timeout=patience.timeout_s)
        except Exception as error:
            asked.set_exception(error)
        else:
            asked.set_result(response)

    threading.Thread(target=ask, daemon=True).start()
    try:
        return asked.result(patience.rate_s)
    except TimeoutError:
        if not asked.done():  # else it is urlopen's own
            asked.add_done_callback(lambda late: late.exception() or late.result().close())
        raise


def _excess(size_bytes: int, most_bytes: int, fits_bytes: int) -> str | None:
    """Which limit a file of this size is over, if any."""
    if size_bytes > most_bytes:
        return f"it is larger than {size_text(most_bytes)}, the limit"
    if size_bytes > fits_bytes:
        return f"it is larger than {size_text(fits_bytes)}, all that the disk has room for: make room or name --out"
    return None


def _chunks(response: HTTPResponse, patience: Patience, deadline: float) -> Iterator[bytes]:
    since, brought = time.monotonic(), 0
    while True:
        try:
            chunk = response.read1(_CHUNK_BYTES)
        except (OSError, HTTPException) as error:
            raise _AttemptError(f"the connection broke ({error!r})") from None
        if not chunk:
            return
        yield chunk
        now = time.monotonic()
        brought += len(chunk)
        if now > deadline:
            raise _PlaceError(f"it takes longer than {patience.most_s:g} s")
        if now - since > patience.rate_s:
            if brought < patience.least_rate * (now - since):
                raise _PlaceError(f"it brings less than {size_text(int(patience.least_rate))} a second")
            since, brought = now, 0


def _validator(headers: Message) -> str | None:
    """What If-Range may say; a weak ETag does not promise equal bytes."""
    etag = headers.get("ETag")
    return etag if etag and not etag.startswith("W/") else headers.get("Last-Modified")


def _whole_size(response: HTTPResponse) -> int | None:
    """Size of the whole file, also where the response is a part of it."""
    if response.status == 206:
        text = response.headers.get("Content-Range", "").rpartition("/")[2]
    else:
        text = response.headers.get("Content-Length", "")
    return _count(text)


def _count(text: str) -> int | None:
    """A number of bytes, as headers give it; None for anything else, or more than there can be."""
    return int(text) if text.isdecimal() and len(text) < 20 else None


def _first_byte(response: HTTPResponse) -> int | None:
    text = response.headers.get("Content-Range", "").removeprefix("bytes ").partition("-")[0]
    return _count(text)


def _fetch_minari(dataset_id: str) -> Path:
    """Where Minari keeps the dataset, after fetching it if need be and reading some of it."""
    import minari
    from minari.storage.datasets_root_dir import get_dataset_path

    directory = get_dataset_path(dataset_id)
    try:
        if not directory.exists():
            with redirect_stdout(sys.stderr):
                minari.download_dataset(dataset_id)
        check_minari(dataset_id, directory / "data")
        dataset = minari.load_dataset(dataset_id)
        next(iter(dataset.iterate_episodes([len(dataset) - 1])))
    except Exception as error:  # whatever the storage behind Minari raises
        reason = " ".join(str(error).split())
        raise GuiderError(
            f"{MINARI_PREFIX}{dataset_id} was not fetched whole into {directory} ({reason}); see `minari list remote` "
            "for what there is, pip install 'guider-rl[hub]' where huggingface_hub is missing, and remove that folder "
            "if it exists before another try"
        ) from error
    return directory


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _discard(part: Path) -> None:
    part.unlink(missing_ok=True)
    _beside(part, ".json").unlink(missing_ok=True)


def _read_origin(path: Path) -> _Origin | None:
    try:
        return _Origin(**_read_json(path))
    except TypeError:
        return None


def _read_json(path: Path) -> dict[str, Any]:
    """The object in the file; empty if there is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _write_json(path: Path, content: dict[str, Any]) -> None:
    new = _beside(path, ".new")
    new.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    os.replace(new, path)
