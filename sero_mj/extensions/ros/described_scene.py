"""Scenes of robots that ROS describes: by a topic, or in a recording."""

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

DESCRIPTION = "robot.urdf"  # an attachment: what the topic robot_description says
_PATIENCE = 5.0  # s for a network to tell of its robot
_SOURCE = "ros"
_SHOWN = 40  # characters of what is no description


def scene_of_network(text: str) -> Path:
    """Writes a scene of the robot that a network of ROS 2 tells of; returns its file.

    Args:
        text: where it is, `ros2://...`, see `Address`.

    Raises:
        SourceError: a package is missing, or the domain cannot be joined.
        UsageError: there is no robot, or it is not known which.
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
            hint = f"{url} says which robot it is"
            raise UsageError(f"the robot_description is no URDF: it begins with {begin}; {hint}")
        return found.urdf
    if len(found.robots) == 1:
        return found.robots[0]
    url = f"{SCHEME}{address.host}?robot=NAME"
    if found.robots:
        known = f"the joints of {found.joint_states} are those of {', '.join(found.robots)}"
    else:
        known = f"nobody publishes a robot_description for {found.joint_states}"
    raise UsageError(f"{known}; say which robot it is: {url}")


def described_scene(robot: str, source: Mapping[str, Any] | None = None) -> Path:
    """Writes a scene of one robot, in a folder that ends with this process; returns its file.

    Args:
        robot: its description (URDF), or the name of a model.
        source: the table of what moves it; None for nothing.
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
    """Yields scenes of the robot that a recording of ROS is of: described in it, else shipped.

    Args:
        source: of the recording, that moves the robot; any when None.
        wanted: names of robots of which it is one; any when empty.

    Raises:
        RecordingError: it has no source.
        UsageError: it has no such source, or it describes no robot, and several shipped ones have
            its joints.
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
        fits = f"its joints are those of {', '.join(found)}, and it does not describe its robot"
        raise UsageError(f"{bag.path}: {fits}; choose one: {choose.replace('NAME', found[0])}")


def shipped_robots_of(bag: PacketFile, source: str | None = None) -> list[str]:
    """Returns the shipped robots with the joints of a recording, or of one of its sources."""
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
    except ElementTree.ParseError:  # which opening it reports
        name = ""
    return re.sub(r"^(?=[^A-Za-z_])|[^A-Za-z0-9_-]", "_", name) if name else "described"
