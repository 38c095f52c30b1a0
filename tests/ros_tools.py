"""ROS messages, bags with messages, and publishers in separate processes."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from sero_mj.base.frames import quat_from_rotation

STORE = get_typestore(Stores.ROS2_HUMBLE)
OLD_STORE = get_typestore(Stores.ROS1_NOETIC)
JOINT_STATE = "sensor_msgs/msg/JointState"
BEGIN = 1_700_000_000 * 10**9  # Unix time at which bags begin, ns


def joint_state(
    names: Sequence[str],
    angles: Any = (),
    velocities: Any = (),
    torques: Any = (),
    stamp: int = 0,
    store: Any = STORE,
) -> Any:
    """Returns a joint state message; the stamp is in ns."""
    types = store.types
    time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    order = ((0,) if store is OLD_STORE else ()) + (time, "")
    header = types["std_msgs/msg/Header"](*order)
    numbers = [np.array(each, float) for each in (angles, velocities, torques)]
    return types[JOINT_STATE](header, list(names), *numbers)


def _header(stamp: int, frame: str) -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    return STORE.types["std_msgs/msg/Header"](time, frame)


def _pose(T: Any, kind: str = "Pose", vector: str = "Point") -> Any:
    types = STORE.types
    w, x, y, z = quat_from_rotation(T[:3, :3])
    turned = types["geometry_msgs/msg/Quaternion"](x, y, z, w)
    at = types[f"geometry_msgs/msg/{vector}"](*map(float, T[:3, 3]))
    return types[f"geometry_msgs/msg/{kind}"](at, turned)


def transforms(edges: Sequence[tuple[str, str, Any]], stamp: int = 0) -> Any:
    """Returns a message with transforms (parent, child, T_parent_child); the stamp is in ns."""
    types = STORE.types
    each = [
        types["geometry_msgs/msg/TransformStamped"](
            _header(stamp, parent), child, _pose(T, "Transform", "Vector3")
        )
        for parent, child, T in edges
    ]
    return types["tf2_msgs/msg/TFMessage"](each)


def odometry(T: Any, child: str, velocity: Sequence[float] = (0, 0, 0), stamp: int = 0) -> Any:
    """Returns an odometry message with a pose in the frame `odom`; the stamp is in ns."""
    types, vector = STORE.types, STORE.types["geometry_msgs/msg/Vector3"]
    twist = types["geometry_msgs/msg/Twist"](vector(*map(float, velocity)), vector(0.1, 0.2, 0.3))
    return types["nav_msgs/msg/Odometry"](
        _header(stamp, "odom"),
        child,
        types["geometry_msgs/msg/PoseWithCovariance"](_pose(T), np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def pose_stamped(T: Any, stamp: int = 0) -> Any:
    """Returns a message with a pose; the stamp is in ns."""
    return STORE.types["geometry_msgs/msg/PoseStamped"](_header(stamp, "map"), _pose(T))


def encoded(message: Any) -> bytes:
    """Returns a message in CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def write_bag(path: Path, topics: dict[str, list[tuple[int, Any]]], kind: str = "mcap") -> Path:
    """Writes a bag and returns its path.

    Args:
        path: path of the folder or file.
        topics: times (ns since `BEGIN`) and messages by topic.
        kind: `mcap`, `db3`, or `bag` for ROS 1.
    """
    if kind == "bag":
        with rosbag1.Writer(path) as writer:
            _fill(writer, topics, OLD_STORE, OLD_STORE.serialize_ros1)
        return path
    plugin = {"mcap": rosbag2.StoragePlugin.MCAP, "db3": rosbag2.StoragePlugin.SQLITE3}[kind]
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        _fill(writer, topics, STORE, STORE.serialize_cdr)
    return path


def _fill(writer: Any, topics: Any, store: Any, serialize: Any) -> None:
    connections = {
        name: writer.add_connection(name, messages[0][1].__msgtype__, typestore=store)
        for name, messages in topics.items()
    }
    merged = sorted(
        ((time, name, message) for name, each in topics.items() for time, message in each),
        key=lambda entry: entry[0],
    )
    for time, name, message in merged:
        writer.write(connections[name], BEGIN + time, serialize(message, message.__msgtype__))


def read_joint_states(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Returns times (ns) and joint state messages by topic, decoded by MCAP's ROS decoder."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if schema is not None and schema.name == JOINT_STATE:
                decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)
                assert decoded is not None
                found.setdefault(channel.topic, []).append(
                    (message.log_time, decoded(message.data))
                )
    return found


class Peer:
    """The publishers of `ros2_peer` in a separate process."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._hear()

    def _hear(self) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "done\n"

    def kill(self) -> None:
        """Kills the process, so that it does not leave the domain properly."""
        self._process.kill()
        self._process.wait(10)

    def say(self, **said: Any) -> None:
        """Sends a command and waits until it is done."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(said) + "\n")
        self._process.stdin.flush()
        self._hear()

    def joints(self, topic: str = "/joint_states", **message: Any) -> None:
        """Publishes the state of joints."""
        self.say(write=topic, kind="JointState", message=message)


def free_domain() -> int:
    """Returns a domain that other tests do not use."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    return 100 + (worker * 40 + os.getpid()) % 130


@contextmanager
def publishing(domain: int, lease: float = 10.0) -> Iterator[Peer]:
    """Yields publishers in a domain on this machine; a kill is detected after `lease` (s)."""
    script = Path(__file__).with_name("ros2_peer.py")
    command = [sys.executable, str(script), str(domain), str(lease)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield Peer(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            process.wait(10)


@contextmanager
def rclpy_environment(folder: Path) -> Iterator[Path]:
    """Yields the Python of an environment with `rclpy` of ROS 2 Kilted over Fast DDS from wheels.

    Skips the test if the wheels cannot be installed.
    """
    python = folder / "bin" / "python"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            packages = ("rclpy", "rmw-fastrtps-cpp", "sensor-msgs", "std-msgs")
            for command in (
                [sys.executable, "-m", "venv", "--clear", str(folder)],
                [str(python), "-m", "pip", "install", "-q", *(f"ros-{each}" for each in packages)],
                [str(python), "-c", "import rclpy, sensor_msgs.msg"],
            ):
                done = subprocess.run(
                    command, capture_output=True, text=True, timeout=250, check=False
                )
                if done.returncode:
                    pytest.skip(f"rclpy cannot be installed: {done.stderr.strip()[-200:]}")
            (folder / "complete").touch()
        yield python
