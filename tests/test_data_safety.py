"""Files that lead elsewhere, that declare what they do not hold, that are damaged or made to do harm: one line each."""

from __future__ import annotations

import errno
import io
import json
import os
import pickle
import shutil
import socket
import tracemalloc
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from recordings import GOAL, antmaze, ends, walk, write_hdf5, write_npz

from guider.data import hdf5_worker, load, safety
from guider.data.store import Recording, open_store
from guider.data.write import write_minari
from guider.errors import GuiderError

LENGTHS = [20, 30]
ARRAYS = walk(LENGTHS) | {"lengths": np.array(LENGTHS)}


def refusal(source: Path | str, **options) -> str:
    """The one line that says why the source is not read."""
    with pytest.raises(GuiderError) as raised:
        load(source, GOAL, **options)
    message = str(raised.value)
    assert len(message.splitlines()) == 1 and len(message) < 600 + len(str(source))
    return message


def refusal_in_little_memory(source: Path) -> str:
    tracemalloc.start()
    try:
        message = refusal(source)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    return message


def hdf5(folder: Path, make: Callable[[h5py.File], object], without: str = "", **options) -> Path:
    """A whole recording, one array left out, and what `make` adds."""
    path = folder / "logs.hdf5"
    with h5py.File(path, "w", **options) as file:
        for key, array in ARRAYS.items():
            if key != without:
                file[key] = array
        make(file)
    return path


# HDF5 stays in its file


@pytest.fixture
def secret(tmp_path) -> Path:
    return write_hdf5(tmp_path / "secret.hdf5", {"observations": np.zeros((50, 5), np.float32)})


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


# npz


def npy(array: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def header(shape: tuple[int, ...], number: str = "<f4") -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": number, "fortran_order": False, "shape": shape})
    return content.getvalue()


MEMBERS = {f"{key}.npy": npy(array) for key, array in ARRAYS.items()}


def archive(folder: Path, *members: tuple[str, bytes]) -> Path:
    path = folder / "logs.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of members that are there twice
        for name, content in members:
            file.writestr(name, content)
    return path


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


# Minari


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


# Damage of every kind


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Some bits flipped, the end cut off, some bytes cut out, zeroed or made up; half of it in the first 2 kB."""
    copy = bytearray(content)
    at = int(rng.integers(min(len(copy), rng.choice([2000, len(copy)]))))
    size = int(rng.integers(1, 200))
    match rng.integers(5):
        case 0:
            copy[at] ^= 1 << int(rng.integers(8))
        case 1:
            del copy[at:]
        case 2:
            del copy[at : at + size]
        case 3:
            copy[at : at + size] = bytes(len(copy[at : at + size]))
        case _:
            copy[at : at + 4] = rng.bytes(len(copy[at : at + 4]))
    return bytes(copy)


def check_data_or_a_line(source: Path) -> bool:
    """Whether the source is refused; anything but data or a line is an error."""
    try:
        load(source, GOAL)
    except GuiderError as error:
        assert len(str(error).splitlines()) == 1
        return True
    return False


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
