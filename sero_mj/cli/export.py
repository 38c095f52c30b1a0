"""`sero-mj export`: a scene, run or recording as a file of another format."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import model_validator

from ..base.options import Duration, Option, Time, positional
from ..base.plugins import EXPORTS, load_plugin, plugins
from ..viewer.image.image_options import Rate
from .arguments import command, progress_bar, read_scene, writing
from .shared_options import SceneArgument, ShownOptions

if TYPE_CHECKING:
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
or of the shipped robot with the same joint names; otherwise in the order of the messages.

.toml and .x3d convert a scene from and to X3D. What the other format cannot express is listed.
"""
GROUP, ORDER = "files", 52


class ExportOptions(SceneArgument, ShownOptions):
    """Write a scene or run as page, glTF, table, MJCF, TOML or X3D.

    Attributes:
        scene: scene, scenario, robot or recording: a file, or a shipped name.
        file: the file to write, as --output.
        output: the file to write; its ending selects the format.
        seconds: length, s (default: to the end; 10 s for live sources).
        begin: start time in the run, s.
        end: end time in the run, s.
        fps: frames per second.
        name: title of the page (default: the scene's name).
        joint_order: robot, or scene of one robot, that orders the joints of a table.
        overwrite: replace an existing table, TOML or X3D file.
        quiet: no progress bar, no closing line.
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
            raise ValueError(f"-o OUT: expected one file to write, {endings}")
        if self.ending not in plugins(EXPORTS):
            raise ValueError(f"found '{self.path}'; expected a name that ends in {endings}")
        if self.end is not None:
            if self.seconds is not None:
                raise ValueError("--to and --seconds say the same; give one of them")
            if self.end <= (self.begin or 0.0):
                raise ValueError(f"--to: found {self.end:g}; expected more than --from, s")
        return self

    @property
    def path(self) -> Path:
        """The file to write."""
        path = self.output or self.file
        assert path is not None
        return path

    @property
    def recording(self) -> Path:
        """The recording that is written as a table."""
        return Path(self.scene)

    @property
    def ending(self) -> str:
        """The ending of the file's name, without the dot."""
        return self.path.suffix.lower().removeprefix(".")

    @property
    def length(self) -> float | None:
        """How long, s; None for to the end."""
        return self.seconds if self.end is None else self.end - (self.begin or 0.0)

    def accept(self, *names: str) -> None:
        """Raises UsageError if an option is given that the format does not have."""
        always = {"scene", "file", "output", "quiet", "package", "arg", *names}
        others = [name for name in type(self).model_fields if name not in always]
        self.refuse(others, f" is not for {self.path}, a file of another kind")


def run(options: ExportOptions) -> int:
    """Writes the file; returns the exit status."""
    return int(load_plugin(EXPORTS, options.ending)(options))


add_to = command("export", run, ExportOptions, _HELP)

# Options of formats that contain a captured run.
CAPTURE_OPTIONS = (
    *("seconds", "begin", "end", "fps", "camera", "settings", "replay", "start", "source"),
    *("columns", "look"),
)


def write_page_of(options: ExportOptions) -> int:
    """Writes a page that plays a scene or a run; returns 0."""
    from ..study.run_marks import marks_of
    from ..viewer.player.page import write_page

    options.accept(*CAPTURE_OPTIONS, "follow", "name")
    scene, found = capture_run(options)
    found.marks = marks_of(scene, found.begin)
    write_page(found, options.path, options.name)
    return report_size(options)


def capture_run(options: ExportOptions) -> tuple[Scene, CapturedRun]:
    """Returns the scene of the options and the run captured from it."""
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
        print(f"sero-mj: no good packet for source '{name}' within 2 s", file=sys.stderr)
    return scene, found


def report_size(options: ExportOptions) -> int:
    """Prints the size of the written file; returns 0."""
    if not options.quiet:
        print(f"{options.path}: {options.path.stat().st_size / 1e6:.2f} MB")
    return 0


def write_mjcf(options: ExportOptions) -> int:
    """Writes MJCF and its mesh files; returns 0."""
    from ..robots.assemble.world import World

    options.accept("settings")
    world = World(read_scene(options.scene, options.settings))
    with writing():
        written = world.export(options.path)
    print(f"{written[0]} and {len(written) - 1} mesh files")
    return 0
