"""ROS 2 recordings: topics with clocks of their own become rows, whoever speaks how often."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer
from recordings import damaged

from guider.cli import main
from guider.data import load
from guider.data.readers import bags
from guider.errors import GuiderError, GuiderWarning

JOINTS = "string[] name\nfloat64[] position\nfloat64[] velocity"
TWIST = (
    "geometry_msgs/Vector3 linear\nfloat64[9] covariance\n"
    + "=" * 40
    + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y"
)
NOTE = "string data"
SCAN = "float32[] ranges"
SECOND = 10**9


def record(path: Path, messages: list[tuple[float, str, str, str, dict[str, Any]]], **options: Any) -> Path:
    """messages: (seconds, topic, type, its definition, what it says), in the order in which they are written."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in {m[2]: m[3] for m in messages}.items()}
        for number, (seconds, topic, kind, _, content) in enumerate(messages):
            nanoseconds = round(seconds * SECOND)
            writer.write_message(topic, schemas[kind], content, nanoseconds, nanoseconds, number)
        writer.finish()
    return path


def joints(seconds: float, shoulder: float, elbow: float) -> tuple[float, str, str, str, dict[str, Any]]:
    content = {"name": ["shoulder", "elbow"], "position": [shoulder, elbow], "velocity": []}
    return seconds, "/arm/joints", "sensor_msgs/JointState", JOINTS, content


def twist(seconds: float, x: float) -> tuple[float, str, str, str, dict[str, Any]]:
    content = {"linear": {"x": x, "y": 0.5}, "covariance": [0.0] * 9}
    return seconds, "/cmd_vel", "geometry_msgs/Twist", TWIST, content


def drive(path: Path, seconds: float = 3.0, **options: Any) -> Path:
    """The joints speak 20 times a second from 0 on and move by 1 rad/s, the commands 4 times from 0.3 on."""
    messages = [joints(k / 20, k / 20, -k / 20) for k in range(round(20 * seconds))]
    messages += [twist(0.3 + k / 4, k / 10) for k in range(round(4 * (seconds - 0.3)))]
    messages += [(0.05, "/scan", "sensor_msgs/LaserScan", SCAN, {"ranges": [1.0] * 100})]
    messages += [(0.05, "/note", "std_msgs/String", NOTE, {"data": "begin"})]
    return record(path, sorted(messages, key=lambda message: message[0]), **options)


def test_rows_stand_at_the_slowest_clock_by_hand(tmp_path):
    """Commands at 0.3 s, 0.55 s, ...: the joints' last word before was at 0.3 s (their 7th), 0.55 s (12th), ..."""
    path = drive(tmp_path / "a.mcap")
    store = bags.read_mcap(path, [path])
    assert store.kind == "MCAP" and set(store.keys) == {
        "timestamp",
        "arm/joints.position.shoulder",
        "arm/joints.position.elbow",
        "cmd_vel.linear.x",
        "cmd_vel.linear.y",
    }
    times = 0.3 + 0.25 * np.arange(11)
    np.testing.assert_allclose(store.vector("timestamp"), times)
    np.testing.assert_allclose(store.vector("arm/joints.position.shoulder"), times, atol=1e-9)
    np.testing.assert_allclose(store.vector("arm/joints.position.elbow"), -times, atol=1e-9)
    np.testing.assert_allclose(store.vector("cmd_vel.linear.x"), np.arange(11) / 10)


def say(**topics: list[float]) -> dict[str, bags.Topic]:
    """Topics that say the number of their message at these seconds."""
    said = {}
    for name, seconds in topics.items():
        times = array("q", [round(time * SECOND) for time in seconds])
        said[name] = bags.Topic(times, {"x": bags.Column(times, array("d", range(len(seconds))))})
    return said


OFTEN = [0.1 * k for k in range(100)]


def test_who_speaks_too_seldom_is_no_clock():
    found, partial = bags.table(say(often=OFTEN, seldom=[0.0, 4.0, 8.0]))
    assert set(found) == {"timestamp", "often.x", "seldom.x"} and len(found["timestamp"]) == 100 and partial == {}
    assert list(found["seldom.x"][[0, 39, 40, 41, 99]]) == [0, 0, 1, 1, 2]
    lone, _ = bags.table(say(seldom=[0.0, 4.0, 8.0]))
    assert list(lone["seldom.x"]) == [0, 1, 2]
    begun, _ = bags.table(say(often=OFTEN, second=[2.05 + 0.1 * k for k in range(78)]))
    assert begun["timestamp"][0] == pytest.approx(2.1), "rows begin once all have spoken"


def test_topics_that_a_slash_tells_apart_stay_apart():
    found, _ = bags.table({"/a": say(a=OFTEN)["a"], "a": say(a=OFTEN)["a"], "/b": say(b=OFTEN)["b"]})
    assert set(found) == {"timestamp", "/a.x", "a.x", "b.x"}


@pytest.mark.parametrize("times", [[9.0, 9.5], [0.1 * k for k in range(30)], [6.0 + 0.1 * k for k in range(40)]])
def test_who_speaks_for_a_part_only_is_left_out_and_told(times):
    """Late, at the beginning, and at the end: held for the rest, what it said would be wrong."""
    found, partial = bags.table(say(often=OFTEN, part=times))
    assert set(found) == {"timestamp", "often.x"} and len(found["timestamp"]) == 100
    assert (
        list(partial) == ["part"]
        and f"speaks from {times[0]:.3g} to {times[-1]:.3g} s of 9.9 s only" in partial["part"]
    )
    _, late = bags.table(say(often=OFTEN, seldom=[8.0]))
    assert late == {"seldom": "it speaks from 8 s on only"}


def test_there_is_no_row_where_one_had_long_been_silent():
    """The second topic pauses from 3 to 6 s: rows stop half a second, or five spacings, after its last word."""
    second = [0.05 + 0.1 * k for k in range(30)] + [6.05 + 0.1 * k for k in range(39)]
    found, _ = bags.table(say(often=OFTEN, second=second))
    inside = found["timestamp"][(found["timestamp"] > 3.0) & (found["timestamp"] < 6.0)]
    assert inside[-1] == pytest.approx(3.4) and len(inside) == 4


def test_lists_without_names_that_vary_are_left_out_and_joints_may_take_turns(tmp_path):
    messages = [(k / 10, "/list", "std_msgs/L", "float64[] data", {"data": [1.0] * (1 + k % 3)}) for k in range(20)]
    for k in range(20):
        name, value = ("shoulder", k / 10) if k % 2 else ("elbow", -k / 10)
        said = {"name": [name], "position": [value], "velocity": []}
        messages.append((k / 10, "/joints", "sensor_msgs/JointState", JOINTS, said))
    messages += [(k / 10, "/rgb", "std_msgs/C", "uint8[3] data", {"data": bytes([k, 2, 3])}) for k in range(20)]
    path = record(tmp_path / "a.mcap", sorted(messages, key=lambda message: message[0]))
    store = bags.read_mcap(path, [path])
    assert set(store.keys) == {"timestamp", "list.data.0", "joints.position.shoulder", "joints.position.elbow"} | {
        f"rgb.data.{k}" for k in range(3)
    }
    assert list(store.vector("rgb.data.0")[:3]) == [1, 2, 3], "rows begin once both joints have spoken"
    np.testing.assert_allclose(store.vector("joints.position.shoulder")[:4], [0.1, 0.1, 0.3, 0.3])


def test_a_recording_cut_by_its_size_is_one(tmp_path):
    messages = [joints(k / 20, k / 20, -k / 20) for k in range(40)] + [twist(k / 4, k / 10) for k in range(8)]
    messages.sort(key=lambda message: message[0])
    record(tmp_path / "bag_0.mcap", messages[:20])
    record(tmp_path / "bag_1.mcap", messages[20:])
    apart = load(tmp_path, goal=("shoulder",))
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    whole = load(tmp_path, goal=("shoulder",))
    assert list(whole.lengths) == [8] and len(apart.lengths) == 2


def test_a_bag_and_a_folder_of_them_are_logs(tmp_path, capsys):
    """The usual names serve: the command is the action, the rest the state; a folder's files are its episodes."""
    for number in range(3):
        drive(tmp_path / f"{number}.mcap", 3.0 + number)
    found = load(tmp_path / "0.mcap", (0, 1))
    assert found.state_names == ("arm/joints.position.shoulder", "arm/joints.position.elbow")
    assert found.action_names == ("cmd_vel.linear.x", "cmd_vel.linear.y") and list(found.lengths) == [11]
    several = load(tmp_path, goal=("shoulder",), action=("cmd_vel.linear.x",))
    assert list(several.lengths) == [11, 15, 19] and several.goal_indices == (0,) and several.actions.shape == (45, 1)
    assert main(["data", "inspect", str(tmp_path), "--goal", "shoulder", "elbow"]) == 0
    assert "rate hz 4.0" in " ".join(capsys.readouterr().out.split())


def test_what_one_recording_lacks_is_told(tmp_path):
    drive(tmp_path / "a.mcap")
    record(tmp_path / "b.mcap", [joints(k / 20, k / 20, -k / 20) for k in range(40)])
    with pytest.warns(GuiderWarning, match=r"cmd_vel.linear.x \(not in b.mcap\)"), pytest.raises(GuiderError):
        load(tmp_path, (0, 1))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_damage_is_a_line(tmp_path, compression):
    whole = drive(tmp_path / "a.mcap", compression=compression).read_bytes()
    rng, refused = np.random.default_rng(0), 0
    for _ in range(60):
        path = tmp_path / "b.mcap"
        path.write_bytes(damaged(whole, rng))
        try:
            bags.read_mcap(path, [path])
        except GuiderError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
    assert refused > 20


def test_what_says_no_numbers_is_told(tmp_path):
    path = record(tmp_path / "a.mcap", [(0.0, "/note", "std_msgs/String", NOTE, {"data": "hello"})])
    with pytest.raises(GuiderError, match=r"no topic says numbers that can be read; its topics are /note"):
        load(path, (0,))


def test_a_recording_in_which_nothing_was_said_is_left_out(tmp_path):
    for name in "ac":
        drive(tmp_path / f"{name}.mcap")
    record(tmp_path / "b.mcap", [])
    with pytest.warns(GuiderWarning, match=r"left out: .*b.mcap: no topic says numbers"):
        assert list(load(tmp_path, (0, 1)).lengths) == [11, 11]


def test_memory_is_asked_for_first(tmp_path, monkeypatch):
    monkeypatch.setattr("guider.data.safety.free_memory", lambda: 1000)
    with pytest.raises(GuiderError, match="reading its messages takes"):
        load(drive(tmp_path / "a.mcap"), (0,))
    monkeypatch.setattr("guider.data.safety.free_memory", lambda: 20_000)
    monkeypatch.setattr(bags, "_NUMBERS_BETWEEN_LOOKS", 100)
    with pytest.raises(GuiderError, match="its messages are too many; reading more takes"):
        load(drive(tmp_path / "b.mcap", 60.0, chunk_size=1000), (0,))
