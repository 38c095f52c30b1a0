"""`Zenoh` against routers and peers of zenoh that publish as rmw_zenoh does."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from polling import until
from ros_bytes import JOINT_STATE, Peer, joint_state, text, transform
from ros_scenes import assert_refused, mirrored_recorded_and_replayed

from sero_mj.base.errors import SourceError
from sero_mj.data.receive import receiving_thread
from sero_mj.data.receive.report import describe, report
from sero_mj.extensions.ros import zenoh
from sero_mj.extensions.ros.zenoh import Zenoh

TOPIC = "/joint_states"
NAMES = ["a", "b", "c"]
SCENE = """
[robots.arm]
dh_convention = "standard"
dh_params = [[0, 0, 0, 0.3], [1.57, 0, 0, 0], [0, 0.4, 0, 0]]
joint_names = ["a", "b", "c"]
[sources.driver]
kind = "zenoh"
host = "127.0.0.1"
port = {port}
domain = 0
[routes]
"arm.joint_angles" = "driver.joint_angles"
"arm.torques" = "driver.torques"
"""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts to connect, and looks at publishers, follow each other quickly."""
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.01)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.04)
    monkeypatch.setattr(zenoh, "_CHECK_INTERVAL", 0.02)
    monkeypatch.setattr(zenoh, "_PATIENCE", 0.4)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer("zenoh_peer.py", free_port()) as peer:
        yield peer


def source_of(port: int, **fields: Any) -> Zenoh:
    return Zenoh(host="127.0.0.1", port=port, **{"joints": NAMES, "domain": 0, **fields})


def give(source: Zenoh, peer: Peer, *messages: bytes, **command: Any) -> None:
    """Publishes messages and waits until they are dealt with."""
    before = source.counters.received
    for message in messages:
        assert peer.do(topic=TOPIC, wait=True, data=message, **command) == "done"
    assert until(lambda: source.counters.received == before + len(messages))


def values(source: Any, event: str = "joint_angles") -> list[float]:
    packet = source.latest()
    return [] if packet is None else packet.values[event].ravel().tolist()


# ---- what comes


@pytest.mark.parametrize("mode", ["router", "peer"])
def test_values_come_by_the_names_of_joints(mode: str) -> None:
    with Peer("zenoh_peer.py", free_port(), mode) as peer:
        with source_of(peer.port) as source:
            give(source, peer, joint_state(NAMES, [1, 2, 3], [4, 5, 6], [7, 8, 9], 1.25))
            assert values(source) == [1.0, 2.0, 3.0]
            assert values(source, "joint_velocities") == [4.0, 5.0, 6.0]
            assert values(source, "torques") == [7.0, 8.0, 9.0]
            assert values(source, "stamp") == [1.25]
            assert source.trouble == ""
            give(source, peer, joint_state(["c", "x", "a", "b"], [3, 0, 1, 2.5]))
            assert values(source) == [1.0, 2.5, 3.0]
            assert np.isnan(values(source, "torques")).all()
            begin = time.monotonic()
        assert time.monotonic() - begin < 1.0
        assert source.about == f"ROS 2 /joint_states, domain 0, zenoh at 127.0.0.1:{peer.port}"


def test_malformed_messages_are_counted(peer: Peer) -> None:
    with source_of(peer.port) as source:
        good = joint_state(NAMES, [1, 2, 3])
        bad = [b"", b"\0", good[:40], good[:-8], b"\xff" * source.size]
        give(source, peer, *bad, good)
        assert (source.counters.wrong_size, source.receive_trigger) == (len(bad), 1)
        assert JOINT_STATE in source.counters.last_fault
        assert values(source) == [1.0, 2.0, 3.0]


def test_publishers_are_distinguished_by_their_attachment(peer: Peer) -> None:
    message = joint_state(NAMES, [1, 2, 3], stamp=0.0)
    with source_of(peer.port) as source:
        give(source, peer, message, message, gid=b"")
        give(source, peer, *3 * [message], gid=bytes(16))
        assert source.counters.senders == 1
        for _ in range(3):
            give(source, peer, message, gid=bytes(range(16)))
            give(source, peer, message, gid=bytes(range(16, 32)))
        assert source.counters.senders == 2


def test_messages_stored_by_publishers_are_read(peer: Peer) -> None:
    kind = "tf2_msgs/msg/TFMessage"
    frames = transform("base", "tool", [0.5, 0.25, 1.0])
    peer.do(topic="/tf_static", kind=kind, kept=True, data=frames)
    with source_of(peer.port, joint_states="", frames=["tool"], root="base") as source:
        assert source.wait(5.0)
        packet = source.latest()
        assert packet is not None
        expected = np.eye(4)
        expected[:3, 3] = 0.5, 0.25, 1.0
        np.testing.assert_array_equal(packet.values["tf_tool"].reshape(4, 4), expected)


def test_domain_defaults_to_the_environment(monkeypatch: pytest.MonkeyPatch, peer: Peer) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with source_of(peer.port, domain=None) as source:
        assert "domain 7" in source.about
        give(source, peer, joint_state(NAMES, [0, 0, 0]), domain=7)
        for domain in (0, 70):
            peer.do(topic=TOPIC, data=joint_state(NAMES, [9, 9, 9]), domain=domain)
        give(source, peer, joint_state(NAMES, [1, 2, 3]), domain=7)
        assert (source.counters.received, values(source)) == (2, [1.0, 2.0, 3.0])


# ---- what goes wrong


def test_unexpected_topics_are_reported(peer: Peer) -> None:
    with source_of(peer.port) as source:
        assert until(lambda: source.trouble == "no publisher in domain 0")
        for topic in ("/left/joint_states", "/right/joint_states"):
            peer.do(topic=topic)
        peer.do(topic="/chatter", kind="std_msgs/msg/String")
        told = "no publisher of /joint_states; topics of its type: /left/joint_states, "
        assert until(lambda: source.trouble == told + "/right/joint_states")
        peer.do(topic=TOPIC, kind="std_msgs/msg/String", data=text("hello"))
        told = f"/joint_states is of type std_msgs/msg/String; expected {JOINT_STATE}"
        assert until(lambda: source.trouble == told)
        assert peer.do(topic=TOPIC, wait=True) == "done"
        assert until(lambda: source.trouble == "the publisher is not sending messages")
        state = {row[0]: row for row in describe(report(source))}["state"]
        assert state[1:] == ("silent", f"no valid packet yet: {source.trouble}")
        give(source, peer, joint_state(NAMES, [1, 2, 3]))
        assert values(source) == [1.0, 2.0, 3.0]
        assert source.counters.received == 1


@pytest.mark.thorough
def test_restarted_router_is_connected_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    port = free_port()
    with source_of(port) as source:
        for k in range(3):
            with Peer("zenoh_peer.py", port) as peer:
                give(source, peer, joint_state(NAMES, [k, 2, 3]))
                assert values(source) == [k, 2.0, 3.0]
            gone = f"lost the connection to the zenoh router at 127.0.0.1:{port}"
            assert until(lambda gone=gone: source.trouble == gone)
        assert source.counters.received == 3
    told = [said for said in caplog.messages if "lost the connection" in said]
    assert told == [f"source 'zenoh': {gone}; reconnecting"]


def test_receiver_waits_for_a_router_that_is_off(caplog: pytest.LogCaptureFixture) -> None:
    port = free_port()
    with source_of(port) as source:
        assert until(lambda: source.trouble == f"no zenoh router at 127.0.0.1:{port}")
        with Peer("zenoh_peer.py", port) as peer:
            give(source, peer, joint_state(NAMES, [1, 2, 3]))
            assert values(source) == [1.0, 2.0, 3.0]
    told = [said for said in caplog.messages if "no zenoh router" in said]
    assert len(told) == 1
    assert told[0].startswith(f"source 'zenoh': no zenoh router at 127.0.0.1:{port} (")
    assert told[0].endswith("; trying again")
    assert " at /" not in told[0]
    with Zenoh(host="no.such.host.invalid", joints=NAMES) as source:
        assert until(lambda: source.trouble == "no zenoh router at no.such.host.invalid:7447")
    with Zenoh(host="a/b?c", joints=NAMES, debug_level=0) as source:
        assert until(lambda: source.trouble == "no zenoh router at a/b?c:7447")


def test_invalid_router_is_reported_and_closing_does_not_wait(monkeypatch: Any) -> None:
    monkeypatch.undo()  # with the pauses that users have
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts and says nothing
        source = source_of(silent.getsockname()[1])
        source.open()
        silent.settimeout(5.0)
        client, _ = silent.accept()
        begin = time.monotonic()
        source.close()
        source.close()
        assert time.monotonic() - begin < 1.0
        client.close()
    assert not [each for each in threading.enumerate() if each.name.startswith("zenoh ")]


def test_invalid_peer_is_disconnected() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        listening.settimeout(5.0)
        with source_of(port) as source:
            for answer in (b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xff" * 70_000, b"\0\0"):
                client, _ = listening.accept()
                client.recv(4096)
                client.sendall(answer)
                client.close()
            assert until(lambda: source.trouble == f"no zenoh router at 127.0.0.1:{port}")


def test_invalid_topic_is_reported(peer: Peer) -> None:
    with source_of(peer.port, joint_states="/a//b") as source:
        assert until(lambda: source.trouble.startswith("zenoh error: Invalid Key Expr"))
        begin = time.monotonic()
    assert time.monotonic() - begin < 1.0


# ---- in a scene


@pytest.mark.parametrize(
    ("fields", "key", "reason"),
    [
        ({}, "host", "is required"),
        ({"host": ""}, "host", "found ''; expected an address such as 192.168.0.3"),
        ({"host": "a", "port": 70_000}, "port", "found 70000; expected"),
        ({"host": "a", "domain": 233}, "domain", "found 233; expected"),
    ],
)
def test_fields_are_checked(fields: dict[str, Any], key: str, reason: str) -> None:
    assert_refused("zenoh", fields, key, reason)


def test_robot_is_mirrored_recorded_and_replayed(peer: Peer, tmp_path: Path) -> None:
    original = mirrored_recorded_and_replayed(
        SCENE.format(port=peer.port),
        tmp_path,
        lambda: peer.do(topic=TOPIC, wait=True) == "done",
        lambda source, good: give(source, peer, good[:-1], good),
    )
    assert isinstance(original, Zenoh)
    assert original.joint_names == NAMES


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(SourceError, match=r"zenoh.*pip install 'sero-mj\[zenoh\]'"):
        source_of(1).open()


def test_packages_are_imported_only_when_needed() -> None:
    code = "import sys, sero_mj.extensions.ros.zenoh; print(*sorted(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert {"rosbags", "zenoh", "cyclonedds"}.isdisjoint(done.stdout.split())
