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
from guider.data.readers.rlds import is_rlds, read_rlds
from guider.data.readers.tables import read_table, table_kind
from guider.data.store import Store, open_store
from guider.errors import GuiderError

_NOT_READ = {
    ".bag": "a ROS 1 recording; write it as MCAP (`pip install rosbags` and `rosbags-convert`), which is read",
    ".db3": "a ROS 2 recording that does not say what its messages hold; write it as MCAP, which does, and is read "
    "(`ros2 bag convert`, or `pip install rosbags` and `rosbags-convert`)",
    ".array_record": "ArrayRecord, which takes a package of its own to read; write each episode's state and action "
    "with it as an npz (observations, actions) into one folder, and name that",
}
"""What names end in: what that is, and what to do."""


@contextmanager
def open_file(path: Path, format: str | None = None) -> Iterator[Store]:
    """format: as in `guider.load_data`. Raises GuiderError for what cannot be read."""
    if format == "wgcsl" or (format is None and is_pickle(path)):
        yield read_pickle(path)
    elif format is None and table_kind(path) is not None:
        yield read_table(path)
    elif format is None and is_mcap(path):
        yield read_mcap(path, [path])
    elif format is None and is_rlds(path):
        yield read_rlds(path, [path])
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
        for ending, told in _NOT_READ.items():
            if ending in path.name.lower():
                raise GuiderError(f"{source}: {told}")
