"""`sero-mj render`: renders an image or a video without a window."""

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

--set overrides any field of a robot (sero-mj list --fields), as TOML. An input that is set this way
is no longer received. A video of live sources shows real time, even if rendering is slower.

--over draws arrows, billboards and doubles over a photo or video of the real robot. The model of
the robot is not drawn; it only hides what is behind it. The camera file is OpenCV or ROS YAML, or
TOML. Its `frame` is the pose of the camera in the world (x right in the photo, y down, z forward),
which `sero-mj calibrate` estimates. Requires `pip install 'sero-mj[camera]'`.
"""

_KINDS = f"{', '.join(IMAGE_ENDINGS)} for an image, or {', '.join(VIDEO_FORMATS)} for a video"
ImageOrVideo = Annotated[Path, ending(*IMAGE_ENDINGS, *VIDEO_FORMATS, expected=_KINDS)]
_Output = Annotated[Path, ending(*IMAGE_ENDINGS, *VIDEO_FORMATS, ".npy", expected=_KINDS)]
GROUP, ORDER = "see", 12


class RenderOptions(SceneArgument, VideoOptions, EyeOptions, ShownOptions, OverOptions):
    """Render an image or a video of a scene without a window.

    Attributes:
        output: image file (.png, .jpg, .webp; with --pass: .png, .npy) or video file (.mp4, .webm,
            .gif).
        at: time of the image in a simulation or recording, in seconds (default: 0).
        quiet: print nothing.
    """

    output: Annotated[_Output, Option("OUT", ("-o", "--output"))]
    at: Time | None = None
    quiet: bool = False

    @property
    def is_video(self) -> bool:
        return self.output.suffix.lower() in VIDEO_FORMATS

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        of_video = self.set_among("duration", "fps", "orbit", "camera_path")
        if of_video and not self.is_video:
            expected = f"{of_video[0]} needs a video ({', '.join(VIDEO_FORMATS)})"
            raise ValueError(f"-o {self.output}: {expected}")
        self._check_pass()
        if self.is_video and self.at is not None:
            raise ValueError(f"-o {self.output}: --at needs an image")
        if self.over is not None:
            names = ("camera", "follow", "orbit", "camera_path", "stereo", "size", "fps")
            why = "the photo or video determines size and camera"
            self.refuse(names, f" cannot be combined with --over: {why}")
        return self

    def _check_pass(self) -> None:
        ends = self.output.suffix.lower()
        if self.render_pass == "colour":
            if ends not in (*IMAGE_ENDINGS, *VIDEO_FORMATS):
                expected = f"expected a name that ends in {_KINDS}"
                raise ValueError(f"-o {self.output}: '{ends}' needs --pass; {expected}")
            return
        what = f"--pass {self.render_pass}"
        if ends not in PASS_ENDINGS:
            expected = f"expected a name that ends in {' or '.join(PASS_ENDINGS)}"
            raise ValueError(f"-o {self.output}: {what} stores exact numbers; {expected}")
        if self.over is not None:
            raise ValueError(f"{what} cannot be combined with --over")
        self.refuse(("stereo",), f" cannot be combined with {what}")


def run(options: RenderOptions) -> int:
    """Renders an image or a video; returns 0."""
    from .opening import with_scene

    options = with_scene(options)
    if options.clicks:  # the log shows the part that each click hits
        logging.getLogger("sero_mj.viewer.image.painter").setLevel(logging.INFO)
    if options.over is not None:
        from .shared_options import find_background

        silent = find_background().render(options, Path(options.over))
    elif options.is_video:
        scene = options.read(options.scene)
        silent = video_with_progress(scene, options.output, options, quiet=options.quiet)
    else:
        from ..viewer.image.render import render_image

        scene = options.read(options.scene)
        silent = render_image(scene, options.output, options, at=options.at or 0.0)
    for name in silent:
        print(
            f"sero-mj: no valid packet from source '{name}' within {options.wait:g} s; "
            "its robots are shown as declared in the scene",
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
    """Renders a video and shows a progress bar; `make` replaces `render_video`.

    Returns the names of the sources from which no valid packet arrived.
    """
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
            print(f"sero-mj: {output} contains the first {frames} frames", file=sys.stderr)
        raise
