"""What is looked at before a file that others wrote is read: that it stays in its place, and that what it declares is
there and fits into memory.

Sizes are checked twice. An array declares shape and type, and no compression unpacks a byte to more than 1032, so a
file of 2 kB that declares a billion rows is known for what it is before anything is read. What is there is then held
against free memory. HDF5 is first opened by another process (see hdf5_worker): its library is native code that files
have crashed, and such a crash becomes one line.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import stat
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from guider.errors import GuiderError

MAIN_FILE, METADATA_FILE = "main_data.hdf5", "metadata.json"  # of a Minari dataset

_WORKER = Path(__file__).with_name("hdf5_worker.py")
_UNWRITTEN_BYTES = 64 << 20  # arrays up to this size may be declared and never written: HDF5 fills them in
_DEFLATE_RATIO = 1032
_COPIES = 2  # what is read is checked, and kept in a copy of its own
_METADATA_BYTES = 16 << 20
_EPISODE_REWARDS = re.compile(r"episode_\d+/rewards")
_EPISODE_VECTORS = re.compile(r"episode_\d+/(observations|actions)\b")
_NUMBER_TYPE = re.compile(r"(float|u?int)\d{1,3}|bool")


@dataclass(frozen=True)
class Declared:
    """What a file says of one array.

    shape, kind, itemsize: () for a single number; NumPy's kind of number; bytes of each
    most_bytes:            what the file can hold of it
    """

    shape: tuple[int, ...]
    kind: str
    itemsize: int
    most_bytes: int

    @property
    def declared_bytes(self) -> int:
        return math.prod(self.shape) * self.itemsize

    @property
    def float_bytes(self) -> int:
        """As float32, or as declared if that is more."""
        return math.prod(self.shape) * max(self.itemsize, 4)


def size_fault(name: str, arrays: list[Declared]) -> str | None:
    """Why `arrays`, taken together, cannot be what they declare: it is more than the file can hold."""
    declared = sum(array.declared_bytes for array in arrays)
    held = sum(array.most_bytes for array in arrays)
    if declared <= held + _UNWRITTEN_BYTES:
        return None
    shape = f" of shape {_shape_text(arrays[0].shape)}" if len(arrays) == 1 else ""
    return f"{name}{shape} would be {size_text(declared)}, but the file can hold at most {size_text(held)} of it"


def memory_fault(name: str, size_bytes: int) -> str | None:
    """Why something of this size is not read: checked and copied it would not fit into memory."""
    free = free_memory()
    if free is None or _COPIES * size_bytes <= free:
        return None
    return f"reading {name} takes {size_text(_COPIES * size_bytes)} of memory, but {size_text(free)} are free"


def size_text(size_bytes: int) -> str:
    for power, unit in enumerate(("bytes", "kB", "MB", "GB", "TB")):
        if size_bytes < 1000 ** (power + 1):
            return f"{size_bytes / 1000**power:.3g} {unit}"
    return "over 1000 TB"


def free_memory() -> int | None:
    """Bytes that can still be used: what the system has available, or what the limits of this process's control groups
    leave, whichever is less. None where the system does not say."""
    found = [size for size in (_available(), *_left_in_groups()) if size is not None]
    return min(found, default=None)


def _available() -> int | None:
    text = _text(Path("/proc/meminfo"))
    found = re.search(r"^MemAvailable:\s+(\d+) kB", text, re.MULTILINE)
    return int(found[1]) * 1024 if found else None


def _left_in_groups() -> Iterator[int]:
    """Limit less use, files that are only cached left out, of each control group up to the top, of versions 1 and 2."""
    for line in _text(Path("/proc/self/cgroup")).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        root = Path("/sys/fs/cgroup") / controllers
        limit, used, cached = (
            ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            if controllers
            else ("memory.max", "memory.current", "inactive_file")
        )
        names = PurePosixPath(path.lstrip("/"))
        for group in (root / names, *(root / parent for parent in names.parents)):
            most, now = _text(group / limit).strip(), _text(group / used).strip()
            if most.isdecimal() and now.isdecimal():
                files = re.search(rf"^{cached} (\d+)$", _text(group / "memory.stat"), re.MULTILINE)
                yield max(0, int(most) - int(now) + (int(files[1]) if files else 0))


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, ValueError):
        return ""


def check_path(path: Path) -> None:
    """Raises GuiderError unless `path` names a regular file or a directory that may be read; a pipe or a device may
    have no end."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise GuiderError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise GuiderError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise GuiderError(f"{path}: not a file, but a pipe, socket or device; copy what it gives into a file")
    if not os.access(path, os.R_OK):
        raise GuiderError(f"{path}: cannot be read (Permission denied)")


def first_bytes(path: Path, count: int) -> bytes:
    """The first bytes of a file, by which it is told apart; none where it is no file, or cannot be read."""
    if not path.is_file():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


def look_into_hdf5(path: Path) -> dict[str, Declared]:
    """The file's arrays by name, found by another process that opened the file and read some of it.

    Raises GuiderError for what that process refuses, and where it does not live to say.
    """
    # the same packages as this process has, without what the interpreter does at its start to find them
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-S", "-P", str(_WORKER), str(path)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=environment,
        )
    except (OSError, ValueError) as error:
        raise GuiderError(f"{path}: the process that looks at HDF5 files cannot be started ({error})") from error
    if done.returncode:
        raise GuiderError(f"{path}: {_death(done.returncode, done.stderr)}")
    answer = json.loads(done.stdout)
    if "refused" in answer:
        raise GuiderError(f"{path}: {answer['refused']}")
    return {name: Declared(tuple(shape), *rest) for name, shape, *rest in answer["arrays"]}


def _death(code: int, words: bytes) -> str:
    if -code in (signal.SIGALRM, signal.SIGXCPU):
        return "opening it takes far longer than a file of its size needs; the file is damaged or made to do so"
    if -code == signal.SIGKILL:
        return "the process that looked at the file was killed; there may be too little free memory"
    last = words.decode(errors="replace").strip().rpartition("\n")[2]
    how = signal.Signals(-code).name if code < 0 else f"status {code}, {last}"
    return f"HDF5's library crashed on it ({how}): the file is damaged or made to do so"


def look_into_npz(archive: zipfile.ZipFile, file_bytes: int) -> dict[str, Declared | None]:
    """The archive's arrays by name, from their headers; None for a member that is no array.

    Raises GuiderError, without the file's name, for members that no honest npz has.
    """
    names = [member.filename for member in archive.infolist()]
    keys = [name.removesuffix(".npy") for name in names]
    for name in names:
        if name.startswith(("/", "\\")) or ".." in re.split(r"[/\\]", name):
            raise GuiderError(f"the archive's member {name!r} names a place outside of it")
    if twice := {key for key in keys if keys.count(key) > 1} if len(set(keys)) < len(keys) else ():
        raise GuiderError(f"the archive holds {min(twice)!r} more than once")
    return {key: _npz_member(archive, member, file_bytes) for key, member in zip(keys, archive.infolist(), strict=True)}


def _npz_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, file_bytes: int) -> Declared | None:
    if member.flag_bits & 1:
        raise GuiderError(f"the archive's member {member.filename!r} is encrypted; save it without a password")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise GuiderError(f"the archive's member {member.filename!r} is compressed in a way that NumPy does not write")
    with archive.open(member) as file:
        try:
            version = np.lib.format.read_magic(file)
            read_header = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}[version[0]]
            shape, _, dtype = read_header(file)
        except (EOFError, zipfile.BadZipFile):
            raise
        except Exception:  # a header is Python's own notation, and parsing what others wrote fails in many ways
            return None
        header_bytes = file.tell()
    ratio = 1 if member.compress_type == zipfile.ZIP_STORED else _DEFLATE_RATIO
    most = min(member.file_size, ratio * min(member.compress_size, file_bytes)) - header_bytes
    kind = "V" if dtype.subdtype else "O" if dtype.hasobject else dtype.kind
    return Declared(shape, kind, dtype.itemsize, most)


def check_minari(source: str, directory: Path) -> None:
    """Raises GuiderError unless Minari can be let read the dataset in `directory`, which holds main_data.hdf5 and
    metadata.json.

    Nothing in it is a link to elsewhere. The metadata names the spaces, since Minari would otherwise make the
    environment that it names, and so run what the metadata asks for. It declares the episodes and steps that are there,
    and these fit into memory.
    """

    def fail(message: str) -> GuiderError:
        return GuiderError(f"{source}: {message}")

    for path in (*([directory] if directory.name == "data" else []), *directory.rglob("*")):
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            raise fail(f"{path.name} in the dataset is a symbolic link, which is not followed; put a copy in its place")
        if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
            raise fail(f"{path.name} in the dataset is neither a file nor a directory")
    metadata = _metadata(directory / METADATA_FILE, fail)
    declared = {key: metadata.get(key) for key in ("total_episodes", "total_steps")}
    for key, count in declared.items():
        if type(count) is not int or count < 0:
            raise fail(f"{key} in {METADATA_FILE} must be a whole number, got {count!r:.80}")
    if metadata.get("data_format") != "hdf5":
        raise fail(f"its data_format is {metadata.get('data_format')!r:.80}; only Minari's hdf5 is read")
    for key in ("observation_space", "action_space"):
        _check_space(key, metadata.get(key), fail)
    if declared["total_episodes"] == 0:
        return
    try:
        arrays = look_into_hdf5(directory / MAIN_FILE)
    except GuiderError as refused:
        raise fail(str(refused).removeprefix(f"{directory}{os.sep}")) from None
    steps = {name: array.shape[0] for name, array in arrays.items() if array.shape and _EPISODE_REWARDS.fullmatch(name)}
    found = {"total_episodes": len(steps), "total_steps": sum(steps.values())}
    for key, count in declared.items():
        if count != found[key]:
            raise fail(f"{METADATA_FILE} declares {key} {count}, but {MAIN_FILE} holds {found[key]}: one is damaged")
    kept = sum(array.float_bytes for name, array in arrays.items() if _EPISODE_VECTORS.match(name))
    largest = max(array.declared_bytes for array in arrays.values())
    if fault := size_fault("the dataset", list(arrays.values())) or memory_fault("the dataset", kept + largest):
        raise fail(fault)


def _metadata(path: Path, fail: Any) -> Mapping[str, Any]:
    try:
        if (size := path.stat().st_size) > _METADATA_BYTES:
            raise fail(f"{METADATA_FILE} has {size_text(size)}, more than the {size_text(_METADATA_BYTES)} it may have")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise fail(f"{METADATA_FILE} is damaged or cut off ({error})") from error
    if not isinstance(content, dict):
        raise fail(f"{METADATA_FILE} is damaged: it must hold a JSON object")
    return content


def _check_space(key: str, text: Any, fail: Any) -> None:
    """A space is JSON in a string. Its types of numbers are checked, as one may declare a billion bytes for each."""
    try:
        waiting = [json.loads(text)]
    except (TypeError, ValueError, RecursionError):
        raise fail(f"{METADATA_FILE} does not say what its {key} is") from None
    while waiting:
        item = waiting.pop()
        if isinstance(item, dict):
            dtype = item.get("dtype", "bool")
            if not isinstance(dtype, str) or not _NUMBER_TYPE.fullmatch(dtype):
                raise fail(f"{key} in {METADATA_FILE} holds numbers of type {dtype!r:.80}, which is none")
            waiting.extend(item.values())
        elif isinstance(item, list):
            waiting.extend(part for part in item if isinstance(part, dict | list))


def _shape_text(shape: tuple[int, ...]) -> str:
    text = f"{shape[:8]!r:.200}"
    return text if len(shape) <= 8 else f"{text} and {len(shape) - 8} more dimensions"
