"""Checkpoints: what is stored is what is read, whatever became of the files, and nothing else is touched."""

from __future__ import annotations

import json
import os
import resource
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp
import pytest
from conftest import dead_pid, equal

from guider.errors import GuiderError, GuiderWarning
from guider.learning.training import Position
from guider.runs import checkpoint
from guider.support.files import parse_json, walk, write_json


def state_of(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "count": np.asarray(seed, np.int32),
        "none": np.zeros((2, 0), np.float32),
        "nested": {"wide": rng.normal(size=(3, 5)).astype(np.float32)},
        "zero": np.zeros((2, 2, 2), np.float32),
    }


TEMPLATE = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state_of(0))


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Checkpoints 5 and 10, at updates 2 and 7 of stage 1."""
    directory = tmp_path / "checkpoints"
    checkpoint.save(directory, 5, Position(1, 2), state_of(5))
    checkpoint.save(directory, 10, Position(1, 7), state_of(10))
    return directory


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def sign(folder: Path) -> None:
    """Make the manifest agree with what lies there, as whoever made the folder could."""
    manifest = parse_json(folder / checkpoint.MANIFEST)
    write_json(folder / checkpoint.MANIFEST, manifest | {"files": checkpoint._digests(checkpoint._contents(folder))})


def test_what_is_saved_is_read_and_orbax_reads_it_too(saved):
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and restored[0] == Position(1, 7) and equal(restored[1], state_of(10))
    theirs = ocp.PyTreeCheckpointer().restore(saved / "10" / "state")
    np.testing.assert_array_equal(theirs["nested.wide"], state_of(10)["nested"]["wide"])
    np.testing.assert_array_equal(theirs["count"], 10)


def test_the_two_newest_are_kept_and_what_training_went_back_behind_is_not(saved):
    checkpoint.save(saved, 12, Position(1, 9), state_of(12))
    assert sorted(os.listdir(saved)) == ["10", "12"]
    checkpoint.save(saved, 11, Position(1, 8), state_of(11))
    assert sorted(os.listdir(saved)) == ["10", "11"]


@pytest.mark.filterwarnings("ignore::guider.errors.GuiderWarning")
@pytest.mark.parametrize("seed", range(40))
def test_a_flipped_bit_is_never_taken(saved, seed):
    rng = np.random.default_rng(seed)
    path = files(saved / "10")[seed % len(files(saved / "10"))]
    content = bytearray(path.read_bytes())
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None
    position, state = restored
    assert (position == Position(1, 7) and equal(state, state_of(10))) or (
        position == Position(1, 2) and equal(state, state_of(5))
    )


def other_position(folder: Path) -> None:
    write_json(folder / checkpoint.MANIFEST, parse_json(folder / checkpoint.MANIFEST) | {"position": {"stage": 0}})


def true_position(folder: Path) -> None:
    position = {"stage": True, "update": 7}
    write_json(folder / checkpoint.MANIFEST, parse_json(folder / checkpoint.MANIFEST) | {"position": position})


def linked_file(folder: Path) -> None:
    path = folder / "state" / "count" / "0"
    path.rename(folder.parent / "elsewhere")
    path.symlink_to(folder.parent / "elsewhere")


def linked_folder(folder: Path) -> None:
    folder.rename(folder.parent / "elsewhere")
    folder.symlink_to(folder.parent / "elsewhere")


def fifo(folder: Path) -> None:
    (folder / "state" / "count" / "0").unlink()
    os.mkfifo(folder / "state" / "count" / "0")


DAMAGES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "emptied": (lambda folder: (folder / "state/count/0").write_bytes(b""), "state/count/0 is not as it was written"),
    "missing": (lambda folder: (folder / "state/zero/0.0.0").unlink(), "0.0.0 is not as it was written"),
    "extra": (lambda folder: (folder / "state/count/1").write_bytes(b"x"), "count/1 is not as it was written"),
    "no manifest": (lambda folder: (folder / "manifest.json").unlink(), "has no manifest"),
    "cut manifest": (lambda folder: (folder / "manifest.json").write_text("{"), "cannot be read"),
    "deep manifest": (lambda folder: (folder / "manifest.json").write_text("[" * 10**5), "cannot be read"),
    "no position": (other_position, "names no position"),
    "a flag for a position": (true_position, "names no position"),
    "linked file": (linked_file, "symbolic link"),
    "linked folder": (linked_folder, "symbolic link"),
    "fifo": (fifo, "no regular file"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_falls_back_to_the_one_before(saved, damage):
    spoil, reason = DAMAGES[damage]
    spoil(saved / "10")
    with pytest.warns(GuiderWarning, match=rf"{reason}.*/5 is used in its place"):
        restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and restored[0] == Position(1, 2) and equal(restored[1], state_of(5))
    checkpoint.save(saved, 10, Position(1, 7), state_of(10))
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and equal(restored[1], state_of(10))


def test_where_all_are_damaged_the_way_on_is_named(saved):
    for step in ("5", "10"):
        (saved / step / "state" / "count" / "0").write_bytes(b"")
    with pytest.raises(GuiderError, match=r"no checkpoint is whole: .*/10 is .*/5 is .*; remove .* to start anew"):
        checkpoint.restore(saved, TEMPLATE)


def test_a_position_that_cannot_be_is_damage(saved):
    with pytest.warns(GuiderWarning, match=r"cannot be at Position\(stage=1, update=7\)"):
        restored = checkpoint.restore(saved, TEMPLATE, lambda step, position: position.update == 2)
    assert restored is not None and restored[0] == Position(1, 2)


def test_what_a_killed_write_left_is_never_taken_and_goes(saved):
    (saved / "10").rename(saved / f".20.{dead_pid()}")
    (saved / "notes.txt").write_text("kept")
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and restored[0] == Position(1, 2)
    checkpoint.save(saved, 10, Position(1, 7), state_of(10))
    assert sorted(os.listdir(saved)) == ["10", "5", "notes.txt"]


# A stranger's, whose manifest agrees


@pytest.mark.parametrize(
    "layout",
    [
        {"shape": [3, 6]},
        {"compressor": {"id": "zstd"}},
        {"chunks": [1, 5]},
        {"dtype": "|O"},
        {"filters": [{"id": "python", "path": "os"}]},
        {"zarr_format": 3},
        {"kvstore": {"driver": "file", "path": "/etc/"}},
        {"kvstore": {"driver": "http", "base_url": "http://127.0.0.1:9/"}},
    ],
)
def test_arrays_laid_out_otherwise_are_refused(saved, layout):
    path = saved / "10" / "state" / "nested.wide" / ".zarray"
    path.write_text(json.dumps(json.loads(path.read_text()) | layout))
    sign(saved / "10")
    with pytest.raises(GuiderError, match=r"does not fit this run's config: nested\.wide"):
        checkpoint.restore(saved, TEMPLATE)


def test_specs_in_a_checkpoint_are_not_followed(saved, tmp_path):
    """What orbax and tensorstore would read of a folder, pointing elsewhere: nothing of it is opened."""
    elsewhere = tmp_path / "elsewhere"
    checkpoint.save(elsewhere, 1, Position(0, 1), state_of(99))
    state = saved / "10" / "state"
    spec = {"driver": "zarr", "kvstore": {"driver": "file", "path": f"{elsewhere}/1/state/count/"}}
    for name in ("_METADATA", "_sharding", "manifest.ocdbt", "zarr.json", "count/zarr.json", "count/.zattrs"):
        (state / name).write_text(json.dumps({"use_ocdbt": True, "use_zarr3": True, "spec": spec, **spec}))
    sign(saved / "10")
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and equal(restored[1], state_of(10))


def test_a_manifest_cannot_name_files_elsewhere(saved):
    folder = saved / "10"
    manifest = parse_json(folder / "manifest.json")
    write_json(folder / "manifest.json", manifest | {"files": manifest["files"] | {"../../secret": [1, "0" * 64]}})
    with pytest.warns(GuiderWarning, match=r"\.\./\.\./secret is not as it was written"):
        checkpoint.restore(saved, TEMPLATE)


# Places


@pytest.mark.parametrize(
    "name",
    ["exp[1]", "a\\b", "gs:", "s3:", "file:", "sp ace", "a#b%20?*", "naïve-日本", "dot.", "{x}|$y", "~", "n" * 250],
)
def test_any_name_of_a_directory_will_do(tmp_path, name):
    directory = tmp_path / name / "checkpoints"
    checkpoint.save(directory, 3, Position(0, 3), state_of(3))
    restored = checkpoint.restore(directory, TEMPLATE)
    assert restored is not None and equal(restored[1], state_of(3))
    assert os.listdir(tmp_path) == [name] and os.listdir(directory) == ["3"]


def test_what_cannot_be_written_is_told_and_leaves_the_last_one(saved, capfd):
    """A limit on the size of files stands for a full disk: the same calls fail, deep inside orbax."""
    large = {"wide": np.ones((1000, 10), np.float32)}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"checkpoints/20 cannot be written: File too large"):
            checkpoint.save(saved, 20, Position(2, 0), large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert sorted(os.listdir(saved)) == ["10", "5"]
    assert "Traceback" not in capfd.readouterr().err
    restored = checkpoint.restore(saved, TEMPLATE)
    assert restored is not None and equal(restored[1], state_of(10))


def test_folders_that_go_while_they_are_walked_are_left_out(tmp_path):
    """Another process renames or removes what it had not finished."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    walking = walk(tmp_path)
    first = next(walking)
    shutil.rmtree(tmp_path / ({"a/file", "b/file"} - {first}).pop().split("/")[0])
    assert [first, *walking] == [first]
    with pytest.raises(FileNotFoundError):
        list(walk(tmp_path / "nothing"))
