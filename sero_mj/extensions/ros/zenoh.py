"""Reads ROS 2 topics from a zenoh router, as published by rmw_zenoh.

rmw_zenoh publishes topic `/x` under the key `DOMAIN/x/TYPE/HASH`, where TYPE is the DDS name of the
type and HASH is the hash of its definition. The liveliness token of each publisher has the key
`@ros2_lv/DOMAIN/SESSION/NODE/NUMBER/MP/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS`, in which `%`
stands for `/`. Messages are in CDR. The attachment of a message ends with the publisher's id (gid).
"""

from __future__ import annotations

import json
import socket
import time as clock
from collections.abc import Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from pydantic import Field

from ...base.errors import SourceError
from ...data.receive import receiving_thread
from ...data.receive.connecting import Address, addresses
from ...data.receive.receiving_thread import Closing, Disconnected
from .dds import MAX_DOMAIN, domain_number
from .ros_source import NO_MESSAGES, TYPES, Listener, RosSource, ros_type, topic_problem

PORT = 7447
TRANSIENT_LOCAL = "/tf_static"  # topic whose publishers send the last messages to late readers
_PATIENCE = 0.8  # s; timeout of an answer of the router, and of an attempt to connect
_CHECK_INTERVAL = 1.0  # s between checks of the publishers while no messages arrive
_MAX_WAITING = 10_000  # messages
_GID = b"source_gid"  # precedes a publisher's id of 16 random bytes
_TOKEN = "@ros2_lv/{}/**"
_TOKEN_PARTS = 13


class Zenoh(RosSource):
    """Reads ROS 2 topics from a zenoh router and publishes nothing.

    The source connects as a client, without discovery. It reconnects when the connection is lost.

    Attributes:
        host: address of the router, or of a peer that accepts connections.
        port: port of the router.
        domain: ROS_DOMAIN_ID of the publishers (default: ROS_DOMAIN_ID of the environment, or 0).
    """

    name: str = "zenoh"
    host: Address
    port: int = Field(PORT, ge=1, le=65535)
    domain: int | None = Field(None, ge=0, le=MAX_DOMAIN)

    @property
    def place_of_router(self) -> str:
        """Address and port of the router."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def about(self) -> str:
        topics = ", ".join(dict.fromkeys(topic for topic, _ in self.topics))
        domain = domain_number(self.domain)
        return f"ROS 2 {topics}, domain {domain}, zenoh at {self.place_of_router}"

    def _subscribe(self, listener: Listener) -> None:
        session = Session(self, listener)
        self.start_receiving(session.receive, session.interrupt, f"zenoh {self.name}")


class _Message(NamedTuple):
    content: str
    raw: bytes
    publisher: bytes


class Session:
    """Reads the topics of a source from zenoh. Raises SourceError if zenoh is not installed."""

    def __init__(self, source: Zenoh, listener: Listener) -> None:
        _zenoh(source.name)
        self._source, self._listener = source, listener
        self._domain = domain_number(source.domain)
        self._waiting: SimpleQueue[_Message | None] = SimpleQueue()

    def interrupt(self) -> None:
        """Makes `receive` return. The source must have set `closing` before."""
        self._waiting.put(None)

    def receive(self, wake: socket.socket) -> None:
        """Connects and receives until the source is closed.

        After the first connection, zenoh reconnects automatically.
        """
        source = self._source
        zenoh = _zenoh(source.name)
        try:
            session = self._open(addresses(source.host, source.port, wake))
        # zenoh raises the same error for every problem with a router.
        except (zenoh.ZError, OSError) as error:
            trouble = f"no zenoh router at {source.place_of_router}"
            raise Disconnected(trouble, _without_location(error)) from error
        try:
            subscribers = [self._read(session, *each) for each in source.topics]
            self._receive(session)
            del subscribers  # zenoh ends a subscription when its object is deleted
        except zenoh.ZError as error:  # for example, the topic is not a valid key
            raise Disconnected(f"zenoh error: {_without_location(error)}") from error
        finally:
            with suppress(zenoh.ZError):
                session.close()

    def _open(self, found: Sequence[tuple[Any, ...]]) -> Any:
        zenoh = _zenoh(self._source.name)
        failure: Exception = OSError("no address")
        for *_, address in found:
            if self._source.closing.is_set():
                raise Closing
            try:
                return zenoh.open(self._configuration(_endpoint(address)))
            except zenoh.ZError as error:
                failure = error
        raise failure

    def _configuration(self, endpoint: str) -> Any:
        configuration = _zenoh(self._source.name).Config()
        patience, shortest, longest = (
            round(1e3 * t)
            for t in (_PATIENCE, receiving_thread.MIN_PAUSE, receiving_thread.MAX_PAUSE)
        )
        again = {"period_init_ms": shortest, "period_max_ms": longest}
        for key, value in {
            "mode": "client",
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": patience,
            "connect/retry": {**again, "period_increase_factor": 2},
            "transport/unicast/open_timeout": patience,
            "transport/shared_memory/enabled": False,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints": [],
        }.items():
            configuration.insert_json5(key, json.dumps(value))
        return configuration

    def _read(self, session: Any, topic: str, content: str) -> Any:
        zenoh = _zenoh(self._source.name)

        def take(sample: Any) -> None:
            if sample.kind == zenoh.SampleKind.PUT and self._waiting.qsize() < _MAX_WAITING:
                publisher = _publisher(sample.attachment)
                self._waiting.put(_Message(content, sample.payload.to_bytes(), publisher))

        package, _, name = TYPES[content].rpartition("/")
        kind = f"{package.replace('/', '::')}::dds_::{name}_"
        key = f"{self._domain}{topic}/{kind}/**"
        if topic != TRANSIENT_LOCAL:
            return session.declare_subscriber(key, take)
        from zenoh import ext

        history = ext.HistoryConfig(detect_late_publishers=True)
        return ext.declare_advanced_subscriber(session, key, take, history=history)

    def _receive(self, session: Any) -> None:
        due = clock.monotonic() + _CHECK_INTERVAL
        while not self._source.closing.is_set():
            received: list[_Message] = []
            try:
                received += filter(None, [self._waiting.get(timeout=_CHECK_INTERVAL)])
                while len(received) < _MAX_WAITING:
                    received += filter(None, [self._waiting.get_nowait()])
            except Empty:
                pass
            if received and not self._source.closing.is_set():
                self._listener.take(received)
            if clock.monotonic() > due:
                self._check_publishers(session)
                due = clock.monotonic() + _CHECK_INTERVAL

    def _check_publishers(self, session: Any) -> None:
        source = self._source
        if source.receiving:
            source.note_trouble("")
            return
        if not (session.info.routers_zid() or session.info.peers_zid()):
            trouble = f"lost the connection to the zenoh router at {source.place_of_router}"
            source.note_trouble(trouble)
            source.log_once(f"{trouble}; reconnecting")
            return
        published = self._published(session)
        wrong = [
            topic_problem(topic, TYPES[content], published) for topic, content in source.topics
        ]
        if not published:
            source.note_trouble(f"no publisher in domain {self._domain}")
        else:
            source.note_trouble("; ".join(filter(None, wrong)) or NO_MESSAGES)

    def _published(self, session: Any) -> list[tuple[str, str]]:
        found = []
        for reply in session.liveliness().get(_TOKEN.format(self._domain), timeout=_PATIENCE):
            parts = str(reply.ok.key_expr).split("/") if reply.ok is not None else []
            if len(parts) == _TOKEN_PARTS and parts[5] == "MP":
                found.append((parts[9].replace("%", "/"), ros_type(parts[10])))
        return found


def _zenoh(owner: str) -> Any:
    try:
        import zenoh
    except ImportError as error:
        reason = f"topics of rmw_zenoh require zenoh ({error}): pip install 'sero-mj[zenoh]'"
        raise SourceError(owner, reason) from error
    return zenoh


def _endpoint(address: tuple[Any, ...]) -> str:
    host, port = address[:2]
    return f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"


def _publisher(attachment: Any) -> bytes:
    attached = b"" if attachment is None else attachment.to_bytes()
    return bytes(attached[-8:]) if _GID in attached else b""


def _without_location(error: Exception) -> str:
    return str(error).partition(" at /")[0].strip()
