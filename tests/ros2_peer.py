"""A publisher of ROS 2 topics in a separate process, with its own definitions of message types.

It reads a line of JSON for each action, and prints `done` after each action. The actions are
`{"match": TOPIC, "kind": TYPE}`, which waits for a reader, `{"write": TOPIC, "message": {...}}` and
`{"leave": TOPIC}`. `"as": NAME` distinguishes several publishers of a topic. Publishers are
reliable, and transient local for topics with a description or static transforms. Arguments are the
domain and optionally the time (s) after which other participants detect a kill.
"""

# No `from __future__ import annotations`: Cyclone DDS reads the annotations.

import json
import os
import sys
import time
from dataclasses import dataclass, fields
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<Peers><Peer Address='127.0.0.1'/></Peers><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    "<LeaseDuration>10s</LeaseDuration></Discovery></Domain></CycloneDDS>"
)


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str = ""


@dataclass
@final
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
@final
class Vector(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector
    torque: Vector


@dataclass
@final
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header
    wrench: Wrench


@dataclass
@final
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
@final
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector
    rotation: Quaternion


@dataclass
@final
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
@final
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
@final
class Dimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
@final
class Layout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[Dimension]
    data_offset: uint32


@dataclass
@final
class Float64MultiArray(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    layout: Layout
    data: sequence[float64]


@dataclass
@final
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


def made(kind: Any, values: Any) -> Any:
    """Returns a message of a type from JSON. Missing numbers are 0, and missing lists are empty."""
    if kind is TFMessage:
        return TFMessage([made(TransformStamped, each) for each in values["transforms"]])
    if not (isinstance(kind, type) and issubclass(kind, IdlStruct)):
        return values
    types = kind.__annotations__
    found = {}
    for field in fields(kind):
        of, value = types[field.name], values.get(field.name)
        if isinstance(of, type) and issubclass(of, IdlStruct):
            value = made(of, value or {})
        elif value is None:
            value = "" if of is str else [] if "sequence" in str(of).lower() else 0
        found[field.name] = value
    return kind(**found)


def main() -> None:
    number = int(sys.argv[1])
    lease = sys.argv[2] if len(sys.argv) > 2 else "10"
    domain = Domain(number, LOOPBACK.replace(">10s<", f">{lease}s<"))
    participant = DomainParticipant(number)
    writers: dict[str, DataWriter] = {}
    kinds: dict[str, Any] = {}
    print("done", flush=True)
    for line in sys.stdin:
        action = json.loads(line)
        topic = next(action[key] for key in ("write", "match", "leave") if key in action)
        name = action.get("as", topic)
        if "kind" in action:
            kinds[name] = globals()[action["kind"]]
        if name not in writers and "leave" not in action:
            is_kept = "description" in topic or "static" in topic
            reliable = Policy.Reliability.Reliable(duration(seconds=1))
            qos = Qos(
                Policy.Reliability.BestEffort if action.get("best_effort") else reliable,
                Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile,
                Policy.History.KeepLast(10),
            )
            made_topic = Topic(participant, f"rt{topic}", kinds[name])
            writers[name] = DataWriter(participant, made_topic, qos=qos)
        if "match" in action:
            while not writers[name].get_matched_subscriptions():
                time.sleep(0.01)
        elif "leave" in action:
            del writers[name]
        else:
            message = made(kinds[name], action.get("message", {}))
            writers[name].write(message)
        print("done", flush=True)
    del domain
    os._exit(0)


if __name__ == "__main__":
    main()
