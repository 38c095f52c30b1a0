"""Options of images and videos for Python and commands, and file name extensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ...base.declaration import expecting
from ...base.options import Duration, Option, Options, Positive, Size, Time

Quality = Literal["draft", "normal", "fine"]
Stereo = Literal["side-by-side", "anaglyph"]
DEFAULT_SIZE = (1280, 800)
EYE_DISTANCE = 0.065  # average eye distance of adults, m
_GESTURES = ("shift", "double", "hover")


def _click(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    x, y, *how = value.split(",")
    gestures = [word for word in how if word in _GESTURES]
    if len(gestures) > 1 or not {*how} <= {*gestures, "touch"}:
        raise ValueError(how)
    return float(x), float(y), gestures[0] if gestures else "click", "touch" in how


def _switches(value: Any) -> Any:
    if not isinstance(value, list):
        return {} if value is None else value
    parts = [text.partition("=") for text in value]
    for text, (_, equals, digits) in zip(value, parts, strict=True):
        if not (equals and digits.isdecimal()):
            raise ValueError(f"found '{text}'; expected NAME=0 or NAME=1, for example arrows=1")
    return {name: digits for name, _, digits in parts}


Degrees = Annotated[
    float, Field(allow_inf_nan=False, ge=-36_000, le=36_000), expecting("degrees, up to 36000")
]
Pass = Literal["colour", "segmentation", "depth"]
Rate = Annotated[Positive, Option("N")]
# Pixel (x, y) counted from the upper left corner, gesture, and whether it is a touch.
Click = tuple[float, float, str, bool]
Switches = Annotated[dict[str, str], BeforeValidator(_switches)]
_GivenClick = Annotated[
    Click,
    BeforeValidator(_click),
    expecting("X,Y in pixels, or X,Y followed by ,shift ,double ,hover or ,touch"),
]


class SizeOptions(Options):
    """Size and quality of images.

    Attributes:
        size: width and height in pixels.
        quality: draft has no shadows and no anti-aliasing, which is much faster with software
            OpenGL; fine is for print at 300 dots per inch, and adds motion blur to videos.
        renderer: classic (OpenGL), or a renderer listed by `sero-mj check` (default: for --quality
            fine, a renderer with soft shadows if one is available; otherwise classic).
    """

    size: Size = DEFAULT_SIZE
    quality: Quality = "normal"
    renderer: Annotated[str | None, Option("NAME")] = None


class StereoOptions(Options):
    """Images for two eyes.

    Attributes:
        stereo: side-by-side has half of the image for each eye; anaglyph is for red-cyan glasses.
        eye_distance: distance between the eyes in m; larger values exaggerate depth.
    """

    stereo: Stereo | None = None
    eye_distance: Annotated[Positive, Option("M")] = EYE_DISTANCE


class CameraOptions(Options):
    """The camera of images.

    Attributes:
        camera: name of a camera, or azimuth,elevation,distance in degrees and m.
        follow: move the free camera with the base of a robot or group, or with a frame such as
            lwr/flange.
    """

    camera: Annotated[str | None, Option("CAM")] = None
    follow: Annotated[str | None, Option("NAME")] = None


class MotionOptions(Options):
    """Motion of the camera in a video.

    Attributes:
        orbit: rotate the camera about its look-at point by this angle in degrees over the whole
            video.
        camera_path: move the camera through the key frames of a TOML file: tables [[keys]] with
            time and azimuth_deg, elevation_deg, distance or look_at.
    """

    orbit: Annotated[Degrees | None, Option("DEG")] = None
    camera_path: Annotated[Path | None, Option("KEYS.toml")] = None


class ImageOptions(SizeOptions, StereoOptions, CameraOptions):
    """Options of an image of a scene; the fields are keyword arguments of `render_image`.

    Attributes:
        clicks: click on a pixel, counted from the upper left corner, before rendering; HOW is
            shift, double, hover or touch (with a finger); may be repeated.
        shown: switch arrows, billboards, axes, legend, inertias or another feature on or off, with
            one digit for all items or one digit for each joint, frame or arrow; may be repeated.
        render_pass: write the link or object at each pixel, or the depth of each pixel, to a .png
            or .npy file instead of the image.
        selected: highlight a joint as if it were clicked.
        wait: maximum time to wait for the first packet of each source, in seconds.
    """

    clicks: Annotated[list[_GivenClick], Option("X,Y[,HOW]", ("--click",))] = []
    shown: Annotated[Switches, Option("NAME=0|1", ("--show",))] = {}
    selected: Annotated[str | None, Option("ROBOT/JOINT", ("--select",))] = None
    render_pass: Annotated[Pass, Option(flags=("--pass",))] = "colour"
    wait: Time = 2.0


class VideoOptions(ImageOptions, MotionOptions):
    """Options of a video of a scene; the fields are keyword arguments of `render_video`.

    Attributes:
        duration: length of the video in seconds.
        fps: frames per second (default: 30, or 20 for a GIF).
    """

    duration: Duration = 5.0
    fps: Rate | None = None


@dataclass(frozen=True)
class VideoFormat:
    """The encoding of video files with the same file name extension.

    Attributes:
        codec: name of the codec in FFmpeg.
        options: options of the codec, with which encoding is fast compared to rendering.
        has_palette: whether frames are limited to 256 colors.
        fps: default number of frames per second.
        max_fps: maximum number of frames per second that players support.
    """

    codec: str
    options: Mapping[str, str]
    has_palette: bool = False
    fps: float = 30.0
    max_fps: float = float("inf")


_VP9 = {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "5", "row-mt": "1"}
VIDEO_FORMATS = {
    ".mp4": VideoFormat("libx264", {"crf": "18", "preset": "veryfast"}),
    ".webm": VideoFormat("libvpx-vp9", _VP9),
    ".gif": VideoFormat("gif", {}, has_palette=True, fps=20.0, max_fps=50.0),
}
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp")
PASS_ENDINGS = (".png", ".npy")
