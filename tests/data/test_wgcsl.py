"""WGCSL's pickles: what NumPy wrote comes back to the bit, and whatever else a pickle may ask for is not done."""

from __future__ import annotations

import contextlib
import os
import pickle
import pickletools
import subprocess
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from guider.data import load, pickles
from guider.data.episodes import Episodes, make_episodes
from guider.errors import GuiderError

EPISODES, STEPS = 3, 4
GOAL = (3, 4, 5)


def make_log(seed: int = 0) -> dict[str, np.ndarray]:
    """As WGCSL saves it: float64, o and ag with a row more, the goal achieved among the state's entries."""
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(EPISODES, STEPS + 1, 7))
    return {
        "o": o,
        "u": rng.uniform(-1, 1, (EPISODES, STEPS, 2)),
        "g": rng.normal(size=(EPISODES, STEPS, 3)),
        "ag": o[:, :, GOAL].copy(),
    }


def expected(log: dict[str, np.ndarray]) -> Episodes:
    states, actions, goals = [], [], []
    for episode in range(EPISODES):
        states.extend(log["o"][episode])
        actions.extend([*log["u"][episode], np.zeros(2)])
        goals.extend([*log["g"][episode], log["g"][episode][-1]])
    return make_episodes(
        np.array(states), np.array(actions), [STEPS + 1] * EPISODES, GOAL, goals=np.array(goals), source="expected"
    )


def write(folder: Path, content: bytes) -> Path:
    path = folder / "buffer.pkl"
    path.write_bytes(content)
    return path


def as_numpy_1(content: bytes) -> bytes:
    """With the module names of NumPy 1, in text (up to protocol 3) and counted (from 4 on)."""
    content = content.replace(b"cnumpy._core.", b"cnumpy.core.")
    for name in (b"numpy._core.multiarray", b"numpy._core.numeric"):
        old = name.replace(b"_core", b"core")
        content = content.replace(bytes([0x8C, len(name)]) + name, bytes([0x8C, len(old)]) + old)
    assert b"_core" not in content
    return pickletools.optimize(content)  # counts the frames anew


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("numpy_1", [False, True])
def test_every_protocol_and_numpy(tmp_path, protocol, numpy_1):
    log = make_log()
    content = pickle.dumps(log | {"info_is_success": np.ones((EPISODES, STEPS, 1), bool)}, protocol)
    path = write(tmp_path, as_numpy_1(content) if numpy_1 else content)
    episodes = load(path, GOAL)
    assert episodes.fingerprint() == expected(log).fingerprint()
    assert episodes.lengths.tolist() == [STEPS + 1] * EPISODES
    assert load(path, GOAL, format="wgcsl").fingerprint() == episodes.fingerprint()


@pytest.mark.parametrize("protocol", [3, 5])
def test_layouts_and_types_of_numbers(tmp_path, protocol):
    log = make_log()
    log["o"] = np.round(log["o"] * 50) + 0.0  # integers know no -0
    log["ag"] = log["o"][:, :, GOAL]
    stored = {
        "o": np.asfortranarray(log["o"].astype(np.int16)),
        "u": log["u"].astype(">f4"),
        "g": np.asfortranarray(log["g"]),
        "ag": log["ag"].astype(np.float16),
        "scale": np.float64(3.0),
    }
    path = write(tmp_path, pickle.dumps(stored, protocol))
    assert load(path, GOAL).fingerprint() == expected(log).fingerprint()


def test_achieved_goals_outside_the_state_are_put_in_front(tmp_path):
    log = make_log()
    log["ag"] = log["ag"] + 1.0
    path = write(tmp_path, pickle.dumps(log, 3))
    episodes = load(path, (0, 1, 2))
    np.testing.assert_array_equal(episodes.achieved, log["ag"].reshape(-1, 3).astype(np.float32))
    np.testing.assert_array_equal(episodes.observations[:, 3:], log["o"].reshape(-1, 7).astype(np.float32))
    assert episodes.goals is not None
    assert load(path, (3, 4, 5)).goals is None  # the recorded goals are of another goal space


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u": np.zeros((EPISODES, STEPS, 2), object)}, "other than numbers"),
        ({"u": np.full((EPISODES, STEPS, 2), "x")}, "other than numbers"),
        ({"u": np.zeros((EPISODES, STEPS, 2), complex)}, "other than numbers"),
        ({"u": np.zeros((EPISODES, STEPS, 1), [("a", "f8")])}, "other than"),
        ({"u": np.zeros((EPISODES, STEPS + 1, 2))}, "o has shape"),
        ({"u": np.zeros((EPISODES, 2))}, "2 dimensions"),
        ({"u": np.zeros((0, STEPS, 2))}, "no proper shape"),
        ({"u": 3.0}, "u is not an array"),
        ({"u": [1, 2]}, "u is not an array"),
        ({"u": {1: 2}}, "keys are not text"),
        ({"g": np.zeros((EPISODES, STEPS, 2))}, "g has 2 columns but ag has 3"),
        ({"o": np.full((EPISODES, STEPS + 1, 7), np.nan)}, "NaN"),
    ],
)
def test_logs_of_another_kind(tmp_path, change, message):
    with pytest.raises(GuiderError, match=message):
        load(write(tmp_path, pickle.dumps(make_log() | change, 4)), GOAL)


def test_a_log_without_an_entry_or_not_a_log(tmp_path):
    log = make_log()
    del log["ag"]
    for content in (log, make_log()["o"], 3):
        with pytest.raises(GuiderError, match="not a dict with"):
            load(write(tmp_path, pickle.dumps(content, 4)), GOAL)
    with pytest.raises(GuiderError, match="not a pickle"):
        load(write(tmp_path, b"PK\3\4"), GOAL, format="wgcsl")
    with pytest.raises(GuiderError, match=r"nowhere\.pkl"):
        load(tmp_path / "nowhere.pkl", GOAL)


# Hostile files


class Calls:
    """Unpickles as the result of a call, given a state if there is one."""

    def __init__(self, function, *arguments, state=None):
        self.call = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self):
        return self.call


def text(value: str) -> bytes:
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


HOSTILE: dict[str, Callable[[str, str], bytes]] = {
    "system": lambda path, code: pickle.dumps(Calls(os.system, f"touch {path}"), 2),
    "process": lambda path, code: pickle.dumps(Calls(subprocess.call, ["touch", path]), 4),
    "eval": lambda path, code: pickle.dumps(Calls(eval, code), 3),
    "exec": lambda path, code: pickle.dumps(Calls(exec, code), 5),
    "numpy saves": lambda path, code: pickle.dumps(Calls(np.savetxt, path, [1.0]), 2),
    "numpy maps": lambda path, code: pickle.dumps(Calls(np.memmap, path, "f8", "w+", 0, (1,)), 4),
    "beside the log": lambda path, code: pickle.dumps(make_log() | {"extra": Calls(eval, code)}, 4),
    "as an array": lambda path, code: pickle.dumps(make_log() | {"u": Calls(eval, code)}, 2),
    "nested": lambda path, code: pickle.dumps(make_log() | {"u": Calls(np.dtype, Calls(eval, f"{code} or 'f8'"))}, 3),
    "in a shape": lambda path, code: pickle.dumps(make_log() | {"u": Calls(np.ndarray, Calls(eval, f"{code} or 2"))}),
    "dotted": lambda path, code: (
        b"\x80\4" + text("os") + text("path.os.system") + b"\x93" + text(f"touch {path}") + b"\x85R."
    ),
    "instance": lambda path, code: b"\x80\2(" + text(code) + b"ibuiltins\neval\n.",
    "object": lambda path, code: b"\x80\2(cbuiltins\neval\n" + text(code) + b"o.",
    "after the log": lambda path, code: (
        pickle.dumps(make_log(), 2)[:-1] + b"cbuiltins\neval\n" + text(code) + b"\x85R0."
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_nothing_that_a_pickle_asks_for_is_run(tmp_path, kind):
    canary = tmp_path / "canary"
    content = HOSTILE[kind](str(canary), f"open({str(canary)!r}, 'w').close()")
    for format in (None, "wgcsl"):
        with pytest.raises(GuiderError) as raised:
            load(write(tmp_path, content), GOAL, format=format)
        assert "\n" not in str(raised.value)
    assert not canary.exists()
    with contextlib.suppress(Exception):
        pickle.loads(content)
    assert canary.exists()  # the file does what it is meant to do where it is unpickled


def reconstruct(shape: tuple[int, ...], state: tuple | None = None) -> Calls:
    return Calls(np.zeros(1).__reduce__()[0], np.ndarray, shape, b"b", state=state)


def sized(opcode: bytes) -> bytes:
    """A pickle of a few bytes whose only object claims to have 2**40."""
    return b"\x80\5" + opcode + (2**40).to_bytes(8, "little") + b"few."


BOMBS: dict[str, tuple[bytes, str]] = {
    "bytes": (sized(b"\x8e"), "damaged or cut off"),
    "text": (sized(b"\x8d"), "damaged or cut off"),
    "bytearray": (sized(b"\x96"), "damaged or cut off"),
    "memo": (b"\x80\2}r\xff\xff\xff\xff.", "not a dict with o"),
    "allocation": (pickle.dumps(make_log() | {"o": reconstruct((2**40,))}), "o is not an array"),
    "shape": (
        pickle.dumps(make_log() | {"o": reconstruct((0,), (1, (2**20, 2**10, 7), np.dtype("f8"), False, b"8 bytes."))}),
        "o declares shape",
    ),
    "shared keys": (b"\x80\2})" + b"q\0h\0\x86" * 60 + b"Ns.", "keys are not text"),
    "many objects": (b"\x80\2" + b"}" * 20_000 + b".", "opcodes"),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_small_file_cannot_ask_for_much_memory(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(pickles, "_MOST_OPCODES", 10_000)
    content, message = BOMBS[kind]
    path = write(tmp_path, content)
    tracemalloc.start()
    try:
        with pytest.raises(GuiderError, match=message):
            load(path, GOAL)
        assert tracemalloc.get_traced_memory()[1] < 4e6
    finally:
        tracemalloc.stop()


def test_cut_and_garbled_files(tmp_path):
    content = pickle.dumps(make_log(), 4)
    rng = np.random.default_rng(0)
    garbled = []
    for _ in range(300):
        copy = bytearray(content)
        copy[rng.integers(2, len(copy))] = rng.integers(256)
        garbled.append(bytes(copy))
    for damaged in (content[:size] for size in range(2, len(content), 17)):
        with pytest.raises(GuiderError, match="damaged or cut off"):
            load(write(tmp_path, damaged), GOAL)
    refused = 0
    for damaged in garbled:
        try:
            load(write(tmp_path, damaged), GOAL)
        except GuiderError as error:
            assert "\n" not in str(error)
            refused += 1
    assert 0 < refused < 300  # most bytes are numbers
