"""A file or folder, whoever wrote it, becomes a store of named arrays: told apart by content, not by name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from guider.data.catalogue import MINARI_PREFIX
from guider.data.readers.files import open_file
from guider.data.readers.folders import read_folder
from guider.data.readers.minari import dataset_directory, read_minari
from guider.data.safety import check_path
from guider.data.store import Store
from guider.errors import GuiderError
from guider.support.files import user_path


@contextmanager
def open_source(source: str, format: str | None) -> Iterator[Store]:
    """The arrays at `source`: format as in `guider.load_data`. Raises GuiderError for what cannot be read."""
    path = user_path(source)
    is_id = source.startswith(MINARI_PREFIX)
    if not is_id:
        check_path(path)
    directory = None if is_id else dataset_directory(path)
    if is_id or directory is not None or format == "minari":
        if format not in (None, "minari"):
            raise GuiderError(f"{source}: a Minari dataset, which cannot be read as {format}")
        if directory is None and not is_id:
            raise GuiderError(f"{source}: no Minari dataset here (a directory with data/main_data.hdf5)")
        yield read_minari(source, directory or source.removeprefix(MINARI_PREFIX))
    elif path.is_dir():
        yield read_folder(path)
    else:
        with open_file(path, format) as store:
            yield store
