"""`Foxglove` with a server of Foxglove's own SDK, and with a server that sends invalid data."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from polling import until
from ros_bytes import JOINT_STATE, Peer, joint_state, text, transform
from ros_scenes import assert_refused, mirrored_recorded_and_replayed
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from sero_mj.base.errors import SourceError
from sero_mj.data.receive import connecting, receiving_thread
from sero_mj.data.receive.report import describe, report
from sero_mj.extensions.ros import foxglove
from sero_mj.extensions.ros.foxglove import SUBPROTOCOLS, Foxglove

TOPIC = "/joint_states"
NAMES = ["a", "b", "c"]
SCENE = """
[robots.arm]
dh_convention = "standard"
dh_params = [[0, 0, 0, 0.3], [1.57, 0, 0, 0], [0, 0.4, 0, 0]]
joint_names = ["a", "b", "c"]
[sources.driver]
kind = "foxglove"
host = "127.0.0.1"
port = {port}
[routes]
"arm.joint_angles" = "driver.joint_angles"
"arm.torques" = "driver.torques"
"""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts to connect, and looks at topics, follow each other quickly."""
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.002)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.02)
    monkeypatch.setattr(foxglove, "_CHECK_INTERVAL", 0.02)


def channel(number: int = 1, topic: str = TOPIC, **other: Any) -> dict[str, Any]:
    return {
        "id": number, "topic": topic, "encoding": "cdr", "schemaName": JOINT_STATE,
        "schemaEncoding": "ros2msg", "schema": "", **other,
    }  # fmt: skip


class Server:
    """A server for Foxglove, of websockets alone.

    Args:
        greeting: messages sent to each client: strings, bytes, or objects to encode as JSON.
        port: 0 for any.
        subprotocols: supported subprotocols.

    Attributes:
        told: messages received from all clients.
        connections: number of clients so far.
        refusal: reason for which clients are rejected; empty to accept them.
    """

    def __init__(self, *greeting: Any, port: int = 0, subprotocols: Any = SUBPROTOCOLS[1:]) -> None:
        self.greeting, self.told, self.connections = list(greeting), [], 0
        self.refusal = ""
        self._client: ServerConnection | None = None
        self._server = serve(
            self._meet, "127.0.0.1", port, subprotocols=subprotocols, compression=None
        )
        self.port = int(self._server.socket.getsockname()[1])
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *exc: object) -> None:
        self._server.shutdown()
        self.drop()
        self._thread.join(5.0)

    def _meet(self, connection: ServerConnection) -> None:
        self._client, self.connections = connection, self.connections + 1
        if self.refusal:
            self.drop()
            return
        try:
            for each in self.greeting:
                self.send(each)
            for each in connection:
                self.told.append(json.loads(each))
        except ConnectionClosed:
            pass

    def drop(self) -> None:
        if self._client is not None:
            self._client.close(1011, self.refusal)

    def send(self, *told: Any) -> None:
        assert self._client is not None
        for each in told:
            self._client.send(each if isinstance(each, str | bytes) else json.dumps(each))

    def advertise(self, *channels: dict[str, Any]) -> None:
        self.send({"op": "advertise", "channels": channels})

    @property
    def subscriptions(self) -> list[tuple[int, int]]:
        """Numbers and channels of all subscriptions so far."""
        return [(each["id"], each["channelId"]) for op in self.told for each in op["subscriptions"]]


def data(message: bytes, number: int = 1) -> bytes:
    return b"\1" + number.to_bytes(4, "little") + bytes(8) + message


def source_of(port: int, **fields: Any) -> Foxglove:
    return Foxglove(host="127.0.0.1", port=port, **{"joints": NAMES, **fields})


def give(source: Foxglove, server: Server, *messages: bytes) -> None:
    """Sends binary messages and waits until they are dealt with."""
    before = source.counters.received
    server.send(*messages)
    assert until(lambda: source.counters.received == before + len(messages))


def values(source: Any, event: str = "joint_angles") -> list[float]:
    packet = source.latest()
    return [] if packet is None else packet.values[event].ravel().tolist()


@pytest.fixture
def server() -> Iterator[Server]:
    with Server({"op": "advertise", "channels": [channel()]}) as server:
        yield server


# ---- from the SDK's server, as foxglove_bridge is one


def test_values_come_by_the_names_of_joints() -> None:
    with Peer("foxglove_peer.py", 0) as peer:
        with source_of(peer.port) as source:
            assert peer.do(topic=TOPIC, wait=True) == "done"
            peer.do(topic=TOPIC, data=joint_state(NAMES, [1, 2, 3], [4, 5, 6], [7, 8, 9], 1.25))
            assert source.wait(5.0)
            assert values(source) == [1.0, 2.0, 3.0]
            assert values(source, "joint_velocities") == [4.0, 5.0, 6.0]
            assert values(source, "torques") == [7.0, 8.0, 9.0]
            assert values(source, "stamp") == [1.25]
            assert source.trouble == ""
            peer.do(topic=TOPIC, data=joint_state(["c", "x", "a", "b"], [3, 0, 1, 2.5]))
            assert until(lambda: values(source) == [1.0, 2.5, 3.0])
            assert np.isnan(values(source, "torques")).all()
            peer.do(topic=TOPIC, data=joint_state(NAMES, [1, 2, 3])[:-8])
            peer.do(topic=TOPIC, data=joint_state(NAMES, [3, 2, 1]))
            assert until(lambda: values(source) == [3.0, 2.0, 1.0])
            assert (source.counters.received, source.counters.wrong_size) == (4, 1)
            assert "sensor_msgs/msg/JointState" in source.counters.last_fault
            assert source.counters.restarts == 0
            begin = time.monotonic()
        assert time.monotonic() - begin < 1.0
        assert source.about == f"ROS 2 /joint_states, Foxglove at ws://127.0.0.1:{peer.port}"


def test_frames_and_several_topics_are_joined() -> None:
    with Peer("foxglove_peer.py", 0) as peer:
        peer.do(topic="/tf_static", kind="tf2_msgs/msg/TFMessage")
        peer.do(topic="/arm/joint_states")
        with source_of(peer.port, namespace="arm", frames=["tool"], root="base") as source:
            frames = transform("base", "tool", [0.5, 0.25, 1.0])
            assert peer.do(topic="/tf_static", wait=True, data=frames) == "done"
            moved = joint_state(NAMES, [1, 2, 3])
            assert peer.do(topic="/arm/joint_states", wait=True, data=moved) == "done"
            assert source.wait(5.0)
            packet = source.latest()
            assert packet is not None
            expected = np.eye(4)
            expected[:3, 3] = 0.5, 0.25, 1.0
            np.testing.assert_array_equal(packet.values["tf_tool"].reshape(4, 4), expected)
            assert values(source) == [1.0, 2.0, 3.0]


def test_restarted_server_is_connected_again() -> None:
    with Peer("foxglove_peer.py", 0) as peer, source_of(peer.port) as source:
        for k in range(3):
            moved = joint_state(NAMES, [k, 2, 3])
            assert peer.do(topic=TOPIC, wait=True, data=moved) == "done"
            assert until(lambda k=k: values(source) == [k, 2.0, 3.0])
            peer.close()
            assert until(lambda: not source.receiving and source.trouble != "")
            assert source.trouble.startswith(f"ws://127.0.0.1:{peer.port}: ")
            peer.__init__("foxglove_peer.py", peer.port)  # type: ignore[misc]
        assert (source.counters.received, source.counters.restarts) == (3, 2)


def test_unexpected_topics_are_reported() -> None:
    with Peer("foxglove_peer.py", 0) as peer, source_of(peer.port) as source:
        assert until(lambda: source.trouble == f"ws://127.0.0.1:{peer.port} has no topics")
        for topic in ("/left/joint_states", "/right/joint_states"):
            peer.do(topic=topic)
        peer.do(topic="/chatter", kind="std_msgs/msg/String")
        told = "no publisher of /joint_states; topics of its type: /left/joint_states, "
        assert until(lambda: source.trouble == told + "/right/joint_states")
        peer.do(topic=TOPIC, kind="std_msgs/msg/String", data=text("hello"))
        told = f"/joint_states is of type std_msgs/msg/String; expected {JOINT_STATE}"
        assert until(lambda: source.trouble == told)
        peer.do(topic=TOPIC, close=True)
        peer.do(topic=TOPIC, encoding="json")
        told = "/joint_states is encoded as 'json'; expected 'cdr'"
        assert until(lambda: source.trouble == told)
        peer.do(topic=TOPIC, data=joint_state(NAMES, [9, 9, 9]))
        peer.do(topic=TOPIC, close=True)
        assert peer.do(topic=TOPIC, wait=True) == "done"
        assert until(lambda: source.trouble == "the publisher is not sending messages")
        state = {row[0]: row for row in describe(report(source))}["state"]
        assert state[1:] == ("silent", f"no valid packet yet: {source.trouble}")
        peer.do(topic=TOPIC, data=joint_state(NAMES, [1, 2, 3]))
        assert until(lambda: values(source) == [1.0, 2.0, 3.0])
        assert source.counters.received == 1


# ---- from others


def test_nothing_but_subscriptions_is_sent(server: Server) -> None:
    with source_of(server.port, wrench="/wrench") as source:
        assert until(lambda: server.subscriptions == [(1, 1)])
        server.advertise(
            channel(7, "/wrench", schemaName="geometry_msgs/WrenchStamped"), channel(8, "/others")
        )
        assert until(lambda: server.subscriptions == [(1, 1), (2, 7)])
        server.advertise(channel())  # once more: it is known
        give(source, server, data(joint_state(NAMES, [1, 2, 3])))
    assert {op["op"] for op in server.told} == {"subscribe"}
    assert len(server.subscriptions) == 2


def test_withdrawn_topics_are_read_when_they_reappear(server: Server) -> None:
    with source_of(server.port) as source:
        assert until(lambda: len(server.subscriptions) == 1)
        server.send({"op": "unadvertise", "channelIds": [1, 99]})
        assert until(lambda: "has no topics" in source.trouble)
        server.send(data(joint_state(NAMES, [9, 9, 9])))  # it was on its way
        server.advertise(channel(2))
        assert until(lambda: server.subscriptions == [(1, 1), (2, 2)])
        give(source, server, data(joint_state(NAMES, [1, 2, 3]), 2))
        assert values(source) == [1.0, 2.0, 3.0]


def test_malformed_messages_are_counted(server: Server) -> None:
    with source_of(server.port) as source:
        assert until(lambda: len(server.subscriptions) == 1)
        good = joint_state(NAMES, [1, 2, 3])
        bad = [b"", b"\1", data(good)[:12], data(b""), data(good[:40]), data(b"\xff" * source.size)]
        give(source, server, *bad)
        assert source.counters.wrong_size == len(bad)
        server.send(b"\2" + bytes(8), b"\4", b"\xff" * 100, data(good, 7))  # others' messages
        give(source, server, data(good))
        assert (source.receive_trigger, source.counters.malformed) == (1, len(bad))
        assert values(source) == [1.0, 2.0, 3.0]
        give(source, server, b"\1" + bytes(5))
        assert source.counters.last_fault.startswith("6 bytes")
        assert server.connections == 1


@pytest.mark.parametrize(
    "nonsense",
    [
        "", "{", "[]", "null", '"op"', "[" * 100_000, '{"op": "advertise"}',
        {"op": "advertise", "channels": 7}, {"op": "advertise", "channels": [{"id": "x"}]},
        {"op": "advertise", "channels": [channel(topic=None)]}, {"op": "unadvertise"},
        {"op": "unadvertise", "channelIds": [{}]}, {"op": "status", "level": "high"},
    ],
    ids=range(13),
)  # fmt: skip
def test_invalid_texts_are_reported(
    server: Server, nonsense: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with source_of(server.port) as source:
        assert until(lambda: len(server.subscriptions) == 1)
        server.send(nonsense, {"op": ["what", "else"]}, {"op": "serverInfo", "name": 3}, nonsense)
        give(source, server, data(joint_state(NAMES, [1, 2, 3])))
        assert values(source) == [1.0, 2.0, 3.0]
        assert server.connections == 1
    told = [said for said in caplog.messages if "unknown message" in said]
    assert len(told) == 1
    assert len(told[0]) < 200


def test_server_messages_are_reported_once(
    server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with source_of(server.port) as source:
        assert until(lambda: len(server.subscriptions) == 1)
        for level, said in enumerate(("all is well", "a topic is slow", "a topic is slow")):
            server.send({"op": "status", "level": level, "message": said})
        give(source, server, data(joint_state(NAMES, [1, 2, 3])))
    said = [each for each in caplog.messages if "server message" in each]
    assert said == ["source 'foxglove': server message: a topic is slow"]


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n\r\n", "does not answer like a Foxglove server"),
        (b"", "does not answer like a Foxglove server"),
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n",
         "not a Foxglove server: server rejected WebSocket connection: HTTP 404"),
        (b"HTTP/1.1 302 Found\r\nLocation: ws://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n",
         "not a Foxglove server: cannot follow"),
        (b"HTTP/1.1 302 Found\r\nLocation: /x\r\nContent-Length: 0\r\n\r\n",
         "not a Foxglove server: "),
        (None, "not a Foxglove server: the answer is not HTTP"),
    ],
)  # fmt: skip
def test_invalid_server_is_reported_and_retried(
    answer: bytes | None, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "PATIENCE", 0.1)
    tries = 0

    def serve_nonsense(listening: socket.socket) -> None:
        nonlocal tries
        kept = []
        while True:
            try:
                client, _ = listening.accept()
            except OSError:
                break
            tries += 1
            client.recv(4096)
            if answer is None:
                client.close()
            else:
                client.sendall(answer)
                kept.append(client)
        for client in kept:
            client.close()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        thread = threading.Thread(target=serve_nonsense, args=[listening], daemon=True)
        thread.start()
        with source_of(port) as source:
            assert until(lambda: tries > 2 and source.trouble != "")
            assert source.trouble.startswith(f"ws://127.0.0.1:{port}: {told}")
        listening.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_websocket_of_another_protocol_is_reported() -> None:
    with Server(subprotocols=None) as server, source_of(server.port) as source:
        assert until(lambda: server.connections > 1)
        assert until(lambda: source.trouble.endswith("not support this protocol"))
    assert server.told == []


def test_reason_for_a_closed_connection_is_reported(server: Server) -> None:
    with source_of(server.port) as source:
        for k in range(3):
            assert until(lambda k=k: len(server.subscriptions) == k + 1)
            give(source, server, data(joint_state(NAMES, [k, 0, 0])))
            assert values(source) == [k, 0.0, 0.0]
            server.refusal = "too slow"
            server.drop()
            assert until(lambda: source.trouble.endswith("closed the connection: too slow"))
            server.refusal = ""
        assert until(lambda: len(server.subscriptions) == 4)
        assert (source.counters.received, source.counters.restarts) == (3, 2)


def test_receiver_waits_for_a_server_that_is_off(caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    with source_of(port) as source:
        assert until(lambda: source.trouble == f"ws://127.0.0.1:{port}: Connection refused")
        with Server({"op": "advertise", "channels": [channel()]}, port=port) as server:
            assert until(lambda: len(server.subscriptions) == 1)
            give(source, server, data(joint_state(NAMES, [1, 2, 3])))
    told = [said for said in caplog.messages if "refused" in said]
    told_once = f"ws://127.0.0.1:{port}: Connection refused; trying again"
    assert told == [f"source 'foxglove': {told_once}"]
    with Foxglove(host="no.such.host.invalid", joints=NAMES) as source:
        assert until(lambda: source.trouble.startswith("ws://no.such.host.invalid:8765: "))
    with Foxglove(host="a..b", joints=NAMES, debug_level=0) as source:
        assert until(lambda: source.trouble == "ws://a..b:8765: not an address")


def test_closing_does_not_wait_for_anybody(server: Server) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts and says nothing
        for port in (silent.getsockname()[1], server.port):
            source = source_of(port)
            source.open()
            assert until(lambda port=port: port != server.port or len(server.subscriptions) == 1)
            begin = time.monotonic()
            source.close()
            source.close()
            assert time.monotonic() - begin < 1.0
    assert not [each for each in threading.enumerate() if each.name.startswith("foxglove")]


def test_plain_text_server_is_reported_if_tls_is_expected(server: Server) -> None:
    with source_of(server.port, tls=True) as source:
        assert until(lambda: source.trouble != "")
        assert source.trouble.startswith(f"wss://127.0.0.1:{server.port}: ")
        assert server.connections == 0


@settings(max_examples=examples(40))
@given(st.lists(st.one_of(st.binary(max_size=200), st.text(max_size=200)), max_size=5))
def test_next_message_is_read_after_any_bytes(sent: list[Any]) -> None:
    greeting = {"op": "advertise", "channels": [channel()]}
    with Server(greeting) as server, source_of(server.port, debug_level=0) as source:
        assert until(lambda: len(server.subscriptions) == 1)
        server.send(*sent, data(joint_state(NAMES, [1, 2, 3])))
        assert until(lambda: values(source) == [1.0, 2.0, 3.0])


# ---- in a scene


@pytest.mark.parametrize(
    ("fields", "key", "reason"),
    [
        ({}, "host", "is required"),
        ({"host": ""}, "host", "found ''; expected an address such as 192.168.0.3"),
        ({"host": "a b"}, "host", "found 'a b'; expected an address such as 192.168.0.3"),
        ({"host": "a", "port": 0}, "port", "found 0; expected"),
        ({"host": "a", "tls": "perhaps"}, "tls", "found 'perhaps'; expected"),
        ({"host": "a", "joint_states": ""}, "joint_states", "no topic is read"),
    ],
)
def test_fields_are_checked(fields: dict[str, Any], key: str, reason: str) -> None:
    assert_refused("foxglove", fields, key, reason)


def test_robot_is_mirrored_recorded_and_replayed(server: Server, tmp_path: Path) -> None:
    original = mirrored_recorded_and_replayed(
        SCENE.format(port=server.port),
        tmp_path,
        lambda: until(lambda: len(server.subscriptions) == 1),
        lambda source, good: give(source, server, data(good[:-1]), data(good)),
    )
    assert isinstance(original, Foxglove)
    assert original.joint_names == NAMES


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    messages = sys.modules["sero_mj.extensions.ros.messages"]
    foxglove_messages: Callable[[], None] = messages.type_store
    foxglove_messages.cache_clear()  # type: ignore[attr-defined]
    with pytest.raises(SourceError, match=r"rosbags.*pip install 'sero-mj\["):
        source_of(1).open()


def test_packages_are_imported_only_when_needed() -> None:
    code = "import sys, sero_mj.extensions.ros.foxglove; print(*sorted(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert {"rosbags", "websockets", "cyclonedds"}.isdisjoint(done.stdout.split())
