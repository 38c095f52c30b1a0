"""Messages of an iiwa, encoded by Google's Protocol Buffers, independently of sero-mj.

Fields and their numbers are those of KUKA's FRI client SDKs 1.11 to 2.7.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

# Fields of each message: name, number and type. `*` marks a repeated field.
MESSAGES = {
    "JointValues": [("*value", 1, "double")],
    "CartesianVector": [("*element", 1, "double")],
    "TimeStamp": [("sec", 1, "uint32"), ("nanosec", 2, "uint32")],
    "Header": [
        ("messageIdentifier", 1, "uint32"), ("sequenceCounter", 2, "uint32"),
        ("reflectedSequenceCounter", 3, "uint32"),
    ],
    "RobotInfo": [
        ("numberOfJoints", 1, "int32"), ("safetyState", 2, "int32"), ("*driveState", 5, "int32"),
        ("operationMode", 6, "int32"), ("controlMode", 7, "int32"),
    ],
    "MonitorData": [
        ("measuredJointPosition", 1, "JointValues"), ("measuredTorque", 2, "JointValues"),
        ("commandedJointPosition", 3, "JointValues"), ("commandedTorque", 4, "JointValues"),
        ("externalTorque", 5, "JointValues"), ("externalForce", 6, "CartesianVector"),
        ("timestamp", 15, "TimeStamp"),
    ],
    "ConnectionInfo": [
        ("sessionState", 1, "int32"), ("quality", 2, "int32"), ("sendPeriod", 3, "uint32"),
        ("receiveMultiplier", 4, "uint32"),
    ],
    "IpoData": [
        ("jointPosition", 1, "JointValues"), ("clientCommandMode", 10, "int32"),
        ("overlayType", 11, "int32"), ("trackingPerformance", 12, "double"),
    ],
    "CommandData": [
        ("jointPosition", 1, "JointValues"),
        ("cartesianWrenchFeedForward", 2, "CartesianVector"),
        ("jointTorque", 3, "JointValues"),
    ],
    "Monitoring": [
        ("header", 1, "Header"), ("robotInfo", 2, "RobotInfo"), ("monitorData", 3, "MonitorData"),
        ("connectionInfo", 4, "ConnectionInfo"), ("ipoData", 5, "IpoData"),
    ],
    "Command": [("header", 1, "Header"), ("commandData", 2, "CommandData")],
}  # fmt: skip


def _make() -> Any:
    file = descriptor_pb2.FileDescriptorProto(name="fri.proto", package="fri", syntax="proto2")
    field_type = descriptor_pb2.FieldDescriptorProto
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for key, number, kind in fields:
            field = message.field.add(name=key.removeprefix("*"), number=number)
            field.label = field.LABEL_REPEATED if key[0] == "*" else field.LABEL_OPTIONAL
            if kind in MESSAGES:
                field.type, field.type_name = field_type.TYPE_MESSAGE, f".fri.{kind}"
            else:
                field.type = getattr(field_type, f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"fri.{name}"))
        for name in MESSAGES
    }


_CLASSES = _make()


def values(*numbers: float) -> dict[str, Any]:
    """Returns a message part with joint values."""
    return {"value": numbers}


def monitoring(counter: int = 1, **parts: dict[str, Any]) -> bytes:
    """Returns a monitoring message of a controller; `parts` override the default values."""
    q = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]
    all_parts: dict[str, dict[str, Any]] = {
        "header": {
            "messageIdentifier": 0x245142, "sequenceCounter": counter,
            "reflectedSequenceCounter": 0,
        },
        "robotInfo": {
            "numberOfJoints": 7, "safetyState": 0, "driveState": [2] * 7, "operationMode": 2,
            "controlMode": 2,
        },
        "monitorData": {
            "measuredJointPosition": values(*q),
            "measuredTorque": values(*(10.0 * x for x in q)),
            "commandedJointPosition": values(*(x + 0.01 for x in q)),
            "commandedTorque": values(*(11.0 * x for x in q)),
            "externalTorque": values(*(2.0 * x for x in q)),
            "timestamp": {"sec": 1_700_000_000, "nanosec": 250_000_000},
        },
        "connectionInfo": {
            "sessionState": 2, "quality": 3, "sendPeriod": 5, "receiveMultiplier": 1,
        },
        "ipoData": {"clientCommandMode": 0, "overlayType": 0, "trackingPerformance": 0.0},
    }  # fmt: skip
    for part, changes in parts.items():
        all_parts[part] = {**all_parts[part], **changes}
        all_parts[part] = {key: x for key, x in all_parts[part].items() if x is not None}
    text: bytes = _CLASSES["Monitoring"](**all_parts).SerializeToString()
    return text


def framed(message: bytes) -> bytes:
    """Returns a message as FRI 2.7 sends it: length, message, checksum."""
    return struct.pack("<I", len(message)) + message + struct.pack("<I", zlib.crc32(message))


def read_command(packet: bytes) -> Any:
    """Returns the decoded command of a client."""
    return _CLASSES["Command"].FromString(packet)


def read_monitoring(packet: bytes) -> Any:
    """Returns the decoded message of a controller."""
    return _CLASSES["Monitoring"].FromString(packet)


def command(counter: int, reflected: int, **data: Any) -> bytes:
    """Returns a command message of a client."""
    header = {
        "messageIdentifier": 0x34001,
        "sequenceCounter": counter,
        "reflectedSequenceCounter": reflected,
    }
    text: bytes = _CLASSES["Command"](header=header, commandData=data).SerializeToString()
    return text
