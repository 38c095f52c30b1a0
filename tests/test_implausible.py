"""Finite but physically implausible values are counted and never applied."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from polling import until
from shm_tools import make, remove
from source_slots import get_source

from sero_mj import Mirror, Scene, SerialRobot, ShmReader, UdpReceiver, record_sources
from sero_mj.base.errors import DeclarationError
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import Source
from sero_mj.data.record.replay import Replay
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow

STRUCTURE = "angles:2F torques:2F pose:1M push:1V shown:1M count:2q raw:1F"
ROUTES = {
    "arm.joint_angles": "{0}.angles * deg",
    "arm.torques": "{0}.torques",
    "arm.base_frame": "{0}.pose",
    "push.vector": "{0}.push * 1000",
    "marker.frame": "{0}.shown",
    "arm.billboard_values": "{0}.count",
}
GOOD: dict[str, Any] = {
    "angles": [90.0, 0.5],
    "torques": [1.0, 2.0],
    "pose": np.eye(4)[None],
    "push": [[1.0, 2.0, 3.0]],
    "shown": np.eye(4)[None],
    "count": [2, 3],
    "raw": [1e300],  # is not routed, so any value is valid
}


def at(x: float) -> Any:
    T = np.eye(4)
    T[0, 3] = x
    return T[None]


# Event, its largest values that are applied, and values that are rejected.
LIMITS: tuple[tuple[str, list[Any], list[Any]], ...] = (
    ("angles", [[math.degrees(0.99e6), 0.0]], [[1e308, 0.0], [0.0, math.degrees(-1.01e6)]]),
    ("torques", [[-1e9, 1e9]], [[1.0, 1e300], [-1.01e9, 0.0]]),
    ("pose", [at(1e6)], [at(1e300), at(-1.01e6)]),
    ("push", [[[1e6, 0.0, 0.0]]], [[[0.0, 1.01e6, 0.0]]]),  # the route multiplies by 1000
    ("shown", [at(-1e6)], [at(1e300)]),
    ("count", [[10**15, 0]], [[10**15 + 1, 0], [0, -(2**63)]]),
)
BAD = [(event, value) for event, _, values in LIMITS for value in values]


def arm() -> SerialRobot:
    return SerialRobot(name="arm", dh_convention="craig", dh_params=[[0, 0, 0, 0.3]] * 2)


def scene_of(name: str, source: Source) -> Scene:
    return Scene(
        robots=[arm()],
        sources={name: source},
        routes={target: origin.format(name) for target, origin in ROUTES.items()},
        arrows=[SmartArrow(name="push", at="arm/flange")],
        frames=[ReceivedFrame(name="marker")],
    )


Send = Callable[[bytes], None]


@contextmanager
def udp() -> Iterator[tuple[Mirror, Send]]:
    source = UdpReceiver(name="robot", udpport=0, structure=STRUCTURE)
    with Mirror(scene_of("robot", source)) as mirror, socket.socket(type=socket.SOCK_DGRAM) as out:
        yield mirror, lambda packet: _send(out, packet, source.port)


def _send(out: socket.socket, packet: bytes, port: int) -> None:
    out.sendto(packet, ("127.0.0.1", port))


@contextmanager
def shm() -> Iterator[tuple[Mirror, Send]]:
    size = UdpReceiver(structure=STRUCTURE).size
    block = make("sero-mj-test-implausible", bytes(size))
    try:
        source = ShmReader(name="robot", block=block.path, structure=STRUCTURE)
        with Mirror(scene_of("robot", source)) as mirror:
            yield mirror, block.write
    finally:
        remove(block)


def packet(**events: Any) -> bytes:
    return UdpReceiver(structure=STRUCTURE).layout.encode({**GOOD, **events})


@pytest.mark.parametrize("kind", [udp, shm])
def test_implausible_packets_are_counted_and_not_applied(kind: Any) -> None:
    with kind() as (mirror, send):
        counters = mirror.sources["robot"].counters
        send(packet())
        assert until(mirror.advance)
        before = mirror.state()
        np.testing.assert_allclose(mirror.data.qpos, [math.pi / 2, math.radians(0.5)])
        for k, (event, value) in enumerate(BAD):
            send(packet(**{event: value}))
            assert until(lambda k=k: counters.implausible == k + 1), (event, value)
            assert counters.last_fault.startswith(f"{event}["), counters.last_fault
            assert not mirror.advance()
            for name in ("qpos", "mocap_pos"):
                assert np.isfinite(getattr(mirror.data, name)).all()
            np.testing.assert_allclose(mirror.data.qpos, [math.pi / 2, math.radians(0.5)])
        assert (counters.malformed, counters.not_finite) == (len(BAD), 0)
        slot = get_source(mirror.data, mirror.world, "robot")
        assert (slot["implausible"], slot["malformed"]) == (len(BAD), len(BAD))
        rows = {what: count for what, count, _ in describe(report(mirror.sources["robot"]))}
        assert rows["implausible"] == str(len(BAD))
        count = mirror.world.slots["arm.torques"]
        assert mirror.data.userdata[count].tolist() == [1.0, 2.0]
        assert len(before) == len(mirror.state())


@pytest.mark.parametrize(
    ("event", "value"), [(event, value) for event, values, _ in LIMITS for value in values]
)
def test_large_but_plausible_values_are_applied(event: str, value: Any) -> None:
    with udp() as (mirror, send):
        send(packet(**{event: value}))
        assert until(mirror.advance), mirror.sources["robot"].counters


def test_replayed_packets_are_classified_as_when_received(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with udp() as (mirror, send), record_sources(mirror.sources, path):
        counters = mirror.sources["robot"].counters
        for bad in (packet(torques=[1e300, 0.0]), packet(pose=at(1e300)), packet()):
            send(bad)
        assert until(lambda: counters.received == 3)
        assert counters.implausible == 2
    replay = Replay(name="robot", file=path)
    with Mirror(scene_of("robot", replay)) as mirror:
        mirror.advance(replay.duration + 1.0)
        counters = mirror.sources["robot"].counters
        assert (counters.received, counters.implausible) == (3, 2)
        np.testing.assert_allclose(mirror.data.qpos, [math.pi / 2, math.radians(0.5)])


def test_infinity_counts_as_no_data_where_nan_does() -> None:
    with udp() as (mirror, send):
        send(packet(torques=[math.inf, 3.0]))
        assert until(mirror.advance)
        counters = mirror.sources["robot"].counters
        assert (counters.blanked, counters.implausible) == (1, 0)


@pytest.mark.parametrize(
    ("target", "value"),
    [
        ("arm.joint_angles", [1e308, 0.0]),
        ("arm.base_frame", at(1e300)[0]),
        ("marker.frame", at(1e7)[0]),
    ],
)
def test_implausible_inputs_set_by_a_program_are_rejected(target: str, value: Any) -> None:
    world = World(scene_of("robot", UdpReceiver(name="robot", structure=STRUCTURE)))
    data = world.make_data()
    with raises_with(DeclarationError, key=target):
        world.set_input(data, target, value)
    assert np.isfinite(data.mocap_pos).all()
    assert np.abs(data.mocap_pos).max(initial=0.0) < 1e6


@pytest.mark.parametrize(
    ("target", "value"),
    [
        ("arm.torques", [0.0, -1e300]),
        ("push.vector", [0.0, 0.0, 1e10]),
    ],
)
def test_implausible_display_values_set_by_a_program_are_blanked(target: str, value: Any) -> None:
    world = World(scene_of("robot", UdpReceiver(name="robot", structure=STRUCTURE)))
    data = world.make_data()
    world.set_input(data, target, value)
    shown = data.userdata[world.slots[target]]
    assert np.isnan(shown).any()
    assert np.nanmax(np.abs(shown), initial=0.0) < 1e6


def test_packets_of_random_doubles_move_nothing_out_of_view() -> None:
    random = np.random.default_rng(3)
    with udp() as (mirror, send):
        source = mirror.sources["robot"]
        for k in range(300):
            bits = random.integers(0, 2**64, 2, dtype=np.uint64)
            send(packet(angles=struct.unpack("<2d", bits.tobytes())))
            assert until(lambda k=k: source.counters.received == k + 1)
            mirror.advance()
            assert np.abs(mirror.data.qpos).max() <= 1e6
        counters = source.counters
        assert counters.implausible > 50
        assert counters.received == source.receive_trigger + counters.malformed
