"""Minari datasets that lead elsewhere, that declare what they do not hold, or are damaged."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from recordings import (
    ARRAYS,
    GOAL,
    LENGTHS,
    check_data_or_a_line,
    damaged,
    refusal,
    refusal_in_little_memory,
)

from guider.data import load, safety
from guider.data.store import Recording
from guider.data.write import write_minari


@pytest.fixture(scope="module")
def minari_source(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("minari") / "walk-v0"
    recording = Recording(ARRAYS["observations"], ARRAYS["actions"], ARRAYS["lengths"])
    write_minari(directory, recording, GOAL, 0.5, dataset_id="walk-v0", recipe="", description="", seed=0)
    return directory


@pytest.fixture
def minari(minari_source, tmp_path) -> Path:
    return shutil.copytree(minari_source, tmp_path / "walk-v0")


def rewrite(directory: Path, **changes) -> None:
    path = directory / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    path.write_text(json.dumps({key: value for key, value in (metadata | changes).items() if value is not None}))


def test_a_whole_minari_dataset(minari):
    assert load(minari, GOAL).lengths.tolist() == LENGTHS


@pytest.mark.parametrize("name", ["data/main_data.hdf5", "data/metadata.json", "data", "data/notes.txt"])
def test_symbolic_links_in_a_minari_dataset_are_refused(minari, name):
    inside, outside = minari / name, minari.parent / "elsewhere"
    if inside.exists():
        inside.rename(outside)
    inside.symlink_to(outside)
    assert f"{Path(name).name} in the dataset is a symbolic link" in refusal(minari)


def test_a_link_to_a_minari_dataset_is_the_users_own(minari):
    (minari.parent / "link").symlink_to(minari)
    assert load(minari.parent / "link", GOAL).lengths.tolist() == LENGTHS


def test_a_pipe_in_a_minari_dataset_is_refused(minari):
    os.mkfifo(minari / "data" / "pipe")
    assert "pipe in the dataset is neither a file nor a directory" in refusal(minari)


@pytest.mark.parametrize("key", ["observations", "rewards"])
def test_arrays_of_a_minari_dataset_that_lie_elsewhere(minari, secret, key):
    with h5py.File(minari / "data" / "main_data.hdf5", "a") as file:
        del file[f"episode_1/{key}"]
        file[f"episode_1/{key}"] = h5py.ExternalLink(str(secret), "/observations")
    assert f"main_data.hdf5: episode_1/{key} is a link to another file" in refusal(minari)


BOX = {"type": "Box", "shape": [5], "low": [-1] * 5, "high": [1] * 5, "dtype": "float32"}


RUNS = json.dumps(
    {"id": "Any-v0", "entry_point": "os:mkdir", "kwargs": {"path": "canary"}, "additional_wrappers": []}
    | {key: None for key in ("reward_threshold", "max_episode_steps", "vector_entry_point")}
    | {key: False for key in ("nondeterministic", "order_enforce", "disable_env_checker")}
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation_space": None, "env_spec": RUNS}, "does not say what its observation_space is"),
        ({"action_space": None, "env_spec": RUNS}, "does not say what its action_space is"),
        ({"observation_space": "[" * 100_000}, "does not say what its observation_space is"),
        ({"observation_space": json.dumps(BOX | {"dtype": "S1000000000"})}, "numbers of type 'S1000000000'"),
        ({"observation_space": json.dumps(BOX | {"shape": [10**12]})}, "damaged"),
        ({"observation_space": json.dumps({"type": "Nothing"})}, "damaged"),
        ({"total_episodes": 10**12}, "declares total_episodes 1000000000000, but main_data.hdf5 holds 2"),
        ({"total_episodes": 1}, "declares total_episodes 1, but main_data.hdf5 holds 2"),
        ({"total_episodes": True}, "total_episodes in metadata.json must be a whole number"),
        ({"total_steps": 10**9}, "declares total_steps 1000000000, but main_data.hdf5 holds 48"),
        ({"total_steps": -1}, "total_steps in metadata.json must be a whole number"),
        ({"data_format": "arrow"}, "only Minari's hdf5 is read"),
        ({"minari_version": "9.9"}, "does not support"),
    ],
)
def test_metadata_that_asks_for_what_is_not_there(minari, monkeypatch, changes, message):
    monkeypatch.chdir(minari)
    rewrite(minari, **changes)
    assert message in refusal(minari)
    assert not (minari / "canary").exists()


def test_metadata_that_is_none(minari, monkeypatch):
    path = minari / "data" / "metadata.json"
    for content in ("", "[]", "[" * 100_000, "\xff"):
        path.write_text(content, encoding="latin-1")
        assert "metadata.json is damaged" in refusal(minari)
    monkeypatch.setattr(safety, "_METADATA_BYTES", 1000)
    path.write_text(" " * 1001)
    assert "more than the 1 kB it may have" in refusal(minari)


def test_minari_episodes_that_declare_more_than_is_there(minari, monkeypatch):
    with h5py.File(minari / "data" / "main_data.hdf5", "a") as file:
        for key, columns in {"observations": (5,), "actions": (2,), "rewards": ()}.items():
            del file[f"episode_1/{key}"]
            rows = 10**9 + (key == "observations")
            file.create_dataset(f"episode_1/{key}", (rows, *columns), "f4", chunks=(1024, *columns))
    rewrite(minari, total_steps=10**9 + 19)
    assert "the dataset would be 32 GB, but the file can hold at most" in refusal_in_little_memory(minari)


def test_a_minari_dataset_larger_than_memory(minari, monkeypatch):
    monkeypatch.setattr(safety, "free_memory", lambda: 3000)
    assert "of memory, but 3 kB are free" in refusal(minari)


def test_damaged_minari_datasets(minari):
    rng = np.random.default_rng(0)
    refused = 0
    for name in ("main_data.hdf5", "metadata.json"):
        path = minari / "data" / name
        whole = path.read_bytes()
        for _ in range(10):
            path.write_bytes(damaged(whole, rng))
            refused += check_data_or_a_line(minari)
        path.write_bytes(whole)
    assert refused
