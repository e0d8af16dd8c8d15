"""The whole training state on disk, as orbax writes it, with a manifest of every byte.

DIRECTORY/STEP/
    state/           orbax's: a folder per array, uncompressed (zarr 2)
    manifest.json    how far training had come, and size and sha256 of every other file; written last

Reading takes the arrays from the very bytes that the manifest was checked against, and no other library interprets a
file: nothing in a checkpoint of a stranger's can name another place.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from guider.errors import GuiderError, GuiderWarning
from guider.learning.training import Position
from guider.support.files import clear_leftovers, read_bytes, read_json, remove, temporary, walk, write_json

PyTree = Any

MANIFEST = "manifest.json"
EXTRA_BYTES = 3 * 4096
"""What an array takes on disk beside its entries: its folder, its layout, its lines in orbax's metadata and ours."""
PLAIN = re.compile(r"[\w/.+=, -]*")
"""Paths that orbax and tensorstore take as they stand; in others they see patterns, separators and addresses."""


def save(directory: Path, step: int, position: Position, state: PyTree) -> None:
    """Write `state` as the checkpoint after `step` updates, and keep it and the one before.

    Raises OSError, with place and reason, where that fails; what was there before stays as it was.
    """
    folder = directory / str(step)
    part = temporary(folder)
    arrays = {name: np.asarray(leaf) for name, leaf in _named(state).items()}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        clear_leftovers(directory, r"\d+")
        remove(part)
        part.mkdir()
        _reserve(part / "room", arrays)
        (part / "state").mkdir()
        _write(part / "state", arrays)
        contents = _contents(part)
        for name, array in _arrays(part, contents, arrays).items():
            if array.tobytes() != arrays[name].tobytes():
                raise OSError(f"{name} reads back other than it was")
        write_json(part / MANIFEST, {"position": asdict(position), "files": _digests(contents)})
        remove(folder)  # damaged where it is there: training went on from a checkpoint before it
        part.rename(folder)
    except Exception as error:  # a full disk alone is an OSError, ValueError, RuntimeError or XlaRuntimeError
        shutil.rmtree(part, ignore_errors=True)
        raise OSError(f"{folder} cannot be written: {_reason(error)}") from error
    for other in set(_steps(directory)) - {step, max((s for s in _steps(directory) if s < step), default=step)}:
        shutil.rmtree(directory / str(other), ignore_errors=True)


def restore(
    directory: Path, template: PyTree, fits: Callable[[int, Position], bool] = lambda step, position: True
) -> tuple[Position, PyTree] | None:
    """The newest checkpoint that is whole, (position, state shaped like `template`), or None where there is none.

    template: tree of jax.ShapeDtypeStruct; fits: whether a checkpoint of that step can have that position. Damaged
    checkpoints are passed over with a GuiderWarning. Raises GuiderError if all are damaged, or if one of another shape
    is found.
    """
    if directory.is_symlink():
        raise GuiderError(f"{directory} is a symbolic link, and those are not followed; put the folder itself there")
    damaged = []
    for step in _steps(directory):
        folder = directory / str(step)
        try:
            position, contents = _verified(folder)
            if not fits(step, position):
                raise GuiderError(f"{folder} cannot be at {position}")
        except (GuiderError, OSError) as error:
            damaged.append(str(error))
            continue
        if damaged:
            warnings.warn(GuiderWarning(f"{'; '.join(damaged)}: {folder} is used in its place"), stacklevel=2)
        try:
            arrays = _arrays(folder, contents, _named(template))
        except GuiderError as error:
            raise GuiderError(f"{folder} does not fit this run's config: {error}") from error
        leaves, structure = jax.tree_util.tree_flatten_with_path(template)
        filled = [arrays.get(_name(path), np.zeros(leaf.shape, leaf.dtype)) for path, leaf in leaves]
        return position, jax.tree.unflatten(structure, filled)
    if damaged:
        raise GuiderError(f"no checkpoint is whole: {'; '.join(damaged)}; remove {directory} to start anew")
    return None


def _steps(directory: Path) -> list[int]:
    """Numbers of the checkpoints there, newest first."""
    names = os.listdir(directory) if directory.is_dir() else []
    return sorted((int(name) for name in names if re.fullmatch(r"0|[1-9][0-9]{0,17}", name)), reverse=True)


def _verified(folder: Path) -> tuple[Position, dict[str, bytes]]:
    """(position, content of every file). Raises GuiderError or OSError if anything is not as it was written."""
    if folder.is_symlink():
        raise GuiderError(f"{folder} is a symbolic link")
    contents = _contents(folder)
    try:
        manifest = read_json(folder / MANIFEST, "the checkpoint is of no use")
    except FileNotFoundError:
        raise GuiderError(f"{folder} is damaged: it has no {MANIFEST}") from None
    found, written = _digests(contents), manifest.get("files")
    written = written if isinstance(written, dict) else {}
    if other := sorted(name for name in found | written if found.get(name) != written.get(name)):
        raise GuiderError(f"{folder} is damaged: {other[0]} is not as it was written")
    position = manifest.get("position")
    stage, update = map(position.get, ("stage", "update")) if isinstance(position, dict) else (None, None)
    if type(stage) is not int or type(update) is not int:
        raise GuiderError(f"{folder} is damaged: it names no position")
    return Position(stage, update), contents


def _contents(folder: Path) -> dict[str, bytes]:
    """Of every file below `folder` but the manifest."""
    return {name: read_bytes(folder / name) for name in walk(folder) if name != MANIFEST}


def _digests(contents: dict[str, bytes]) -> dict[str, list[Any]]:
    return {name: [len(content), hashlib.sha256(content).hexdigest()] for name, content in contents.items()}


def _reserve(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    """Raise the system's own error where there is no room for the arrays and what is written about each.

    Where it is orbax that finds the disk full, threads of its own may print stack traces for as long as they live.
    """
    if not hasattr(os, "posix_fallocate"):
        return
    folder.mkdir()
    for index, array in enumerate(arrays.values()):
        with (folder / str(index)).open("xb") as file:
            os.posix_fallocate(file.fileno(), 0, array.nbytes + EXTRA_BYTES)
    shutil.rmtree(folder)


def _write(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    import orbax.checkpoint as ocp  # heavy: only runs that write checkpoints pay for it

    handler = ocp.PyTreeCheckpointHandler(use_ocdbt=False, use_zarr3=False, use_compression=False)
    logger = logging.getLogger("absl")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)  # what fails is raised too
    try:
        with _plainly_named(folder) as path:
            handler.save(path, args=ocp.args.PyTreeSave(arrays))  # pyright: ignore[reportArgumentType]
    finally:
        logger.setLevel(level)
        handler.close()


@contextmanager
def _plainly_named(folder: Path) -> Iterator[Path]:
    """`folder` under a name that is nothing but a path."""
    path = os.path.realpath(folder)
    if PLAIN.fullmatch(path):
        yield Path(path)
        return
    beside = os.path.realpath(tempfile.gettempdir())
    with tempfile.TemporaryDirectory(dir=beside if PLAIN.fullmatch(beside) else "/tmp") as shelter:
        link = Path(shelter) / "state"
        link.symlink_to(path)
        yield link


def _arrays(folder: Path, contents: dict[str, bytes], wanted: dict[str, Any]) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint, by name. Raises GuiderError unless they are those `wanted`, by shape and dtype."""
    stored = {found[1] for name in contents if (found := re.fullmatch(r"state/([^/]+)/\.zarray", name))}
    if other := sorted(stored ^ set(wanted)):
        raise GuiderError(f"{other[0]} is {'not in it' if other[0] in wanted else 'none of its arrays'}")
    arrays = {}
    for name, leaf in wanted.items():
        layout = _layout(contents[f"state/{name}/.zarray"])
        if layout.get("shape") != list(leaf.shape):
            raise GuiderError(f"{name} has shape {layout.get('shape')}, not {list(leaf.shape)}")
        data = contents.get(f"state/{name}/{'.'.join('0' for _ in leaf.shape) or '0'}", b"")
        if layout != _plain_layout(leaf) or len(data) != leaf.size * leaf.dtype.itemsize:
            raise GuiderError(f"{name} is not stored as {leaf.dtype} in one piece")
        arrays[name] = np.frombuffer(data, leaf.dtype).reshape(leaf.shape)
    return arrays


def _layout(text: bytes) -> dict[str, Any]:
    try:
        layout = json.loads(text)
    except (ValueError, RecursionError):
        layout = None
    return layout if isinstance(layout, dict) else {}


def _plain_layout(leaf: Any) -> dict[str, Any]:
    """What orbax says of an array that it wrote as it lies in memory."""
    return {
        "zarr_format": 2,
        "shape": list(leaf.shape),
        "chunks": list(leaf.shape),
        "dtype": np.dtype(leaf.dtype).str,
        "order": "C",
        "dimension_separator": ".",
        "compressor": None,
        "fill_value": None,
        "filters": None,
    }


def _named(tree: PyTree) -> dict[str, Any]:
    """Leaves by name; those without a single entry are left out, orbax does not take them."""
    return {_name(path): leaf for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0] if leaf.size}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _reason(error: Exception) -> str:
    """In a few words; the libraries beneath wrap the system's in pages of their own."""
    text = str(error) or type(error).__name__
    system = [
        os.strerror(number)
        for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EIO)
    ]
    return next((words for words in system if words.lower() in text.lower()), text.splitlines()[0][:200])
