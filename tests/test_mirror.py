"""`Mirror`: a world follows its sources, retains the last valid pose, and counts packets."""

from __future__ import annotations

import gc
import math
import os
import socket
import struct
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from numpy.typing import NDArray
from polling import until
from source_slots import get_source

from sero_mj.base.errors import SourceError
from sero_mj.data.drive.mirror import Mirror, restore
from sero_mj.data.receive.mailbox import Packet, age
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.load import load_scene
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import VALUE_INPUTS
from sero_mj.robots.declared.scene import Scene

Array = NDArray[np.float64]
SCENES = Path(__file__).parent.parent / "scenes"
TILTED = {"xyz": [0.3, -0.2, 0.5], "rpy": [0.4, -0.3, 1.1]}

# A separate process with its own encoder, which sends one packet of doubles.
ROBOT = """
import socket, struct, sys
values = [float(word) for word in sys.argv[2:]]
packet = struct.pack(f"<{len(values)}d", *values)
socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(packet, ("127.0.0.1", int(sys.argv[1])))
"""


def arm(name: str = "arm", convention: str = "craig") -> SerialRobot:
    return SerialRobot(
        name=name,
        dh_convention=convention,
        dh_params=[[0.3, 0.2, 0.1, 0.3], [-1.5, 0.0, 0.5, 0.2], [1.2, 0.1, 0.0, 0.4]],
        joint_types=["revolute", "prismatic", "revolute"],
        base_frame=TILTED,
        flange_frame=TILTED,
        joint_angles=[0.1, 0.2, 0.3],
        torques=[7.0, 8.0, 9.0],
    )


def mirror_of(*robots: SerialRobot) -> Mirror:
    """Returns a mirror in which one source sets angles and torques of all robots."""
    routes = {f"{robot.name}.joint_angles": "udp.values0" for robot in robots}
    routes |= {f"{robot.name}.torques": "udp.values1" for robot in robots}
    source = {"kind": "udp", "structure": "3F3F"}
    return Mirror(Scene(robots=list(robots), sources={"udp": source}, routes=routes, floor=False))


def frame_of(mirror: Mirror, name: str) -> Array:
    site = mirror.world.frames.site[mirror.world.frames.names.index(name)]
    T = np.eye(4)
    T[:3, :3] = mirror.data.site_xmat[site].reshape(3, 3)
    T[:3, 3] = mirror.data.site_xpos[site]
    return T


def largest_difference(mirror: Mirror, robot: SerialRobot, q: Array) -> float:
    """Returns the difference of the model's frames from those computed by the DH table."""
    expected = robot.dh.frames(q, robot.base_frame)
    names = ["base", *(f"link{i + 1}" for i in range(robot.n))]
    found = np.array([frame_of(mirror, f"{robot.name}/{name}") for name in names])
    flange = frame_of(mirror, f"{robot.name}/flange")
    return max(
        float(np.abs(found - expected).max()),
        float(np.abs(flange - expected[-1] @ robot.flange_frame).max()),
    )


def counted(mirror: Mirror) -> dict[str, float]:
    return get_source(mirror.data, mirror.world, "udp")


def slot(mirror: Mirror, name: str) -> list[float]:
    return mirror.data.userdata[mirror.world.slots[name]].tolist()


Send = Callable[[Mirror, bytes], object]


@pytest.fixture
def sender() -> Iterator[Send]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        yield lambda mirror, packet: sock.sendto(packet, ("127.0.0.1", port_of(mirror)))


def port_of(mirror: Mirror, name: str = "udp") -> int:
    source = mirror.sources[name]
    assert isinstance(source, UdpReceiver)
    return source.port


def six(angles: tuple[float, ...], torques: tuple[float, ...] = (1.0, 2.0, 3.0)) -> bytes:
    return struct.pack("<6d", *angles, *torques)


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_pose_equals_that_of_the_dh_table(sender: Send, convention: str) -> None:
    robot = arm(convention=convention)
    with mirror_of(robot) as mirror:
        assert not mirror.advance()
        assert largest_difference(mirror, robot, robot.home) < 1e-12
        for seed in range(5):
            q = np.random.default_rng(seed).uniform(-2, 2, 3)
            sender(mirror, six(tuple(q)))
            assert until(mirror.advance)
            assert largest_difference(mirror, robot, q) < 1e-12


def test_shipped_scene_follows_a_robot_in_another_process() -> None:
    scene = load_scene(SCENES / "lwr_udp.toml")
    scene.sources["udp"]["port"] = 0  # so that tests can run side by side
    values = np.random.default_rng(1).uniform(-1.5, 1.5, 14)
    with Mirror(scene) as mirror:
        words = [repr(float(value)) for value in values]
        subprocess.run(
            [sys.executable, "-c", ROBOT, str(port_of(mirror)), *words], check=True, timeout=30
        )
        assert mirror.wait(5.0) == []
        assert mirror.advance()
        assert largest_difference(mirror, scene.robots["lwr"], values[:7]) < 1e-12
        assert slot(mirror, "lwr.torques") == values[7:].tolist()


def test_send_command_moves_the_shipped_scene() -> None:
    scene = load_scene(SCENES / "lwr_udp.toml")
    scene.sources["udp"]["port"] = 0
    with Mirror(scene) as mirror:
        command = [sys.executable, "-m", "sero_mj", "send", "lwr_udp", "--rate", "200"]
        command += ["--duration", "0.2", "--port", str(port_of(mirror))]
        environment = {**os.environ, "PYTHONPATH": str(SCENES.parent)}
        done = subprocess.run(
            command, check=True, timeout=60, capture_output=True, text=True, env=environment
        )
        assert "sent 40 packets" in done.stdout
        assert until(lambda: mirror.advance() or counted(mirror)["received"] == 40)
        assert counted(mirror).keys() == {"received", "age", "size"}
        q = mirror.data.qpos[mirror.world.robots["lwr"].qpos].copy()
        assert np.abs(q).max() > 0.1
        assert largest_difference(mirror, scene.robots["lwr"], q) < 1e-12


def test_several_robots_follow_one_packet(sender: Send) -> None:
    left, right = arm("left"), arm("right")
    with mirror_of(left, right) as mirror:
        q = np.array([0.5, -0.25, 1.5])
        sender(mirror, six(tuple(q)))
        assert until(mirror.advance)
        for robot in (left, right):
            assert largest_difference(mirror, robot, q) < 1e-12
            assert slot(mirror, f"{robot.name}.torques") == [1.0, 2.0, 3.0]
            flags, userdata = mirror.world.flags, mirror.data.userdata
            keys = ("joint_angles", *VALUE_INPUTS)
            arrived = [key for key in keys if userdata[flags[f"{robot.name}.{key}"]]]
            assert arrived == ["joint_angles", "torques"]


def test_declared_pose_is_shown_before_the_first_packet() -> None:
    with mirror_of(arm()) as mirror:
        assert not mirror.advance()
        assert mirror.data.qpos.tolist() == [0.1, 0.2, 0.3]
        assert slot(mirror, "arm.torques") == [7.0, 8.0, 9.0]
        assert counted(mirror) == {"size": 48}
        assert mirror.wait(0.0) == ["udp"]


def test_malformed_packets_are_counted_and_keep_the_last_pose(sender: Send) -> None:
    bad = [
        six((math.nan, 0.0, 0.0)),
        six((1.0, 1.0, -math.inf)),
        six((1.0, 1.0, 1.0))[:-1],
        six((1.0, 1.0, 1.0)) + b"\0",
        b"",
    ]
    robot = arm()
    q = np.array([0.5, -0.25, 1.5])
    with mirror_of(robot) as mirror:
        sender(mirror, six(tuple(q)))
        assert until(mirror.advance)
        for count, packet in enumerate(bad, start=1):
            sender(mirror, packet)
            assert until(lambda count=count: mirror.sources["udp"].counters.malformed == count)
            assert not mirror.advance()
            found = counted(mirror)
            assert (found["received"], found["malformed"]) == (1 + count, count)
        assert largest_difference(mirror, robot, q) < 1e-12
        assert slot(mirror, "arm.torques") == [1.0, 2.0, 3.0]


def test_age_is_the_time_since_arrival() -> None:
    packet = Packet({}, arrival=100.0, number=1)
    assert age(packet, 100.25) == 0.25
    assert age(None, 3.0) == math.inf


def test_age_of_a_silent_source_increases(sender: Send) -> None:
    with mirror_of(arm()) as mirror:
        before = time.monotonic()
        sender(mirror, six((0.0, 0.0, 0.0)))
        assert until(mirror.advance)
        young = counted(mirror)["age"]
        assert 0 <= young <= time.monotonic() - before
        assert until(lambda: mirror.advance() or counted(mirror)["age"] > young + 0.02)
        assert counted(mirror)["age"] <= time.monotonic() - before


def test_closed_mirror_removes_its_callbacks_from_sources() -> None:
    source = UdpReceiver(name="udp", udpport=0, structure="3F3F")
    own: list[int] = []
    source.on_receive(lambda: own.append(1))
    for _ in range(3):
        routes = {"arm.joint_angles": "udp.values0"}
        mirror = Mirror(Scene(robots=[arm()], sources={"udp": source}, routes=routes))
        mirror.listen(lambda *_: None, to_all=True)
        for _ in range(2):
            with mirror:
                assert len(source._callbacks) == 2
                packet = struct.pack("<6d", *range(6))
                with socket.socket(type=socket.SOCK_DGRAM) as sender:
                    sender.sendto(packet, ("127.0.0.1", source.port))
                assert mirror.wait_next(5.0)
            assert len(source._callbacks) == 1
            source.accept([struct.pack("<6d", *range(6))])  # without a listener
            assert source.take_history() is None
    assert len(own) == 12


def test_packets_dropped_by_the_kernel_are_in_userdata() -> None:
    mirror = mirror_of(arm())
    source: Any = mirror.sources["udp"]
    source.counters.dropped = 5  # test_udp tests real drops
    mirror.advance()
    found = counted(mirror)
    assert found.pop("link_age") == pytest.approx(0.0, abs=1.0)
    assert found == {"size": 48, "dropped": 5}


def test_time_is_measured_from_open_unless_passed() -> None:
    mirror = mirror_of(arm())
    before = time.monotonic()
    with mirror:
        opened = time.monotonic()
        assert until(lambda: mirror.advance() or mirror.data.time > 0.01)
        earliest = time.monotonic() - opened
        mirror.advance()
        assert earliest <= mirror.data.time <= time.monotonic() - before
        mirror.advance(now=12.5)
        assert mirror.data.time == 12.5


def test_reset_applies_the_latest_packet_again(sender: Send) -> None:
    robot = arm()
    q = np.array([0.5, -0.25, 1.5])
    with mirror_of(robot) as mirror:
        sender(mirror, six(tuple(q)))
        assert until(mirror.advance)
        assert not mirror.advance()  # nothing new
        mirror.reset()
        assert mirror.data.qpos.tolist() == [0.1, 0.2, 0.3]
        assert slot(mirror, "arm.torques") == [7.0, 8.0, 9.0]
        assert mirror.advance()
        assert largest_difference(mirror, robot, q) < 1e-12
        assert slot(mirror, "arm.torques") == [1.0, 2.0, 3.0]


def test_reopened_mirror_follows_from_the_first_packet(sender: Send) -> None:
    mirror = mirror_of(arm())
    for angle in (0.5, -0.5):
        with mirror:
            sender(mirror, six((angle, 0.0, 0.0)))
            assert mirror.wait(5.0) == []
            assert mirror.advance()
            assert mirror.data.qpos[0] == angle
    mirror.close()  # has no effect


def test_restored_state_has_identical_frames_and_userdata(sender: Send) -> None:
    fields = ("qpos", "userdata", "mocap_pos", "mocap_quat", "xpos", "xmat", "site_xpos")
    fields += ("site_xmat", "geom_xpos", "geom_xmat", "cam_xpos", "light_xpos", "subtree_com")
    with mirror_of(arm()) as mirror:
        sender(mirror, six((0.5, -0.25, 1.5)))
        assert until(mirror.advance)
        state = mirror.state()
        kept = {field: getattr(mirror.data, field).copy() for field in fields}
        moment = mirror.data.time
        sender(mirror, six((-1.0, 1.0, -1.0), (4.0, 5.0, 6.0)))
        assert until(mirror.advance)
        assert not np.array_equal(mirror.data.xpos, kept["xpos"])
        fresh = mirror.world.make_data()
        for data in (mirror.data, fresh):
            restore(mirror.world, data, state)
            assert data.time == moment
            for field, value in kept.items():
                assert getattr(data, field).tobytes() == value.tobytes(), field
        # A state is a copy, which later packets do not change.
        assert mirror.state().tobytes() == state.tobytes()
        assert mirror.state() is not state


def test_sources_without_a_route_are_not_opened() -> None:
    sources = {name: {"kind": "udp", "structure": "3F"} for name in ("used", "unused")}
    mirror = Mirror(Scene(robots=[arm()], sources=sources, routes={"arm.torques": "used.values0"}))
    assert list(mirror.sources) == ["used"]


def test_failure_to_open_a_source_closes_the_others() -> None:
    with UdpReceiver(structure="3F") as blocker:
        sources = {
            "first": UdpReceiver(structure="3F", name="first"),
            "second": {"kind": "udp", "structure": "3F", "port": blocker.port},
        }
        routes = {"arm.joint_angles": "first.values0", "arm.torques": "second.values0"}
        mirror = Mirror(Scene(robots=[arm()], sources=sources, routes=routes))
        used = "in use by another program. Close it, or choose another port"
        reason = f"UDP port {blocker.port} on 127.0.0.1 is {used}"
        with raises_with(SourceError, source="second", reason=reason):
            mirror.open()
        assert not [t.name for t in threading.enumerate() if t.name == "udp first"]
        assert port_of(mirror, "first") == 0  # no socket, so no port


def test_wait_returns_silent_sources_within_the_timeout(sender: Send) -> None:
    sources = {name: {"kind": "udp", "structure": "3F3F"} for name in ("udp", "mute", "dumb")}
    routes = {"a.torques": "udp.values0", "b.torques": "mute.values0", "c.torques": "dumb.values0"}
    with Mirror(Scene(robots=[arm(n) for n in "abc"], sources=sources, routes=routes)) as mirror:
        sender(mirror, six((0.0, 0.0, 0.0)))
        assert until(lambda: mirror.sources["udp"].latest() is not None)
        start = time.monotonic()
        assert mirror.wait(0.1) == ["mute", "dumb"]
        # The timeout applies to all sources together.
        assert 0.1 <= time.monotonic() - start < 0.19


@pytest.mark.thorough
@pytest.mark.slow
def test_memory_does_not_grow(sender: Send) -> None:
    with mirror_of(arm()) as mirror:

        def run(count: int) -> None:
            for k in range(count):
                sender(mirror, b"nonsense")
                sender(mirror, six((k * 1e-4, 0.0, 0.0)))
                assert until(mirror.advance)
                mirror.state()

        run(200)
        tracemalloc.start()
        try:
            run(100)
            gc.collect()  # also frees the tuples that Python caches
            before, _ = tracemalloc.get_traced_memory()
            run(1500)
            gc.collect()
            after, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        # Storing one packet, or one float, for each advance would exceed this.
        assert after - before < 20_000


def test_nan_in_unused_events_does_not_reject_packets(sender: Send) -> None:
    """Robots, such as the LWR with FRI, send many values that a scene does not use."""
    source = {"kind": "udp", "port": 0, "structure": "3F3F2F1f1M"}
    routes = {"arm.joint_angles": "udp.values0"}
    scene = Scene(robots=[arm()], sources={"udp": source}, routes=routes)
    nans, frame = (math.nan,) * 6, np.eye(4).ravel()

    def packet(angle: float, *, matrix: NDArray[np.float64] = frame) -> bytes:
        return struct.pack("<8d1f16d", angle, 0.0, 0.0, *nans[:5], math.inf, *matrix)

    with Mirror(scene) as mirror:
        sender(mirror, packet(0.25))
        assert until(mirror.advance)
        assert mirror.data.qpos.tolist() == [0.25, 0.0, 0.0]
        sender(mirror, packet(0.5, matrix=np.full(16, math.nan)))
        assert until(mirror.advance)
        assert mirror.data.qpos.tolist() == [0.5, 0.0, 0.0]
        counters = mirror.sources["udp"].counters
        assert (counters.blanked, counters.malformed) == (2, 0)
        sender(mirror, packet(math.nan))  # joint angles move the robot
        assert until(lambda: counters.not_finite == 1)
        assert not mirror.advance()


def test_packets_of_unexpected_senders_are_in_userdata(sender: Send) -> None:
    source = {"kind": "udp", "port": 0, "structure": "3F3F", "sender": "192.0.2.1"}
    routes = {"arm.joint_angles": "udp.values0"}
    scene = Scene(robots=[arm()], sources={"udp": source}, routes=routes)
    with Mirror(scene) as mirror:
        mirror.advance()
        assert "foreign" not in counted(mirror)
        for count in (1, 2):
            sender(mirror, six((1.0, 1.0, 1.0)))
            assert until(lambda c=count: mirror.sources["udp"].counters.foreign == c)
            mirror.advance()
            found = counted(mirror)
            assert (found["foreign"], found["foreign_age"]) == (count, 0.0)
        mirror.advance()
        assert 0.0 < counted(mirror)["foreign_age"] < 5.0


def test_velocities_are_differences_of_joint_angles() -> None:
    robots = [arm(), arm("copy")]
    scene = Scene(
        robots=robots,
        sources={"udp": {"kind": "udp", "structure": "3F", "port": 0}},
        routes={
            "arm.joint_angles": "udp.values0",
            "copy.joint_angles": "-2 * arm.joint_angles",
        },
        floor=False,
    )
    speeds = np.array([0.3, -0.02, 1.5])
    with Mirror(scene) as mirror:
        source, parts = mirror.sources["udp"], mirror.world.robots

        def velocities(time: float, angles: Array) -> tuple[list[float], list[float]]:
            source.accept([struct.pack("<3d", *angles)], [time])
            assert mirror.advance()
            arm, copy = (mirror.data.qvel[parts[name].dofs] for name in ("arm", "copy"))
            return arm.tolist(), copy.tolist()

        none = ([0.0] * 3, [0.0] * 3)
        assert velocities(10.0, np.zeros(3)) == none  # no earlier packet
        for time in (10.016, 10.05, 10.4):
            found = velocities(time, speeds * (time - 10.0))
            assert found[0] == pytest.approx(speeds)
            assert found[1] == pytest.approx(-2 * speeds)
        mirror.reset()
        mirror.advance()
        assert not mirror.data.qvel.any()
        assert velocities(11.0, np.ones(3)) == none  # after a silence
        assert velocities(10.9, np.zeros(3)) == none  # a recording is rewound
        assert velocities(10.9, np.zeros(3)) == none
        assert velocities(11.0, speeds)[0] == pytest.approx(10 * speeds)
    with mirror:  # reopening discards earlier packets
        mirror.reset()
        assert velocities(11.1, np.zeros(3)) == none
