"""Recordings of ROS, played as recordings of ours."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from ros_tools import (
    BEGIN,
    OLD_STORE,
    STORE,
    encoded,
    joint_state,
    read_joint_states,
    write_bag,
)
from test_cli import run

from sero_mj.base.errors import DeclarationError, RecordingError, UsageError
from sero_mj.cli.arguments import replay_instead
from sero_mj.cli.shared_options import is_recording
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.source import RoutedJoint
from sero_mj.data.record.replay import Replay
from sero_mj.extensions.ros.bag import DESCRIPTION, Bag, open_recording
from sero_mj.extensions.ros.described_scene import scenes_of_bag
from sero_mj.extensions.tables.run import read_run_table
from sero_mj.extensions.tables.table import read_csv
from sero_mj.load import load_scene
from sero_mj.simulate.runs.run_recording import read_run

KINDS = ("mcap", "db3", "bag")
COUNT, STEP = 400, 10**7  # messages, and ns between them
ORDER = [3, 1, 7, 2, 4, 6, 5]  # of the joints in messages
NAMES = [f"fr3_joint{i}" for i in ORDER]
LED = [RoutedJoint(f"fr3_joint{i}") for i in range(1, 8)]


def angles(k: int) -> np.ndarray:
    """Of joints 1 to 7 in message k."""
    return np.sin(0.01 * k + np.arange(7.0))


def states(store: Any = STORE, names: list[str] = NAMES) -> list[tuple[int, Any]]:
    order = np.array(ORDER) - 1
    return [
        (
            k * STEP,
            joint_state(names, angles(k)[order], (), 10 * angles(k)[order], k * STEP + 1, store),
        )
        for k in range(COUNT)
    ]


@pytest.fixture(scope="module", params=KINDS)
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    kind = str(request.param)
    path = tmp_path_factory.mktemp(kind) / ("drive.bag" if kind == "bag" else "drive")
    store = OLD_STORE if kind == "bag" else STORE
    text = store.types["std_msgs/msg/String"]("<robot name='x'/>")
    topics = {"/joint_states": states(store), "/robot_description": [(0, text)]}
    return write_bag(path, topics, kind)


def test_packets_are_those_of_the_messages_in_the_robot_s_order(bag: Path) -> None:
    replay = Replay(name="drive", file=bag)
    replay.set_joints(LED)
    assert replay.events["joint_angles"] == (7,)
    with open_recording(bag) as recording:
        assert isinstance(recording, Bag)
        assert list(recording.sources) == ["joint_states"]
        assert recording.duration == pytest.approx((COUNT - 1) * STEP / 1e9)
        assert recording.sources["joint_states"].count == COUNT
        assert recording.read_attachment(DESCRIPTION) == b"<robot name='x'/>"
    with replay:
        replay.start_history()
        replay.advance_to(100.0)
        packets = replay.take_history()
    assert packets is not None
    found = packets.values["joint_angles"]
    # The first one was there when it was opened.
    assert found == pytest.approx(np.array([angles(k) for k in range(1, COUNT)]))
    assert packets.values["torques"] == pytest.approx(10 * found)
    assert packets.arrivals == pytest.approx(np.arange(1, COUNT) * STEP / 1e9)


@pytest.mark.parametrize("time", [0.0, 0.004, 1.234, 3.99, 50.0])
def test_seeking_gives_what_playing_up_to_there_gives(bag: Path, time: float) -> None:
    with open_recording(bag) as recording:
        played = [entry for entry in recording.packets("joint_states") if entry[0] <= time]
        assert recording.last_before("joint_states", time) == played[-1]
        rest = list(recording.packets("joint_states", time))
        assert rest == [e for e in recording.packets("joint_states") if e[0] >= time]
        assert recording.last_before("joint_states", -1.0) is None


@pytest.mark.thorough
def test_robot_alone_is_moved_by_a_bag(bag: Path, tmp_path: Path, capsys: Any) -> None:
    picture = tmp_path / "seen.png"
    still = tmp_path / "still.png"
    command = ["render", "fr3", "--replay", str(bag), "--size", "160x120", "--output"]
    assert run(capsys, *command, str(picture), "--at", "3")[0] == 0
    assert run(capsys, *command, str(still), "--at", "0")[0] == 0
    assert picture.read_bytes() != still.read_bytes()


def test_bag_is_a_table_and_a_run(bag: Path, tmp_path: Path, capsys: Any) -> None:
    table = tmp_path / "drive.csv"
    assert run(capsys, "export", str(bag), str(table))[0] == 0
    header, *rows = table.read_text(encoding="utf-8").splitlines()
    assert header.split(",")[:3] == ["time", "stamp[0]", "joint_angles[fr3_joint1]"]
    assert len(rows) == COUNT
    assert list(map(float, rows[5].split(",")[2:9])) == pytest.approx(angles(5))
    log = read_run(bag, scene=load_scene("fr3"))
    assert log.signals["fr3_joint_angles"] == pytest.approx(
        np.array([angles(k) for k in range(COUNT)])
    )
    assert log.signals["fr3_torques"][5] == pytest.approx(10 * angles(5))


def test_scenes_read_what_their_source_reads_live(tmp_path: Path) -> None:
    wrench = STORE.types["geometry_msgs/msg/WrenchStamped"]
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    both = STORE.types["geometry_msgs/msg/Wrench"](vector(1, 2, 3), vector(4, 5, 6))
    force = wrench(joint_state(()).header, both)
    other = states(names=[f"left_{name}" for name in NAMES])
    bag = write_bag(
        tmp_path / "both",
        {"/left/joint_states": other, "/right/joint_states": states(), "/ft": [(0, force)]},
    )
    file = tmp_path / "scene.toml"
    file.write_text(
        """
[robots.arm]
model = "fr3"
[sources.ros]
kind = "ros2"
namespace = "left"
wrench = "/ft"
[arrows.contact]
at = "arm/flange"
[routes]
"arm.joint_angles" = "ros.joint_angles"
"contact.vector" = "ros.force[0]"
""",
        encoding="utf-8",
    )
    scene = load_scene(file)
    replay_instead(scene, bag, None)
    with Mirror(scene) as mirror:
        mirror.advance(0.0)
        mirror.advance(2.0)
        assert mirror.data.qpos == pytest.approx(angles(200), abs=0.05)
        packet = mirror.sources["ros"].latest()
        assert packet is not None
        assert packet.values["force"].tolist() == [[1, 2, 3]]


def test_source_can_replay_a_bag(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(
        f"""
[robots.arm]
model = "fr3"
[sources.drive]
kind = "replay"
file = "{bag}"
[routes]
"arm.joint_angles" = "drive.joint_angles"
""",
        encoding="utf-8",
    )
    with Mirror(load_scene(file)) as mirror:
        mirror.advance(0.0)
        mirror.advance(1.0)
        assert mirror.data.qpos == pytest.approx(angles(100), abs=0.02)


def test_topics_have_to_be_chosen_where_there_are_several(tmp_path: Path, capsys: Any) -> None:
    bag = write_bag(tmp_path / "two", {"/a/joint_states": states(), "/b/joint_states": states()})
    several = "has several sources: " + "; ".join(
        f"{name}_joint_states (topic /{name}/joint_states, 400 messages, joints fr3_joint3, "
        "fr3_joint1, fr3_joint7 and 4 more)"
        for name in "ab"
    )
    chosen = f'{several}; choose one with source = "a_joint_states"'
    with pytest.raises(DeclarationError, match=re.escape(chosen)):
        Replay(file=bag)
    status, _, told = run(capsys, "export", str(bag), str(tmp_path / "out.csv"))
    assert status == 2 and f"{several}; choose one with --source a_joint_states" in told
    picture = ["-o", str(tmp_path / "seen.png"), "--size", "80x60"]
    status, _, told = run(capsys, "render", "fr3", "--replay", str(bag), *picture)
    assert status == 2 and several in told and "--source a_joint_states" in told
    command = ["render", str(bag), *picture, "--source"]
    status, _, told = run(capsys, *command, "b_joint_stats")
    assert status == 2 and "; did you mean 'b_joint_states'?" in told
    assert run(capsys, *command, "b_joint_states")[0] == 0
    with pytest.raises(UsageError, match=r"scene 'lwr_udp' has its own sources \(udp\)"):
        replay_instead(load_scene("lwr_udp"), bag, None, "b_joint_states")
    assert Replay(file=bag, source="b_joint_states").recorded.count == COUNT
    assert Replay(file=bag, topics={"joint_states": "/a/joint_states"}).recorded.name == "replay"
    with pytest.raises(DeclarationError, match=r"topics: .* has none of these"):
        Replay(file=bag, topics={"joint_states": "/c"})


def test_reason_for_skipped_messages_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Also where no other message is in the recording."""
    states = [(k * STEP, joint_state([*UR, UR[0]], np.zeros(7))) for k in range(3)]
    bag = write_bag(tmp_path / "odd", {"/joint_states": states})
    scene = load_scene("ur5e")
    replay_instead(scene, bag, None)
    (replay,) = wire(scene).sources.values()
    with replay:
        assert replay.counters.last_fault == f"joint {UR[0]} is named twice"
    caplog.clear()
    with pytest.raises(RecordingError, match="has no valid packet for"):
        read_run(bag, scene=load_scene("ur5e"))
    assert caplog.records[-1].args == (
        bag,
        f"a message of /joint_states was skipped: joint {UR[0]} is named twice",
    )


def damaged(bag: Path, to: Path, cut: float) -> Path:
    """A copy of a bag whose largest file is cut off."""
    if bag.is_dir():
        shutil.copytree(bag, to)
        file = max(to.iterdir(), key=lambda each: each.stat().st_size)
    else:
        file = Path(shutil.copy(bag, to.with_suffix(bag.suffix)))
        to = file
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * cut)])
    return to


def write_chunks(path: Path, compression: CompressionType, *, chunked: bool) -> bytes:
    """Writes what a recorder of ROS 2 would, in chunks of about 28 messages; returns the file."""
    text, _ = STORE.generate_msgdef("sensor_msgs/msg/JointState", ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file, 8000, compression, use_chunking=chunked)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for time, message in states():
            writer.add_message(channel, BEGIN + time, encoded(message), BEGIN + time)
        writer.finish()
    return path.read_bytes()


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize(
    ("compression", "chunked"),
    [(CompressionType.ZSTD, True), (CompressionType.NONE, True), (CompressionType.NONE, False)],
)
def test_intact_part_of_a_truncated_bag_is_read(
    compression: CompressionType, chunked: bool, cut: float, tmp_path: Path
) -> None:
    whole, path = tmp_path / "whole.mcap", tmp_path / "folder" / "cut_0.mcap"
    data = write_chunks(whole, compression, chunked=chunked)
    path.parent.mkdir()  # without metadata.yaml, as after a recorder that was killed
    path.write_bytes(data[: int(cut * len(data))])
    with open_recording(whole) as recording:
        expected = list(recording.packets("joint_states"))
    for opened in (path, path.parent):
        with open_recording(opened) as recording:
            found = list(recording.packets("joint_states"))
            assert recording.sources["joint_states"].count == len(found)
            (fault,) = recording.faults
            before = recording.last_before("joint_states", 0.101)
        assert found == expected[: len(found)]
        assert cut * COUNT - 40 < len(found) <= COUNT
        assert before == expected[10]
        assert fault.startswith(
            "was not closed" if cut > 0.99 else "is truncated or damaged at byte"
        )


def test_damaged_chunk_of_a_truncated_bag_loses_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    data = bytearray(write_chunks(path, CompressionType.NONE, chunked=True)[:60_000])
    data[20_000] ^= 255
    path.write_bytes(data)
    with open_recording(path) as recording:
        found = list(recording.packets("joint_states"))
        assert "is damaged (its checksum is wrong) and skipped" in recording.faults[0]
    times = np.diff([time for time, _ in found])
    assert 20 * STEP < 1e9 * times.max() < 40 * STEP and len(found) > 120


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("mcap", "is truncated or damaged at byte 43 .*; no message before that can be read"),
        ("db3", r"is cut off \(.*\): \d+ of \d+ bytes are missing; what is left may be saved"),
        ("bag", "is truncated or damaged .*, so its index cannot be read; `rosbag reindex`"),
    ],
)
def test_bag_without_intact_messages_is_reported(kind: str, why: str, tmp_path: Path) -> None:
    store = OLD_STORE if kind == "bag" else STORE
    bag = write_bag(tmp_path / ("a.bag" if kind == "bag" else "a"), {"/j": states(store)}, kind)
    with pytest.raises(RecordingError, match=why):
        open_recording(damaged(bag, tmp_path / "cut", 0.5))
    if kind != "mcap":
        with pytest.raises(RecordingError, match=r"is empty \(its process was killed"):
            open_recording(damaged(bag, tmp_path / "none", 0.0))


@pytest.mark.thorough
def test_folder_without_metadata_is_read_as_its_only_file(tmp_path: Path, capsys: Any) -> None:
    for kind in ("mcap", "db3"):
        bag = write_bag(tmp_path / kind, {"/joint_states": states()}, kind)
        (bag / "metadata.yaml").unlink()
        picture = ["-o", str(tmp_path / f"{kind}.png"), "--size", "80x60"]
        assert run(capsys, "render", str(bag), *picture)[0] == 0
    (bag / "other.mcap").touch()
    with pytest.raises(RecordingError, match=r"Open one of them: db3\.db3, other\.mcap$"):
        open_recording(bag)


@pytest.mark.parametrize("is_cut", [False, True])
def test_parts_of_a_recording_without_metadata_are_read_in_their_order(
    tmp_path: Path, is_cut: bool
) -> None:
    bag, half = tmp_path / "parts", COUNT // 2
    bag.mkdir()
    (bag / "notes.md").touch()
    for k, part in enumerate([states()[:half], states()[half:]]):
        whole = write_bag(tmp_path / f"part{k}", {"/joint_states": part})
        (whole / f"part{k}.mcap").rename(bag / f"parts_{k}.mcap")
    if is_cut:
        last = bag / "parts_1.mcap"
        last.write_bytes(last.read_bytes()[:-40])
    assert is_recording(bag)
    with Replay(file=bag) as replay:
        assert replay.recorded.count == COUNT
        assert replay.duration == pytest.approx((COUNT - 1) * STEP / 1e9)
    (bag / "robot.toml").touch()  # so the folder is a robot
    assert not is_recording(bag)


def test_messages_in_the_write_ahead_log_of_a_database_are_read(
    tmp_path: Path, capsys: Any
) -> None:
    folder = write_bag(tmp_path / "drive", {"/joint_states": states()[:100]}, "db3")
    (file,) = folder.glob("*.db3")
    # As a recorder that is killed: closing a database would take the log into it.
    code = f"""
import os, sqlite3
written = sqlite3.connect({str(file)!r})
written.execute("PRAGMA journal_mode = WAL")
written.execute("INSERT INTO messages SELECT id + 1000, topic_id, timestamp + 1000000000, data "
                "FROM messages")
written.commit()
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    before = {each.name: each.read_bytes() for each in folder.iterdir()}
    assert before[f"{file.name}-wal"]
    for path in (file, folder):
        with open_recording(path) as recording:
            assert recording.sources["joint_states"].count == 200
            assert recording.duration == pytest.approx(1.99)
            (told,) = recording.faults
        assert "drive.db3-wal are included; 200 messages of 2.0 s can be read" in told
    _, out, _ = run(capsys, "export", str(folder), str(tmp_path / "drive.csv"))
    assert f"note: {folder}: {told}" in out and "200 rows" in out
    assert {each.name: each.read_bytes() for each in folder.iterdir()} == before


@pytest.mark.thorough
def test_commands_for_runs_report_the_readable_part_of_a_truncated_bag(
    tmp_path: Path, capsys: Any, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "cut.mcap"
    data = write_chunks(tmp_path / "whole.mcap", CompressionType.ZSTD, chunked=True)
    path.write_bytes(data[: len(data) // 2])
    with open_recording(path) as recording:
        count = recording.sources["joint_states"].count
    assert run(capsys, "plot", str(path), "-o", str(tmp_path / "cut.pdf"))[0] == 0
    (told,) = [each.getMessage() for each in caplog.records]
    assert told.startswith(f"{path}: is truncated or damaged at byte ")
    assert told.endswith(f"; {count} messages of {(count - 1) * STEP / 1e9:.1f} s can be read")


def test_unclosed_ros_1_bag_suggests_reindexing(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "drive.bag", {"/joint_states": states(OLD_STORE)}, "bag")
    data = bytearray(bag.read_bytes())
    index = data.index(b"index_pos=") + len(b"index_pos=")
    data[index : index + 8] = bytes(8)
    for name in ("drive.bag", "drive.bag.active"):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(
            RecordingError, match=f"so it has no index; create it with `rosbag reindex {path}`"
        ):
            open_recording(path)


@pytest.mark.parametrize("cut", [0.0, 0.01, 0.5, 0.97])
def test_damaged_bags_are_errors_or_end_early(bag: Path, tmp_path: Path, cut: float) -> None:
    path = damaged(bag, tmp_path / "cut", cut)
    try:
        with open_recording(path) as recording:
            found = list(recording.packets("joint_states"))
    except RecordingError as error:
        assert str(path) in str(error)
    else:
        assert len(found) <= COUNT
        assert recording.faults


def test_bag_without_joints_reports_its_topics(tmp_path: Path) -> None:
    text = STORE.types["std_msgs/msg/String"]("hello")
    bag = write_bag(tmp_path / "text", {"/chatter": [(0, text)]})
    with pytest.raises(RecordingError, match=r"/chatter \(std_msgs/msg/String\)") as caught:
        open_recording(bag)
    assert "expected one of sensor_msgs/msg/JointState" in str(caught.value)


def test_malformed_messages_of_a_bag_are_counted(tmp_path: Path) -> None:
    entries = states()
    entries[7] = (7 * STEP, joint_state(NAMES, [1.0]))
    entries[8] = (8 * STEP, joint_state(NAMES, [math.nan] * 7))
    bag = write_bag(tmp_path / "bad", {"/joint_states": entries})
    with Replay(file=bag) as replay:
        replay.advance_to(100.0)
        assert replay.counters.received == COUNT
        assert (replay.counters.wrong_size, replay.counters.not_finite) == (1, 1)


def test_recordings_of_runs_have_the_states_of_joints_for_ros(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "run.mcap"
    command = ["simulate", "impedance_push", "--record", str(path)]
    assert run(capsys, *command)[0] == 0
    log = read_run(path)
    ((topic, messages),) = read_joint_states(path).items()
    assert topic == "/lwr/joint_states"
    assert [*messages[0][1].name] == list(log.robots["lwr"].names)
    for time, message in messages:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert stamp == time
        k = int(np.argmin(abs(log.times - (time - messages[0][0]) / 1e9)))
        for event, numbers in (
            ("joint_angles", message.position),
            ("joint_velocities", message.velocity),
            ("torques", message.effort),
        ):
            assert numbers == pytest.approx(log.signals[f"lwr_{event}"][k])


def test_check_reports_a_bag_of_another_robot(tmp_path: Path, capsys: Any) -> None:
    write_bag(tmp_path / "xarm", {"/xarm/joint_states": states(names=list("abcdefg"))})
    file = tmp_path / "scene.toml"
    file.write_text(
        """
[robots.arm]
model = "fr3"
[sources.xarm]
kind = "replay"
file = "xarm"
[routes]
"arm.joint_angles" = "xarm.joint_angles"
""",
        encoding="utf-8",
    )
    status, said, _ = run(capsys, "check", str(file))
    assert status == 0
    assert f"replay of {tmp_path / 'xarm'}, {COUNT} unusable packets" in " ".join(said.split())
    status, _, told = run(capsys, "render", str(file), "-o", str(tmp_path / "seen.png"))
    assert status == 2 and "no message has the required joints" in told


ARM = [f"joint{i}" for i in range(1, 7)]


def described(path: Path, more: dict[str, Any] | None = None) -> Path:
    """A bag of an arm of its own whose meshes nobody has."""
    link = (
        '<link name="l{i}"><visual><geometry><mesh filename="package://arm/l{i}.stl"/></geometry>'
        '</visual><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
    )
    joint = (
        '<joint name="joint{i}" type="revolute"><origin xyz="0 0 0.2"/><parent link="l{k}"/>'
        '<child link="l{i}"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="10" velocity="1"/></joint>'
    )
    parts = [link.format(i=i) for i in range(7)] + [joint.format(i=i, k=i - 1) for i in range(1, 7)]
    text = STORE.types["std_msgs/msg/String"](f"<robot name='arm'>{''.join(parts)}</robot>")
    own = [(k * STEP, joint_state(ARM, angles(k)[:6], (), angles(k)[:6])) for k in range(COUNT)]
    topics = {"/joint_states": own, "/robot_description": [(0, text)], **(more or {})}
    return write_bag(path, topics)


@pytest.mark.thorough
def test_commands_for_runs_find_the_robot_of_a_bag(tmp_path: Path, capsys: Any) -> None:
    own = described(tmp_path / "own")
    plot = ["plot", str(own), "-o", str(tmp_path / "own.pdf")]
    assert run(capsys, *plot)[0] == 0
    assert run(capsys, *plot, "--robot", "arm")[0] == 0
    status, _, told = run(capsys, *plot, "--robot", "fr4")
    assert status == 2 and "no scene or robot 'fr4'; did you mean 'fr3'?" in told
    path = write_bag(tmp_path / "shipped", {"/joint_states": states()})
    status, said, told = run(capsys, "compare", str(path), str(path))
    assert status == 0 and "fr3_joint7" in said
    chosen = f"note: {path} does not describe its robot; using fr3, which has the same joint names"
    assert told.splitlines() == [chosen] * 2
    other = write_bag(tmp_path / "other", {"/joint_states": states(names=list("abcdefg"))})
    status, _, told = run(capsys, "plot", str(other), "-o", str(tmp_path / "other.pdf"))
    assert status == 2 and "no included robot has these joints" in told and "--scene SCENE" in told


def test_robot_is_moved_by_the_topic_with_its_joints(tmp_path: Path, capsys: Any) -> None:
    # Joints of the FR3 are called as those of the arm are, behind a prefix.
    both = described(tmp_path / "both", {"/fr3/joint_states": states()})
    for name, source in (("fr3", "fr3_joint_states"), ("ur5e", None)):
        scene = load_scene(name)
        if source is None:
            with pytest.raises(UsageError, match=r"several sources: .* --source joint_states"):
                replay_instead(scene, both, None)
        else:
            replay_instead(scene, both, None)
            assert list(scene.sources) == [source]
    log = read_run(both, scene=load_scene("fr3"))
    assert log.signals["fr3_joint_angles"][9] == pytest.approx(angles(9))
    with pytest.raises(UsageError, match="choose one with --source "):
        read_run(both, scene=load_scene("ur5e"))
    assert run(capsys, "plot", str(both), "-o", str(tmp_path / "both.pdf"))[0] == 0


def test_missing_meshes_of_a_described_robot_are_reported_once(
    tmp_path: Path, capsys: Any, caplog: pytest.LogCaptureFixture
) -> None:
    path = described(tmp_path / "own")
    picture = ["-o", str(tmp_path / "own.png"), "--size", "80x60"]
    assert run(capsys, "render", str(path), *picture)[0] == 0
    (told,) = [each.getMessage() for each in caplog.records if "mesh" in each.getMessage()]
    assert told == (
        "arm.urdf: 7 mesh files were not found; collision shapes are shown instead; "
        "set its folder with --package arm=DIR: package://arm/l0.stl, package://arm/l1.stl, "
        "package://arm/l2.stl and 4 more"
    )


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_check_and_status_accept_a_bag_like_view(kind: str, tmp_path: Path, capsys: Any) -> None:
    name = "drive.bag" if kind == "bag" else "drive"
    store = OLD_STORE if kind == "bag" else STORE
    path = write_bag(tmp_path / name, {"/joint_states": states(store)}, kind)
    for scene in ([str(path)], ["fr3", "--replay", str(path)]):
        status, out, _ = run(capsys, "check", *scene)
        assert status == 0
        assert f"joint_states:replayof{path},4.0s" in "".join(out.split())
        assert "joint_states.torques -> fr3.torques" in out
        status, out, _ = run(capsys, "status", *scene, "--duration", "0.3")
        assert status == 0 and "received" in out
    other = write_bag(tmp_path / "other", {"/joint_states": states(names=list("abcdefg"))})
    status, _, told = run(capsys, "check", str(other))
    assert (
        status == 2
        and "found no scene that has the sources of" in told
        and "--replay other" in told
    )


UR = [
    "elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
]  # fmt: skip


def ur_states(names: list[str], step: int = 0) -> list[tuple[int, Any]]:
    """States in which a joint is at 0.1 times its number in the alphabet, plus 0.001 k."""
    values = 0.1 * np.array([UR.index(name) for name in names])
    return [(k * STEP + step, joint_state(names, values + 1e-3 * k)) for k in range(COUNT)]


def test_ambiguous_robot_is_not_chosen_automatically(tmp_path: Path, capsys: Any) -> None:
    bag = write_bag(tmp_path / "ur", {"/joint_states": ur_states(UR)})
    picture = ["-o", str(tmp_path / "seen.png"), "--size", "80x60"]
    fits = f"{bag} does not describe its robot, and ur10e, ur5e have the same joint names"
    for command, how in (
        (["render", str(bag), *picture], f"sero-mj view ur10e --replay {bag}"),
        (["compare", str(bag), str(bag)], "--scene ur10e"),
    ):
        status, _, told = run(capsys, *command)
        assert status == 2 and f"{fits}. Choose one: {how}" in told
    with open_recording(bag) as recording:
        assert isinstance(recording, Bag)
        assert list(scenes_of_bag(recording, "", wanted=["ur5e"])) == ["ur5e"]


def test_columns_are_called_by_joints_in_the_order_of_the_robot(
    tmp_path: Path, capsys: Any
) -> None:
    """Two devices publish the joints of one robot, in an order of their own."""
    own = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", *UR[3:]]
    messages = [*ur_states(UR[3:]), *ur_states(UR[:3], step=STEP // 8)]
    messages.sort(key=lambda each: each[0])
    # A message that contradicts itself costs itself only.
    messages.insert(0, (0, joint_state([UR[0], UR[0]], [1, 2])))
    bag, table = write_bag(tmp_path / "ur", {"/joint_states": messages}), tmp_path / "ur.csv"
    status, said, _ = run(capsys, "export", str(bag), str(table))
    assert status == 0 and "joints in the order of ur10e and ur5e, 1 malformed packet" in said
    assert f"a message of /joint_states was skipped: joint {UR[0]} is named twice" in said
    _, columns = read_csv(table)
    assert list(columns)[1:7] == [f"joint_angles[{name}]" for name in own]
    wrist = columns["joint_angles[wrist_2_joint]"]
    assert wrist == pytest.approx(0.1 * UR.index("wrist_2_joint") + 1e-3 * np.arange(len(wrist)))
    # Nobody has told of these joints before: no angle is made up.
    assert np.isnan(columns["joint_angles[shoulder_pan_joint]"][0])
    # It is read again, without a route.
    again = read_run_table(table, load_scene("ur5e"))
    assert again.robots["ur5e"].names == own
    pan = again.signals["ur5e_joint_angles"][:, 0]
    assert pan[1:] == pytest.approx(columns["joint_angles[shoulder_pan_joint]"][1:])
    elsewhere = [str(bag), str(table), "--overwrite", "--scene", "fr3"]
    status, _, told = run(capsys, "export", *elsewhere)
    assert status == 2 and "--scene fr3" in told and "fr3_joint1, " in told and UR[3] in told


def test_messages_without_joint_names_belong_to_the_named_robot(
    tmp_path: Path, capsys: Any
) -> None:
    messages = [(k * STEP, joint_state([], angles(k))) for k in range(COUNT)]
    bag = write_bag(tmp_path / "bare", {"/joint_states": messages})
    why = f"{bag}: the messages of /joint_states do not name their joints. Choose a scene"
    picture = ["-o", str(tmp_path / "seen.png"), "--size", "80x60"]
    for command in (
        ["render", str(bag), *picture],
        ["plot", str(bag), "-o", str(tmp_path / "seen.pdf")],
        ["export", str(bag), str(tmp_path / "seen.csv")],
        ["send", "lwr_udp", "--play", str(bag)],
    ):
        status, _, told = run(capsys, *command)
        assert status == 2 and why in told, command
    log = read_run(bag, scene=load_scene("fr3"))
    assert log.signals["fr3_joint_angles"][9] == pytest.approx(angles(9))
    assert run(capsys, "render", "fr3", "--replay", str(bag), *picture)[0] == 0


def json_bag(path: Path, topics: dict[str, list[Any]]) -> Path:
    """Writes messages in JSON as MCAP."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096)
        writer.start("", "another program")
        number = writer.register_schema("anything", "jsonschema", b'{"type": "object"}')
        for topic, entries in topics.items():
            channel = writer.register_channel(topic, "json", number)
            for k, entry in enumerate(entries):
                time, raw = 10**18 + k * STEP, json.dumps(entry).encode()
                writer.add_message(channel, time, raw, time)
        writer.finish()
    return path


@pytest.mark.parametrize("is_foxglove", [False, True])
def test_states_of_joints_in_json_are_a_recording(
    tmp_path: Path, capsys: Any, is_foxglove: bool
) -> None:
    def entry(k: int) -> Any:
        position, effort = angles(k).tolist(), (10 * angles(k)).tolist()
        stamp = {"sec": 10**9 + k * STEP // 10**9, "nsec": k * STEP % 10**9}
        if is_foxglove:
            rows = zip(NAMES, position, effort, strict=True)
            joints = [{"name": n, "position": q, "effort": tau} for n, q, tau in rows]
            return {"timestamp": stamp, "joints": joints}
        states = {"name": NAMES, "position": position, "velocity": [], "effort": effort}
        return {"header": {"stamp": stamp}, **states}

    entries = [entry(k) for k in range(COUNT)]
    entries[COUNT // 2] = "odd"
    bag = json_bag(tmp_path / "hand.mcap", {"/state": entries, "/note": [{"text": "hello"}]})
    log = read_run(bag, scene=load_scene("fr3"))
    by_name = np.array([angles(9)[NAMES.index(f"fr3_joint{i + 1}")] for i in range(7)])
    assert log.signals["fr3_joint_angles"][9] == pytest.approx(by_name)
    assert log.signals["fr3_torques"][9] == pytest.approx(10 * by_name)
    assert len(log.times) == COUNT - 1
    picture = ["-o", str(tmp_path / "seen.png"), "--size", "80x60"]
    assert run(capsys, "render", str(bag), *picture)[0] == 0


def test_truncated_json_bag_is_read_up_to_its_end(tmp_path: Path) -> None:
    entries = [{"name": NAMES, "position": [k] * 7} for k in range(COUNT)]
    bag = json_bag(tmp_path / "hand.mcap", {"/state": entries})
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    with open_recording(bag) as recording:
        assert "is truncated or damaged" in recording.faults[0]
        found = [np.frombuffer(packet)[1] for _, packet in recording.packets("state")]
        assert found == [*range(len(found))] and COUNT // 4 < len(found) < COUNT
        assert recording.sources["state"].count == len(found)


def test_json_without_joint_states_is_reported(tmp_path: Path) -> None:
    bag = json_bag(tmp_path / "text.mcap", {"/note": [{"text": "hello"}], "/none": []})
    with pytest.raises(RecordingError) as caught:
        open_recording(bag)
    assert str(caught.value) == (
        f"{bag} has the topics /none (JSON without messages), /note (JSON: found the keys text; "
        "expected name, position, velocity and effort, or joints); expected one of "
        "sensor_msgs/msg/JointState or nav_msgs/msg/Odometry, or /tf"
    )
