"""Reads ROS 2 topics over DDS with Cyclone DDS, without a ROS installation.

In DDS, the topic `/x` is named `rt/x`, and the type `pkg/msg/T` is named `pkg::msg::dds_::T_`. This
was tested with publishers that use Fast DDS, the default of ROS 2, and Cyclone DDS.
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
from .ros_source import NO_MESSAGES, TYPES, Listener, RosSource, ros_type, topic_problem

LOCALHOST, SUBNET = "localhost", "subnet"
MAX_DOMAIN = 232
_BATCH = 256  # maximum number of messages read in one call
_MAX_PUBLISHERS = 10_000
_DISCOVERY_INTERVAL = 2  # s between announcements of this participant
_CHECK_INTERVAL = 1.0  # s between checks of the publishers while no messages arrive
_BASE_TYPES = {"bool": "bool", "octet": "uint8", "byte": "uint8", "char": "uint8"}


class Ros2(RosSource):
    """Reads ROS 2 topics and publishes nothing.

    Attributes:
        host: location of the publishers: `localhost` for this machine, `subnet` to find them by
            multicast as ROS 2 does, or the address of a machine.
        domain: ROS_DOMAIN_ID of the publishers (default: ROS_DOMAIN_ID of the environment, or 0).
        reliability: `best_effort` to read from all publishers, or `reliable` to request lost
            messages again, which receives nothing from best-effort publishers.
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
    """Reads the DDS topics of a source."""

    def __init__(self, source: Ros2, listener: Listener) -> None:
        self._source, self._listener = source, listener
        self.participant = Participant(source.host, source.domain, source.name)
        self._readers = [
            (content, self.participant.reader(topic, TYPES[content], source.reliability))
            for topic, content in source.topics
        ]

    def receive(self, _: socket.socket) -> None:
        """Passes messages to the listener until the source is closed."""
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
            trouble = f"no publisher in domain {self.participant.domain}"
            if source.host == LOCALHOST:
                trouble += " of this machine; set host = 'subnet' to search the network"
            source.note_trouble(trouble)
            return
        wrong: list[str] = []
        for topic, content in source.topics:
            wrong += self._topic_problem(topic, TYPES[content], published)
        source.note_trouble("; ".join(wrong) or NO_MESSAGES)

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
            return [f"{topic} is published as best effort; set reliability = 'best_effort'"]
        return []


@dataclass(frozen=True)
class Publication:
    """A publisher of a topic.

    Attributes:
        topic: full name of the topic, with a leading `/`.
        kind: message type, for example `sensor_msgs/msg/JointState`.
        is_transient_local: whether late readers receive the last messages.
    """

    topic: str
    kind: str
    is_reliable: bool
    is_transient_local: bool


class Reader:
    """Reads raw messages of a topic.

    Args:
        reader: reader of Cyclone DDS with a type of `raw_type`.
    """

    def __init__(self, reader: Any) -> None:
        self.reader = reader

    def take(self) -> Iterable[tuple[bytes, bytes]]:
        """Yields each received message in CDR, and the id of its publisher."""
        for sample in self.reader.take(_BATCH):
            if isinstance(sample, _Raw) and sample.data:
                publisher = sample.sample_info.publication_handle
                yield sample.data, int(publisher).to_bytes(8, "little")


class Writer:
    """Publishes raw messages of a topic.

    Args:
        writer: writer of Cyclone DDS.
        kind: type of the messages, from `raw_type`.
    """

    def __init__(self, writer: Any, kind: Any) -> None:
        self.writer, self._raw = writer, b""
        self._sample = kind.__new__(kind)
        self._sample.serialize = lambda **_: self._raw

    def write(self, message: bytes) -> None:
        """Publishes a message in CDR. Raises SourceError if it does not match the type."""
        from cyclonedds.core import DDSException

        self._raw = message
        try:
            self.writer.write(self._sample)
        except DDSException as error:
            raise SourceError("ros2", f"cannot publish a message: {error}") from error


class Participant:
    """A participant of a DDS domain, with readers and writers; raises SourceError.

    Args:
        host: location of the other participants, see `Ros2`.
        domain: ROS_DOMAIN_ID, see `Ros2`.
        owner: name of the source or controller for error messages.
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
            raise SourceError(owner, f"cannot join domain {self.domain}: {error}") from error
        self._waits.attach(self._end)
        self._entities: list[Any] = []  # references, without which Cyclone DDS deletes them

    def reader(
        self,
        topic: str,
        kind: str,
        reliability: str = "best_effort",
        *,
        is_transient_local: bool = False,
    ) -> Reader:
        """Returns a reader of a topic.

        Args:
            topic: full name of the topic, with a leading `/`.
            kind: message type, for example `sensor_msgs/msg/JointState`.
            reliability: `best_effort` or `reliable`, see `Ros2`.
            is_transient_local: whether to receive messages that were published before.
        """
        core, qos = _cyclone("")
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        policy = qos.Policy
        is_transient_local = is_transient_local or topic == "/tf_static"
        needs_reliable = is_transient_local or reliability == "reliable"
        reliable = policy.Reliability.Reliable(duration(seconds=1))
        policies = [
            reliable if needs_reliable else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if is_transient_local else policy.Durability.Volatile,
            policy.History.KeepLast(_BATCH),
        ]
        made = Topic(self._participant, f"rt{topic}", raw_type(kind))
        reader = DataReader(self._participant, made, qos=qos.Qos(*policies))
        state = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        condition = core.ReadCondition(reader, state)
        self._waits.attach(condition)
        self._entities += [made, reader, condition]
        return Reader(reader)

    def writer(self, topic: str, kind: str) -> Writer:
        """Returns a writer of a topic. The writer stores only the newest message.

        Args:
            topic: full name of the topic, with a leading `/`.
            kind: message type, for example `sensor_msgs/msg/JointState`.
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
        self._entities += [made, writer]
        return Writer(writer, raw)

    def published(self) -> list[Publication]:
        """Returns the publishers of other participants in the domain."""
        core, qos = _cyclone("")
        reliability, durability = qos.Policy.Reliability, qos.Policy.Durability
        own = self._participant.guid
        # The entry of a publisher that has left is not alive, and may not even have a topic name.
        return [
            Publication(
                sample.topic_name.removeprefix("rt"),
                ros_type(sample.type_name),
                is_reliable=isinstance(sample.qos[reliability], reliability.Reliable),
                is_transient_local=sample.qos[durability] == durability.TransientLocal,
            )
            for sample in self._publications.read(_MAX_PUBLISHERS)
            if sample.sample_info.valid_data
            and sample.sample_info.instance_state == core.InstanceState.Alive
            and (sample.topic_name or "").startswith("rt/")
            and sample.participant_key != own
        ]

    def wait(self, seconds: float) -> bool:
        """Waits for messages, and returns whether any have arrived."""
        from cyclonedds.util import duration

        return bool(self._waits.wait(duration(nanoseconds=round(max(seconds, 0.0) * 1e9))))

    def wake(self) -> None:
        """Makes the current call of `wait` and all later calls return immediately."""
        self._end.set(True)

    def close(self) -> None:
        self._entities.clear()
        del self._publications, self._waits, self._end, self._participant


class _Raw:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


def domain_number(domain: int | None) -> int:
    """Returns the number of a domain (default: ROS_DOMAIN_ID of the environment, or 0)."""
    if domain is not None:
        return domain
    with suppress(ValueError):
        return int(os.environ.get("ROS_DOMAIN_ID", "0"))
    return 0


def _cyclone(owner: str) -> tuple[Any, Any]:
    try:
        from cyclonedds import core, qos
    except ImportError as error:
        reason = f"ROS 2 requires Cyclone DDS ({error}): pip install 'sero-mj[ros2]'"
        raise SourceError(owner, reason) from error
    return core, qos


# Mapping from domain numbers to host, domain, and a participant. This participant is never closed,
# because announcements of others are lost while a process has no participant.
_domains: dict[int, tuple[str, Any, Any]] = {}
_lock = threading.Lock()


def _configure(number: int, host: str, owner: str) -> None:
    from cyclonedds.domain import Domain, DomainParticipant

    with _lock:
        if number in _domains:
            other = _domains[number][0]
            if other != host:
                reason = f"host is '{host}', but domain {number} is open with host '{other}'"
                raise SourceError(owner, Problem("", reason, expected="one host per domain"))
            return
        domain = Domain(number, _configuration(host))
        _domains[number] = host, domain, DomainParticipant(number)


def _configuration(host: str) -> str:
    multicast = "default" if host == SUBNET else "false"
    peer = "127.0.0.1" if host == LOCALHOST else host
    peers = "" if host == SUBNET else f"<Peers><Peer Address={quoteattr(peer)}/></Peers>"
    own = (
        # Fast DDS of ROS 2 Kilted describes types in a way that Cyclone DDS never matches.
        "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation>"
        f"</Compatibility><General><AllowMulticast>{multicast}</AllowMulticast></General>"
        f"<Discovery>{peers}<ParticipantIndex>auto</ParticipantIndex>"
        "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
        # Fast DDS announces itself only by multicast. Announcing this participant repeatedly finds
        # participants that start later or restart.
        f"<SPDPInterval>{_DISCOVERY_INTERVAL}s</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay></Discovery></Domain></CycloneDDS>"
    )
    return ",".join(filter(None, (own, os.environ.get("CYCLONEDDS_URI"))))


@cache
def raw_type(kind: str) -> Any:
    """Returns a type of Cyclone DDS whose messages are not decoded.

    Args:
        kind: ROS name of the type, for example `sensor_msgs/msg/JointState`.
    """
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
