"""`sero-mj export`: writes a scene, run or recording in another format."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import model_validator

from ..base.errors import SeroError, UsageError, without_warnings
from ..base.options import Duration, Option, Time, positional
from ..base.plugins import EXPORTS, load_plugin, plugins
from ..viewer.image.image_options import Rate
from .arguments import (
    check_new,
    check_span,
    command,
    progress_bar,
    read_scene,
    replay_instead,
    writing,
)
from .shared_options import SceneArgument, ShownOptions

if TYPE_CHECKING:
    from ..data.record.recording import PacketFile
    from ..data.record.replay import Replay
    from ..robots.declared.scene import Scene
    from ..viewer.player.capture import CapturedRun

_HELP = """\
examples:
  sero-mj export run.mcap -o run.html       a page that plays a recording, offline
  sero-mj export run.mcap -o run.csv        the packets of a recording as a table
  sero-mj export lwr_udp -o lwr.xml         MJCF with its mesh files, for plain MuJoCo

A page (.html) is one file that makes no network requests. It plays the run, steps frame by frame,
rotates, and shows names and values of clicked parts. .glb is a glTF animation. Both can also show a
scenario, which is simulated, or live sources.

MJCF (.xml) has the names robot/link1 etc. and the key frame "home" with the declared joint angles.
It has the masses of the simulation, but not its drives, motor inertia and friction. A comment in
the file lists the estimated masses.

A table (.csv) has one row per valid packet: seconds since the recording began, then all values in
full precision. Joints are in the order of the robot of --scene, of the recorded robot description
or of the included robot with the same joint names; otherwise in the order of the messages.

.toml and .x3d convert a scene from and to X3D. What the other format cannot express is listed.
"""
GROUP, ORDER = "files", 52


class ExportOptions(SceneArgument, ShownOptions):
    """Write a scene or run as a page, glTF, table, MJCF, TOML or X3D file.

    Attributes:
        scene: file or included name of a scene, scenario, robot or recording.
        file: output file (may also be given as --output).
        output: output file; its extension determines the format.
        seconds: duration to export in seconds (default: until the end, or 10 s for live sources).
        begin: start time in the run, in seconds.
        end: end time in the run, in seconds.
        fps: frames per second.
        name: title of the page (default: the name of the scene).
        joint_order: robot, or scene with one robot, that determines the joint order of a table.
        overwrite: replace an existing table, TOML or X3D file.
        quiet: print nothing.
    """

    scene: Annotated[str, positional("SCENE")]
    file: Annotated[Path | None, positional("OUT")] = None
    output: Annotated[Path | None, Option("OUT", ("-o", "--output"))] = None
    seconds: Annotated[Duration | None, Option("S", ("--duration", "--seconds"))] = None
    begin: Annotated[Time | None, Option("S", ("--from",))] = None
    end: Annotated[Duration | None, Option("S", ("--to",))] = None
    fps: Rate = 30.0
    name: Annotated[str, Option("TEXT")] = ""
    joint_order: Annotated[str | None, Option("SCENE", ("--scene",))] = None
    overwrite: bool = False
    quiet: bool = False

    @model_validator(mode="after")
    def _check_output(self) -> Self:
        endings = ", ".join(f".{name}" for name in sorted(plugins(EXPORTS)))
        if (self.file is None) == (self.output is None):
            raise ValueError(f"-o OUT: expected exactly one output file ({endings})")
        if self.ending not in plugins(EXPORTS):
            raise ValueError(f"found '{self.path}'; expected a name that ends in {endings}")
        if self.end is not None:
            if self.seconds is not None:
                raise ValueError("--to cannot be combined with --seconds")
            if self.end <= (self.begin or 0.0):
                raise ValueError(f"--to: found {self.end:g}; expected more than --from")
        return self

    @property
    def path(self) -> Path:
        path = self.output or self.file
        assert path is not None
        return path

    @property
    def recording(self) -> Path:
        return Path(self.scene)

    @property
    def ending(self) -> str:
        return self.path.suffix.lower().removeprefix(".")

    @property
    def length(self) -> float | None:
        """Duration to export in seconds, or None for the rest of the run."""
        return self.seconds if self.end is None else self.end - (self.begin or 0.0)

    def accept(self, *names: str) -> None:
        """Raises UsageError if an option other than the supported options `names` is set."""
        always = {"scene", "file", "output", "quiet", "package", "arg", *names}
        others = [name for name in type(self).model_fields if name not in always]
        self.refuse(others, f" is not available for {self.ending} files")


def run(options: ExportOptions) -> int:
    """Writes the output file and returns the exit status."""
    return int(load_plugin(EXPORTS, options.ending)(options))


add_to = command("export", run, ExportOptions, _HELP)

# Options of formats that contain a captured run.
CAPTURE_OPTIONS = (
    *("seconds", "begin", "end", "fps", "camera", "settings", "replay", "start", "source"),
    *("columns", "look"),
)


def write_page_of(options: ExportOptions) -> int:
    """Writes a page that plays a scene or run; returns 0."""
    from ..study.run_report import marks_of
    from ..viewer.player.page import write_page

    options.accept(*CAPTURE_OPTIONS, "follow", "name")
    scene, found = capture_run(options)
    found.marks = marks_of(scene, found.begin)
    write_page(found, options.path, options.name)
    return report_size(options)


def capture_run(options: ExportOptions) -> tuple[Scene, CapturedRun]:
    """Loads the scene of the options and captures its run; returns both."""
    from ..viewer.player.capture import capture
    from .opening import with_scene

    path, options = options.path, with_scene(options)
    scene = options.read(options.scene)
    is_new = not path.exists()
    with writing():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("ab").close()
    try:
        with progress_bar("collecting", quiet=options.quiet) as update:
            found = capture(
                scene, seconds=options.length, begin=options.begin or 0.0, fps=options.fps,
                camera=options.camera, follow=options.follow, on_progress=update,
            )  # fmt: skip
    except BaseException:
        if is_new:
            path.unlink()
        raise
    for name in found.silent:
        print(f"sero-mj: no valid packet from source '{name}' within 2 s", file=sys.stderr)
    return scene, found


def report_size(options: ExportOptions) -> int:
    """Prints the size of the written file; returns 0."""
    if not options.quiet:
        print(f"{options.path}: {options.path.stat().st_size / 1e6:.2f} MB")
    return 0


def write_mjcf(options: ExportOptions) -> int:
    """Writes a scene as MJCF with its mesh files; returns 0."""
    from ..robots.assemble.world import World

    options.accept("settings")
    world = World(read_scene(options.scene, options.settings))
    with writing():
        written = world.export(options.path)
    print(f"{written[0]} and {len(written) - 1} mesh files")
    return 0


def write_table(options: ExportOptions) -> int:
    """Writes a recording as a table; returns 1 if there are only invalid packets, otherwise 0."""
    options.accept("begin", "end", "source", "joint_order", "overwrite")
    from ..data.record.csv_files import export_csv
    from ..data.record.formats import open_recording
    from ..data.record.replay import Replay

    if not options.overwrite:
        check_new([options.path], "choose another name or add --overwrite")
    replay = _replay_by_robot(options)
    opened = open_recording(options.recording) if replay is None else replay.open_recording()
    with opened as recording:
        wanted = options.source or "" if replay is None else replay.source
        name = recording.choose_source(wanted, by="--source NAME")
        check_span(recording, options.begin, "--from")
        source = replay or Replay(file=options.recording, source=name)
        source.allow_nan(source.events)  # a table can express NaN
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
    left_out = f", {written.malformed} malformed packets skipped" if written.malformed else ""
    order = f", joints in the order of {robot}" if robot else ""
    print(f"{options.path}: {written.rows} rows{order}{left_out}")
    is_tf = source.recorded.declared.get("joint_states") == "tf"
    if not written.rows and replay is None and is_tf:
        print("note: joint angles can be computed from transforms if --scene names the robot")
    return 1 if (damaged or written.malformed) and not written.rows else 0


def _replay_by_robot(options: ExportOptions) -> Replay | None:
    """Returns a replay of a ROS recording whose messages name no joints, such as transforms.

    The joints are those of the robot in `--scene`, or of the robot that the recording describes.
    Returns None for other recordings.
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
            count = f"found {len(robots)} robots; expected one, which orders the joints"
            raise UsageError(f"--scene {options.joint_order}: {count}")
    elif recording.names_joints:
        described = _described(recording)
        robots = [] if described is None else list(described.robots.values())
        if not robots:
            shipped = recording.shipped_robots(options.source)
            robots = [load_robot(name) for name in shipped]
    else:  # recordings of sero-mj have the joint order of the robot
        return [], ""
    orders: list[list[str]] = []
    for robot in robots:
        prefix = prefix_before(robot.names, joints)
        there = [prefix + name for name in robot.names if prefix + name in joints]
        if options.joint_order is not None and joints and not there:
            found = f"found joints {first_of(robot.names)}; expected {first_of(joints)}"
            raise UsageError(f"--scene {options.joint_order}: {found}")
        orders.append(there + [name for name in joints if name not in there])
    if not joints or not orders or any(order != orders[0] for order in orders):
        return [], ""
    return orders[0], " and ".join(robot.name for robot in robots)
