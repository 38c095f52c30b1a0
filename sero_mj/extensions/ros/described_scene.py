"""Scenes of robots that are described in a ROS topic or recording."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ...base import paths
from ...base.errors import RecordingError, UsageError, shown
from ...data.record.recording import PacketFile
from .bag_scenes import source_routes
from .network import SCHEME, Address, Found, find_robot, robots_with

DESCRIPTION = "robot.urdf"  # attachment that contains the message of the topic robot_description
_PATIENCE = 5.0  # s; maximum time to wait for a robot in a network
_SOURCE = "ros"
_SHOWN = 40  # characters of an invalid description in an error


def scene_of_network(text: str) -> Path:
    """Writes a scene of the robot in a ROS 2 network, and returns its file.

    Args:
        text: address of the robot, `ros2://...`, see `Address`.

    Raises:
        SourceError: a package is missing, or the domain cannot be joined.
        UsageError: there is no robot, or more than one.
    """
    address = Address.parse(text)
    found = find_robot(address, _PATIENCE)
    source = {**address.source}
    if found.joint_states and "joint_states" not in source:
        source["joint_states"] = found.joint_states
    return described_scene(_robot(address, found), source)


def _robot(address: Address, found: Found) -> str:
    if address.robot:
        return address.robot
    if found.urdf:
        if not _is_xml(found.urdf):
            begin = shown(found.urdf[:_SHOWN])
            url = f"{SCHEME}{address.host}?robot=NAME"
            raise UsageError(
                f"the robot_description is not URDF: it begins with {begin}. To name an included "
                f"robot, use {url}"
            )
        return found.urdf
    if len(found.robots) == 1:
        return found.robots[0]
    url = f"{SCHEME}{address.host}?robot=NAME"
    if found.robots:
        reason = f"{', '.join(found.robots)} have the joints of {found.joint_states}"
    else:
        reason = f"no robot_description is published for {found.joint_states}"
    raise UsageError(f"{reason}. To name the robot, use {url}")


def described_scene(robot: str, source: Mapping[str, Any] | None = None) -> Path:
    """Writes a scene of one robot to a temporary folder, and returns its file.

    Args:
        robot: URDF of the robot, or the name of a model.
        source: table of the source that moves the robot, or None.
    """
    folder, model = paths.make_temporary_folder(), robot
    if _is_xml(robot):
        name = _name_in(robot)
        model = f"{name}.urdf"
        (folder / model).write_text(robot, encoding="utf-8")
    else:
        name = paths.model_name(paths.find_model(robot))
    tables: dict[str, Mapping[str, Any]] = {
        "": {"floor": "below"},
        f"robots.{name}": {"model": model, "show_arrows": True},
    }
    if source is not None:
        tables[f"sources.{_SOURCE}"] = source
        tables["routes"] = source_routes(name, _SOURCE, source)
    file = folder / f"{name}.toml"
    file.write_text("\n".join(_toml(*each) for each in tables.items()), encoding="utf-8")
    return file


def scenes_of_bag(
    bag: PacketFile, choose: str, source: str | None = None, wanted: Collection[str] = ()
) -> Iterator[str]:
    """Yields scenes that can show a ROS recording.

    The first scene shows the robot that the recording describes, if it contains a description. The
    other scenes are included robots with the joint names of the recording.

    Args:
        choose: option that chooses a scene, such as `--scene NAME`, for the error message.
        source: source that must have the robot's joints (default: any source).
        wanted: names of the allowed robots; empty for any robot.

    Raises:
        RecordingError: the recording has no source.
        UsageError: the recording has no such source, or it does not describe its robot, and several
            included robots have its joints.
    """
    if source is not None:
        bag.choose_source(source)
    if not bag.sources:
        raise RecordingError(bag.path, bag.why_no_source())
    is_described = DESCRIPTION in bag.attachments
    if is_described:
        yield str(described_scene(bag.read_attachment(DESCRIPTION).decode("utf-8")))
    found = shipped_robots_of(bag, source)
    if wanted:
        yield from [name for name in found if name in wanted]
        yield from [name for name in wanted if name not in found]
    elif len(found) == 1:
        yield from found
    elif found and not is_described:
        names = ", ".join(found)
        reason = f"does not describe its robot, and {names} have the same joint names"
        raise UsageError(f"{bag.path} {reason}. Choose one: {choose.replace('NAME', found[0])}")


def shipped_robots_of(bag: PacketFile, source: str | None = None) -> list[str]:
    """Returns the included robots with the joints of a recording, or of one of its sources."""
    sources = [each for name, each in bag.sources.items() if source in (None, name)]
    robots = [robot for each in sources for robot in robots_with(each.declared["joints"])]
    return list(dict.fromkeys(robots))


def _is_xml(text: str) -> bool:
    return text.lstrip("\ufeff \t\r\n").startswith("<")


def _toml(name: str, table: Mapping[str, Any]) -> str:
    head = f"[{name}]\n" if name else ""
    return head + "".join(
        f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in table.items()
    )


def _name_in(urdf: str) -> str:
    try:
        name = ElementTree.fromstring(urdf).get("name", "")
    except ElementTree.ParseError:  # opening the file reports this error
        name = ""
    return re.sub(r"^(?=[^A-Za-z_])|[^A-Za-z0-9_-]", "_", name) if name else "described"
