"""Scenes whose robot is moved by a ROS recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from typing import Any

from ...base.errors import SeroError
from ...data.drive.wiring import wired_source
from ...data.record.csv_files import prefix_before
from ...data.record.recording import PacketFile
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from .joined_packets import TF
from .ros_source import is_tf

_NAMELESS = "joint_states"  # name of the source of messages that do not name joints


def led_by(
    scene: Scene,
    recording: PacketFile,
    nameless: Sequence[str],
    parent_frames: Callable[[], Mapping[str, tuple[str, bool]]],
    source: str | None,
) -> Scene:
    """Returns a copy of a scene in which the recording moves the only robot.

    Args:
        nameless: topics whose messages contain no joint names.
        parent_frames: function that returns the parent frames, see `Bag.parent_frames`.
        source: source that moves the robot (default: the source with the robot's joint names).
    """
    if scene.sources or len(scene.robots) != 1:
        return scene
    name, robot = next(iter(scene.robots.items()))
    joints = {each: of.declared["joints"] for each, of in recording.sources.items()}
    table: dict[str, Any] = {"kind": "replay", "file": str(recording.path)}
    if not joints and source is None and len(nameless) == 1:
        source, joints = _NAMELESS, {_NAMELESS: []}
        table["topics"] = {"joint_states": nameless[0]}
    if source is None:
        source = _source_of(robot, joints)
    if source not in joints:
        return scene
    led = copy(scene)
    table["source"] = source
    declared = table["topics"] if "topics" in table else recording.sources[source].declared
    if not declared.get("odometry") and _base_moves(robot, parent_frames):
        declared = {key: each for key, each in declared.items() if key != "joints"}
        table["topics"] = declared = {**declared, "odometry": TF}
    led.sources = {source: table}
    led.routes = {**source_routes(name, source, declared), **scene.routes}
    if robot.mount is not None:
        led.routes.pop(f"{name}.base_frame", None)
    shown = _first_pose(led, source)
    if "show_arrows" not in robot.model_fields_set and f"{name}.torques" in led.routes:
        shown["show_arrows"] = True
    led.robots = {name: robot.model_copy(update=shown)}
    return led


def _source_of(robot: SerialRobot, joints: Mapping[str, Sequence[str]]) -> str | None:
    if len(joints) == 1:
        return next(iter(joints))
    wanted = [robot.names[k] for k in robot.coupled.independent]
    best: dict[tuple[bool, bool], list[str]] = {}
    for source, names in joints.items():
        prefix = prefix_before(wanted, names)
        others = set(names).difference(prefix + name for name in wanted)
        if len(names) - len(others) == len(wanted):
            best.setdefault((bool(prefix), bool(others)), []).append(source)
    # Sources without a prefix are preferred, and among these, sources without other joints.
    found = best[min(best)] if best else []
    return found[0] if len(found) == 1 else None


def _base_moves(
    robot: SerialRobot, parent_frames: Callable[[], Mapping[str, tuple[str, bool]]]
) -> bool:
    links = robot.link_frames
    if not links or robot.mount is not None:
        return False
    parents = parent_frames()
    for link in links:
        name, passed = link, set[str]()
        while name in parents and name not in passed:
            passed.add(name)
            name, is_moved = parents[name]
            if is_moved and name not in links:
                return True
    return False


def _first_pose(scene: Scene, source: str) -> dict[str, Any]:
    ((name, robot),) = scene.robots.items()
    pose: dict[str, Any] = {"joint_angles": robot.home}
    with suppress(SeroError):
        replay = wired_source(scene, source, scene.sources[source])
        replay.debug_level = 0  # problems are reported during playback
        with replay:
            packet = replay.latest()
        values = {} if packet is None else packet.values
        angles = values.get("joint_angles")
        if angles is not None and len(angles) == robot.coupled.k:
            pose["joint_angles"] = robot.coupled.positions(angles)
        if f"{name}.base_frame" in scene.routes and "base_frame" in values:
            pose["base_frame"] = values["base_frame"].reshape(4, 4)
    return pose


def source_routes(robot: str, source: str, declared: Mapping[str, Any]) -> dict[str, str]:
    """Returns the routes from a ROS source to a robot.

    Args:
        declared: table of the source.
    """
    states = declared.get("joint_states", "joint_states")
    events = ["joint_angles"] if states else []
    if states and not is_tf(states):
        events.append("torques")
    if declared.get("odometry"):
        events.append("base_frame")
    return {f"{robot}.{event}": f"{source}.{event}" for event in events}
