"""ROS 2 messages in CDR, encoded by `rosbags`, and processes that publish them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from conftest import ROOT
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def _encoded(kind: str, **fields: Any) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[kind](**fields), kind))


def _header(stamp: float, frame: str = "") -> Any:
    seconds, rest = divmod(round(stamp * 1e9), 10**9)
    time = STORE.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    return STORE.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def joint_state(
    names: Sequence[str],
    angles: Sequence[float],
    velocities: Sequence[float] = (),
    torques: Sequence[float] = (),
    stamp: float = 1.5,
) -> bytes:
    numbers = [np.array(each, float) for each in (angles, velocities, torques)]
    return _encoded(
        JOINT_STATE,
        header=_header(stamp),
        name=list(names),
        position=numbers[0],
        velocity=numbers[1],
        effort=numbers[2],
    )


def text(said: str) -> bytes:
    return _encoded("std_msgs/msg/String", data=said)


def transform(parent: str, child: str, position: Sequence[float]) -> bytes:
    """Returns a message with a transform without rotation."""
    vector = STORE.types["geometry_msgs/msg/Vector3"](*map(float, position))
    rotation = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = STORE.types["geometry_msgs/msg/Transform"](translation=vector, rotation=rotation)
    stamped = STORE.types["geometry_msgs/msg/TransformStamped"](
        header=_header(1.0, parent), child_frame_id=child, transform=pose
    )
    return _encoded(TRANSFORMS, transforms=[stamped])


class Peer:
    """A script of `tests/` in another process, which answers each command with a line.

    Args:
        script: file name of the script.
        port: local port on which the script listens.
        arguments: further arguments of the script.
    """

    def __init__(self, script: str, port: int, *arguments: str) -> None:
        command = [sys.executable, str(ROOT / "tests" / script), str(port), *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port = int(self._answer())

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def do(self, **command: Any) -> str:
        """Sends a command, waits until it is done, and returns the answer."""
        assert self._process.stdin is not None
        for key, value in command.items():
            command[key] = value.hex() if isinstance(value, bytes) else value
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the peer has ended"
        return line.strip()
