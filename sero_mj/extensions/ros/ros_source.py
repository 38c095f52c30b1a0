"""Base class of sources whose packets are joined from ROS messages."""

from __future__ import annotations

import time as clock
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PrivateAttr, field_validator, model_validator

from ...base.errors import Problem, SourceError
from ...data.receive.source import RoutedJoint, RoutedLinks, Source
from ...data.receive.structure import TorqueSign
from ...data.record.csv_files import JOINT_EVENTS
from . import messages
from .joined_packets import (
    COMMANDS,
    FORCES,
    FRAMES,
    JOINT_STATES,
    ODOMETRY,
    POSE,
    TF,
    JoinedPackets,
    MessageLayout,
    event_of_frame,
)
from .messages import MalformedMessage

# Mapping from the content of a topic to its message type.
TYPES = {
    JOINT_STATES: messages.JOINT_STATE,
    FORCES: messages.WRENCH,
    COMMANDS: messages.NUMBERS,
    FRAMES: messages.TRANSFORMS,
    ODOMETRY: messages.ODOMETRY,
    POSE: messages.POSE,
}
MAX_REJECTED_BYTES = 2048  # bytes of a malformed message that are recorded
NO_MESSAGES = "the publisher is not sending messages"
_MAX_NAMED = 5  # topics in a message


class RosSource(Source):
    """Base class of sources whose packets are joined from ROS 2 topics.

    Events are `stamp` and, for n joints, `joint_angles`, `joint_velocities` and `torques`. Values
    that no message contains are NaN, except for angles, which keep the values that the robot
    declares. If the corresponding fields are set, there are also `commanded_torques`, `force`,
    `moment`, `pose`, `base_frame`, `base_velocity` and `base_angular_velocity` in the base frame,
    and `tf_NAME` for each frame.

    Attributes:
        joint_states: topic of `sensor_msgs/JointState`, or `tf` to compute angles from the
            transforms of the robot's links; empty for none.
        joints: joint names in messages: a list in the robot's joint order, or a table that maps the
            robot's joint names to the names in messages (default: the robot's joint names, possibly
            with a common prefix).
        commands: topic of `std_msgs/Float64MultiArray` with commanded torques; empty for none.
        wrench: topic of `geometry_msgs/WrenchStamped`; empty for none.
        odometry: topic of `nav_msgs/Odometry` with the pose of the robot's base, or `tf` to use
            transforms; empty for none.
        pose: topic of `geometry_msgs/PoseStamped`; empty for none.
        frames: names of frames to receive from `tf` and `tf_static`.
        root: reference frame of `frames` and of a base pose from `tf`; if it is empty, the base
            pose is relative to the root of the transform tree.
        namespace: prefix of topics that do not begin with `/`.
        effort_unit: unit of efforts: `Nm`, or `A` together with `torque_constants`.
        torque_constants: torque per ampere in Nm/A, as one value for all joints or one per joint.
        torque_sign: factor of efforts: 1, or -1 for drivers that publish the torque that the load
            exerts on the drive.
    """

    name: str = "ros"
    joint_states: str = "joint_states"
    joints: list[str] | dict[str, str] = []
    commands: str = ""
    wrench: str = ""
    odometry: str = ""
    pose: str = ""
    frames: list[str] = []
    root: str = ""
    namespace: str = ""
    effort_unit: Literal["Nm", "A"] = "Nm"
    torque_constants: float | list[float] | None = Field(None)
    torque_sign: TorqueSign = 1
    structure: str = ""
    time: str = "stamp"

    _fixed_by: ClassVar[str] = "ROS"
    _structure_is: ClassVar[str] = "derived from the topics"
    # Until the routes are known, values that a driver does not publish may be missing.
    _nan_allowed: frozenset[str] = PrivateAttr(
        frozenset(
            (
                "joint_velocities",
                "torques",
                "commanded_torques",
                "force",
                "moment",
                "base_velocity",
                "base_angular_velocity",
                "pose",
            )
        )
    )
    _led: list[RoutedJoint] = PrivateAttr(default_factory=list)
    _links: RoutedLinks | None = PrivateAttr(None)
    _kinds: dict[str, str] = PrivateAttr(default_factory=dict)

    @field_validator("joints")
    @classmethod
    def _joints_differ(cls, joints: list[str] | dict[str, str]) -> list[str] | dict[str, str]:
        names = list(joints if isinstance(joints, list) else joints.values())
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise Problem("", f"found {twice[0]} twice", expected="each joint once").error()
        return joints

    @field_validator("frames", check_fields=False)  # JSON messages have no frames
    @classmethod
    def _frames_differ(cls, frames: list[str]) -> list[str]:
        events = [event_of_frame(name) for name in frames]
        twice = [name for name in frames if events.count(event_of_frame(name)) > 1]
        if twice:
            expected = "names that differ in letters or digits"
            raise Problem("", f"found {', '.join(twice)}", expected=expected).error()
        return frames

    @model_validator(mode="after")
    def _fields_fit_each_other(self) -> RosSource:
        has_constants = self.torque_constants is not None
        if has_constants != (self.effort_unit == "A"):
            reason = (
                "is required, because effort_unit is A"
                if self.effort_unit == "A"
                else "is not allowed, because effort_unit is Nm"
            )
            raise Problem("torque_constants", reason).error()
        if not (self.joint_states or self.wrench or self.frames or self.odometry or self.pose):
            raise Problem("joint_states", "no topic is read", expected="a topic name").error()
        if self.frames and not self.root:
            expected = "the reference frame, for example base_link"
            raise Problem("root", "is required by frames", expected=expected).error()
        self._nan_allowed |= {event_of_frame(name) for name in self.frames}
        return self

    def set_joints(self, joints: Sequence[RoutedJoint]) -> None:
        self._led = list(joints)
        self.__dict__.pop("layout", None)

    def set_links(self, links: RoutedLinks) -> None:
        self._links = links
        self.__dict__.pop("layout", None)

    def needs_joints(self, event: str) -> bool:
        return not self.joint_names and event in JOINT_EVENTS

    @property
    def joint_names(self) -> list[str]:
        """Joint names in messages, in the order of the values in packets."""
        if isinstance(self.joints, list) and self.joints:
            return self.joints
        names = self.joints if isinstance(self.joints, dict) else {}
        return [names.get(joint.name, joint.name) for joint in self._led]

    def joined(self, report: Callable[[str], None] | None = None) -> JoinedPackets:
        """Returns an object that joins the messages of this source to packets.

        Args:
            report: function called with each warning for the user (default: `log_once`).
        """
        led = self._led
        if isinstance(self.joints, list) and self.joints:
            if len(led) != len(self.joints):
                led = [RoutedJoint(name) for name in self.joints]
            pairs = zip(led, self.joints, strict=True)
            led = [joint._replace(name=name) for joint, name in pairs]
        constants = 1.0 if self.torque_constants is None else self.torque_constants
        return JoinedPackets(
            led if self.joint_states else [],
            self.joints if isinstance(self.joints, dict) else {},
            has_commands=bool(self.commands),
            has_forces=bool(self.wrench),
            frames=self.frames,
            root=self.root,
            odometry=self.odometry and (TF if is_tf(self.odometry) else ODOMETRY),
            has_pose=bool(self.pose),
            joints_by=TF if is_tf(self.joint_states) else "",
            links=self._links,
            torque_constants=self.torque_sign * np.asarray(constants, float),
            report=self.log_once if report is None else report,
        )

    @cached_property
    def layout(self) -> MessageLayout:
        return self.joined().layout

    def decoding_fields(self) -> dict[str, Any]:
        kept = {"joint_states", "commands", "wrench", "odometry", "pose", "frames", "root"}
        fields = self.model_dump(mode="json", include=kept, exclude_defaults=True)
        return {**fields, **self._place_fields(), "joints": self.joint_names}

    def _place_fields(self) -> Mapping[str, Any]:
        required = {key for key, field in type(self).model_fields.items() if field.is_required()}
        return dict(self.model_dump(mode="json", include=required))

    @property
    def topics(self) -> list[tuple[str, str]]:
        """Full name and content of each topic to read."""
        declared = {
            JOINT_STATES: self.joint_states,
            ODOMETRY: self.odometry,
            POSE: self.pose,
            FORCES: self.wrench,
            COMMANDS: self.commands,
        }
        found = [
            (self._full(topic), content)
            for content, topic in declared.items()
            if topic and not is_tf(topic)
        ]
        if self.reads_transforms:
            found += [("/tf", FRAMES), ("/tf_static", FRAMES)]
        return found

    @property
    def reads_transforms(self) -> bool:
        return bool(self.frames) or is_tf(self.joint_states) or is_tf(self.odometry)

    def _full(self, topic: str) -> str:
        if topic.startswith("/"):
            return topic
        before = self.namespace.strip("/")
        return f"/{before}/{topic}" if before else f"/{topic}"

    def is_default(self, field: str) -> bool:
        """Returns whether a field has its default value."""
        return bool(getattr(self, field) == type(self).model_fields[field].default)

    def with_fields(self, **fields: Any) -> RosSource:
        own = {key: self.__dict__[key] for key in type(self).model_fields}
        other = type(self)(**{**own, **fields})
        other.set_joints(self._led)
        other._links = self._links
        return other

    @property
    def of_messages(self) -> RosSource:
        return self

    @property
    def trouble(self) -> str:
        return "" if self.receiving else self._trouble

    def open(self) -> None:
        """Starts receiving messages. Publishers may start later. Raises SourceError."""
        self.close()
        if self.joint_states and not self.joint_names:
            problem = Problem("joints", "no route to a robot", expected="the joint names")
            raise SourceError(self.name, problem)
        self.reset()
        messages.type_store()
        self._subscribe(Listener(self))

    def close(self) -> None:
        self.stop_receiving()

    @abstractmethod
    def _subscribe(self, listener: Listener) -> None: ...


class Listener:
    """Decodes messages of a source, and passes the joined packets to `source.accept`.

    Only one thread may use a listener.
    """

    def __init__(self, source: RosSource) -> None:
        self._source = source
        self._joined = source.joined()

    def take(self, received: Sequence[tuple[str, bytes, bytes]]) -> None:
        """Decodes and joins messages that have arrived together.

        Args:
            received: for each message, the content of its topic, its bytes in CDR, and the id of
                its publisher, which may be empty.
        """
        source, now = self._source, clock.time()
        packets: list[bytes] = []
        senders: list[bytes] = []
        for content, raw, sender in received:
            try:
                packet = self._joined.take(content, messages.decode(raw, TYPES[content]), now)
            except MalformedMessage as error:
                source.layout.fault = str(error)
                packet = source.layout.never(raw[:MAX_REJECTED_BYTES])
            if packet is not None:
                packets.append(packet)
                senders.append(sender)
        if packets:
            rows = np.frombuffer(b"".join(s.ljust(8, b"\0") for s in senders), np.uint8)
            source.accept(packets, senders=rows.reshape(len(packets), 8))


def topic_problem(topic: str, kind: str, published: Iterable[tuple[str, str]]) -> str:
    """Returns a message if a topic has no publisher or another type, otherwise an empty string.

    Args:
        topic: full name of the topic, with a leading `/`.
        kind: expected message type.
        published: name and message type of each published topic.
    """
    published = list(published)
    kinds = [other for each, other in published if each == topic]
    if not kinds:
        if topic in ("/tf", "/tf_static"):  # either may be missing
            return ""
        fitting = sorted({each for each, other in published if other == kind})
        instead = f"; topics of its type: {', '.join(fitting[:_MAX_NAMED])}" if fitting else ""
        return f"no publisher of {topic}{instead}"
    return "" if kind in kinds else f"{topic} is of type {kinds[0]}; expected {kind}"


def is_tf(topic: str) -> bool:
    """Returns whether the name of a topic is `tf`, which stands for transforms."""
    return topic.lstrip("/") == TF


def ros_type(name: str) -> str:
    """Converts the DDS name of a message type to its ROS name."""
    return name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")
