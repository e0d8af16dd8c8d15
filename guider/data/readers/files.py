"""A single file of arrays: what it holds, whoever wrote it, told apart by its content."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from guider.data.pickles import is_pickle
from guider.data.readers.bags import is_mcap, read_mcap
from guider.data.readers.groups import keeps_episodes_apart, read_groups
from guider.data.readers.imitation import is_imitation, read_imitation
from guider.data.readers.pickled import has_episode_axis, read_episode_axis, read_pickle
from guider.data.readers.tables import read_table, table_kind
from guider.data.store import Store, open_store
from guider.errors import GuiderError

_HINTS = {
    ".db3": "a ROS 2 recording",
    ".bag": "a ROS 1 recording",
    ".tfrecord": "TFRecord",
    ".array_record": "ArrayRecord",
}


@contextmanager
def open_file(path: Path, format: str | None = None) -> Iterator[Store]:
    """format: as in `guider.load_data`. Raises GuiderError for what cannot be read."""
    if format == "wgcsl" or (format is None and is_pickle(path)):
        yield read_pickle(path)
    elif format is None and table_kind(path) is not None:
        yield read_table(path)
    elif format is None and is_mcap(path):
        yield read_mcap(path)
    else:
        refuse_others(path, [path])
        with open_store(path) as store:
            yield _apart(store) if format is None else store


def _apart(store: Store) -> Store:
    """What an HDF5 or npz file holds, episode by episode where it keeps them apart."""
    if store.kind == "HDF5" and keeps_episodes_apart(store):
        return read_groups(store)
    if store.kind == "npz" and is_imitation(store):
        return read_imitation(store)
    return read_episode_axis(store) if has_episode_axis(store) else store


def refuse_others(source: Path, files: Sequence[Path]) -> None:
    """Raise GuiderError, saying what to run, where one of the files is a recording that is not read here."""
    for path in files:
        what = next((words for ending, words in _HINTS.items() if ending in path.name.lower()), None)
        if what in ("TFRecord", "ArrayRecord"):
            raise GuiderError(
                f"{source}: {what}, as of RLDS, which takes TensorFlow to read; write each episode's state and "
                "action with it as an npz (observations, actions) into one folder, and name that"
            )
        if what is not None:
            raise GuiderError(
                f"{source}: {what}, whose file does not say what its messages hold; write it as MCAP, which does, "
                "and is read (`ros2 bag convert`, or `pip install rosbags` and `rosbags-convert`)"
            )
