"""Files that guider keeps: JSON with a checksum, lines that are checked, names for what is not finished yet.

Nothing here follows a symbolic link: what lies in a folder from elsewhere must not make us read or write outside it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import shutil
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from guider.errors import GuiderError, GuiderWarning

CHECKSUM = "checksum"


def read_bytes(path: Path) -> bytes:
    """Raises OSError where there is no such file, GuiderError where it is a link or no regular file."""
    if path.is_symlink():
        raise _link(path)
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise GuiderError(f"{path} is no regular file; remove it")
        return file.read()


def walk(folder: Path) -> Iterator[str]:
    """Every file below `folder`, by its path from there; what another process takes away meanwhile is left out.

    Raises GuiderError on links and on what is no regular file, OSError where `folder` cannot be read.
    """
    waiting = [folder]
    while waiting:
        inner = waiting.pop()
        try:
            entries = list(os.scandir(inner))
        except FileNotFoundError:
            if inner == folder:
                raise
            continue
        for entry in entries:
            path = Path(entry.path)
            if entry.is_symlink():
                raise _link(path)
            if entry.is_dir():
                waiting.append(path)
            elif entry.is_file():
                yield path.relative_to(folder).as_posix()
            else:
                raise GuiderError(f"{path} is no regular file; remove it")


def _link(path: Path) -> GuiderError:
    return GuiderError(f"{path} is a symbolic link, and those are not followed; put in its place what it points at")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, which what was written there takes over at the end, unless that failed: readers
    see the old file or the new one, never half."""
    part = temporary(path)
    part.unlink(missing_ok=True)
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Whole or not at all, see `replacing`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Whole or not at all, see `replacing`."""
    with replacing(path) as part, part.open("xb") as file:
        file.write(content)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write JSON, as `write_text` does, with a checksum of its content."""
    plain = json.loads(json.dumps(values))
    write_text(path, _rows_in_lines(json.dumps(plain | {CHECKSUM: _checksum(plain)}, indent=1)) + "\n")


def _rows_in_lines(text: str) -> str:
    """Indented JSON with each list of numbers and words on one line; within strings no line ends, so none changes."""
    return re.sub(
        r"\[\n[^\[\]{}]*\n *\]", lambda rows: re.sub(r"\n *", " ", rows[0]).replace("[ ", "[")[:-2] + "]", text
    )


def parse_json(path: Path) -> dict[str, Any]:
    """Raises OSError where there is no such file, GuiderError where it is no JSON object."""
    try:
        values = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise GuiderError(f"{path} cannot be read: {error}") from error
    if not isinstance(values, dict):
        raise GuiderError(f"{path} cannot be read: it holds no JSON object")
    return values


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """What `write_json` wrote. Raises GuiderError, which ends in `remedy`, where it holds anything else."""
    try:
        values = parse_json(path)
    except GuiderError as error:
        raise GuiderError(f"{error}; {remedy}") from error
    return checked(path, values, remedy)


def checked(path: Path, values: dict[str, Any], remedy: str) -> dict[str, Any]:
    """`values`, read from `path`, without their checksum. Raises GuiderError where it is not theirs."""
    content = {name: value for name, value in values.items() if name != CHECKSUM}
    if values.get(CHECKSUM) != _checksum(content):
        raise GuiderError(f"{path} is damaged or was changed by hand: its checksum is not its content's; {remedy}")
    return content


def _checksum(values: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values | {CHECKSUM: None}, sort_keys=True).encode()).hexdigest()


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(map(_number, value))


def _count(value: Any) -> bool:
    return type(value) is int and 0 < value < 2**63


LINES: dict[str, dict[str, Callable[[Any], bool]]] = {
    "metrics.jsonl": {
        "stage": lambda value: isinstance(value, str),
        "update": _count,
        "total_updates": _count,
        "seconds": lambda value: _number(value) and math.isfinite(value) and value >= 0,
        "metrics": lambda value: isinstance(value, dict) and all(map(_numbers, value.values())),
    },
    "evaluations.jsonl": {
        "total_updates": _count,
        "score": lambda value: _numbers(value) and all(map(math.isfinite, value)),
        "episodes": _count,
    },
}
"""What every line of a file holds: name -> whether a value can be."""


def parse_line(name: str, text: str | bytes) -> dict[str, Any] | None:
    """A line of the file called `name`; None where it is not one that guider wrote."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return line if is_line(name, line) else None


def is_line(name: str, line: Any) -> bool:
    """Whether `line` can be one of the file called `name`, by types and ranges."""
    return isinstance(line, dict) and all(
        field in line and can_be(line[field]) for field, can_be in LINES[name].items()
    )


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The lines of metrics.jsonl or evaluations.jsonl; none where there is no file.

    One cut off at the end, by a crash, is left out; others that are damaged are too, with a GuiderWarning.
    """
    try:
        *texts, _ = read_bytes(path).split(b"\n")
    except FileNotFoundError:
        return []
    lines = [parse_line(path.name, text) for text in texts]
    if damaged := [str(number) for number, line in enumerate(lines, start=1) if line is None]:
        named = ", ".join(damaged[:5]) + (", ..." if len(damaged) > 5 else "")
        warnings.warn(GuiderWarning(f"{path} is damaged and read without its line(s) {named}"), stacklevel=2)
    return [line for line in lines if line is not None]


def append_line(path: Path, values: dict[str, Any]) -> None:
    """Add one line to a JSONL file: the whole of it, or nothing and an OSError."""
    data = (json.dumps(values) + "\n").encode()
    with open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666), "rb+", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            if file.write(data) != len(data):
                file.write(data)  # says why
        except OSError:
            file.truncate(size)
            raise


def temporary(path: Path) -> Path:
    """A name beside `path` for what this process has not finished writing."""
    return path.with_name(f".{shortened(path.name)}.{os.getpid()}")


def shortened(name: str) -> str:
    """So much of a name that there is room for more in the 255 bytes that a name may have."""
    return os.fsdecode(os.fsencode(name)[:200])


def clear_leftovers(folder: Path, name: str) -> None:
    """Remove what processes that are dead left unfinished in `folder`. name: pattern of what they were to write."""
    for entry in list(os.scandir(folder)):
        found = re.fullmatch(rf"\.(?:{name})\.(\d+)", entry.name)
        if found and is_dead(int(found[1])):
            remove(Path(entry.path))


def remove(path: Path) -> None:
    """Remove a file, a link itself, or a folder with all in it, where there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def is_dead(pid: int) -> bool:
    """Whether no process of this machine has that number."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:
        return False
    return False


def new_file(typed: str | Path, option: str) -> Path:
    """The path of a file that is to be written, in a folder that is made where there is none. Raises GuiderError where
    something is there already, OSError where nothing can be written."""
    path = user_path(typed)
    if os.path.lexists(path):
        raise GuiderError(f"{path} exists already and is never overwritten; choose another {option}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(errno.EACCES, "nothing can be written here", str(path.parent))
    return path


def user_path(typed: str | Path) -> Path:
    """The path, with ~ for the home directory. Raises GuiderError for what can be no path."""
    text = os.fspath(typed)
    if not text or "\0" in text:
        raise GuiderError(f"{text!r} is no path")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise GuiderError(f"{text}: there is no home directory that ~ could stand for (HOME is not set)") from None
