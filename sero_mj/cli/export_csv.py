"""The table of a recording that `sero-mj export` writes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from ..base.errors import SeroError, UsageError, without_warnings
from .arguments import check_new, check_span, read_scene, replay_instead

if TYPE_CHECKING:
    from ..data.record.recording import PacketFile
    from ..data.record.replay import Replay
    from ..robots.declared.scene import Scene
    from .export import ExportOptions


def write_table(options: ExportOptions) -> int:
    """Writes a table; returns 0, or 1 if there are packets and none could be decoded."""
    options.accept("begin", "end", "source", "joint_order", "overwrite")
    from ..data.record.csv_files import export_csv
    from ..data.record.formats import open_recording
    from ..data.record.replay import Replay

    if not options.overwrite:
        check_new([options.path], "choose another name, or --overwrite")
    led = _led(options)
    opened = open_recording(options.recording) if led is None else led.open_recording()
    with opened as recording:
        given = options.source or "" if led is None else led.source
        name = recording.choose_source(given, by="--source NAME")
        check_span(recording, options.begin, "--from")
        source = led or Replay(file=options.recording, source=name)
        source.allow_nan(source.events)  # a table has a place for them
        start = -math.inf if options.begin is None else options.begin
        joints = recording.sources[name].declared.get("joints") or []
        ordered, robot = _in_order(recording, joints, options)
        written = export_csv(
            recording,
            name,
            options.path,
            source.decode,
            joints=joints,
            ordered=ordered,
            start=start,
            stop=options.end,
        )
        for fault in recording.faults:
            print(f"note: {options.recording}: {fault}")
        damaged = bool(recording.faults)
    left_out = f", {written.malformed} malformed packets left out" if written.malformed else ""
    order = f", joints in the order of {robot}" if robot else ""
    print(f"{options.path}: {written.rows} rows{order}{left_out}")
    if not written.rows and led is None and source.recorded.declared.get("joint_states") == "tf":
        print("note: transforms tell joint angles of a robot; --scene names it")
    return 1 if (damaged or written.malformed) and not written.rows else 0


def _led(options: ExportOptions) -> Replay | None:
    """What plays a recording of ROS whose messages name no joints, for those of its robot.

    The robot is that of `--scene`, or the one that the recording describes.
    """
    from ..data.drive.wiring import wired_source
    from ..data.record.formats import look_into, open_recording
    from ..data.record.replay import Replay

    known = look_into(options.recording)
    sources = known.sources.values()
    if not known.names_joints or any(each.declared.get("joints") for each in sources):
        return None
    scene = None if options.joint_order is None else read_scene(options.joint_order)
    if scene is None:
        with open_recording(options.recording) as recording:
            scene = _described(recording)
    if scene is None:
        return None
    replay_instead(scene, options.recording, None, options.source)
    wired = [wired_source(scene, name, table) for name, table in scene.sources.items()]
    replays = [each for each in wired if isinstance(each, Replay)]
    named = [each for each in replays if each.source == options.source]
    return next(iter(named or replays), None)


def _described(recording: PacketFile) -> Scene | None:
    with without_warnings(), suppress(SeroError):
        if (file := recording.described_scene()) is not None:
            return read_scene(str(file))
    return None


def _in_order(
    recording: PacketFile, joints: Sequence[str], options: ExportOptions
) -> tuple[list[str], str]:
    from ..base.errors import first_of
    from ..data.record.csv_files import prefix_before
    from ..load import load_robot

    if options.joint_order is not None:
        robots = list(read_scene(options.joint_order).robots.values())
        if len(robots) != 1:
            count = f"it has {len(robots)} robots; expected one, in whose order joints are"
            raise UsageError(f"--scene {options.joint_order}: {count}")
    elif recording.names_joints:
        described = _described(recording)
        robots = [] if described is None else list(described.robots.values())
        if not robots:
            shipped = recording.shipped_robots(options.source)
            robots = [load_robot(name) for name in shipped]
    else:  # packets of our own recordings are in the robot's order
        return [], ""
    orders: list[list[str]] = []
    for robot in robots:
        prefix = prefix_before(robot.names, joints)
        there = [prefix + name for name in robot.names if prefix + name in joints]
        if options.joint_order is not None and joints and not there:
            found = f"its joints are {first_of(robot.names)}; expected {first_of(joints)}"
            raise UsageError(f"--scene {options.joint_order}: {found}")
        orders.append(there + [name for name in joints if name not in there])
    if not joints or not orders or any(order != orders[0] for order in orders):
        return [], ""
    return orders[0], " and ".join(robot.name for robot in robots)
