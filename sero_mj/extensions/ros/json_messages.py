"""Joint states in JSON, as published by robot hands, arms and their bridges.

Two formats are supported. One is `sensor_msgs/JointState`, also in the envelope of rosbridge
(`msg`):

    {"header": {"stamp": {"sec": 1, "nanosec": 0}}, "name": ["j1", "j2"],
     "position": [0.1, 0.2], "velocity": [], "effort": [1.5, -0.3]}

The other is `foxglove.JointStates` (docs.foxglove.dev/docs/sdk/schemas/joint-states):

    {"timestamp": {"sec": 1, "nsec": 0},
     "joints": [{"name": "j1", "position": 0.1, "effort": 1.5}, ...]}
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...base.errors import printable
from ...base.frames import Array
from .messages import MAX_BYTES, MalformedMessage

_NUMBERS = ("position", "velocity", "effort")
_NANOSECONDS = ("nanosec", "nsec", "nsecs")
_SHOWN, _SHOWN_BYTES = 40, 8  # characters or bytes of a message in an error


def joint_state_of(raw: bytes) -> Any:
    """Decodes UTF-8 JSON to the attributes of `sensor_msgs/JointState`; raises MalformedMessage.

    A missing or null value becomes NaN. A quantity without any values becomes an empty array.
    """
    if len(raw) > MAX_BYTES:
        raise MalformedMessage(f"found {len(raw)} bytes; expected at most {MAX_BYTES}")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        begin = raw[:_SHOWN_BYTES].hex(" ")
        reason = f"byte {error.start} is not UTF-8; it begins with the bytes {begin}"
        raise MalformedMessage(f"the message is not JSON: {reason}") from None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        begin = printable(text[:_SHOWN])
        raise MalformedMessage(
            f"the message is not JSON: {error}; it begins with {begin}"
        ) from None
    if isinstance(found, Mapping) and isinstance(found.get("msg"), Mapping):
        found = found["msg"]
    if not isinstance(found, Mapping):
        raise MalformedMessage(f"found a {type(found).__name__}; expected a JSON object")
    joints = found.get("joints")
    if isinstance(joints, list) and all(isinstance(each, Mapping) for each in joints):
        names: Any = [each.get("name") for each in joints]
        stamp = found.get("timestamp")
        columns = {key: [each.get(key) for each in joints] for key in _NUMBERS}
        numbers = {
            key: _numbers(key, each if any(x is not None for x in each) else [])
            for key, each in columns.items()
        }
    else:
        header = found.get("header")
        stamp = header.get("stamp") if isinstance(header, Mapping) else None
        if not any(key in found for key in _NUMBERS):
            keys = ", ".join(str(key)[:_SHOWN] for key in [*found][:8]) or "none"
            expected = "name, position, velocity and effort, or joints"
            raise MalformedMessage(f"found the keys {keys}; expected {expected}")
        names = found.get("name", [])
        numbers = {key: _numbers(key, found.get(key)) for key in _NUMBERS}
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise MalformedMessage("joint names are not a list of strings")
    return SimpleNamespace(header=SimpleNamespace(stamp=_stamp(stamp)), name=names, **numbers)


def message_of(
    names: Sequence[str], stamp: float, angles: Array, velocities: Array, efforts: Array
) -> bytes:
    """Encodes a `sensor_msgs/JointState` in JSON.

    Args:
        stamp: time stamp in seconds; 0 if unknown.
        angles: joint angles in rad or m, shape (n,). NaN becomes null, and a quantity that is NaN
            for all joints becomes an empty list.
        velocities: joint velocities in rad/s or m/s, shape (n,).
        efforts: efforts in the unit that the receiver expects, shape (n,).
    """
    seconds = math.floor(stamp)
    message: dict[str, Any] = {
        "header": {"stamp": {"sec": seconds, "nanosec": int((stamp - seconds) * 1e9)}},
        "name": list(names),
    }
    for key, values in zip(_NUMBERS, (angles, velocities, efforts), strict=True):
        known = [x if math.isfinite(x) else None for x in values.tolist()]
        message[key] = known if any(x is not None for x in known) else []
    return json.dumps(message, ensure_ascii=False).encode()


def _numbers(key: str, values: Any) -> Array:
    values = [] if values is None else values
    try:
        if not isinstance(values, list):
            raise TypeError
        return np.array([math.nan if x is None else x for x in values], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MalformedMessage(f"{key} is not a list of numbers") from None


def _stamp(found: Any) -> Any:
    parts = [0, 0]
    if isinstance(found, Mapping):
        nanoseconds = next((found[key] for key in _NANOSECONDS if key in found), 0)
        parts = [found.get("sec", found.get("secs", 0)), nanoseconds]
    if not all(isinstance(part, int | float) and math.isfinite(part) for part in parts):
        raise MalformedMessage("the time stamp is not in integer seconds and nanoseconds")
    return SimpleNamespace(sec=parts[0], nanosec=parts[1])
