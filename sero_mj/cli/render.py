"""`sero-mj render`: a picture or a film without a window."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import model_validator

from ..base.options import Option, Time, ending
from ..viewer.image.image_options import IMAGE_ENDINGS, PASS_ENDINGS, VIDEO_FORMATS, VideoOptions
from .arguments import command, progress_bar
from .shared_options import EyeOptions, OverOptions, SceneArgument, ShownOptions

if TYPE_CHECKING:
    from ..robots.declared.scene import Scene

_HELP = """\
examples:
  sero-mj render lwr_udp -o lwr.png                     an image, once the robot has sent data
  sero-mj render lwr_udp -o run.mp4 --replay run.mcap   a video of a recording
  sero-mj render lwr -o pose.png --camera 90,-80,2.5 --set lwr.torques=10,-80,5,30,0,-2,1

--set takes any field of a robot (sero-mj list --fields shows them), as TOML. An input that is set
is not received. A film of live sources shows real time, however long rendering takes.

--over draws arrows, billboards and doubles over a photo or video of the real robot, whose model
only hides what is behind it. The camera file is OpenCV's or ROS's YAML, or TOML, with `frame`:
where the camera stands in the world (x to the right of the picture, y down, z forward). sero-mj
calibrate finds it. Needs `pip install 'sero-mj[camera]'`.
"""

_OF_OTHERS = "the picture is as large as the photo or video, seen by its camera"
_KINDS = f"{', '.join(IMAGE_ENDINGS)} for a picture, or in {', '.join(VIDEO_FORMATS)} for a film"
PictureOrFilm = Annotated[Path, ending(*IMAGE_ENDINGS, *VIDEO_FORMATS, expected=_KINDS)]
_AnyPicture = Annotated[Path, ending(*IMAGE_ENDINGS, *VIDEO_FORMATS, ".npy", expected=_KINDS)]
GROUP, ORDER = "see", 12


class RenderOptions(SceneArgument, VideoOptions, EyeOptions, ShownOptions, OverOptions):
    """Render a scene to a picture or a film, without a window.

    Attributes:
        output: a picture: .png, .jpg, .webp; or a film: .mp4, .webm, .gif; of --pass, .png or .npy.
        at: time of a simulation's or recording's picture, s.
        quiet: no progress bar, no closing line.
    """

    output: Annotated[_AnyPicture, Option("OUT", ("-o", "--output"))]
    at: Time | None = None
    quiet: bool = False

    @property
    def is_film(self) -> bool:
        """Whether it is a film."""
        return self.output.suffix.lower() in VIDEO_FORMATS

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if not self.is_film and self.set_among("duration", "fps"):
            films = ", ".join(VIDEO_FORMATS)
            raise ValueError(f"-o {self.output}: --duration and --fps are for films ({films})")
        if not self.is_film and (moves := self.set_among("orbit", "camera_path")):
            raise ValueError(
                f"-o {self.output}: {moves[0]} is for films ({', '.join(VIDEO_FORMATS)})"
            )
        self._check_pass()
        if self.is_film and self.at is not None:
            raise ValueError(f"-o {self.output}: --at is for pictures; a film begins at the start")
        if self.over is not None:
            names = ("camera", "follow", "orbit", "camera_path", "stereo", "size", "fps")
            self.refuse(names, f" does not go with --over: {_OF_OTHERS}")
        return self

    def _check_pass(self) -> None:
        ends = self.output.suffix.lower()
        if self.render_pass == "colour":
            if ends not in (*IMAGE_ENDINGS, *VIDEO_FORMATS):
                expected = f"expected a name that ends in {_KINDS}"
                raise ValueError(f"-o {self.output}: '{ends}' is for --pass; {expected}")
            return
        what = f"--pass {self.render_pass}"
        if ends not in PASS_ENDINGS:
            expected = f"expected a name that ends in {' or '.join(PASS_ENDINGS)}"
            raise ValueError(f"-o {self.output}: {what} needs exact numbers; {expected}")
        if self.over is not None:
            raise ValueError(f"{what} is for pictures of a scene alone; leave out --over")
        self.refuse(("stereo",), f" does not go with {what}, which has one eye")


def run(options: RenderOptions) -> int:
    """Renders; returns 0."""
    from .opening import with_scene

    options = with_scene(options)
    if options.clicks:  # what was hit is worth a line
        logging.getLogger("sero_mj.viewer.image.painter").setLevel(logging.INFO)
    if options.over is not None:
        from .shared_options import find_background

        silent = find_background().render(options, Path(options.over))
    elif options.is_film:
        scene = options.read(options.scene)
        silent = video_with_progress(scene, options.output, options, quiet=options.quiet)
    else:
        from ..viewer.image.render import render_image

        scene = options.read(options.scene)
        silent = render_image(scene, options.output, options, at=options.at or 0.0)
    for name in silent:
        print(
            f"sero-mj: no good packet for source '{name}' within {options.wait:g} s; "
            "its robots are shown as the scene declares them",
            file=sys.stderr,
        )
    if not options.quiet:
        print(options.output)
    return 0


add_to = command("render", run, RenderOptions, _HELP)


def video_with_progress(
    scene: Scene,
    output: Path,
    options: VideoOptions,
    *,
    quiet: bool = False,
    make: Callable[..., list[str]] | None = None,
) -> list[str]:
    """Makes a film with a progress bar, unless `quiet`; returns the silent sources."""
    from ..viewer.image.render import render_video

    frames = 0

    def update(done: int, total: int) -> None:
        nonlocal frames
        frames = done
        show(done, total)

    try:
        with progress_bar("rendering", quiet=quiet, stays=True) as show:
            return (make or render_video)(scene, output, options, on_progress=update)
    except KeyboardInterrupt:
        if frames:
            print(f"sero-mj: {output} holds the {frames} frames so far", file=sys.stderr)
        raise
