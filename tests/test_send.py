"""`send`: packets of a motion at exact times, independently of network errors."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import SourceError, StructureError, UsageError
from sero_mj.data.send.motion import InverseDynamics, SineMotion
from sero_mj.data.send.play import MotionPackets
from sero_mj.data.send.sender import SendReport, UdpSink, paced, send
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import VALUE_INPUTS
from sero_mj.robots.declared.scene import Scene

UDP = {"kind": "udp", "port": 4711, "structure": "2F2F2F"}
ROUTES = {
    "arm.joint_angles": "udp.values0",
    "arm.torques": "udp.values1",
    "arm.billboard_values": "udp.values2",
}


def arm(name: str = "arm", n: int = 2) -> SerialRobot:
    return SerialRobot(name=name, dh_convention="craig", dh_params=[[1.0, 0.1, 0.0, 0.3]] * n)


def scene_of(
    routes: dict[str, str] = ROUTES, sources: dict[str, Any] | None = None, **robots: int
) -> Scene:
    return Scene(
        robots=[arm(name, n) for name, n in (robots or {"arm": 2}).items()],
        sources={"udp": UDP} if sources is None else sources,
        routes=routes,
    )


@pytest.fixture
def listener() -> Any:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


@pytest.fixture
def to(listener: socket.socket) -> Iterator[UdpSink]:
    with UdpSink(*listener.getsockname()) as sink:
        yield sink


@pytest.mark.realtime
@pytest.mark.slow
def test_packets_are_sent_at_1_khz(to: UdpSink) -> None:
    reports: list[SendReport] = []
    # A busy machine may delay one run of half a second, but hardly three.
    while len(reports) < 3 and not (reports and 950 < reports[-1].rate < 1050):
        start = time.perf_counter()
        reports.append(send(paced(lambda t: b"1", 1000, 0.5), to))
        assert 0.475 < reports[-1].seconds <= time.perf_counter() - start
    assert 950 < reports[-1].rate < 1050
    assert (reports[-1].packets, reports[-1].refused) == (500, 0)
    assert 0 <= reports[-1].jitter_p50 <= reports[-1].jitter_p99 < 0.1


def test_packets_are_sent_in_order_and_on_time(listener: socket.socket, to: UdpSink) -> None:
    moments: list[float] = []
    made: list[float] = []

    def packet_at(t: float) -> bytes:
        moments.append(time.perf_counter())
        made.append(t)
        return struct.pack("<d", t)

    start = time.perf_counter()
    send(paced(packet_at, 500, 0.1), to)
    assert made == [k / 500 for k in range(50)]
    assert [struct.unpack("<d", listener.recv(100))[0] for _ in range(50)] == made
    # A packet is computed after the previous one was sent, so none is sent early.
    assert (np.array(moments[1:]) >= start + np.array(made[:-1])).all()


def test_reported_rate_is_packets_per_second() -> None:
    assert SendReport(500, 0.5, 0, 0.0, 0.0).rate == 1000.0
    assert SendReport(0, 0.0, 0, 0.0, 0.0).rate == 0.0


def test_delays_are_reported(to: UdpSink) -> None:
    def packet_at(t: float) -> bytes:
        if t >= 0.05:
            time.sleep(0.02)  # computing the motion takes too long
        return b""

    report = send(paced(packet_at, 100, 0.1), to)
    assert report.packets == 10
    assert report.jitter_p50 < 0.03 < report.jitter_p99
    assert report.rate < 80


def test_refused_packets_are_counted_and_sending_continues(
    listener: socket.socket, to: UdpSink
) -> None:
    # The system rejects every second packet, which is too long for UDP.
    packets = paced(lambda t: bytes(70_000 if round(t * 1000) % 2 else 8), 1000, 0.02)
    report = send(packets, to)
    assert (report.packets, report.refused) == (20, 10)
    assert [len(listener.recv(100)) for _ in range(10)] == [8] * 10


def test_sending_works_without_a_receiver(listener: socket.socket, to: UdpSink) -> None:
    listener.close()
    assert send(paced(lambda t: b"1", 1000, 0.02), to).packets == 20


def test_at_least_one_packet_is_sent(to: UdpSink) -> None:
    assert send(paced(lambda t: b"1", 10, 1e-6), to).packets == 1


@pytest.mark.parametrize("duration", [None, 100.0])
def test_interrupt_ends_sending_with_a_report(to: UdpSink, duration: float | None) -> None:
    def packet_at(t: float) -> bytes:
        if t >= 0.01:
            raise KeyboardInterrupt
        return b"1"

    report = send(paced(packet_at, 1000, duration), to)
    assert report.packets == 10
    assert report.seconds < 5


def test_interrupt_before_the_first_packet_returns_a_report(to: UdpSink) -> None:
    def packet_at(t: float) -> bytes:
        raise KeyboardInterrupt

    report = send(paced(packet_at, 1000), to)
    assert (report.packets, report.refused, report.jitter_p99) == (0, 0, 0.0)


@pytest.mark.parametrize("host", ["no.such.host.invalid", "x" * 70])
def test_unresolvable_host_is_reported(host: str) -> None:
    with pytest.raises(SourceError) as caught:
        UdpSink(host, 4711)
    assert str(caught.value).startswith(f"source '{host}:4711': not an address: ")


def test_packets_are_sent_to_ipv6() -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(("::1", 0))
        except OSError:
            pytest.skip("no IPv6 here")
        sock.settimeout(5.0)
        with UdpSink("::1", sock.getsockname()[1]) as to:
            send(paced(lambda t: b"six", 10, 0.1), to)
        assert sock.recv(100) == b"six"


@pytest.mark.parametrize("t", [0.0, 1.25])
def test_packets_have_the_signals_of_the_routed_inputs(t: float) -> None:
    packets = MotionPackets(scene_of(), amplitude=0.5)
    assert packets.source.udpport == 4711
    assert packets.structure.text == "2F2F2F"
    position, velocity, acceleration = SineMotion(arm(), 0.5).at(t)
    torques = InverseDynamics(arm()).torques(position, velocity, acceleration)
    # Billboard values are the velocities.
    expected = struct.pack("<6d", *position, *torques, *velocity)
    assert packets.at(t) == expected
    assert math.isfinite(sum(struct.unpack("<6d", expected)))


@pytest.mark.parametrize("key", ["joint_angles", *VALUE_INPUTS])
def test_every_routable_input_can_be_sent(key: str) -> None:
    packet = MotionPackets(scene_of({f"arm.{key}": "udp.values0"})).at(0.4)
    numbers = struct.unpack("<6d", packet)
    assert all(map(math.isfinite, numbers))
    assert all(numbers[:2])
    assert not any(numbers[2:])


def test_events_without_a_route_are_zero_and_float32_is_used() -> None:
    source = {"kind": "udp", "structure": "5F2F", "double": False}
    packets = MotionPackets(scene_of({"arm.joint_angles": "udp.values1"}, {"udp": source}))
    position, _, _ = SineMotion(arm()).at(0.3)
    assert packets.at(0.3) == struct.pack("<7f", *[0.0] * 5, *position)


def test_one_packet_has_signals_of_several_robots() -> None:
    source = {"kind": "udp", "structure": "3F2F"}
    routes = {"b.joint_angles": "udp.values1", "a.joint_angles": "udp.values0"}
    packets = MotionPackets(scene_of(routes, {"udp": source}, a=3, b=2))
    positions = [*SineMotion(arm(n=3)).at(0.7)[0], *SineMotion(arm(n=2)).at(0.7)[0]]
    assert packets.at(0.7) == struct.pack("<5d", *positions)


@pytest.mark.parametrize(("double", "code"), [(True, "d"), (False, "f")])
def test_other_structure_has_only_its_own_events(double: bool, code: str) -> None:
    packets = MotionPackets(scene_of(ROUTES, {"udp": {**UDP, "double": double}}), structure="2F")
    assert packets.at(0.3) == struct.pack(f"<2{code}", *SineMotion(arm()).at(0.3)[0])


def test_source_is_chosen_by_name() -> None:
    sources = {"left": {**UDP, "port": 1}, "right": {**UDP, "port": 2}}
    routes = {"arm.joint_angles": "left.values0", "arm.torques": "right.values0"}
    packets = MotionPackets(scene_of(routes, sources), source="right")
    assert packets.source.udpport == 2
    torques = InverseDynamics(arm()).torques(*SineMotion(arm()).at(0.5))
    assert packets.at(0.5) == struct.pack("<6d", *torques, *[0.0] * 4)


OTHER_UDP = {**UDP, "port": 4712}


@pytest.mark.parametrize(
    ("sources", "choice", "message"),
    [
        ({}, {}, "the scene has no source; none is available"),
        (
            {"a": UDP, "b": OTHER_UDP},
            {},
            "the scene has several sources; choose one with --source: a, b",
        ),
        (
            {"udp": UDP},
            {"source": "upd"},
            "the scene has no source 'upd'; did you mean 'udp'?",
        ),
        (
            {"udp": UDP, "idle": OTHER_UDP},
            {"source": "idle"},
            "no route uses source 'idle', so there is nothing to send",
        ),
        (
            {"udp": UDP},
            {"structure": "q:6Q 2V"},
            "structure 'q:6Q 2V' has q, vectors0; the routes from 'udp' take values0, values1, "
            "values2, so there is nothing to send",
        ),
        (
            {"udp": UDP},
            {"structure": "3F"},
            "structure '3F': values0 has 3 values, but arm.joint_angles takes 2, one per joint",
        ),
    ],
)
def test_unsendable_scenes_are_reported(
    sources: dict[str, Any], choice: dict[str, str], message: str
) -> None:
    with pytest.raises(UsageError) as caught:
        MotionPackets(scene_of(ROUTES if "udp" in sources else {}, sources), **choice)
    assert str(caught.value) == message


def test_invalid_structure_is_reported() -> None:
    with raises_with(StructureError, position=1):
        MotionPackets(scene_of(), structure="2X")
