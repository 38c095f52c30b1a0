"""`Zenoh`: topics of ROS 2 from a router of zenoh, as rmw_zenoh publishes them.

rmw_zenoh has topic `/x` under the key `DOMAIN/x/TYPE/HASH`, where TYPE is the one of DDS and HASH
that of its definition, and each publisher's token of liveliness under
`@ros2_lv/DOMAIN/SESSION/NODE/NUMBER/MP/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS`, `%` being `/`.
Messages are in CDR; what is attached to them ends in the number of the publisher (gid).
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
from .ros_source import TYPES, Listener, RosSource, ros_type, topic_problem

PORT = 7447
KEPT = "/tf_static"  # its publishers keep the last messages, for who comes later
_PATIENCE = 0.8  # s for a router's answer, and so for the end of an attempt to connect
_CHECK_INTERVAL = 1.0  # s between looks at the publishers, as long as nothing comes
_MAX_WAITING = 10_000  # messages
_GID = b"source_gid"  # comes before a publisher's number, of 16 random bytes
_TOKEN = "@ros2_lv/{}/**"
_TOKEN_PARTS = 13


class Zenoh(RosSource):
    """Reads topics of ROS 2 from a zenoh router and publishes nothing.

    It connects as a client, without discovery, and reconnects when the connection is lost.

    Attributes:
        host: address of the router, or of a peer that listens.
        port: port of the router.
        domain: ROS_DOMAIN_ID of the publishers (default: that of the environment, or 0).
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
    """Reads a source's topics; raises SourceError."""

    def __init__(self, source: Zenoh, listener: Listener) -> None:
        _zenoh(source.name)
        self._source, self._listener = source, listener
        self._domain = domain_number(source.domain)
        self._waiting: SimpleQueue[_Message | None] = SimpleQueue()

    def interrupt(self) -> None:
        """Wakes what waits for messages; after `closing` of the source is set."""
        self._waiting.put(None)

    def receive(self, wake: socket.socket) -> None:
        """Connects, which zenoh repeats once it has succeeded, and receives.

        See `Source.start_receiving`.
        """
        source = self._source
        zenoh = _zenoh(source.name)
        try:
            session = self._open(addresses(source.host, source.port, wake))
        # zenoh has one error for everything that may be wrong with a router.
        except (zenoh.ZError, OSError) as error:
            trouble = f"no router of zenoh at {source.place_of_router}"
            raise Disconnected(trouble, _without_location(error)) from error
        try:
            subscribers = [self._read(session, *each) for each in source.topics]
            self._receive(session)
            del subscribers  # which would otherwise end before
        except zenoh.ZError as error:  # such as of a topic that no key can have
            raise Disconnected(f"zenoh refuses: {_without_location(error)}") from error
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
        if topic != KEPT:
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
            trouble = f"the router of zenoh at {source.place_of_router} is gone"
            source.note_trouble(trouble)
            source.log_once(f"{trouble}; trying again")
            return
        published = self._published(session)
        wrong = [
            topic_problem(topic, TYPES[content], published) for topic, content in source.topics
        ]
        if not published:
            source.note_trouble(f"nobody publishes in domain {self._domain}")
        else:
            source.note_trouble("; ".join(filter(None, wrong)) or "its publisher is silent")

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
        reason = f"rmw_zenoh's topics need zenoh ({error}): pip install 'sero-mj[zenoh]'"
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
