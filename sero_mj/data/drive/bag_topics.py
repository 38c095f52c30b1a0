"""What a scene reads of a recording of ROS: the topics of its sources, or those of its robot."""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import Any

from ...base.errors import SeroError
from ...base.frames import Array
from ...robots.declared.scene import Scene
from ..record.bag import Bag, open_recording
from ..record.replay import Replay
from ..ros.ros_source import RosSource
from .wiring import wired_source

_FIELDS = frozenset(RosSource.model_fields) - {"name", "structure", "only_latest_packet"}


def topics_of(scene: Scene) -> dict[str, RosSource]:
    """What a scene's sources read of ROS; those that are declared wrongly are left out."""
    found: dict[str, RosSource] = {}
    for name, declared in scene.sources.items():
        with suppress(SeroError):
            source = wired_source(scene, name, declared)
            of_ros = source.of_ros if isinstance(source, Replay) else source
            if isinstance(of_ros, RosSource):
                found[name] = of_ros
    return found


def replay_of(scene: Scene, name: str, file: Path) -> dict[str, Any]:
    """The table of a source that plays a recording in the place of one of a scene.

    Args:
        scene: the declaration.
        name: of the source, in both.
        file: the recording.
    """
    table: dict[str, Any] = {"kind": "replay", "file": str(file), "source": name}
    source = topics_of(scene).get(name)
    with open_recording(file) as recording:
        if source is not None and isinstance(recording, Bag):
            table["topics"] = source.model_dump(include=_FIELDS, exclude_unset=True)
    return table


def with_bag(scene: Scene, file: Path) -> Scene:
    """A scene without sources that has a single robot, with that robot led by a recording of ROS.

    Other scenes, and those of other recordings, are returned as they are.

    Args:
        scene: is not changed.
        file: the recording.

    Raises:
        RecordingError: it cannot be read.
    """
    if scene.sources or len(scene.robots) != 1:
        return scene
    with open_recording(file) as recording:
        if not isinstance(recording, Bag):
            return scene
        names = list(recording.sources)
    if len(names) != 1:
        return scene
    (name, robot), (source,) = next(iter(scene.robots.items())), names
    led = copy(scene)
    led.sources = {source: {"kind": "replay", "file": str(file), "source": source}}
    led.routes = {**joint_routes(name, source), **scene.routes}
    shown: dict[str, Any] = {"joint_angles": _first_angles(led, source)}
    if "show_arrows" not in robot.model_fields_set:
        shown["show_arrows"] = True
    led.robots = {name: robot.model_copy(update=shown)}
    return led


def _first_angles(scene: Scene, source: str) -> Array:
    """The angles of a robot's joints at the beginning of what leads it, to which views are fitted.

    Args:
        scene: of one robot.
        source: that leads it.
    """
    (robot,) = scene.robots.values()
    with suppress(SeroError):
        replay = wired_source(scene, source, scene.sources[source])
        replay.debug_level = 0  # what is wrong is told where it is played
        with replay:
            packet = replay.latest()
        angles = None if packet is None else packet.values.get("joint_angles")
        if angles is not None and len(angles) == robot.coupled.k:
            return robot.coupled.positions(angles)
    return robot.home


def joint_routes(robot: str, source: str) -> dict[str, str]:
    """The routes from a source of ROS to a robot."""
    events = ("joint_angles", "torques")
    return {f"{robot}.{event}": f"{source}.{event}" for event in events}
