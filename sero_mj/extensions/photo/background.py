"""`Photos`: the option `--over` of `render` and `view` for photos, videos and cameras."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ...base.errors import UsageError
from ...base.options import Options
from ...cli.render import RenderOptions, video_with_progress
from ...cli.shared_options import Background
from ...cli.terminal import make_console
from .camera_feed import CameraFeed, VideoFeed
from .camera_file import read_camera
from .footage import Video, is_photo
from .over import render_image_over, render_video_over
from .video_offset import find_offset

if TYPE_CHECKING:
    from ...cli.shared_options import OverOptions
    from ...data.drive.mirror import Mirror
    from ...robots.declared.scene import Scene
    from ...viewer.window.viewport import Viewport


class Photos(Background):
    """The backgrounds that `--over` accepts: photos and videos in files, and live cameras."""

    def render(self, options: Options, over: Path) -> list[str]:
        assert isinstance(options, RenderOptions)
        assert options.camera_file is not None
        if is_photo(over):
            if options.is_video:
                expected = "expected an image file such as .png, because --over is a photo"
                raise UsageError(f"-o {options.output}: {expected}")
            options.refuse(
                ("offset",), " is for videos; use --start for the time of a photo in a recording"
            )
            scene, offset = options.read(options.scene), 0.0
        else:
            options.refuse(("start",), " is for photos; use --offset for the start of a video")
            scene = options.from_its_begin().read(options.scene)
            if options.offset is not None and not scene.sources:
                raise UsageError(
                    "--offset is for recordings and scenarios; the scene has no sources"
                )
            offset = offset_of_video(
                scene, over, options.camera_file, options.offset, options.quiet
            )
        if not options.is_video:
            return render_image_over(
                scene, options.output, options, over=over, camera_file=options.camera_file,
                at=options.at, offset=offset,
            )  # fmt: skip
        make_video = partial(
            render_video_over, over=over, camera_file=options.camera_file, offset=offset,
            duration=options.duration if options.set_among("duration") else None,
        )  # fmt: skip
        return video_with_progress(
            scene, options.output, options, quiet=options.quiet, make=make_video
        )

    @contextlib.contextmanager
    def viewport(self, mirror: Mirror, options: OverOptions) -> Iterator[Callable[..., Viewport]]:
        from .photo_viewport import PhotoViewport

        with contextlib.closing(open_feed(mirror, options)) as feed:
            yield partial(PhotoViewport, feed=feed)


def open_feed(mirror: Mirror, options: OverOptions) -> CameraFeed | VideoFeed:
    """Returns the camera or video over which the scene is drawn."""
    assert options.over is not None and options.camera_file is not None
    sources, scene = mirror.sources.values(), mirror.world.scene
    file = Path(options.over)
    if not file.is_file() or not sources or any(source.is_live for source in sources):
        if options.offset is not None:
            raise UsageError(
                "--offset needs a video file as --over, and a scene that is a recording or scenario"
            )
        return CameraFeed(options.over, options.camera_file)
    offset = offset_of_video(scene, file, options.camera_file, options.offset)
    return VideoFeed(file, options.camera_file, offset)


def offset_of_video(
    scene: Scene,
    video: Path,
    camera_file: Path,
    offset: float | Literal["auto"] | None = None,
    quiet: bool = False,
) -> float:
    """Returns the time of a recording or scenario in seconds at which a video starts.

    If `offset` is not a number, the time is estimated from the motion in video and recording.
    """
    if isinstance(offset, float) or not scene.sources:
        return float(offset or 0.0)
    with Video(video) as opened:
        camera = read_camera(camera_file, opened.size)
    with contextlib.ExitStack() as stack:
        if not quiet:
            console = make_console(stderr=True)
            stack.enter_context(console.status("comparing the motion of video and recording"))
        found = find_offset(scene, video, camera)
    if not quiet:
        print(found, flush=True)
    return found.offset
