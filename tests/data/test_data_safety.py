"""Files that lead elsewhere, that declare what they do not hold, that are damaged or made to do harm: one line each."""

from __future__ import annotations

import errno
import os
import pickle
import socket
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from recordings import (
    ARRAYS,
    GOAL,
    LENGTHS,
    ends,
    hdf5,
    refusal,
    refusal_in_little_memory,
    write_hdf5,
    write_npz,
)

from guider.data import hdf5_worker, load, safety
from guider.data.store import open_store
from guider.errors import GuiderError

# HDF5 stays in its file


@pytest.mark.parametrize("kind", ["external storage", "external link", "virtual dataset", "link to a link"])
def test_hdf5_that_leads_to_other_files_is_refused(tmp_path, secret, kind):
    def elsewhere(file: h5py.File) -> None:
        if kind == "external storage":
            file.create_dataset("observations", (50, 5), "f4", external=[(str(secret), 0, 1000)])
        if kind == "external link":
            file["observations"] = h5py.ExternalLink(str(secret), "/observations")
        if kind == "virtual dataset":
            layout = h5py.VirtualLayout((50, 5), "f4")
            layout[:] = h5py.VirtualSource(str(secret), "observations", (50, 5))
            file.create_virtual_dataset("observations", layout)
        if kind == "link to a link":
            file["there"] = h5py.ExternalLink(str(secret), "/")
            file["observations"] = h5py.SoftLink("/there/observations")

    message = refusal(hdf5(tmp_path, elsewhere, without="observations"))
    assert "another file" in message or "other files" in message
    assert ("there" if kind == "link to a link" else "observations") in message


def test_links_within_the_file_are_followed_once(tmp_path):
    def circles(file: h5py.File) -> None:
        group = file.create_group("group")
        group["itself"], group["root"] = group, file["/"]
        group["states"] = ARRAYS["observations"]
        for _ in range(25):  # 2^25 paths lead down there
            below = group.create_group("a")
            group["b"], group = below, below
        file["observations"] = h5py.SoftLink("/group/states")
        file["nowhere"], file["circle"] = h5py.SoftLink("/missing"), h5py.SoftLink("/circle")

    assert load(hdf5(tmp_path, circles, without="observations"), GOAL).lengths.tolist() == LENGTHS


def test_groups_nested_without_end_are_refused(tmp_path):
    def nest(file: h5py.File) -> None:
        group = file
        for _ in range(3000):
            group = group.create_group("g")

    assert "32 deep" in refusal(hdf5(tmp_path, nest))


def test_names_are_shown_in_a_line(tmp_path):
    path = write_hdf5(tmp_path / "a.hdf5", {"one\nline\x1b[31m": np.zeros(3), "long" * 500: np.zeros(3)})
    assert r"'one\nline\x1b[31m'" in refusal(path)


# HDF5 is opened by another process first


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import os; os.kill(os.getpid(), 11)", r"HDF5's library crashed on it \(SIGSEGV\)"),
        ("import os; os.kill(os.getpid(), 14)", "takes far longer than a file of its size needs"),
        ("import os; os.kill(os.getpid(), 9)", "was killed; there may be too little free memory"),
        ("import nothing_of_this_name", "status 1, ModuleNotFoundError"),
    ],
)
def test_a_file_that_ends_that_process_is_refused(tmp_path, monkeypatch, code, message):
    worker = tmp_path / "worker.py"
    worker.write_text(code)
    monkeypatch.setattr(safety, "_WORKER", worker)
    with pytest.raises(GuiderError, match=message):
        load(write_hdf5(tmp_path / "a.hdf5", ARRAYS), GOAL)


def test_that_process_has_limits(tmp_path, monkeypatch):
    worker = tmp_path / "worker.py"
    worker.write_text(
        f"import json, resource, runpy, signal\n"
        f"runpy.run_path({hdf5_worker.__file__!r})['limit'](20_000_000)\n"
        "limits = [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_CPU, resource.RLIMIT_AS)]\n"
        "try: bytearray(3 << 30)\n"
        "except MemoryError: print(json.dumps({'refused': f'{limits} {signal.alarm(0)}'}))\n"
    )
    monkeypatch.setattr(safety, "_WORKER", worker)
    assert refusal(write_hdf5(tmp_path / "a.hdf5", ARRAYS)).endswith(f"[30, {2 << 30}] 90")


def test_large_arrays_are_read_in_places(tmp_path, monkeypatch):
    rows = np.random.default_rng(0).normal(size=(4000, 5))
    reads = []

    class Watched(h5py.Dataset):
        def __getitem__(self, args, new_dtype=None):  # pyright: ignore[reportIncompatibleMethodOverride]
            reads.append((args.start, min(args.stop, len(self))))
            return super().__getitem__(args, new_dtype=new_dtype)

    monkeypatch.setattr(h5py, "Dataset", Watched)
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file.create_dataset("observations", data=rows, chunks=(10, 5), compression="gzip")
    for read_bytes, rows_read in ((1 << 20, 4000), (16_000, 400)):
        monkeypatch.setattr(hdf5_worker, "_READ_BYTES", read_bytes)
        monkeypatch.setattr(hdf5_worker, "_LEAST_SHARE_BYTES", read_bytes)
        reads.clear()
        (found,) = hdf5_worker.look(str(tmp_path / "a.hdf5"))
        assert found == ["observations", (4000, 5), "f", 8, rows.nbytes]
        assert reads[0][0] == 0 and reads[-1][1] == 4000
        assert len({row for start, stop in reads for row in range(start, stop)}) == rows_read


def test_a_file_that_another_program_writes(tmp_path):
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w") as file:
        file["observations"] = ARRAYS["observations"]
        file.flush()
        assert "another program has it open for writing; close it there" in refusal(path)


def test_a_file_that_was_never_closed(tmp_path):
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w", libver="latest") as file:
        file["observations"] = ARRAYS["observations"]
        file.flush()
        content = path.read_bytes()
    path.write_bytes(content)
    assert "h5clear -s FILE" in refusal(path)


# What is declared is there, and fits


@pytest.mark.parametrize("rows", [10**9, 10**12])
@pytest.mark.parametrize("options", [{}, {"chunks": (1024, 4), "compression": "gzip"}])
def test_hdf5_that_declares_more_than_it_holds(tmp_path, rows, options):
    path = hdf5(
        tmp_path, lambda file: file.create_dataset("observations", (rows, 4), "f4", **options), without="observations"
    )
    size = {10**9: "16 GB", 10**12: "16 TB"}[rows]
    assert (
        f"of shape ({rows}, 4) would be {size}, but the file can hold at most 0 bytes of it"
        in refusal_in_little_memory(path)
    )


def test_flags_that_declare_more_than_the_file_holds(tmp_path):
    def flags(file: h5py.File) -> None:
        file.create_dataset("timeouts", (3_000_000_000,), "?", chunks=(1 << 20,))

    assert "timeouts of shape (3000000000,) would be 3 GB" in refusal_in_little_memory(
        hdf5(tmp_path, flags, without="lengths")
    )


def test_a_shape_of_many_dimensions(tmp_path):
    def many(file: h5py.File) -> None:
        file.create_dataset("observations", (1 << 60,) * 32, "f4", chunks=(1,) * 32)

    assert "and 24 more dimensions" in refusal_in_little_memory(hdf5(tmp_path, many, without="observations"))


def test_what_is_there_but_unpacks_to_more_than_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(safety, "free_memory", lambda: 10_000_000)

    def bomb(file: h5py.File) -> None:
        array = file.create_dataset("observations", (1, 64 << 20), "u1", chunks=(1, 8 << 20), compression="gzip")
        packed = zlib.compress(bytes(8 << 20), 9)
        for start in range(0, 64 << 20, 8 << 20):
            array.id.write_direct_chunk((0, start), packed)

    path = hdf5(tmp_path, bomb, without="observations")
    assert path.stat().st_size < 100_000
    assert "reading observations takes 537 MB of memory, but 10 MB are free" in refusal(path)
    np.savez_compressed(tmp_path / "a.npz", **ARRAYS | {"observations": np.zeros((500_000, 5))})  # pyright: ignore
    assert "reading observations takes 40 MB of memory, but 10 MB are free" in refusal(tmp_path / "a.npz")
    log = {key: np.zeros((100, 10, 3000)) for key in ("o", "u", "g", "ag")}
    (tmp_path / "log.pkl").write_bytes(pickle.dumps(log))
    assert "reading o takes 24 MB of memory, but 10 MB are free" in refusal(tmp_path / "log.pkl")


FILTERS = {
    "none": {"chunks": (16, 5)},
    "gzip": {"compression": "gzip", "compression_opts": 9},
    "gzip, shuffle, checksum": {"compression": "gzip", "shuffle": True, "fletcher32": True},
    "lzf": {"compression": "lzf", "shuffle": True},
    "scale-offset": {"scaleoffset": 3},
}


@pytest.mark.parametrize("filters", FILTERS)
def test_honest_files_pack_well_and_leave_arrays_unwritten(tmp_path, filters, monkeypatch):
    monkeypatch.setattr(safety, "_UNWRITTEN_BYTES", 200_000)
    rows = 300_000
    path = tmp_path / "a.hdf5"
    states = np.zeros((rows, 5), np.float32)
    states[:, 0] = np.arange(rows) % 2
    with h5py.File(path, "w") as file:
        file.create_dataset("observations", data=states, **FILTERS[filters])
        file.create_dataset("actions", data=states[:, :2], chunks=(1000, 2), compression="gzip")
        file.create_dataset("timeouts", data=ends([rows]), chunks=True, compression="gzip")
        file.create_dataset("terminals", (rows // 2,), "?")
        file.create_dataset("rewards", (rows // 2,), "?", chunks=(100,))
    with open_store(path) as store:
        np.testing.assert_array_equal(store.matrix("observations"), states)
        np.testing.assert_array_equal(store.matrix("actions"), states[:, :2])
        np.testing.assert_array_equal(store.vector("timeouts"), ends([rows]))
        assert not store.vector("terminals").any() and not store.vector("rewards").any()


def test_free_memory_is_what_the_tightest_control_group_leaves(monkeypatch):
    files = {
        "/proc/meminfo": "MemTotal: 9000 kB\nMemAvailable:    8000 kB\n",
        "/proc/self/cgroup": "4:memory:/job/step\n1:cpu:/\n0::/a/b\n",
        "/sys/fs/cgroup/a/b/memory.max": "max\n",
        "/sys/fs/cgroup/a/b/memory.current": "1000\n",
        "/sys/fs/cgroup/a/memory.max": "6000000\n",
        "/sys/fs/cgroup/a/memory.current": "3000000\n",
        "/sys/fs/cgroup/a/memory.stat": "anon 7\ninactive_file 500000\n",
        "/sys/fs/cgroup/memory/job/memory.limit_in_bytes": "5000000\n",
        "/sys/fs/cgroup/memory/job/memory.usage_in_bytes": "1000000\n",
    }
    monkeypatch.setattr(safety, "_text", lambda path: files.get(str(path), ""))
    assert safety.free_memory() == 3_500_000
    del files["/sys/fs/cgroup/a/memory.max"]
    assert safety.free_memory() == 4_000_000
    del files["/sys/fs/cgroup/memory/job/memory.limit_in_bytes"]
    assert safety.free_memory() == 8000 * 1024
    files.clear()
    assert safety.free_memory() is None


# What is no file, and what may not be read


def test_pipes_devices_and_sockets_are_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        for name in ("pipe", "socket", "/dev/zero"):
            for format in (None, "arrays", "wgcsl", "minari"):
                assert "a pipe, socket or device" in refusal(name, format=format)


def test_names_that_cannot_be(tmp_path, monkeypatch):
    path = write_npz(tmp_path / "a.npz", ARRAYS)
    assert "no such file" in refusal(tmp_path / "b.npz")
    assert "Not a directory" in refusal(path / "b.npz")
    assert "name too long" in refusal("a" * 300)
    assert "is no path" in refusal("a\0b")
    assert "no home directory" in refusal("~nobody-of-this-name/a.npz")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may read everything
    assert "Permission denied" in refusal(path)


def test_a_disk_that_fails(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.EIO, "Input/output error")

    path = write_npz(tmp_path / "a.npz", ARRAYS)
    monkeypatch.setattr(Path, "open", fail)
    assert "cannot be read (Input/output error)" in refusal(path)
