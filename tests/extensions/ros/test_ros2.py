"""Kind `ros2`: topics of publishers in another process, over DDS on this machine."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from conftest import sampled
from polling import until
from ros_tools import Peer, free_domain, publishing, rclpy_environment, read_joint_states
from test_cli import run

from sero_mj.base.errors import SourceError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import RoutedJoint, make_source
from sero_mj.data.record.replay import Replay
from sero_mj.extensions.ros import dds
from sero_mj.extensions.ros.dds import Ros2
from sero_mj.extensions.ros.described_scene import scene_of_network
from sero_mj.extensions.ros.network import Address
from sero_mj.load import load_scene
from sero_mj.viewer.session.status_line import source_text

DOMAIN = free_domain()
ARM = ("shoulder", "elbow")
SCENE = f"""
[robots.arm]
dh_convention = "standard"
dh_params_deg = [[90, 0, 0, 0.2], [0, 0.4, 0, 0]]
joint_names = ["shoulder", "elbow"]
torque_limits = [50.0, 20.0]
[sources.ros]
kind = "ros2"
domain = {DOMAIN}
[routes]
"arm.joint_angles" = "ros.joint_angles"
"arm.torques" = "ros.torques"
"""
RCLPY = """
import sys
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("driver")
states = node.create_publisher(JointState, "joint_states", 10)
kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, "robot_description", kept).publish(String(data=sys.stdin.read()))
print("ready", flush=True)
while True:
    message = JointState(name=["elbow", "shoulder"], position=[2.0, 1.0], effort=[20.0, 10.0])
    message.header.stamp = node.get_clock().now().to_msg()
    states.publish(message)
    rclpy.spin_once(node, timeout_sec=0.01)
"""
URDF = """<robot name="found">
<link name="base"/>
<link name="upper"><visual><geometry><box size="0.1 0.1 0.4"/></geometry></visual></link>
<link name="lower"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="20" velocity="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    with publishing(DOMAIN) as found:
        yield found


def source_of(joints: tuple[str, ...] = ARM, **fields: Any) -> Ros2:
    source = Ros2(**{"name": "ros", "domain": DOMAIN, **fields})
    source.set_joints([RoutedJoint(name, 0.5, 50.0) for name in joints])
    return source


def test_values_arrive_by_the_names_of_joints(peer: Peer) -> None:
    with source_of(joint_states="/named") as source:
        peer.say(match="/named", kind="JointState")

        def arrives() -> bool:
            peer.joints(
                "/named",
                header={"stamp": {"sec": 12, "nanosec": 500_000_000}},
                name=["elbow", "gripper", "shoulder"],
                position=[2, 9, 1],
                velocity=[0.2, 9, 0.1],
                effort=[20, 9, 10],
            )
            return source.receive_trigger > 0

        assert until(arrives)
        packet = source.latest()
        assert packet is not None
        assert {key: value.tolist() for key, value in packet.values.items()} == {
            "stamp": [12.5],
            "joint_angles": [1.0, 2.0],
            "joint_velocities": [0.1, 0.2],
            "torques": [10.0, 20.0],
        }
        assert (source.trouble, source.counters.senders) == ("", 1)


@pytest.mark.parametrize(
    ("late", "shown"), [(2.5, "clock is 2.5 s slow"), (-2.5, "clock is 2.5 s fast")]
)
def test_clock_offset_is_detected_and_shown(peer: Peer, late: float, shown: str) -> None:
    with source_of(joint_states="/clock") as source:
        peer.say(match="/clock", kind="JointState")

        def arrives() -> bool:
            seconds, fraction = divmod(time.time() - late, 1.0)
            stamp = {"sec": int(seconds), "nanosec": int(fraction * 1e9)}
            peer.joints("/clock", header={"stamp": stamp}, name=ARM, position=[1, 2])
            return source.receive_trigger > 5

        assert until(arrives)
        found = report(source)
        assert found["clock"] == pytest.approx(late, abs=0.05)
        assert shown in source_text(found, is_live=True)[0]
        (row,) = [why for what, _, why in describe(found) if what == "clock"]
        assert re.search(r"25\d\d\.\d ms slow" if late > 0 else r"24\d\d\.\d ms fast", row), row


def test_stamps_without_a_common_clock_are_not_compared(peer: Peer) -> None:
    with source_of(joint_states="/simulated") as source:
        peer.say(match="/simulated", kind="JointState")

        def arrives() -> bool:
            peer.joints("/simulated", header={"stamp": {"sec": 3}}, name=ARM, position=[1, 2])
            return source.receive_trigger > 0

        assert until(arrives)
        assert report(source)["clock"] is None


def test_forces_commands_and_frames_come_with_the_joints(peer: Peer) -> None:
    topics = {"wrench": "/ft", "commands": "/effort", "frames": ["tool"], "root": "base"}
    with source_of(joint_states="/all", **topics) as source:
        for topic, kind in (
            ("/all", "JointState"),
            ("/ft", "WrenchStamped"),
            ("/effort", "Float64MultiArray"),
            ("/tf", "TFMessage"),
            ("/tf_static", "TFMessage"),
        ):
            peer.say(match=topic, kind=kind)
        half = float(np.sqrt(0.5))
        turn = {"translation": {"x": 1, "y": 0, "z": 0}, "rotation": {"z": half, "w": half}}
        move = {"translation": {"x": 0, "y": 2, "z": 0}, "rotation": {"w": 1}}
        base = {"header": {"frame_id": "base"}, "child_frame_id": "link", "transform": turn}
        tool = {"header": {"frame_id": "link"}, "child_frame_id": "tool", "transform": move}
        peer.say(write="/tf_static", message={"transforms": [tool]})
        peer.say(write="/tf", message={"transforms": [base]})
        peer.say(write="/ft", message={"wrench": {"force": {"z": -9}, "torque": {"x": 1}}})
        peer.say(write="/effort", message={"data": [3, 4]})

        def all_is_there() -> bool:
            peer.joints("/all", name=ARM, position=[1, 2])
            packet = source.latest()
            return packet is not None and all(
                np.isfinite(packet.values[event]).all()
                for event in ("force", "commanded_torques", "tf_tool")
            )

        assert until(all_is_there, 15.0)
        packet = source.latest()
        assert packet is not None
        values = packet.values
        assert values["force"].tolist() == [[0, 0, -9]]
        assert values["moment"].tolist() == [[1, 0, 0]]
        assert values["commanded_torques"].tolist() == [3, 4]
        # Turned by 90 degrees about z at (1, 0, 0), then 2 m along its y, which is -x.
        expected = [[0, -1, 0, -1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        assert values["tf_tool"][0] == pytest.approx(np.array(expected, float), abs=1e-9)


def test_arm_and_gripper_can_publish_separately(peer: Peer) -> None:
    with source_of(("shoulder", "elbow", "finger"), joint_states="/apart") as source:
        peer.say(match="/apart", kind="JointState")
        peer.say(match="/apart", kind="JointState", **{"as": "gripper"})

        def seen_after(opening: float, **message: Any) -> list[float]:
            """The angles that a packet has once the gripper's opening is in it."""

            def is_seen() -> bool:
                gripper = {"name": ["finger"], "position": [opening], "effort": [7]}
                peer.say(write="/apart", message=gripper, **{"as": "gripper"})
                if message:
                    peer.joints("/apart", **message)
                packet = source.latest()
                return packet is not None and packet.values["joint_angles"][2] == opening

            assert until(is_seen)
            packet = source.latest()
            assert packet is not None
            return [float(x) for x in packet.values["joint_angles"]]

        assert seen_after(0.04) == [0.5, 0.5, 0.04]
        arm = {"name": ARM, "position": [1, 2], "effort": [3, 4]}
        assert until(lambda: seen_after(0.03, **arm)[0] == 1.0)
        # From now on the arm's messages make packets, not those of the gripper.
        assert seen_after(0.02, **arm) == [1, 2, 0.02]
        packet = source.latest()
        assert packet is not None
        assert packet.values["torques"].tolist() == [3, 4, 7]


def test_two_publishers_of_the_same_joints_are_counted(peer: Peer) -> None:
    with source_of(joint_states="/twice") as source:
        for name in ("first", "second"):
            peer.say(match="/twice", kind="JointState", **{"as": name})

        def both_are_seen() -> bool:
            for name in ("first", "second"):
                message = {"name": list(ARM), "position": [1, 2]}
                peer.say(write="/twice", message=message, **{"as": name})
            return source.counters.senders == 2

        assert until(both_are_seen)


@pytest.mark.parametrize(
    ("topic", "trouble"),
    [
        ("/nowhere", "no publisher of /nowhere; topics of its type: .*/here"),
        ("/text", "/text is of type std_msgs/msg/String; expected sensor_msgs/msg/JointState"),
        ("/here", "the publisher is not sending messages"),
    ],
)
def test_reason_for_missing_data_is_reported(peer: Peer, topic: str, trouble: str) -> None:
    with source_of(joint_states="/here") as other:
        peer.say(match="/here", kind="JointState")
        other.close()
    peer.say(write="/text", kind="String", message={"data": "hello"})
    with source_of(joint_states=topic) as source:
        assert until(lambda: re.search(trouble, source.trouble), 8.0), source.trouble


def test_domain_without_publishers_is_reported() -> None:
    with source_of(domain=231) as source:
        assert until(lambda: source.trouble, 8.0)
        assert "no publisher in domain 231 of this machine" in source.trouble
        assert "host = 'subnet'" in source.trouble


def test_domain_has_one_host_per_process(peer: Peer) -> None:
    with source_of(), pytest.raises(SourceError, match="is open with host 'localhost'"):
        source_of(host="192.0.2.1").open()


def test_incompatible_reliability_is_reported(peer: Peer) -> None:
    peer.say(write="/loose", kind="JointState", best_effort=True, message={})
    with source_of(joint_states="/loose", reliability="reliable") as source:
        assert until(lambda: "best_effort" in source.trouble, 8.0), source.trouble


def test_robot_is_mirrored_recorded_and_replayed(
    peer: Peer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(SCENE, encoding="utf-8")
    scene = load_scene(file)
    with Mirror(scene) as mirror:
        source = mirror.sources["ros"]
        peer.say(match="/joint_states", kind="JointState")

        sent = 0

        def is_connected() -> bool:
            nonlocal sent
            sent += 1
            peer.joints(name=ARM, position=[0, 0], header={"stamp": {"sec": sent}})
            return source.receive_trigger > 0

        assert until(is_connected)
        assert until(lambda: source.latest().values["stamp"][0] == sent)
        before = source.receive_trigger
        path = tmp_path / "run.mcap"
        with record_sources({"ros": source}, path, scene=scene, signals_rate=1000.0):
            for k in range(20):
                peer.joints(name=["elbow", "shoulder"], position=[k / 20, 1], effort=[2, 10])
            assert until(lambda: source.receive_trigger == before + 20)
        mirror.advance()
        assert mirror.data.qpos.tolist() == pytest.approx([1.0, 19 / 20])
        assert report(source)["rate"] > 0
    again = load_scene(file)
    again.sources["ros"] = {"kind": "replay", "file": str(tmp_path / "run.mcap"), "source": "ros"}
    with Mirror(again) as mirror:
        played = mirror.sources["ros"]
        assert isinstance(played, Replay)
        played.seek(played.recorded.last)
        packet = played.latest()
        assert packet is not None
        assert packet.values["joint_angles"].tolist() == [1.0, 19 / 20]
    export = ["export", str(tmp_path / "run.mcap"), str(tmp_path / "run.csv")]
    assert run(capsys, *export)[0] == 0
    rows = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 21
    ((topic, messages),) = read_joint_states(tmp_path / "run.mcap").items()
    assert (topic, len(messages)) == ("/arm/joint_states", 20)
    _, newest = messages[-1]
    assert (newest.name, newest.position) == ([*ARM], [1.0, 19 / 20])
    assert (newest.velocity, newest.effort) == ([], [10.0, 2.0])
    assert [float(x) for x in rows[-1].split(",")][2:4] == [1.0, 19 / 20]


def test_any_robot_on_the_network_is_shown(peer: Peer, capsys: pytest.CaptureFixture[str]) -> None:
    peer.say(write="/found/robot_description", kind="String", message={"data": URDF})
    peer.say(write="/found/joint_states", kind="JointState", message={"name": list(ARM)})
    with source_of(joint_states="/found/joint_states") as source:

        def listens() -> bool:
            peer.joints("/found/joint_states", name=ARM, position=[0.25, -0.5], effort=[10, 5])
            return source.receive_trigger > 0

        assert until(listens)
    stop = Event()

    def publish() -> None:
        while not stop.wait(0.02):
            peer.joints("/found/joint_states", name=ARM, position=[0.25, -0.5], effort=[10, 5])

    publisher = Thread(target=publish)
    publisher.start()
    try:
        scene = load_scene(scene_of_network(f"ros2://:{DOMAIN}/found"))
        (robot,) = scene.robots.values()
        assert (robot.name, robot.names) == ("found", ["shoulder", "elbow"])
        with Mirror(scene) as mirror:
            assert mirror.sources["ros"].wait(5.0)
            mirror.advance()
            assert mirror.data.qpos.tolist() == [0.25, -0.5]
        status, out, _ = run(capsys, "status", f"ros2://:{DOMAIN}", "--topics", "--json")
        assert status == 0
        topics = {each["name"]: each for each in json.loads(out)}
        states = topics["/found/joint_states"]
        assert (states["kind"], states["joints"]) == ("sensor_msgs/msg/JointState", [*ARM])
        assert 10 < states["rate"] < 100
        address = f"ros2://:{DOMAIN}/found"
        status, out, _ = run(capsys, "status", address, "--duration", "1", "--json")
        assert status == 0 and json.loads(out)[0]["good"] > 10
    finally:
        stop.set()
        publisher.join()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("text", "said"),
    sampled(
        [
            ["no XML", "the robot_description is not URDF: it begins with 'no XML'"],
            ["<robot name='x'><link", "described.urdf"],
            ["<robot name='x'/>", "has no <link>"],
        ],
        1,
    ),
)
def test_invalid_descriptions_are_reported(
    peer: Peer, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    peer.say(write="/wrong/robot_description", kind="String", message={"data": text})
    peer.say(write="/wrong/joint_states", kind="JointState", message={"name": ["a"]})
    address = f"ros2://:{DOMAIN}/wrong"
    status, _, error = run(capsys, "render", address, "--output", "never.png")
    assert (status, said in error) == (2, True), error


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("ros2://:999", "domain 999; expected 0 to 232"),
        ("ros2://:x", "expected ros2://HOST:DOMAIN/NAMESPACE"),
        ("ros2://?robto=fr3", "no field 'robto'; did you mean 'robot'?"),
        ("ros2://?torque_constants=a", "torque_constants: found 'a'; expected numbers in Nm/A"),
        ("ros2://:230", "ROS 2 domain 230 on localhost has no publisher"),
    ],
)
def test_invalid_addresses_are_rejected(
    address: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, error = run(capsys, "render", address, "--output", "never.png")
    assert (status, said in error) == (2, True), error


def test_address_sets_joint_names_and_effort_units() -> None:
    address = "ros2://:3/arm?joints=a,b&effort_unit=A&torque_constants=11.5,9&torque_sign=-1"
    fields = Address.parse(address).source
    source = Ros2(name="it", **{key: fields[key] for key in fields.keys() - {"kind"}})
    assert (source.joints, source.torque_constants) == (["a", "b"], [11.5, 9.0])
    assert (source.domain, source.namespace, source.effort_unit) == (3, "arm", "A")
    assert source.torque_sign == -1


def test_empty_topic_list_suggests_another_host(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "status", "ros2://:229", "--topics", "--duration", "0.2")
    assert (status, "ros2://subnet" in out) == (1, True), out


@pytest.mark.parametrize(
    ("fields", "key"),
    [
        ({"joints": ["a", "a"]}, "joints"),
        ({"frames": ["a/b", "a_b"]}, "frames"),
        ({"frames": ["tool0"]}, "root"),
        ({"effort_unit": "A"}, "torque_constants"),
        ({"torque_constants": 1.0}, "torque_constants"),
        ({"joint_states": ""}, "joint_states"),
        ({"domain": 233}, "domain"),
        ({"host": ""}, "host"),
        ({"structure": "7F"}, "structure"),
        ({"time": "x"}, "time"),
    ],
)
def test_wrong_declarations_name_their_key(fields: dict[str, Any], key: str) -> None:
    from sero_mj.base.errors import DeclarationError

    with pytest.raises(DeclarationError) as caught:
        make_source("ros", {"kind": "ros2", **fields})
    assert [problem.key for problem in caught.value.problems] == [key]


def test_missing_routes_of_joints_are_reported() -> None:
    with pytest.raises(SourceError, match="joints: no route"):
        Ros2(domain=DOMAIN).open()


@contextmanager
def kilted_driver(python: Path, domain: int) -> Iterator[None]:
    """A publisher of ROS 2 Kilted over Fast DDS, which takes its leave at the end."""
    with subprocess.Popen(
        [str(python), "-c", RCLPY],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    ) as driver:
        try:
            assert driver.stdin is not None
            driver.stdin.write(URDF)
            driver.stdin.close()
            assert driver.stdout is not None
            assert driver.stdout.readline() == "ready\n"
            yield
            driver.terminate()
            driver.wait(10.0)
        finally:
            driver.kill()


def test_killed_driver_is_replaced_by_another_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dds, "_CHECK_INTERVAL", 0.05)
    domain = DOMAIN - 90  # where nobody else publishes
    missed = f"no publisher in domain {domain}"
    with source_of(domain=domain) as source:
        for driver in range(2):
            with publishing(domain, lease=1.0) as peer:
                peer.say(match="/joint_states", kind="JointState")
                received = source.receive_trigger

                def arrives(peer: Peer = peer, received: int = received) -> bool:
                    peer.joints(name=[*ARM], position=[1, 2])
                    return source.receive_trigger > received

                assert until(arrives, 10.0), (driver, source.trouble, source.error)
                peer.kill()
            # Once its lease is over, its entry is left, without the topic's name.
            assert until(lambda: source.trouble.startswith(missed), 15.0), source.trouble
            assert (source.error, source.counters.failures) == (None, 0)


@pytest.mark.thorough
@pytest.mark.timeout(400)
def test_driver_of_ros_2_kilted_is_received_over_fast_dds(pytestconfig: pytest.Config) -> None:
    domain = DOMAIN - 95  # of its own
    folder = Path(pytestconfig.rootpath) / ".peers" / f"rclpy{sys.version_info[1]}"
    with rclpy_environment(folder) as python, ExitStack() as stack:  # made once, for all workers
        with kilted_driver(python, domain):
            scene = load_scene(scene_of_network(f"ros2://:{domain}"))
            assert list(scene.robots) == ["found"]
            mirror = stack.enter_context(Mirror(scene))
            source = mirror.sources["ros"]
            assert until(lambda: source.receive_trigger > 50, 20.0), source.trouble
            packet = source.latest()
            assert packet is not None
            assert packet.values["joint_angles"].tolist() == [1, 2]
            assert packet.values["torques"].tolist() == [10, 20]
            assert source.counters.malformed == 0
        time.sleep(12.0)
        with kilted_driver(python, domain):  # which is found when it comes again
            received = source.receive_trigger
            assert until(lambda: source.receive_trigger > received + 50, 15.0), source.trouble
