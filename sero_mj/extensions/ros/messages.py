"""Decodes ROS messages with `rosbags`, which defines all common types."""

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

MAX_BYTES = 1 << 20  # bytes of a message that moves a robot; robot descriptions may be longer


class MalformedMessage(ValueError):
    """Raised for a ROS message that cannot be decoded or is inconsistent."""


@cache
def type_store() -> Any:
    """Returns the definitions of the ROS 2 message types; raises SourceError."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise SourceError(
            "ros", f"ROS messages require rosbags ({error}): pip install 'sero-mj[ros2]'"
        ) from error
    return get_typestore(Stores.LATEST)


def decode(raw: bytes, kind: str, max_bytes: int = MAX_BYTES) -> Any:
    """Decodes a CDR message that begins with a 4-byte header; raises MalformedMessage."""
    from rosbags.serde import SerdeError

    if len(raw) > max_bytes:
        raise MalformedMessage(f"found {len(raw)} bytes; expected at most {max_bytes}")
    try:
        return type_store().deserialize_cdr(raw, kind)
    except (SerdeError, UnicodeDecodeError, MemoryError) as error:
        raise MalformedMessage(f"the message is not a {kind}: {error}") from error
