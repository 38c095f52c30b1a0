"""`Foxglove`: topics of ROS 2 from the WebSocket of foxglove_bridge; no DDS is needed.

A server lists its topics in JSON, and sends the messages of subscribed topics: an opcode of 1 byte,
the subscription id (uint32), a time of 8 bytes, and the message in CDR, all little-endian. The
client sends only subscriptions. The protocol is v1 of Foxglove's SDK, and its predecessor, which
has the same messages.
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
from .ros_source import MAX_KEPT_BYTES, TYPES, Listener, RosSource, ros_type, topic_problem

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

PORT = 8765
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
ENCODING = "cdr"
_DATA = 1  # the opcode of messages of topics; others are not asked for
_HEAD = struct.Struct("<BIQ")
_MAX_BYTES = 1 << 26  # of what comes at once; a list of topics has all of their definitions
_CHECK_INTERVAL = 1.0  # s between looks at the topics, as long as nothing comes
_CLOSE_TIMEOUT = 0.2  # s for the peer's part in ending a connection
_WARNING = 1  # the lowest level of what a server says that is told
_MAX_SAID, _MAX_SHOWN = 200, 80  # characters of what it says, and of what is not understood
_MAX_TOPICS = 100_000


class Foxglove(RosSource):
    """Reads topics from a Foxglove server, such as `foxglove_bridge`, and publishes nothing.

    It reconnects when the connection is lost. Topics may appear later.

    Attributes:
        host: address of the server.
        port: port of the server.
        tls: whether the connection is encrypted (`wss://`), with a trusted certificate.
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


class _Said(BaseModel):
    level: int
    message: str


class Client:
    """Reads a source's topics."""

    def __init__(self, source: Foxglove, listener: Listener) -> None:
        self._source, self._listener = source, listener
        self._channels: dict[int, _Channel] = {}
        self._subscribed: dict[int, tuple[int, str]] = {}  # number to channel, and what it content
        self._is_reconnecting = False  # nothing has come since it connected, but before
        self._number = 0  # of the last subscription
        self._socket: socket.socket | None = None  # ends the connection, whoever waits for it
        self._connection: ClientConnection | None = None

    def interrupt(self) -> None:
        """Ends the connection; after `closing` of the source is set."""
        if (connection := self._connection) is not None:
            connection.close()
        if (duplicate := self._socket) is not None:
            with suppress(OSError):  # for all who use it
                duplicate.shutdown(socket.SHUT_RDWR)

    def receive(self, wake: socket.socket) -> None:
        """Connects and receives once; see `Source.start_receiving`."""
        from websockets.exceptions import (
            ConnectionClosed,
            InvalidMessage,
            WebSocketException,
        )

        url = self._source.url
        try:
            self._connect(wake)
        except ConnectionClosed as error:
            said = "" if error.rcvd is None else error.rcvd.reason[:_MAX_SAID]
            reason = "it closed the connection" + (f": {said}" if said else "")
        except (InvalidMessage, EOFError):
            reason = "no server for Foxglove: its answer is no HTTP"
        except TimeoutError as error:
            reason = error.strerror or "does not answer as a server for Foxglove"
        except OSError as error:
            reason = f"{error.strerror or error}"
        except (WebSocketException, ValueError) as error:  # the latter of redirections
            reason = f"no server for Foxglove: {str(error)[:_MAX_SAID]}"
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
                        raise InvalidHandshake("it does not speak this protocol")
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
            layout.fault = f"{len(received)} bytes that are no message: they end in its head"
            self._source.accept([layout.never(received[:MAX_KEPT_BYTES])])
            return
        _, number, _ = _HEAD.unpack_from(received)
        if number in self._subscribed:  # else it was on its way when its topic was withdrawn
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
                said = _Said.model_validate_json(text)
                if said.level >= _WARNING:
                    self._source.log_once(f"the server says: {said.message[:_MAX_SAID]}")
        except (ValueError, AttributeError, RecursionError):
            self._source.log_once(
                f"{self._source.url} content what is not understood: {text[:80]!r}"
            )

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
            self._source.note_trouble("; ".join(filter(None, wrong)) or "its publisher is silent")

    def _topic_problem(self, topic: str, kind: str) -> str:
        channels = self._channels.values()
        if wrong := topic_problem(topic, kind, ((each.topic, each.kind) for each in channels)):
            return wrong
        encodings = {each.encoding for each in channels if (each.topic, each.kind) == (topic, kind)}
        if encodings and ENCODING not in encodings:
            return f"{topic} is encoded as {min(encodings)[:40]!r}; expected {ENCODING!r}"
        return ""
