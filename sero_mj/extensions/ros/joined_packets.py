"""Joins ROS messages to packets with the newest values of all topics, in the robot's joint order.

Messages name their joints in any order, and several publishers can send joints of one robot (arm
and gripper). Each message that contains the robot's first published joint completes a packet. The
packet includes the newest values of all other messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ...base.frames import Array, frame, inverse, rotation_from_quat
from ...data.receive.source import RoutedJoint, RoutedLinks
from ...data.receive.structure import Structure
from ...data.record.csv_files import JOINT_EVENTS, prefix_before
from .link_transforms import LinkTransforms
from .messages import MalformedMessage

JOINT_STATES, FORCES, COMMANDS, FRAMES = "joint states", "wrench", "commands", "transforms"
ODOMETRY, POSE = "odometry", "pose"
TF = "tf"  # replaces the name of a topic if values are computed from transforms
_MAX_LISTED = 8  # names in a message
_PATIENCE = 2.0  # s; every publisher of joints should send a message within this time
_IMPLAUSIBLE = 3.0  # efforts above this multiple of the torque limit are reported
_UNIT_TOLERANCE = 1e-2  # tolerance of a quaternion's norm


class JoinedPackets:
    """Joins the ROS messages of one source to packets.

    Angles are in rad or m, torques in Nm or N. Values that no message has contained are NaN, except
    for angles, which keep the values that the robot declares.

    Args:
        names: mapping from the robot's joint names to different names in messages.
        odometry: origin of the base pose: `ODOMETRY` for the odometry topic, `TF` for transforms,
            empty if there is no base pose.
        joints_by: origin of the angles: `TF` for transforms of links, empty for joint states.
        links: links of the robot, for transforms and odometry; None if the robot is unknown.
        torque_constants: torque per unit of effort, a scalar or shape (n,).
        report: function called with each warning for the user.
    """

    def __init__(
        self,
        joints: Sequence[RoutedJoint],
        names: Mapping[str, str],
        *,
        has_commands: bool = False,
        has_forces: bool = False,
        frames: Sequence[str] = (),
        root: str = "",
        odometry: str = "",
        has_pose: bool = False,
        joints_by: str = "",
        links: RoutedLinks | None = None,
        torque_constants: float | Sequence[float] | Array = 1.0,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._joints = list(joints)
        self._wanted = [names.get(joint.name, joint.name) for joint in joints]
        self._frames, self._root = list(frames), root
        self._odometry, self._joints_by = odometry, joints_by
        self._factors = np.broadcast_to(np.asarray(torque_constants, float), len(joints))
        self._limits = np.array([joint.torque_limit for joint in joints])
        self._report = report
        count = len(joints)
        parts = {"stamp:1d": 1}
        if count:
            events = JOINT_EVENTS if has_commands else JOINT_EVENTS[: 1 if joints_by == TF else 3]
            parts |= {f"{event}:{count}d": count for event in events}
        if has_forces:
            parts |= {"force:1Vd": 3, "moment:1Vd": 3}
        if odometry:
            parts |= {"base_frame:1Td": 12}
        if odometry == ODOMETRY:
            parts |= {"base_velocity:1Vd": 3, "base_angular_velocity:1Vd": 3}
        if has_pose:
            parts |= {"pose:1Td": 12}
        parts |= {f"{event_of_frame(name)}:1Td": 12 for name in frames}
        self.structure = f"< {' '.join(parts)}"
        ends = np.cumsum([*parts.values()]).tolist()
        self._places = {
            text.partition(":")[0]: slice(end - size, end)
            for (text, size), end in zip(parts.items(), ends, strict=True)
        }
        self._values = np.full(ends[-1], np.nan)
        if count:
            self._values[self._places["joint_angles"]] = [joint.angle for joint in joints]
        if odometry:
            base = np.eye(4) if links is None else links.base
            self._values[self._places["base_frame"]] = base[:3].T.ravel()
        self._links = self._linked(links, [*{odometry, joints_by} & {TF}])
        orders = {
            JOINT_STATES: count and joints_by != TF,
            FRAMES: joints_by == TF,
            ODOMETRY: odometry == ODOMETRY,
            POSE: has_pose,
            FORCES: has_forces,
        }
        self.leads = next((topic for topic, is_wanted in orders.items() if is_wanted), FRAMES)
        self._first = count  # lowest joint index in all messages so far
        self._first_body = np.inf  # lowest body index in all transforms so far
        self._awaited = set(self._wanted)  # joints without values so far
        self._report_due = np.inf  # time at which missing joints are reported, s
        self._found: list[str] | None = None  # joint names in the last message
        self._mine = self._theirs = np.arange(0)
        self._is_effort_reported = False
        self._parents: dict[str, tuple[str, Array]] = {}

    def _linked(self, links: RoutedLinks | None, wanted: Sequence[str]) -> LinkTransforms | None:
        if links is None or len(links.joints) != len(self._joints or links.joints):
            return None
        if wanted and not links.poses:
            self._report(
                "transforms cannot move the robot, because it does not declare link_frames. "
                "Import the robot from URDF or MJCF"
            )
        return LinkTransforms(links, self._report)

    @cached_property
    def layout(self) -> MessageLayout:
        return MessageLayout(self.structure)

    def take(self, topic: str, message: Any, arrival: float) -> bytes | None:
        """Stores the values of a message. Returns the packet that it completes, or None.

        Args:
            topic: content of the topic, for example `JOINT_STATES`.
            message: decoded message, see `messages.decode`.
            arrival: arrival time in seconds since the epoch, which replaces a stamp of 0.

        Raises:
            MalformedMessage: the message is inconsistent.
        """
        values = self._values.copy()
        makes = topic == self.leads
        if topic == JOINT_STATES:
            makes = self._take_joints(values, message)
            self._report_missing_joints(arrival)
        elif topic == COMMANDS:
            self._take_commands(values, message)
        elif topic == FORCES:
            wrench = message.wrench
            for event, vector in (("force", wrench.force), ("moment", wrench.torque)):
                values[self._places[event]] = vector.x, vector.y, vector.z
        elif topic in (ODOMETRY, POSE):
            self._take_pose(values, message, topic)
        else:
            makes = self._take_frames(values, message) or (makes and self._joints_by != TF)
        header = getattr(message, "header", None)
        if makes:
            stamp = 0.0 if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec
            values[0] = stamp or arrival
        # Values are stored only if each angle is finite, or is unknown (NaN) as before.
        angles = self._places.get("joint_angles", slice(0))
        known, before = np.isfinite(values[angles]), np.isnan(self._values[angles])
        if (known | before & np.isnan(values[angles])).all():
            self._values = values
        return values.tobytes() if makes else None

    def _take_joints(self, values: Array, message: Any) -> bool:
        count = len(message.name)
        if message.name != self._found:
            self._match(message.name, len(message.position))
        if not len(self._mine):
            return False
        values_in_message = (message.position, message.velocity, message.effort)
        for event, numbers in zip(JOINT_EVENTS, values_in_message, strict=False):
            into = values[self._places[event]]
            if len(numbers) not in (0, count or len(self._joints)):
                raise MalformedMessage(
                    f"found {len(numbers)} values of {event} for {count} joint names"
                )
            if len(numbers):
                into[self._mine] = numbers[self._theirs]
            elif event != "joint_angles":
                into[self._mine] = np.nan
        if len(message.effort):
            torques = values[self._places["torques"]]
            torques[self._mine] *= self._factors[self._mine]
            self._check_torques(torques)
        self._awaited.difference_update(self._wanted[joint] for joint in self._mine)
        self._first = min(self._first, int(self._mine[0]))
        return int(self._mine[0]) == self._first

    def _match(self, names: list[str], count: int) -> None:
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise MalformedMessage(f"joint {twice} is named twice")
        if not names:
            matches = count == len(self._joints)
            self._mine = np.arange(count if matches else 0)
            self._theirs = self._mine
            if count:
                said = "read in the robot's joint order" if matches else "ignored"
                self._report(f"messages of {count} joints without names are {said}")
            return
        prefix = prefix_before(self._wanted, names)
        places = {name: k for k, name in enumerate(names)}
        pairs = [
            (joint, places[prefix + name])
            for joint, name in enumerate(self._wanted)
            if prefix + name in places
        ]
        self._found = list(names)
        self._mine = np.array([joint for joint, _ in pairs], np.intp)
        self._theirs = np.array([place for _, place in pairs], np.intp)
        if prefix:
            self._report(f"joint names in messages have the prefix {prefix!r}")
        others = [name for k, name in enumerate(names) if k not in self._theirs]
        if not pairs:
            self._report(
                f"messages with the joints {_listed(names)} contain none of "
                f"{_listed(self._wanted)}. Set joints = [...] to the names in messages"
            )
        elif others:
            self._report(f"ignoring joints that the robot does not have: {_listed(others)}")

    def _report_missing_joints(self, arrival: float) -> None:
        if not self._awaited or len(self._awaited) == len(self._wanted):
            return
        self._report_due = min(self._report_due, arrival + _PATIENCE)
        if arrival >= self._report_due:
            missing = [name for name in self._wanted if name in self._awaited]
            self._report(
                f"no message has contained {_listed(missing)} within {_PATIENCE:g} s; these joints "
                "keep their declared angles"
            )
            self._awaited.clear()

    def _check_torques(self, torques: Array) -> None:
        if self._is_effort_reported:
            return
        with np.errstate(invalid="ignore"):
            wrong = np.abs(torques) > _IMPLAUSIBLE * self._limits
        if wrong.any():
            self._is_effort_reported, k = True, int(np.argmax(wrong))
            self._report(
                f"the effort of {self._wanted[k]} is {torques[k]:.4g}, but its torque limit is "
                f"{self._limits[k]:g} Nm. If efforts are not in Nm, set effort_unit and "
                "torque_constants"
            )

    def _take_commands(self, values: Array, message: Any) -> None:
        if len(message.data) != len(self._joints):
            found = f"found {len(message.data)} commanded torques"
            raise MalformedMessage(f"{found}; expected {len(self._joints)}, one per joint")
        values[self._places["commanded_torques"]] = message.data

    def _take_pose(self, values: Array, message: Any, topic: str) -> None:
        geometry = message.pose.pose if topic == ODOMETRY else message.pose
        moved, turned = geometry.position, geometry.orientation
        pose = _pose((moved.x, moved.y, moved.z), (turned.w, turned.x, turned.y, turned.z))
        if pose is None:
            raise MalformedMessage(f"the orientation of the {topic} is not a unit quaternion")
        if topic == POSE:
            values[self._places["pose"]] = pose[:3].T.ravel()
            return
        for event, vector in (
            ("base_velocity", message.twist.twist.linear),
            ("base_angular_velocity", message.twist.twist.angular),
        ):
            values[self._places[event]] = vector.x, vector.y, vector.z
        if self._links is not None:  # the message may contain the pose of a link, not of the base
            angles = values[self._places["joint_angles"]] if self._joints else None
            link = message.child_frame_id.lstrip("/")
            pose = pose @ inverse(self._links.in_base(link, angles))
        values[self._places["base_frame"]] = pose[:3].T.ravel()

    def _take_frames(self, values: Array, message: Any) -> bool:
        bodies: list[float] = []
        for transform in message.transforms:
            parent, child = transform.header.frame_id, transform.child_frame_id
            moved, turned = transform.transform.translation, transform.transform.rotation
            pose = _pose((moved.x, moved.y, moved.z), (turned.w, turned.x, turned.y, turned.z))
            if pose is None:
                raise MalformedMessage(f"the rotation of {child} is not a unit quaternion")
            self._parents[child.lstrip("/")] = parent.lstrip("/"), pose
            if self._links is not None:
                body = self._links.take(parent.lstrip("/"), child.lstrip("/"), pose)
                bodies += [] if body is None else [body or np.inf]
        if self._links is not None:
            self._solve(values, self._links)
        for name in self._frames:
            pose = self._in_root(name)
            if pose is not None:
                values[self._places[event_of_frame(name)]] = pose[:3].T.ravel()  # column-major
        self._first_body = min([self._first_body, *bodies])
        return self.leads == FRAMES and self._first_body in bodies

    def _solve(self, values: Array, links: LinkTransforms) -> None:
        if self._joints_by == TF:
            values[self._places["joint_angles"]] = links.solve()
        if self._odometry == TF and (base := links.base(self._root)) is not None:
            values[self._places["base_frame"]] = base[:3].T.ravel()

    def _in_root(self, name: str) -> Array | None:
        pose, at = np.eye(4), name
        for _ in range(len(self._parents)):
            if at == self._root or at not in self._parents:
                break
            at, step = self._parents[at]
            pose = step @ pose
        return pose if at == self._root else None


class MessageLayout(Structure):
    """Layout of packets that are joined from messages."""

    message = "message"

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        return self.fault or f"{length} bytes that are not a {self.message}"

    def never(self, message: bytes) -> bytes:
        """Returns the bytes of a malformed message, with a length that valid packets never have."""
        return message + b"\0" * (len(message) == self.size)


def event_of_frame(name: str) -> str:
    """Returns the name of the event with the pose of a frame."""
    return "tf_" + "".join(c if c.isalnum() and c.isascii() else "_" for c in name)


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Array | None:
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(position).all() or not abs(length - 1.0) <= _UNIT_TOLERANCE:
        return None
    return frame(rotation_from_quat(np.array(quaternion)), np.array(position))


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return ", ".join(names[:_MAX_LISTED]) + more
