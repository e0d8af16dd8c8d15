"""Damage of every kind: data, or a line."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from recordings import (
    ARRAYS,
    LENGTHS,
    antmaze,
    archive,
    check_data_or_a_line,
    damaged,
    npy,
    write_npz,
)


def test_damaged_archives(tmp_path):
    rng = np.random.default_rng(0)
    whole = write_npz(tmp_path / "whole.npz", antmaze(LENGTHS)).read_bytes()
    path = tmp_path / "a.npz"
    refused = 0
    for _ in range(120):
        path.write_bytes(damaged(whole, rng))
        refused += check_data_or_a_line(path)
    assert 60 < refused


@pytest.mark.filterwarnings("ignore::guider.GuiderWarning")
def test_damaged_and_swapped_members_of_whole_archives(tmp_path):
    """The archive's checksums are right, so that NumPy sees every damage."""
    rng = np.random.default_rng(0)
    odd = [
        np.zeros(()),
        np.zeros((50, 5, 1)),
        np.zeros(50, "c16"),
        np.zeros((50, 5), [("a", "f4")]),
        np.full(50, np.nan),
    ]
    members = {f"{key}.npy": npy(array) for key, array in antmaze(LENGTHS).items()}
    refused = 0
    for _ in range(200):
        first, second = rng.choice(list(members), 2)
        changes = [
            {first: members[second], second: members[first]},
            {first: damaged(members[first][:128], rng) + members[first][128:]},
            {first: npy(odd[rng.integers(len(odd))])},
        ]
        refused += check_data_or_a_line(archive(tmp_path, *(members | changes[rng.integers(3)]).items()))
    assert 80 < refused < 200


@pytest.mark.parametrize("options", [{}, {"chunks": True, "compression": "gzip", "fletcher32": True}])
@pytest.mark.filterwarnings("ignore::guider.GuiderWarning")
def test_damaged_hdf5(tmp_path, options):
    rng = np.random.default_rng(0)
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w") as file:
        for key, array in ARRAYS.items():
            file.create_dataset(key, data=array, **options)
    whole = path.read_bytes()
    refused = 0
    for _ in range(12):
        path.write_bytes(damaged(whole, rng))
        refused += check_data_or_a_line(path)
    assert refused
