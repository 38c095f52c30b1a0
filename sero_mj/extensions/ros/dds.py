"""`Ros2`: topics of ROS 2 over DDS with Cyclone DDS; no ROS is needed.

In DDS, ROS 2 names a topic `/x` `rt/x`, and a type `pkg/msg/T` `pkg::msg::dds_::T_`. Tested with
publishers that use Fast DDS, the default of ROS 2, and Cyclone DDS.
"""

from __future__ import annotations

import os
import socket
import threading
import time as clock
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal
from xml.sax.saxutils import quoteattr

from pydantic import AfterValidator, Field, PrivateAttr

from ...base.errors import Problem, SourceError
from ...data.receive.connecting import is_address
from . import messages
from .ros_source import TYPES, Listener, RosSource, ros_type, topic_problem

LOCALHOST, SUBNET = "localhost", "subnet"
MAX_DOMAIN = 232
_AT_ONCE = 256  # messages that are taken together
_MAX_PUBLISHERS = 10_000
_ASKS_EVERY = 2  # s between questions who is there
_CHECK_INTERVAL = 1.0  # s between looks at the publishers, as long as nothing comes
_BASE_TYPES = {"bool": "bool", "octet": "uint8", "byte": "uint8", "char": "uint8"}


class Ros2(RosSource):
    """Reads topics of ROS 2 and publishes nothing.

    Attributes:
        host: where the publishers are: `localhost` for this machine, `subnet` to find them by
            multicast as ROS 2 does, or the address of a machine.
        domain: ROS_DOMAIN_ID of the publishers (default: that of the environment, or 0).
        reliability: `best_effort` reads from all publishers; `reliable` requests lost messages
            again, and receives nothing from best-effort publishers.
    """

    host: Annotated[
        str, AfterValidator(is_address("localhost, subnet, or an address such as 192.168.0.3"))
    ] = LOCALHOST
    domain: int | None = Field(None, ge=0, le=MAX_DOMAIN)
    reliability: Literal["best_effort", "reliable"] = "best_effort"

    @property
    def about(self) -> str:
        topics = ", ".join(dict.fromkeys(topic for topic, _ in self.topics))
        return f"ROS 2 {topics}, domain {domain_number(self.domain)} of {self.host}"

    _readers: Readers | None = PrivateAttr(None)

    def _subscribe(self, listener: Listener) -> None:
        self._readers = readers = Readers(self, listener)
        self.start_receiving(readers.receive, readers.participant.wake, f"ros2 {self.name}")

    def close(self) -> None:
        super().close()
        if self._readers is not None:
            self._readers.participant.close()
        self._readers = None


class Readers:
    """Reads a source's topics."""

    def __init__(self, source: Ros2, listener: Listener) -> None:
        self._source, self._listener = source, listener
        self.participant = Participant(source.host, source.domain, source.name)
        self._readers = [
            (content, self.participant.reader(topic, TYPES[content], source.reliability))
            for topic, content in source.topics
        ]

    def receive(self, _: socket.socket) -> None:
        """Passes messages on; see `Source.start_receiving`."""
        due = clock.monotonic() + _CHECK_INTERVAL
        while not self._source.closing.is_set():
            self.participant.wait(_CHECK_INTERVAL)
            if self._source.closing.is_set():
                break
            self._read()
            if clock.monotonic() > due:
                self._check_publishers()
                due = clock.monotonic() + _CHECK_INTERVAL

    def _read(self) -> None:
        received = [
            (content, raw, publisher)
            for content, reader in self._readers
            for raw, publisher in reader.take()
        ]
        if received:
            self._listener.take(received)

    def _check_publishers(self) -> None:
        source = self._source
        if source.receiving:
            source.note_trouble("")
            return
        published = self.participant.published()
        if not published:
            trouble = f"nobody publishes in domain {self.participant.domain}"
            if source.host == LOCALHOST:
                trouble += " of this machine; set host = 'subnet' to search the network"
            source.note_trouble(trouble)
            return
        wrong: list[str] = []
        for topic, content in source.topics:
            wrong += self._topic_problem(topic, TYPES[content], published)
        source.note_trouble("; ".join(wrong) or "its publisher is silent")

    def _topic_problem(self, topic: str, kind: str, published: list[Publication]) -> list[str]:
        wrong = topic_problem(topic, kind, ((each.topic, each.kind) for each in published))
        if wrong:
            return [wrong]
        mine = [each for each in published if each.topic == topic]
        if (
            mine
            and self._source.reliability == "reliable"
            and not any(each.is_reliable for each in mine)
        ):
            return [f"{topic} is published best effort: reliability = 'best_effort' reads it"]
        return []


@dataclass(frozen=True)
class Publication:
    """A publisher of a topic.

    Attributes:
        topic: with a `/` before it.
        is_kept: whether late readers get the last messages (transient local).
    """

    topic: str
    kind: str
    is_reliable: bool
    is_kept: bool


class Reader:
    """A reader of a topic: raw messages.

    Args:
        reader: of Cyclone DDS, of a type that `_raw_type` has made.
    """

    def __init__(self, reader: Any) -> None:
        self.reader = reader

    def take(self) -> Iterable[tuple[bytes, bytes]]:
        """Takes what has come: each message, in CDR, and the number of its publisher."""
        for sample in self.reader.take(_AT_ONCE):
            if isinstance(sample, _Raw) and sample.data:
                publisher = sample.sample_info.publication_handle
                yield sample.data, int(publisher).to_bytes(8, "little")


class Writer:
    """A writer of a topic: raw messages. `kind`: its type, that `raw_type` has made."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self.writer, self._raw = writer, b""
        self._sample = kind.__new__(kind)
        self._sample.serialize = lambda **_: self._raw

    def write(self, message: bytes) -> None:
        """Publishes a message, in CDR; raises SourceError where it is none of this type."""
        from cyclonedds.core import DDSException

        self._raw = message
        try:
            self.writer.write(self._sample)
        except DDSException as error:
            raise SourceError("ros2", f"a message cannot be published: {error}") from error


class Participant:
    """A participant of a domain, with readers and writers; raises SourceError.

    Args:
        host: see `Ros2.host`.
        domain: see `Ros2.domain`.
    """

    def __init__(self, host: str, domain: int | None, owner: str) -> None:
        core, _ = _cyclone(owner)
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.domain import DomainParticipant

        self.domain = domain_number(domain)
        try:
            _configure(self.domain, host, owner)
            self._participant = DomainParticipant(self.domain)
            self._waits = core.WaitSet(self._participant)
            self._end = core.GuardCondition(self._participant)
            self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        except core.DDSException as error:
            raise SourceError(owner, f"domain {self.domain} cannot be joined: {error}") from error
        self._waits.attach(self._end)
        self._kept: list[Any] = []  # which Cyclone DDS would otherwise delete

    def reader(
        self, topic: str, kind: str, reliability: str = "best_effort", *, is_kept: bool = False
    ) -> Reader:
        """Returns a reader of a topic.

        Args:
            topic: with a `/` before it.
            reliability: see `Ros2.reliability`.
            is_kept: whether it reads what was published before (transient local).
        """
        core, qos = _cyclone("")
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        policy = qos.Policy
        is_kept = is_kept or topic == "/tf_static"
        reliable = policy.Reliability.Reliable(duration(seconds=1))
        policies = [
            reliable if is_kept or reliability == "reliable" else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if is_kept else policy.Durability.Volatile,
            policy.History.KeepLast(_AT_ONCE),
        ]
        made = Topic(self._participant, f"rt{topic}", raw_type(kind))
        reader = DataReader(self._participant, made, qos=qos.Qos(*policies))
        state = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        condition = core.ReadCondition(reader, state)
        self._waits.attach(condition)
        self._kept += [made, reader, condition]
        return Reader(reader)

    def writer(self, topic: str, kind: str) -> Writer:
        """Returns a writer of a topic, whose readers get the newest message.

        Args:
            topic: with a `/` before it.
        """
        _, qos = _cyclone("")
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        policy, raw = qos.Policy, raw_type(kind)
        policies = [
            policy.Reliability.Reliable(duration(seconds=1)),
            policy.Durability.Volatile,
            policy.History.KeepLast(1),
        ]
        made = Topic(self._participant, f"rt{topic}", raw)
        writer = DataWriter(self._participant, made, qos=qos.Qos(*policies))
        self._kept += [made, writer]
        return Writer(writer, raw)

    def published(self) -> list[Publication]:
        """Everything that others publish in the domain."""
        core, qos = _cyclone("")
        reliability, durability = qos.Policy.Reliability, qos.Policy.Durability
        own = self._participant.guid
        # The entry of a publisher that has gone is not alive, and may lack even the topic's name.
        return [
            Publication(
                sample.topic_name.removeprefix("rt"),
                ros_type(sample.type_name),
                is_reliable=isinstance(sample.qos[reliability], reliability.Reliable),
                is_kept=sample.qos[durability] == durability.TransientLocal,
            )
            for sample in self._publications.read(_MAX_PUBLISHERS)
            if sample.sample_info.valid_data
            and sample.sample_info.instance_state == core.InstanceState.Alive
            and (sample.topic_name or "").startswith("rt/")
            and sample.participant_key != own
        ]

    def wait(self, seconds: float) -> bool:
        """Waits for messages; whether there are some."""
        from cyclonedds.util import duration

        return bool(self._waits.wait(duration(nanoseconds=round(max(seconds, 0.0) * 1e9))))

    def wake(self) -> None:
        """Ends the present `wait` and all later ones at once."""
        self._end.set(True)

    def close(self) -> None:
        self._kept.clear()
        del self._publications, self._waits, self._end, self._participant


class _Raw:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


def domain_number(domain: int | None) -> int:
    """Returns the number of a domain (default: that of the environment, or 0)."""
    if domain is not None:
        return domain
    with suppress(ValueError):
        return int(os.environ.get("ROS_DOMAIN_ID", "0"))
    return 0


def _cyclone(owner: str) -> tuple[Any, Any]:
    try:
        from cyclonedds import core, qos
    except ImportError as error:
        reason = f"ROS 2 needs Cyclone DDS ({error}): pip install 'sero-mj[ros2]'"
        raise SourceError(owner, reason) from error
    return core, qos


# Number to host, domain, and a participant that stays: what others announce while a process has
# none would be lost to the next one.
_domains: dict[int, tuple[str, Any, Any]] = {}
_lock = threading.Lock()


def _configure(number: int, host: str, owner: str) -> None:
    from cyclonedds.domain import Domain, DomainParticipant

    with _lock:
        if number in _domains:
            other = _domains[number][0]
            if other != host:
                reason = f"found host '{host}'; domain {number} is open with host '{other}'"
                raise SourceError(owner, Problem("", reason, expected="one host for each domain"))
            return
        domain = Domain(number, _configuration(host))
        _domains[number] = host, domain, DomainParticipant(number)


def _configuration(host: str) -> str:
    multicast = "default" if host == SUBNET else "false"
    peer = "127.0.0.1" if host == LOCALHOST else host
    peers = "" if host == SUBNET else f"<Peers><Peer Address={quoteattr(peer)}/></Peers>"
    own = (
        # Fast DDS of ROS 2 Kilted describes types in a way that nothing of Cyclone DDS matches.
        "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation>"
        f"</Compatibility><General><AllowMulticast>{multicast}</AllowMulticast></General>"
        f"<Discovery>{peers}<ParticipantIndex>auto</ParticipantIndex>"
        "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
        # Fast DDS content of itself by multicast alone: who comes late, or again, is asked for.
        f"<SPDPInterval>{_ASKS_EVERY}s</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay></Discovery></Domain></CycloneDDS>"
    )
    return ",".join(filter(None, (own, os.environ.get("CYCLONEDDS_URI"))))


@cache
def raw_type(kind: str) -> Any:
    """A type of Cyclone DDS whose messages stay as they are: in CDR. `kind`: as ROS has it."""
    made = _idl_type(kind)
    made.deserialize = staticmethod(lambda data, **_: _Raw(data))
    made.deserialize_key = staticmethod(lambda data, **_: _Raw(b""))
    return made


@cache
def _idl_type(kind: str) -> Any:
    from cyclonedds.idl import annotations, make_idl_struct

    package, _, name = kind.rpartition("/")
    in_dds = f"{package.replace('/', '::')}::dds_::{name}_"
    _, fields = messages.type_store().fielddefs[kind]
    return annotations.final(
        make_idl_struct(name, in_dds, {field: _idl_field(what) for field, what in fields})
    )


def _idl_field(what: Any) -> Any:
    from cyclonedds.idl import types
    from rosbags.interfaces import Nodetype

    node, inside = what
    if node == Nodetype.NAME:
        return _idl_type(inside)
    if node == Nodetype.BASE:
        name, bound = inside
        if name == "string":
            return types.bounded_str[bound] if bound else str
        name = _BASE_TYPES.get(name, name)
        return bool if name == "bool" else getattr(types, name)
    element, count = _idl_field(inside[0]), inside[1]
    if node == Nodetype.ARRAY:
        return types.array[element, count]
    return types.sequence[element, count] if count else types.sequence[element]
