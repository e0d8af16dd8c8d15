"""Archives that hold what no honest one has, or declare what they do not hold."""

from __future__ import annotations

import io
import pickle

import numpy as np
import pytest
from recordings import (
    ARRAYS,
    archive,
    npy,
    refusal,
    refusal_in_little_memory,
)


def header(shape: tuple[int, ...], number: str = "<f4") -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": number, "fortran_order": False, "shape": shape})
    return content.getvalue()


MEMBERS = {f"{key}.npy": npy(array) for key, array in ARRAYS.items()}


@pytest.mark.parametrize(
    ("member", "message"),
    [
        (("../a.npy", b""), "'../a.npy' names a place outside"),
        (("a/../../b.npy", b""), "names a place outside"),
        (("/etc/a.npy", b""), "'/etc/a.npy' names a place outside"),
        (("actions.npy", b""), "holds 'actions' more than once"),
        (("actions", b""), "holds 'actions' more than once"),
    ],
)
def test_members_that_no_honest_archive_has(tmp_path, member, message):
    assert message in refusal(archive(tmp_path, *MEMBERS.items(), member))


@pytest.mark.parametrize(
    ("byte", "value", "message"), [(8, 1, "'observations.npy' is encrypted"), (10, 14, "in a way that NumPy")]
)
def test_members_that_are_encrypted_or_packed_otherwise(tmp_path, byte, value, message):
    path = archive(tmp_path, *MEMBERS.items())
    content = bytearray(path.read_bytes())
    content[content.find(b"PK\x01\x02") + byte] = value  # the first member's entry in the archive's list
    path.write_bytes(content)
    assert message in refusal(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "observations.npy",
            header((10**9, 4)),
            "(1000000000, 4) would be 16 GB, but the file can hold at most 0 bytes",
        ),
        ("observations.npy", header((10**12, 4)), "would be 16 TB"),
        ("observations.npy", header((2,) * 80), "and 72 more dimensions"),
        ("observations.npy", header((-5, 4)), "cannot read observations"),
        ("observations.npy", header((50, 4), "|S1000000000"), "would be 200 GB"),
        ("lengths.npy", header((3 * 10**9,), "|i1"), "lengths of shape (3000000000,) would be 3 GB"),
        ("lengths.npy", npy(np.array([2**62, 2**62])), "episode lengths must be"),
        ("observations.npy", pickle.dumps([1.0]), "observations is not an array that NumPy saved"),
        (
            "observations.npy",
            b"\x93NUMPY\x01\x00\x76\x00" + b"(" * 118,
            "observations is not an array that NumPy saved",
        ),
        ("observations.npy", b"", "observations is not an array that NumPy saved"),
    ],
)
@pytest.mark.filterwarnings("ignore::guider.GuiderWarning")
def test_members_that_declare_what_they_do_not_hold(tmp_path, name, content, message):
    path = archive(tmp_path, *(MEMBERS | {name: content}).items())
    assert message in refusal_in_little_memory(path)


def test_an_archive_that_lies_about_what_is_stored(tmp_path):
    path = archive(tmp_path, *(MEMBERS | {"observations.npy": header((10**9, 4))}).items())
    content = bytearray(path.read_bytes())
    entry = content.find(b"PK\x01\x02")
    content[entry + 20 : entry + 28] = b"\xf0" * 8  # bytes when packed, and unpacked
    path.write_bytes(content)
    assert "would be 16 GB, but the file can hold at most" in refusal_in_little_memory(path)
