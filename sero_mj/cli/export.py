"""`sero-mj export`: a page that plays a run, a glTF animation, or MJCF that plain MuJoCo loads."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from ..base.options import Duration, Option, Time, ending, positional
from ..viewer.image.picture_options import Rate
from .arguments import command, progress_bar, read_scene, writing
from .shared_options import SceneArgument, ShownOptions

_EPILOG = """\
examples:
  sero-mj export run.mcap -o run.html          a recording as a page that plays it, offline
  sero-mj export impedance_push -o push.html   a scenario, simulated
  sero-mj export lwr_udp -o lwr.html --seconds 10    live sources, for ten seconds
  sero-mj export run.mcap -o run.glb --from 2 --to 8    for programs that read glTF
  sero-mj export lwr_udp out/lwr.xml && python -m mujoco.viewer --mjcf=out/lwr.xml

A page is one file that makes no network requests: it plays, goes frame by frame, turns, and tells
names and numbers of what is clicked on.

Mesh files of MJCF are written to a folder beside the XML. Bodies are named robot/link1 and so on;
the key frame "home" has the joint angles that the scene declares. It is what is viewed, without
drives, motor inertia and friction, which are what `simulate` adds, but with the masses of
simulation. A comment in the file says which of these are estimated.
"""
ORDER = 55  # in the help of `sero-mj`
_ENDINGS = (".html", ".glb", ".xml")
_OfRuns = ("seconds", "begin", "end", "fps", "camera", "replay", "start", "look", "name")


class ExportOptions(SceneArgument, ShownOptions):
    """Write a scene or a run as one file: a page, a glTF animation, or MJCF with its meshes.

    Attributes:
        scene: scene, scenario, robot or recording: a file, or a shipped name.
        file: the file to write, as --output.
        output: the file to write: .html, .glb or .xml.
        seconds: how long, s (default: to the end; of live sources 10 s).
        begin: from this time of a run on, s.
        end: up to this time of a run, s.
        fps: frames per second.
        name: title of the page (default: the scene's name).
        quiet: no progress bar, no closing line.
    """

    scene: Annotated[str, positional("SCENE")]
    file: Annotated[Path | None, ending(*_ENDINGS), positional("OUT")] = None
    output: Annotated[Path | None, ending(*_ENDINGS), Option("OUT", ("-o", "--output"))] = None
    seconds: Annotated[Duration | None, Option("S", ("--duration", "--seconds"))] = None
    begin: Annotated[Time | None, Option("S", ("--from",))] = None
    end: Annotated[Duration | None, Option("S", ("--to",))] = None
    fps: Rate = 30.0
    name: Annotated[str, Option("TEXT")] = ""
    quiet: bool = False

    @model_validator(mode="after")
    def _check_output(self) -> Self:
        if (self.file is None) == (self.output is None):
            raise ValueError("-o OUT: expected one file to write, .html, .glb or .xml")
        if self.end is not None:
            if self.seconds is not None:
                raise ValueError("--to and --seconds say the same; give one of them")
            if self.end <= (self.begin or 0.0):
                raise ValueError(f"--to: found {self.end:g}; expected more than --from, s")
        if self.path.suffix.lower() == ".xml":
            self.refuse(_OfRuns, f" is for pages and animations; {self.path} is MJCF")
        if self.path.suffix.lower() != ".html":
            self.refuse(("follow",), f" is for cameras; {self.path} has none")
        return self

    @property
    def path(self) -> Path:
        """The file to write."""
        path = self.output or self.file
        assert path is not None
        return path

    @property
    def length(self) -> float | None:
        """How long, s; None for to the end."""
        return self.seconds if self.end is None else self.end - (self.begin or 0.0)


def run(options: ExportOptions) -> int:
    """Writes; returns 0."""
    path = options.path
    if path.suffix.lower() == ".xml":
        return _write_mjcf(options, path)
    from ..study.run_marks import marks_of
    from ..viewer.player.capture import capture
    from ..viewer.player.page import write_page
    from .opening import with_scene

    options = with_scene(options)
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
    if path.suffix.lower() == ".glb":
        from ..viewer.player.gltf import write_glb

        write_glb(found, path)
    else:
        found.marks = marks_of(scene, found.begin)
        write_page(found, path, options.name)
    if not options.quiet:
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
    return 0


add_to = command("export", run, ExportOptions, _EPILOG)


def _write_mjcf(options: ExportOptions, path: Path) -> int:
    from ..robots.assemble.world import World

    world = World(read_scene(options.scene))
    with writing():
        written = world.export(path)
    print(f"{written[0]} and {len(written) - 1} mesh files")
    return 0
