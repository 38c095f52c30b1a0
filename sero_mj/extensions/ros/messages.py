"""Messages of ROS, decoded by `rosbags`, which has the definitions of all common types."""

from __future__ import annotations

from functools import cache
from typing import Any

from ...base.errors import SourceError

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
NUMBERS = "std_msgs/msg/Float64MultiArray"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
TEXT = "std_msgs/msg/String"
CLOCK = "rosgraph_msgs/msg/Clock"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"

MOST_BYTES = 1 << 20  # of a message that moves something; texts may be longer


class MalformedMessage(ValueError):
    """A message that cannot be decoded, or contradicts itself."""


@cache
def type_store() -> Any:
    """The definitions of ROS 2's types; raises SourceError."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise SourceError(
            "ros", f"messages of ROS need rosbags ({error}): pip install 'sero-mj[ros2]'"
        ) from error
    return get_typestore(Stores.LATEST)


def decode(raw: bytes, kind: str, most: int = MOST_BYTES) -> Any:
    """Decodes a message; raises MalformedMessage if it is no such message.

    Args:
        raw: in CDR, with its header of 4 bytes.
        kind: its type, e.g. `sensor_msgs/msg/JointState`.
        most: bytes that it may have.
    """
    from rosbags.serde import SerdeError

    if len(raw) > most:
        raise MalformedMessage(f"found {len(raw)} bytes; expected at most {most}")
    try:
        return type_store().deserialize_cdr(raw, kind)
    except (SerdeError, UnicodeDecodeError, MemoryError) as error:
        raise MalformedMessage(f"no {kind}: {error}") from error
