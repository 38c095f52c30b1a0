"""Renders arrows, axes and billboards over photos and videos of the real robot."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from ...base.errors import Problem, RenderError, UsageError
from ...data.drive.mirror import Mirror
from ...robots.assemble.world_view import WorldView
from ...robots.declared.scene import Scene
from ...viewer.decor.font import line_height
from ...viewer.decor.image_view import ImageView
from ...viewer.image.held_torques import HeldTorques
from ...viewer.image.image_files import check_video, default_fps
from ...viewer.image.image_options import VIDEO_FORMATS, ImageOptions, Quality
from ...viewer.image.mujoco_private import context_of, lend_shapes
from ...viewer.image.painter import Painter, perform_clicks
from ...viewer.image.render import (
    MAX_SIDE,
    QUALITIES,
    SUPERSAMPLING,
    OnProgress,
    make_renderer,
    render_image,
    write_video,
)
from ...viewer.image.renderer import CLASSIC, SceneRenderer, choose_renderer, renderers
from ...viewer.image.scene_decor import SceneDecor
from ...viewer.image.typesetting import Typesetter, compose
from .camera_file import read_camera
from .footage import Pixels, Video, at_rate, is_photo, read_frame, read_photo
from .over_photo import PhotoPainter
from .photo_camera import PhotoCamera

log = logging.getLogger(__name__)


class PhotoRenderer(Painter):
    """Context manager that renders the visual features of a world over photos of one camera.

    Attributes:
        renderer: name of the renderer in use, such as `classic`.
        photo: photo that `render` uses by default.

    Raises:
        RenderError: OpenGL is not available, or the photos are too large.
    """

    def __init__(
        self,
        world: WorldView,
        camera: PhotoCamera,
        quality: Quality = "normal",
        renderer: str | None = None,
    ) -> None:
        if quality not in QUALITIES:
            raise RenderError(Problem("quality", found=quality, expected=", ".join(QUALITIES)))
        scale = SUPERSAMPLING if quality == "fine" else 1
        self.world, self.size = world, (camera.width, camera.height)
        self.photo: Pixels = np.zeros((camera.height, camera.width, 3), np.uint8)
        self._painter = PhotoPainter(world, camera, (MAX_SIDE // 2, MAX_SIDE // 2), scale)
        size = self._painter.size
        self.renderer = choose_renderer(renderer, quality, *size)
        self._renderer: SceneRenderer
        if self.renderer == CLASSIC:
            classic = self._renderer = make_renderer(world, *size, is_draft=quality == "draft")
            classic.first_shape = lend_shapes(context_of(classic))
        else:
            self._renderer, _ = renderers()[self.renderer].make(world, *size, quality)
        self._typesetter = Typesetter(line_height(world, camera.width, camera.height))
        self.decor = SceneDecor(world, with_text=False)
        self.decor.first_shape = self._renderer.first_shape

    def render(self, data: mujoco.MjData, photo: Pixels | None = None) -> Pixels:
        """Draws visual features over a photo, and returns the image (height, width, 3), uint8."""
        photo = self.photo if photo is None else photo
        scene = self._renderer.scene
        self.decor.draw(data, self._look(data), scene)
        self._renderer.follow(data)
        pixels = self._painter.over(photo, scene, self._renderer.render)
        compose(pixels, self._typesetter.place(self.decor.panels))
        return pixels

    def _look(self, data: mujoco.MjData) -> ImageView:
        self.decor.fill(data, mujoco.MjvCamera(), self._renderer.scene)
        return self._painter.look(self._renderer.scene, self._typesetter.font)


def render_image_over(
    scene: Scene,
    path: Path,
    options: ImageOptions,
    *,
    over: Path,
    camera_file: Path,
    at: float | None = None,
    offset: float = 0.0,
) -> list[str]:
    """Renders the current state of a scene over a photo, or over a frame of a video.

    Args:
        over: photo, or video whose frame at the same time is used.
        camera_file: file with the intrinsics and the pose of the camera.
        at: time since the start of recordings and simulations, s (default: the start, or the time
            of the first frame of a video).
        offset: time of recordings and simulations at the first frame of a video, s.

    Returns:
        names of the sources without data, whose robots are in their declared pose.

    Raises:
        SeroError: the scene, its sources, the camera or a file is invalid.
    """
    is_video = not is_photo(over)
    now = (offset if is_video else 0.0) if at is None else at
    pixels = read_frame(over, now - offset) if is_video else read_photo(over)
    camera = read_camera(camera_file, (pixels.shape[1], pixels.shape[0]))

    def painter(mirror: Mirror, options: ImageOptions) -> PhotoRenderer:
        if is_video:
            refuse_live(mirror, over)
        renderer = PhotoRenderer(mirror.world, camera, options.quality, options.renderer)
        renderer.photo = pixels
        return renderer

    return render_image(scene, path, options, at=now, painter=painter)


def render_video_over(
    scene: Scene,
    path: Path,
    options: ImageOptions,
    *,
    over: Path,
    camera_file: Path,
    offset: float = 0.0,
    duration: float | None = None,
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Renders a recording or a simulation over a video, frame by frame.

    Frames before the start and after the end of the recording are not changed.

    Args:
        over: original video.
        camera_file: file with the intrinsics and the pose of the camera.
        offset: time of the recording at the first frame of the original video, s.
        duration: duration of the rendered video, s (default: the duration of the original video).
        on_progress: function that is called with the numbers of rendered frames and all frames.

    Returns:
        names of the sources without data.

    Raises:
        SeroError: the scene, its sources, the camera or a file is invalid.
    """
    with Video(over) as video, Mirror(scene) as mirror:
        camera = read_camera(camera_file, video.size)
        refuse_live(mirror, over)
        begin, end = recorded_span(mirror)
        length = video.duration if duration is None else min(duration, video.duration or duration)
        fps = min(video.fps, VIDEO_FORMATS[check_video(path).suffix.lower()].max_fps)
        if path.suffix.lower() == ".gif":
            fps = min(fps, default_fps(path))
        with PhotoRenderer(mirror.world, camera, options.quality, options.renderer) as renderer:
            plain = drawn = 0
            held = HeldTorques(mirror, renderer.toggles)

            def frames() -> Iterator[Pixels]:
                nonlocal plain, drawn
                for time, pixels in at_rate(video, fps, duration):
                    if not begin <= time + offset <= end:
                        plain += 1
                        yield pixels
                        continue
                    mirror.advance(time + offset)
                    held.update(mirror.data)
                    if not drawn:
                        perform_clicks(renderer, mirror.data, options.clicks)
                    drawn += 1
                    yield renderer.render(mirror.data, pixels)

            silent = write_video(
                mirror, renderer, path, frames(), fps=fps, count=max(round(length * fps), 1),
                options=options, on_progress=on_progress,
            )  # fmt: skip
        if plain:
            span = f"from {begin - offset:.2f} to {end - offset:.2f} s of the video"
            what = f"{plain} of {plain + drawn} frames were not changed"
            log.warning("%s: data is available %s", what, span)
    return silent


def refuse_live(mirror: Mirror, video: Path) -> None:
    """Raises UsageError if a mirror has live sources, which cannot be combined with a video."""
    if mirror.is_live:
        raise UsageError(
            f"{video}: live sources cannot be combined with a video; use a recording, --replay "
            "REC.mcap, or a photo"
        )


def recorded_span(mirror: Mirror) -> tuple[float, float]:
    """Returns the start and end time in seconds of the recordings or simulations of a mirror."""
    if not mirror.sources:
        return float("-inf"), float("inf")
    ends = [source.end for source in mirror.sources.values()]
    return 0.0, max(float("inf") if end is None else end for end in ends)
