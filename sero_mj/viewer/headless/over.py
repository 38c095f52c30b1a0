"""Pictures and films of decor over photos and videos of the real robot."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco

from ...base.errors import RenderError, UsageError
from ...data.drive.mirror import Mirror
from ...robots.assemble.scene import Scene
from ...robots.assemble.world_view import WorldView
from ..decor.font import line_height
from ..photo.camera_file import read_camera
from ..photo.footage import Pixels, Video, at_rate, is_photo, read_frame, read_photo
from ..photo.over_photo import PhotoPainter
from ..photo.photo_camera import PhotoCamera
from ..session.interaction import Gesture
from ..session.picking import Picked
from ..session.scene_decor import SceneDecor
from ..session.view_state import apply_switches
from ..typesetting import Typesetter, compose
from .film import FILMS, FilmWriter, check_writable, default_fps, save_picture
from .render import (
    MAX_SIDE,
    NEXT_WITHIN,
    PRINT_DPI,
    QUALITIES,
    SUPERSAMPLING,
    Click,
    OnProgress,
    Quality,
    make_renderer,
    perform_clicks,
)

log = logging.getLogger(__name__)


class PhotoRenderer:
    """Renders the decor of a world over photos of one camera; a context manager.

    Args:
        world: what is in the photos.
        camera: of the photos.
        quality: see `HeadlessRenderer`.

    Attributes:
        decor: of the last photo.

    Raises:
        RenderError: no OpenGL, or the photos are too large.
    """

    def __init__(self, world: WorldView, camera: PhotoCamera, quality: Quality = "normal") -> None:
        if quality not in QUALITIES:
            raise RenderError(f"found quality {quality!r}; expected {', '.join(QUALITIES)}")
        scale = SUPERSAMPLING if quality == "fine" else 1
        self._painter = PhotoPainter(world, camera, (MAX_SIDE // 2, MAX_SIDE // 2), scale)
        self._renderer = make_renderer(world, *self._painter.size, is_draft=quality == "draft")
        self._typesetter = Typesetter(line_height(world, camera.width, camera.height))
        self.decor = SceneDecor(world, with_text=False)

    def render(self, data: mujoco.MjData, photo: Pixels) -> Pixels:
        """Returns a photo with decor over it.

        Args:
            data: the world's state, with frames up to date.
            photo: (height, width, 3), uint8, of the camera's size.
        """
        renderer, painter = self._renderer, self._painter
        renderer.update_scene(data)
        view = painter.look(renderer.scene, self._typesetter.font)
        self.decor.draw(data, view, renderer.scene)
        pixels = painter.over(photo, renderer.scene, renderer.render)
        compose(pixels, self._typesetter.place(self.decor.panels))
        return pixels

    def click(
        self,
        data: mujoco.MjData,
        x: float,
        y: float,
        gesture: Gesture = "click",
        tolerance: float = 0.0,
    ) -> Picked | None:
        """Clicks on a pixel of the photo, see `HeadlessRenderer.click`."""
        decor = self._lay_out(data)
        return decor.click(data, decor.from_above(x, y), gesture, tolerance)

    def hover(self, data: mujoco.MjData, x: float, y: float) -> Picked | None:
        """Moves the pointer to a pixel of the photo, see `HeadlessRenderer.hover`."""
        decor = self._lay_out(data)
        return decor.hover(data, decor.from_above(x, y))

    def _lay_out(self, data: mujoco.MjData) -> SceneDecor:
        scene = self._renderer.scene
        self._renderer.update_scene(data)
        self.decor.lay_out(data, self._painter.look(scene, self._typesetter.font))
        return self.decor

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> PhotoRenderer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def render_picture_over(
    scene: Scene,
    photo: Path,
    camera_file: Path,
    path: Path,
    *,
    wait: float = 2.0,
    at: float | None = None,
    offset: float = 0.0,
    shown: Mapping[str, str] | None = None,
    selected: str | None = None,
    clicks: Sequence[Click] = (),
    quality: Quality = "normal",
) -> list[str]:
    """Renders the current state of a scene over a photo, or over a frame of a video.

    Args:
        scene: what to show.
        photo: the file, or a video, of which the frame of that time is taken.
        camera_file: see `camera_file`.
        path: of the picture; .png, or another format of Pillow.
        wait: maximum time to wait for the first packet of every source, s.
        at: time of recordings and simulations, s after their start; None for the start, or for the
            first frame of a video.
        offset: time of these at the first frame of a video.
        shown: switches to set, see `view_state.apply_switches`.
        selected: the joint to be lit.
        clicks: clicks to perform before rendering.
        quality: see `HeadlessRenderer`.

    Returns:
        names of the sources without data; their robots have the declared pose.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or a file.
    """
    if is_photo(photo):
        pixels, now = read_photo(photo), at or 0.0
    else:
        now = offset if at is None else at
        pixels = read_frame(photo, now - offset)
    camera = read_camera(camera_file, (pixels.shape[1], pixels.shape[0]))
    with Mirror(scene) as mirror:
        if not is_photo(photo):
            refuse_live(mirror, photo)
        check_writable(path)
        with PhotoRenderer(mirror.world, camera, quality) as renderer:
            silent = mirror.wait(wait)
            mirror.wait_fresh(min(wait, NEXT_WITHIN), now)
            apply_switches(mirror.world, renderer.decor.toggles, shown or {}, selected)
            perform_clicks(renderer, mirror.data, clicks)
            dpi = PRINT_DPI if quality == "fine" else None
            save_picture(path, renderer.render(mirror.data, pixels), dpi)
    return silent


def render_film_over(
    scene: Scene,
    path: Path,
    *,
    over: Path,
    camera_file: Path,
    offset: float = 0.0,
    duration: float | None = None,
    shown: Mapping[str, str] | None = None,
    selected: str | None = None,
    clicks: Sequence[Click] = (),
    quality: Quality = "normal",
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Renders a recording or a simulation over a video, frame by frame.

    Frames of before it began or after it ended are left as they are.

    Args:
        scene: what to show; its sources are recordings or simulated.
        path: of the film; .mp4, .webm or .gif.
        over: the video.
        camera_file: see `camera_file`.
        offset: time of the recording, s since it began, at the first frame of the video; see
            `video_offset.find_offset`.
        duration: of the film, s; None for the video's.
        shown: switches to set, see `view_state.apply_switches`.
        selected: the joint to be lit.
        clicks: clicks to perform before the first frame that shows data.
        quality: see `HeadlessRenderer`.
        on_progress: called with the number of rendered frames and of all frames.

    Returns:
        names of the sources without data.

    Raises:
        SeroError: a problem of the scene, its sources, the camera or a file.
    """
    with Video(over) as video, Mirror(scene) as mirror:
        camera = read_camera(camera_file, video.size)
        refuse_live(mirror, over)
        begin, end = recorded_span(mirror)
        length = video.duration if duration is None else min(duration, video.duration or duration)
        fps = min(video.fps, FILMS[path.suffix.lower()].most_fps)
        if path.suffix.lower() == ".gif":
            fps = min(fps, default_fps(path))
        count = max(round(length * fps), 1)
        width, height = video.size
        with (
            FilmWriter(path, width, height, fps) as film,
            PhotoRenderer(mirror.world, camera, quality) as renderer,
        ):
            silent = mirror.wait(0.0)
            apply_switches(mirror.world, renderer.decor.toggles, shown or {}, selected)
            plain = 0
            for time, pixels in at_rate(video, fps, duration):
                now = time + offset
                if begin <= now <= end:
                    mirror.advance(now)
                    perform_clicks(renderer, mirror.data, clicks)
                    clicks = ()
                    film.add(renderer.render(mirror.data, pixels))
                else:
                    plain += 1
                    film.add(pixels)
                if on_progress is not None:
                    on_progress(film.frames, max(count, film.frames))
        if plain:
            span = f"from {begin - offset:.2f} to {end - offset:.2f} s of the video"
            log.warning(
                "%d of %d frames are as they were: there are data %s", plain, film.frames, span
            )
    return silent


def refuse_live(mirror: Mirror, video: Path) -> None:
    """Raises UsageError where a video is to show what comes now."""
    if mirror.is_live:
        raise UsageError(
            f"{video}: live sources do not go with a video; expected a recording, --replay "
            "REC.mcap, or a photo"
        )


def recorded_span(mirror: Mirror) -> tuple[float, float]:
    """When the recordings or simulations of a mirror begin and end, s."""
    if not mirror.sources:
        return float("-inf"), float("inf")
    ends = [source.end for source in mirror.sources.values()]
    return 0.0, max(float("inf") if end is None else end for end in ends)
