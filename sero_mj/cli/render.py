"""`sero-mj render`: a picture or a film without a window."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import UsageError
from ._arguments import (
    DEFAULT_SIZE,
    Commands,
    add_command,
    add_over_options,
    add_picture_options,
    add_scene_options,
    add_stereo_options,
    check_over_options,
    check_stereo_options,
    not_negative,
    offset_of_video,
    positive,
    read_shown_scene,
)

if TYPE_CHECKING:
    from ..robots.assemble.scene import Scene

_EPILOG = """\
examples:
  sero-mj render lwr_udp -o lwr.png                   wait for the robot, take a picture
  sero-mj render lwr_udp -o lwr.mp4 --duration 10     film it for 10 s of real time
  sero-mj render lwr -o pose.png --set lwr.joint_angles=0,0.5,0,-1.5,0,1,0 \\
      --set lwr.torques=10,-80,5,30,0,-2,1 --set lwr.show_arrows=true
  sero-mj render lwr_udp -o lwr.gif --size 480x320    small enough for a page of text
  sero-mj render lwr_udp -o top.png --camera 90,-80,2.5 --size 640x480
  sero-mj render lwr_udp -o lwr.png --stereo anaglyph  for red-cyan glasses
  sero-mj render lwr_udp -o run.mp4 --replay run.mcap --duration 10
  sero-mj render lwr -o joint.png --click 640,400     as if one clicked there in a window
  sero-mj render lwr_udp -o now.png --over photo.jpg --camera-file cell.yaml
  sero-mj render lwr_udp -o run.mp4 --over video.mp4 --camera-file cell.yaml \\
      --replay run.mcap                               when it begins is found from the motion

--set takes any field of a robot (sero-mj list --fields shows them), as TOML. An input that is set
is not received. A film of live sources shows real time, however long rendering takes.

--over draws arrows, billboards and doubles over a photo or video of the real robot, whose model
only hides what is behind it. The camera file is OpenCV's or ROS's YAML, or TOML, with `frame`:
where the camera stands in the world (x to the right of the picture, y down, z forward). sero-mj
calibrate finds it. Needs `pip install 'sero-mj[camera]'`.
"""

_OF_OTHERS = "the picture is as large as the photo or video, seen by its camera"
ORDER = 13  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "render", run, "render a scene to a picture or a film, without a window", _EPILOG
    )
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        type=Path,
        metavar="OUT",
        help="a picture: .png, .jpg, .webp; or a film: .mp4, .webm, .gif",
    )
    add_picture_options(parser)
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="length of a film in s (default 5)"
    )
    parser.add_argument(
        "--fps", type=positive, metavar="N", help="frames per second (default 30; of a GIF 20)"
    )
    add_stereo_options(parser)
    add_scene_options(parser)
    parser.add_argument(
        "--click",
        action="append",
        default=[],
        type=_click,
        dest="clicks",
        metavar="X,Y[,HOW]",
        help="click on a pixel, counted from the upper left, before rendering; HOW is shift, "
        "double, hover or touch (as with a finger); may be repeated",
    )
    parser.add_argument(
        "--show",
        action="append",
        default=[],
        type=_switch,
        dest="shown",
        metavar="NAME=0|1",
        help="switch arrows, billboards, axes, legend, ... on or off: a digit for all of them, or "
        "one for each joint, frame, ...; may be repeated",
    )
    parser.add_argument(
        "--select", metavar="ROBOT/JOINT", help="light a joint, as one that was clicked on is"
    )
    parser.add_argument(
        "--at", type=not_negative, metavar="S", help="time of a simulation's or recording's picture"
    )
    parser.add_argument(
        "--wait",
        type=not_negative,
        default=2.0,
        metavar="S",
        help="how long to wait for the first packet (default 2)",
    )
    add_over_options(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no closing line")


def _click(text: str) -> tuple[float, float, str, bool]:
    x, y, *how = [*text.split(","), ""][: max(text.count(",") + 1, 2)]
    gestures = [word for word in how if word in ("shift", "double", "hover")]
    try:
        if len(gestures) <= 1 and set(how) <= {*gestures, "touch"}:
            return float(x), float(y), gestures[0] if gestures else "click", "touch" in how
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(
        f"found '{text}'; expected X,Y in pixels, or X,Y and shift, double, hover or touch"
    )


def _switch(text: str) -> tuple[str, str]:
    name, equals, digits = text.partition("=")
    if equals and digits.isdecimal():
        return name, digits
    raise argparse.ArgumentTypeError(f"found '{text}'; expected NAME=0 or NAME=1, arrows=1 say")


def run(options: argparse.Namespace) -> int:
    """Renders; returns 0."""
    from ..viewer.headless.film import FILMS

    output: Path = options.output
    is_film = check_picture_or_film("-o", output)
    if not is_film and (options.duration or options.fps):
        raise UsageError(f"-o {output}: --duration and --fps are for films ({', '.join(FILMS)})")
    if is_film and options.at is not None:
        raise UsageError(f"-o {output}: --at is for pictures; a film begins at the start")
    if options.clicks:  # what was hit is worth a line
        logging.getLogger("sero_mj.viewer.headless.render").setLevel(logging.INFO)
    check_stereo_options(options)
    check_over_options(options)
    if options.over is not None:
        return _run_over(options, is_film=is_film)
    scene = read_shown_scene(options)
    if is_film:
        silent = film_with_progress(
            scene,
            output,
            quiet=options.quiet,
            duration=options.duration or 5.0,
            fps=options.fps,
            size=options.size,
            camera=options.camera,
            wait=options.wait,
            clicks=options.clicks,
            shown=dict(options.shown),
            selected=options.select,
            quality=options.quality,
            stereo=options.stereo,
            eye_distance=options.eye_distance,
        )
    else:
        from ..viewer.headless.render import render_picture

        silent = render_picture(
            scene,
            output,
            size=options.size,
            camera=options.camera,
            wait=options.wait,
            clicks=options.clicks,
            shown=dict(options.shown),
            selected=options.select,
            at=options.at or 0.0,
            quality=options.quality,
            stereo=options.stereo,
            eye_distance=options.eye_distance,
        )
    return _told(options, silent)


def _told(options: argparse.Namespace, silent: list[str]) -> int:
    for name in silent:
        print(
            f"sero-mj: no good packet for source '{name}' within {options.wait:g} s; "
            "its robots are shown as the scene declares them",
            file=sys.stderr,
        )
    if not options.quiet:
        print(options.output)
    return 0


def _run_over(options: argparse.Namespace, *, is_film: bool) -> int:
    """Renders over a photo or a video."""
    from ..viewer.headless.over import render_film_over, render_picture_over
    from ..viewer.photo.footage import is_photo

    over: Path = options.over
    of_photo = is_photo(over)
    if of_photo and is_film:
        raise UsageError(f"-o {options.output}: a photo gives a picture, .png say; found a film")
    for name, given in (
        ("camera", options.camera), ("stereo", options.stereo),
        ("size", options.size if options.size != DEFAULT_SIZE else None),
        ("fps", options.fps),
    ):  # fmt: skip
        if given is not None:
            raise UsageError(f"--{name} does not go with --over: {_OF_OTHERS}")
    if of_photo and options.offset is not None:
        raise UsageError("--offset is for videos; --start says when of a recording a photo is")
    if not of_photo and options.start is not None:
        raise UsageError("--start does not go with a video; --offset says when it begins")
    if not of_photo and options.replay is not None:
        options.start = 0.0  # times are those of the recording
    scene = read_shown_scene(options)
    if not of_photo:
        if options.offset is not None and not scene.sources:
            raise UsageError("--offset is for recordings and scenarios; the scene has no sources")
        if options.offset in (None, "auto") and scene.sources:
            options.offset = offset_of_video(scene, over, options.camera_file, quiet=options.quiet)
    if not is_film:
        silent = render_picture_over(
            scene,
            over,
            options.camera_file,
            options.output,
            wait=options.wait,
            at=options.at,
            offset=options.offset or 0.0,
            shown=dict(options.shown),
            selected=options.select,
            clicks=options.clicks,
            quality=options.quality,
        )
        return _told(options, silent)
    silent = film_with_progress(
        scene,
        options.output,
        quiet=options.quiet,
        render=render_film_over,
        over=over,
        camera_file=options.camera_file,
        offset=options.offset or 0.0,
        duration=options.duration,
        shown=dict(options.shown),
        selected=options.select,
        clicks=options.clicks,
        quality=options.quality,
    )
    return _told(options, silent)


def check_picture_or_film(option: str, path: Path) -> bool:
    """Whether a name is a film's; raises UsageError where it is no picture's either."""
    from ..viewer.headless.film import FILMS, PICTURES

    suffix = path.suffix.lower()
    if suffix not in (*FILMS, *PICTURES):
        pictures, films = ", ".join(PICTURES), ", ".join(FILMS)
        raise UsageError(
            f"{option} {path}: expected a name that ends in {pictures} for a picture, or in "
            f"{films} for a film"
        )
    return suffix in FILMS


def film_with_progress(
    scene: Scene,
    output: Path,
    *,
    quiet: bool = False,
    render: Callable[..., list[str]] | None = None,
    **options: Any,
) -> list[str]:
    """Calls `render_film` or another with a progress bar, unless `quiet`.

    Returns:
        the silent sources.
    """
    from rich import progress as bars
    from rich.console import Console

    from ..viewer.headless.render import render_film

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeRemainingColumn(),
    )
    progress = bars.Progress(*columns, console=Console(stderr=True), disable=quiet)
    task = progress.add_task("rendering", total=None)

    def update(done: int, total: int) -> None:
        progress.start()  # only now: an error before the first frame leaves no empty bar
        progress.update(task, completed=done, total=total)

    try:
        return (render or render_film)(scene, output, on_progress=update, **options)
    except KeyboardInterrupt:
        done = int(progress.tasks[task].completed)
        if done:
            print(f"sero-mj: {output} holds the {done} frames so far", file=sys.stderr)
        raise
    finally:
        if progress.live.is_started:
            progress.stop()
