"""Packets that a mirror passes to user code, and waiting for them."""

from __future__ import annotations

import socket
import struct
import threading

import pytest
from polling import until

from sero_mj import Mirror, Scene, SerialRobot, UdpReceiver
from sero_mj.data.receive.mailbox import Packets


@pytest.mark.parametrize("lossless", [True, False])
def test_all_applied_packets_are_passed_to_the_listener(lwr: SerialRobot, lossless: bool) -> None:
    source = UdpReceiver(structure="7F", only_latest_packet=not lossless)
    scene = Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})
    heard: list[tuple[str, Packets]] = []
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        mirror.listen(lambda name, packets: heard.append((name, packets)))
        assert not mirror.wait_next(0.0)
        for k in range(5):
            sock.sendto(struct.pack("<7d", *[k / 10] * 7), ("127.0.0.1", source.port))
        assert until(lambda: source.counters.received == 5)
        assert mirror.wait_next(1.0)
        assert mirror.advance()
        assert not mirror.advance()
        ((name, packets),) = heard
        assert name == "udp"
        first = packets.values["values0"][:, 0].tolist()
        assert first == ([0.0, 0.1, 0.2, 0.3, 0.4] if lossless else [0.4])
        assert mirror.data.qpos.tolist() == [0.4] * 7
        mirror.reset()
        assert mirror.data.qpos.tolist() == lwr.home.tolist()
        assert mirror.advance()  # the latest packet again, but nothing new was received
        assert mirror.data.qpos.tolist() == [0.4] * 7
        assert len(heard) == 1


def test_superseded_packets_are_passed_to_the_listener(lwr: SerialRobot) -> None:
    source = UdpReceiver(structure="7F")
    scene = Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})
    heard: list[float] = []
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        mirror.listen(lambda _, packets: heard.extend(packets.values["values0"][:, 0]), to_all=True)
        for frame in range(2):
            for k in range(5):
                sock.sendto(struct.pack("<7d", *[frame + k / 10] * 7), ("127.0.0.1", source.port))
            assert until(lambda count=5 * frame + 5: source.counters.received == count)
            assert mirror.advance()
        assert not mirror.advance()
        assert heard == [0.0, 0.1, 0.2, 0.3, 0.4, 1.0, 1.1, 1.2, 1.3, 1.4]
        assert source.counters.superseded == 8


def test_waiting_ends_when_a_packet_arrives(lwr: SerialRobot) -> None:
    source = UdpReceiver(structure="7F")
    scene = Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        came: list[bool] = []
        waiting = threading.Thread(target=lambda: came.append(mirror.wait_next(20.0)))
        waiting.start()
        sock.sendto(bytes(56), ("127.0.0.1", source.port))
        waiting.join(10.0)
        assert came == [True]
        assert not mirror.wait_next(0.0)  # only what has arrived since


def test_rendering_waits_for_a_new_packet(lwr: SerialRobot) -> None:
    source = UdpReceiver(structure="7F")
    scene = Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        mirror.wait_fresh(20.0)  # at once: it has sent nothing that could be old
        sock.sendto(struct.pack("<7d", *[0.1] * 7), ("127.0.0.1", source.port))
        assert source.wait(10.0)
        mirror.wait_fresh(0.0)
        assert mirror.data.qpos.tolist() == [0.1] * 7  # the newest available
        waiting = threading.Thread(target=mirror.wait_fresh, args=(20.0,))
        waiting.start()
        sent = 0
        while waiting.is_alive():
            sent += 1
            sock.sendto(struct.pack("<7d", *[0.2] * 7), ("127.0.0.1", source.port))
            waiting.join(0.01)
        assert sent < 100
        assert mirror.data.qpos.tolist() == [0.2] * 7


def test_toggles_follow_whether_packets_arrive(lwr: SerialRobot) -> None:
    source = UdpReceiver(structure="7F")
    routes = {
        "lwr.joint_angles": "udp.values0",
        "lwr.show_axes": "udp.receiving",
        "toggles.legend": "not udp.receiving",
        "lwr.show_billboards": "udp.receive_trigger",
    }
    scene = Scene(robots=[lwr], sources={"udp": source}, routes=routes)
    targets = ("lwr.show_axes", "toggles.legend", "lwr.show_billboards")

    def switches() -> list[float]:
        mirror.advance()
        return [float(mirror.data.userdata[mirror.world.slots[target]][0]) for target in targets]

    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        assert switches() == [0.0, 1.0, 0.0]
        sock.sendto(bytes(56), ("127.0.0.1", source.port))
        assert source.wait(5.0)
        assert switches() == [1.0, 0.0, 1.0]
        assert switches() == [1.0, 0.0, 0.0]  # it receives, but nothing new has arrived
        assert until(lambda: switches() == [0.0, 1.0, 0.0], seconds=2.0)
