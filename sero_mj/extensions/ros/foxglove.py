"""Reads ROS 2 topics from the WebSocket of foxglove_bridge, without DDS.

The server lists its topics in JSON. Each message of a subscribed topic consists of an opcode of
1 byte, the subscription id (uint32), a time of 8 bytes, and the message in CDR, all little-endian.
The client sends only subscriptions. The protocol is version 1 of Foxglove's SDK. The older protocol
`foxglove.websocket.v1` has the same messages.
"""

from __future__ import annotations

import json
import socket
import ssl
import struct
import time as clock
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field

from ...data.receive import connecting
from ...data.receive.connecting import Address
from ...data.receive.receiving_thread import Closing, Disconnected
from .ros_source import (
    MAX_REJECTED_BYTES,
    NO_MESSAGES,
    TYPES,
    Listener,
    RosSource,
    ros_type,
    topic_problem,
)

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

PORT = 8765
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
ENCODING = "cdr"
_DATA = 1  # opcode of topic messages; the client does not request any others
_HEAD = struct.Struct("<BIQ")
_MAX_BYTES = 1 << 26  # bytes of a WebSocket message, because lists of topics contain definitions
_CHECK_INTERVAL = 1.0  # s between checks of the topics while no messages arrive
_CLOSE_TIMEOUT = 0.2  # s; timeout of the peer's closing handshake
_WARNING = 1  # lowest level of status messages that are shown
_MAX_STATUS, _MAX_SHOWN = 200, 80  # characters shown of a status message or unknown message
_MAX_TOPICS = 100_000


class Foxglove(RosSource):
    """Reads topics from a Foxglove server, such as `foxglove_bridge`, and publishes nothing.

    The source reconnects when the connection is lost. Topics may appear after it has connected.

    Attributes:
        host: address of the server.
        port: port of the server.
        tls: whether to use an encrypted connection (`wss://`), which requires a trusted
            certificate.
    """

    name: str = "foxglove"
    host: Address
    port: int = Field(PORT, ge=1, le=65535)
    tls: bool = False

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'wss' if self.tls else 'ws'}://{host}:{self.port}"

    @property
    def about(self) -> str:
        topics = ", ".join(dict.fromkeys(topic for topic, _ in self.topics))
        return f"ROS 2 {topics}, Foxglove at {self.url}"

    def _subscribe(self, listener: Listener) -> None:
        client = Client(self, listener)
        self.start_receiving(client.receive, client.interrupt, f"foxglove {self.name}")


class _Channel(BaseModel):
    id: int
    topic: str
    encoding: str
    schema_name: str = Field(alias="schemaName")

    @property
    def kind(self) -> str:
        package, _, name = ros_type(self.schema_name).rpartition("/")
        return f"{package}/{name}" if package.endswith("/msg") else f"{package}/msg/{name}"


class _Advertised(BaseModel):
    channels: list[_Channel]


class _Unadvertised(BaseModel):
    channel_ids: list[int] = Field(alias="channelIds")


class _Status(BaseModel):
    level: int
    message: str


class Client:
    """Reads the topics of a source from a Foxglove server."""

    def __init__(self, source: Foxglove, listener: Listener) -> None:
        self._source, self._listener = source, listener
        self._channels: dict[int, _Channel] = {}
        self._subscribed: dict[int, tuple[int, str]] = {}  # subscription id to channel and content
        self._is_reconnecting = False  # there were messages, but none since the last connection
        self._number = 0  # id of the last subscription
        self._socket: socket.socket | None = None  # to end the connection from another thread
        self._connection: ClientConnection | None = None

    def interrupt(self) -> None:
        """Ends the connection. The source must have set `closing` before."""
        if (connection := self._connection) is not None:
            connection.close()
        if (duplicate := self._socket) is not None:
            with suppress(OSError):  # shuts down the original of this duplicate, too
                duplicate.shutdown(socket.SHUT_RDWR)

    def receive(self, wake: socket.socket) -> None:
        """Connects, and receives until the connection ends; raises Disconnected or Closing."""
        from websockets.exceptions import ConnectionClosed, InvalidMessage, WebSocketException

        url = self._source.url
        try:
            self._connect(wake)
        except ConnectionClosed as error:
            said = "" if error.rcvd is None else error.rcvd.reason[:_MAX_STATUS]
            reason = "the server closed the connection" + (f": {said}" if said else "")
        except (InvalidMessage, EOFError):
            reason = "not a Foxglove server: the answer is not HTTP"
        except TimeoutError as error:
            reason = error.strerror or "does not answer like a Foxglove server"
        except OSError as error:
            reason = f"{error.strerror or error}"
        except (WebSocketException, ValueError) as error:  # ValueError: invalid redirection
            reason = f"not a Foxglove server: {str(error)[:_MAX_STATUS]}"
        raise Disconnected(f"{url}: {reason}")

    def _connect(self, wake: socket.socket) -> None:
        from websockets.exceptions import InvalidHandshake
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        source = self._source
        sock = connecting.connect(source.host, source.port, wake)
        sock.setblocking(True)
        with sock.dup() as duplicate:
            self._socket = duplicate
            try:
                if source.closing.is_set():
                    sock.close()
                    raise Closing
                options: dict[str, Any] = {}
                if source.tls:
                    options["ssl"] = ssl.create_default_context()
                with connect(
                    source.url,
                    sock=sock,
                    subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
                    compression=None,
                    open_timeout=connecting.PATIENCE,
                    close_timeout=_CLOSE_TIMEOUT,
                    max_size=_MAX_BYTES,
                    **options,
                ) as connection:
                    if connection.subprotocol is None:
                        raise InvalidHandshake("the server does not support this protocol")
                    self._connection = connection
                    if not source.closing.is_set():
                        self._converse(connection)
            finally:
                self._connection = self._socket = None
                sock.close()

    def _converse(self, connection: ClientConnection) -> None:
        self._channels, self._subscribed, self._number = {}, {}, 0
        self._is_reconnecting = self._source.receive_trigger > 0
        due = clock.monotonic() + _CHECK_INTERVAL
        while True:
            try:
                received = connection.recv(timeout=max(due - clock.monotonic(), 0.0))
            except TimeoutError:
                pass
            else:
                if isinstance(received, bytes):
                    self._take(received)
                else:
                    self._on_text(received, connection)
            if clock.monotonic() >= due:
                self._check_publishers()
                due = clock.monotonic() + _CHECK_INTERVAL

    def _take(self, received: bytes) -> None:
        self._acknowledge_now()
        if received and received[0] != _DATA:
            return
        if len(received) < _HEAD.size:
            layout = self._source.layout
            layout.fault = f"{len(received)} bytes are too short for the header of a message"
            self._source.accept([layout.never(received[:MAX_REJECTED_BYTES])])
            return
        _, number, _ = _HEAD.unpack_from(received)
        if number in self._subscribed:  # otherwise, the server has just withdrawn the topic
            _, content = self._subscribed[number]
            if self._is_reconnecting:
                self._is_reconnecting = False
                self._source.intake.restart()
            self._listener.take([(content, received[_HEAD.size :], b"")])

    def _acknowledge_now(self) -> None:
        if (duplicate := self._socket) is not None and hasattr(socket, "TCP_QUICKACK"):
            duplicate.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)

    def _on_text(self, text: str, connection: ClientConnection) -> None:
        try:
            operation = json.loads(text).get("op")
            if operation == "advertise":
                self._advertise(_Advertised.model_validate_json(text).channels, connection)
            elif operation == "unadvertise":
                self._withdraw(_Unadvertised.model_validate_json(text).channel_ids)
            elif operation == "status":
                status = _Status.model_validate_json(text)
                if status.level >= _WARNING:
                    self._source.log_once(f"server message: {status.message[:_MAX_STATUS]}")
        except (ValueError, AttributeError, RecursionError):
            shown = repr(text[:_MAX_SHOWN])
            self._source.log_once(f"{self._source.url} has sent an unknown message: {shown}")

    def _advertise(self, channels: list[_Channel], connection: ClientConnection) -> None:
        self._source.note_trouble("")
        wanted = []
        for channel in channels:
            if len(self._channels) >= _MAX_TOPICS:
                break
            known = {each for each, _ in self._subscribed.values()}
            self._channels[channel.id] = channel
            for topic, content in self._source.topics:
                fits = (channel.topic, channel.kind) == (topic, TYPES[content])
                if fits and channel.encoding == ENCODING and channel.id not in known:
                    self._number += 1
                    self._subscribed[self._number] = channel.id, content
                    wanted.append({"id": self._number, "channelId": channel.id})
        if wanted:
            connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _withdraw(self, channels: list[int]) -> None:
        for channel in channels:
            self._channels.pop(channel, None)
        self._subscribed = {
            number: (channel, content)
            for number, (channel, content) in self._subscribed.items()
            if channel not in channels
        }

    def _check_publishers(self) -> None:
        if self._source.receiving:
            self._source.note_trouble("")
            return
        wrong = [
            self._topic_problem(topic, TYPES[content]) for topic, content in self._source.topics
        ]
        if not self._channels:
            self._source.note_trouble(f"{self._source.url} has no topics")
        else:
            self._source.note_trouble("; ".join(filter(None, wrong)) or NO_MESSAGES)

    def _topic_problem(self, topic: str, kind: str) -> str:
        channels = self._channels.values()
        if wrong := topic_problem(topic, kind, ((each.topic, each.kind) for each in channels)):
            return wrong
        encodings = {each.encoding for each in channels if (each.topic, each.kind) == (topic, kind)}
        if encodings and ENCODING not in encodings:
            return f"{topic} is encoded as {min(encodings)[:40]!r}; expected {ENCODING!r}"
        return ""
