"""Lists the topics of a ROS 2 network, and finds the robot that it describes."""

from __future__ import annotations

import time as clock
import tomllib
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from ...base import paths
from ...base.errors import Problem, UsageError
from ...data.record.csv_files import prefix_before
from . import messages
from .dds import LOCALHOST, MAX_DOMAIN, Participant, Publication, Reader, Ros2
from .messages import JOINT_STATE, TEXT, MalformedMessage

SCHEME = "ros2://"
_DESCRIPTION = "/robot_description"
_MAX_DESCRIPTION = 64 << 20  # bytes
_LISTS = ("joints", "frames", "torque_constants")  # fields of a source with several values
_SIGNS = ("1", "-1")
_CHECK_INTERVAL = 0.05  # s between checks of the publishers
_MAX_LISTED = 20  # topics in a message
# The rates of these types are not measured, because receiving them would load the network.
_LARGE = ("Image", "CompressedImage", "PointCloud", "PointCloud2", "OccupancyGrid")


@dataclass(frozen=True)
class Address:
    """Address `ros2://HOST:DOMAIN/NAMESPACE?FIELD=VALUE` of a robot. All parts are optional.

    Attributes:
        host: location of the publishers, see `Ros2`.
        domain: ROS_DOMAIN_ID of the publishers, see `Ros2`.
        namespace: namespace of the robot's topics.
        robot: name of the model to show (default: the robot description in the network).
        fields: fields of the source, such as `joint_states`. In the address, the values of a list
            are separated by commas.
    """

    host: str = LOCALHOST
    domain: int | None = None
    namespace: str = ""
    robot: str = ""
    fields: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Address:
        """Parses an address; raises UsageError."""
        expected = f"{SCHEME}HOST:DOMAIN/NAMESPACE, for example {SCHEME}subnet:42"
        try:
            parts = urlsplit(text)
            domain, host = parts.port, unquote(parts.hostname or LOCALHOST)
            query = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=False))
        except ValueError as error:
            raise UsageError(Problem("", f"{text}: {error}", expected=expected)) from None
        if domain is not None and domain > MAX_DOMAIN:
            problem = Problem("", f"{text}: domain", found=domain, expected=f"0 to {MAX_DOMAIN}")
            raise UsageError(problem)
        robot = query.pop("robot", "")
        known = [key for key, each in Ros2.model_fields.items() if isinstance(each.default, str)]
        known.append("torque_sign")
        fields: dict[str, Any] = {}
        for key, value in query.items():
            if key not in (*known, *_LISTS):
                available = ["robot", *known, *_LISTS]
                raise UsageError(Problem("", f"{text}: no field", found=key, available=available))
            fields[key] = value.split(",") if key in _LISTS else value
        if "torque_constants" in fields:
            try:
                fields["torque_constants"] = [float(each) for each in fields["torque_constants"]]
            except ValueError:
                found, expected = query["torque_constants"], "numbers in Nm/A"
                problem = Problem(f"{text}: torque_constants", found=found, expected=expected)
                raise UsageError(problem) from None
        if fields.get("torque_sign") in _SIGNS:
            fields["torque_sign"] = int(fields["torque_sign"])
        return cls(host, domain, unquote(parts.path).strip("/"), robot, fields)

    @property
    def source(self) -> dict[str, Any]:
        place: dict[str, Any] = {"kind": "ros2", "host": self.host}
        if self.domain is not None:
            place["domain"] = self.domain
        if self.namespace:
            place["namespace"] = self.namespace
        return {**place, **self.fields}


@dataclass
class Topic:
    """A published ROS 2 topic.

    Attributes:
        kind: message type, for example `sensor_msgs/msg/JointState`.
        publishers: number of publishers.
        rate: number of messages per second, or None if it was not measured.
        joints: joint names in messages of type `sensor_msgs/JointState`.
    """

    name: str
    kind: str
    publishers: int
    rate: float | None = None
    joints: list[str] = field(default_factory=list)

    @property
    def robots(self) -> list[str]:
        """Names of included robots whose joint names are in the messages."""
        return robots_with(self.joints)


def list_topics(host: str, domain: int | None, seconds: float) -> list[Topic]:
    """Listens to a ROS 2 network, and returns its topics sorted by name; raises SourceError."""
    participant = Participant(host, domain, "ros2")
    try:
        times: dict[str, list[float]] = defaultdict(list)
        joints: dict[str, dict[str, None]] = defaultdict(dict)  # joint names in order of arrival
        readers: dict[str, Reader] = {}
        kinds: dict[str, str] = {}
        end = clock.monotonic() + seconds
        while (now := clock.monotonic()) < end:
            for each in participant.published():
                if each.topic not in readers and _is_light(each.kind):
                    readers[each.topic] = participant.reader(each.topic, each.kind)
                    kinds[each.topic] = each.kind
            participant.wait(min(_CHECK_INTERVAL, end - now))
            for name, reader in readers.items():
                for raw, _ in reader.take():
                    times[name].append(clock.monotonic())
                    if kinds[name] == JOINT_STATE:
                        with suppress(MalformedMessage):
                            message = messages.decode(raw, JOINT_STATE)
                            joints[name].update(dict.fromkeys(message.name))
        found: dict[str, Topic] = {}
        for each in participant.published():
            topic = found.setdefault(each.topic, Topic(each.topic, each.kind, 0))
            topic.publishers += 1
        for name, topic in found.items():
            topic.rate = _rate(times[name]) if name in readers else None
            topic.joints = list(joints[name])
        return [found[name] for name in sorted(found)]
    finally:
        participant.close()


def _rate(times: Sequence[float]) -> float:
    span = times[-1] - times[0] if len(times) > 1 else 0.0
    return (len(times) - 1) / span if span > 0.0 else 0.0


def _is_light(kind: str) -> bool:
    return kind in messages.type_store().fielddefs and not kind.endswith(_LARGE)


@dataclass(frozen=True)
class Found:
    """A robot that was found in a ROS 2 network.

    Attributes:
        urdf: URDF of the robot, or empty if it is not published.
        robots: included robots with the same joint names.
        joint_states: topic of the joint states; the default topic if none is published.
    """

    urdf: str
    robots: list[str]
    joint_states: str


def find_robot(address: Address, seconds: float) -> Found:
    """Finds a robot in a ROS 2 network.

    Args:
        address: address of the robot.
        seconds: maximum time in seconds to wait for the robot.

    Raises:
        SourceError: a package is missing, or the domain cannot be joined.
        UsageError: there is no robot, or more than one.
    """
    participant = Participant(address.host, address.domain, "ros2")
    try:
        search = _RobotSearch(participant, address)
        end = clock.monotonic() + seconds
        while (now := clock.monotonic()) < end and not search.is_enough:
            search.look(min(_CHECK_INTERVAL, end - now))
        return search.robot(seconds)
    finally:
        participant.close()


class _RobotSearch:
    def __init__(self, participant: Participant, address: Address) -> None:
        self._participant, self._address = participant, address
        self._before = f"/{address.namespace}" if address.namespace else ""
        self._readers: dict[str, tuple[str, Reader]] = {}
        self._described: dict[str, str] = {}  # URDF by topic
        self._joints: dict[str, list[str]] = {}  # joint names by topic

    @property
    def is_enough(self) -> bool:
        return bool(self._joints and (self._described or self._address.robot))

    def look(self, seconds: float) -> None:
        for each in self._participant.published():
            if each.topic not in self._readers and self._is_relevant(each):
                is_transient_local = each.kind == TEXT and each.is_transient_local
                reader = self._participant.reader(
                    each.topic, each.kind, is_transient_local=is_transient_local
                )
                self._readers[each.topic] = each.kind, reader
        self._participant.wait(seconds)
        for topic, (kind, reader) in self._readers.items():
            for raw, _ in reader.take():
                with suppress(MalformedMessage):
                    message = messages.decode(raw, kind, _MAX_DESCRIPTION)
                    if kind == TEXT:
                        self._described[topic] = message.data
                    else:
                        self._joints[topic] = list(message.name)

    def _is_relevant(self, each: Publication) -> bool:
        if not each.topic.startswith(f"{self._before}/"):
            return False
        is_description = each.kind == TEXT and each.topic.endswith(_DESCRIPTION)
        return is_description or each.kind == JOINT_STATE

    def robot(self, seconds: float) -> Found:
        if not (self._described or self._joints):
            raise UsageError(f"{self._place} {self._why_none(seconds)}")
        wanted = self._before + _DESCRIPTION
        if len(self._described) > 1 and wanted not in self._described:
            names = [topic.removesuffix(_DESCRIPTION) for topic in self._described]
            url = f"{SCHEME}{self._address.host}:{self._participant.domain}{names[0]}"
            found = f"has several robots: {', '.join(names)}"
            raise UsageError(f"{self._place} {found}. Choose one, for example with {url}")
        urdf = self._described.get(wanted, next(iter(self._described.values()), ""))
        states = [topic for topic, (kind, _) in self._readers.items() if kind == JOINT_STATE]
        usual = f"{self._before}/joint_states"
        topic = usual if usual in states or not states else states[0]
        return Found(urdf, robots_with(self._joints.get(topic, [])), topic)

    @property
    def _place(self) -> str:
        return f"ROS 2 domain {self._participant.domain} on {self._address.host}"

    def _why_none(self, seconds: float) -> str:
        topics = sorted({each.topic for each in self._participant.published()})
        if topics:
            listed = ", ".join(topics[:_MAX_LISTED])
            place = f" in {self._before}" if self._before else ""
            return f"has no robot_description and no joint states{place}; published: {listed}"
        why = f"has no publisher (waited {seconds:g} s)"
        if self._address.host == LOCALHOST:
            why += f". Use {SCHEME}subnet to search the network, or {SCHEME}ADDRESS for one machine"
        return why


def robots_with(joints: Sequence[str]) -> list[str]:
    """Returns the included robots with these joint names, possibly with one common prefix.

    Only the robots with the largest number of joints are returned. For example, an arm is not
    returned if the same arm with a gripper matches as well.
    """
    found = {}
    for robot in paths.list_models():
        with suppress(OSError, ValueError):
            text = paths.find_model(robot).read_text(encoding="utf-8")
            names = tomllib.loads(text).get("joint_names", [])
            prefix = prefix_before(names, joints)
            if names and set(joints).issuperset(prefix + name for name in names):
                found[robot] = len(names)
    return [robot for robot, count in found.items() if count == max(found.values())]
