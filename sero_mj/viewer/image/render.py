"""Renders images and videos of a world, or of a scene with live sources, without a window.

A video of a live robot must play in real time, even if software rendering is slower. Therefore, a
thread samples the state at the frame rate of the video, and frames are rendered from these samples.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self, get_args

import mujoco
import numpy as np
from PIL import Image

from ...base.errors import Problem, RenderError, UsageError
from ...base.frames import Array, Ints
from ...data.drive.mirror import Mirror
from ...robots.assemble.solids import geom_corners
from ...robots.assemble.world_view import WorldView
from ...robots.declared.scene import Scene
from ..decor.font import line_height
from ..decor.image_view import ImageView
from .added_surroundings import added_surroundings
from .backend import adopt_backend, backend_problem
from .camera import Follower, find_camera, followed
from .framing import Framing, bounding_sphere, declared_data, stand_back
from .held_torques import HeldTorques
from .image_files import ImageArray, Pixels, VideoWriter, check_writable, default_fps, save_image
from .image_options import (
    DEFAULT_SIZE,
    EYE_DISTANCE,
    ImageOptions,
    Pass,
    Quality,
    Stereo,
    VideoOptions,
)
from .mujoco_private import context_of, lend_shapes
from .painter import Painter, perform_clicks
from .passes import PassRenderer, check_pass_file, save_depth, save_segmentation
from .picking import Pixel
from .renderer import CLASSIC, SceneRenderer, choose_renderer, renderers
from .scene_decor import SceneDecor
from .stereo import anaglyph, check_stereo, each_eye, looked_at
from .switches import apply_switches
from .textures import upload_textures, without_textures
from .typesetting import Typesetter, compose
from .video_frames import SUBFRAMES, Exposure, video_frames

log = logging.getLogger(__name__)

MAX_SIDE = 16384  # maximum width and height in pixels, a limit of the Mesa software renderer
QUALITIES: tuple[str, ...] = get_args(Quality)
SUPERSAMPLING = 2  # rendered pixels per image pixel along each side, for quality `fine`
PRINT_DPI = 300


def check_size(what: str, width: int, height: int) -> None:
    """Raises RenderError if the size of an image or window in pixels is out of range.

    Args:
        what: name of the image or window in the message.
    """
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        expected = f"1 to {MAX_SIDE} pixels per side"
        problem = Problem(f"{what} size", found=(width, height), expected=expected)
        raise RenderError(problem)


@contextmanager
def offscreen_size(
    model: mujoco.MjModel,
    width: int,
    height: int,
    *,
    samples: int | None = None,
    is_draft: bool = False,
) -> Iterator[None]:
    """Sets the offscreen buffer size of the OpenGL contexts that the `with` block creates.

    MuJoCo reads the size from the model, which is changed temporarily.
    """
    size, quality = model.vis.global_, model.vis.quality
    before = size.offwidth, size.offheight, quality.offsamples, quality.shadowsize
    size.offwidth, size.offheight = width, height
    if samples is not None:
        quality.offsamples = samples
    if is_draft:
        quality.offsamples = quality.shadowsize = 0
    try:
        yield
    finally:
        size.offwidth, size.offheight, quality.offsamples, quality.shadowsize = before


class ClassicRenderer(mujoco.Renderer):  # type: ignore[misc]
    """The OpenGL renderer of MuJoCo with the interface of a `SceneRenderer`."""

    first_shape: int | None = None

    def follow(self, data: mujoco.MjData) -> None: ...


class HeadlessRenderer(Painter):
    """A renderer that draws a world into arrays, without a window.

    Args:
        camera: name or pose of the camera, as in `find_camera` (default: the view of the scene).
        quality: `draft` for speed with software OpenGL, `normal`, or `fine` for print.
        stereo: `side-by-side` for one half of the image for each eye, or `anaglyph` for red-cyan
            glasses.
        eye_distance: distance between the eyes, m.
        follow: robot, group or frame that the free camera follows (default: the setting in the
            view of the scene).
        renderer: `classic` for OpenGL, or the name of a `Renderer` of an extension (default: a
            renderer for quality `fine` if this quality is requested, otherwise `classic`). If the
            renderer is not available, the classic renderer is used, and a warning states the
            reason.
        frames: approximate number of frames that will be rendered.

    Raises:
        RenderError: OpenGL is not available, the size or eye distance is out of range, or the
            quality, renderer or stereo mode is unknown.
        UnknownName: `camera` or `follow` is not a name of the scene.
        UsageError: `follow` is set, but the camera is fixed.
    """

    def __init__(
        self,
        world: WorldView,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str | None = None,
        quality: Quality = "normal",
        stereo: Stereo | None = None,
        eye_distance: float = EYE_DISTANCE,
        follow: str | None = None,
        renderer: str | None = None,
        frames: int = 1,
    ) -> None:
        check_stereo(stereo, eye_distance)
        if quality not in QUALITIES:
            raise RenderError(Problem("quality", found=quality, expected=", ".join(QUALITIES)))
        self._scale = SUPERSAMPLING if quality == "fine" else 1
        check_size("image", width * self._scale, height * self._scale)
        self.world = world
        self.camera = find_camera(world, camera)
        self._framing = Framing(world, self.camera, camera)
        follow = followed(world, self.camera, follow)
        self._follower = None
        if follow is not None:
            self._follower = Follower(world, follow, declared_data(world))
        self.size = (width, height)
        self._stereo, self._eye_distance = stereo, eye_distance
        # Size of the image for one eye.
        self._half = (width // 2, height) if stereo == "side-by-side" else (width, height)
        check_size("half of the image", *self._half)
        self._centre = bounding_sphere(world)[0] if stereo is not None else np.zeros(3)
        self.decor = SceneDecor(world, with_text=False)
        size = self._half[0] * self._scale, height * self._scale
        self.renderer = choose_renderer(renderer, quality, *size)
        self._renderer: SceneRenderer
        if self.renderer == CLASSIC:
            classic = self._renderer = make_renderer(world, *size, is_draft=quality == "draft")
            # The OpenGL context of a new renderer is the current one.
            classic.first_shape = lend_shapes(context_of(classic))
            self._surroundings = added_surroundings(world, context_of(classic))
        else:
            kind = renderers()[self.renderer]
            self._renderer, self._surroundings = kind.make(world, *size, quality, frames=frames)
        if quality == "draft":
            self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self.decor.first_shape = self._renderer.first_shape
        self._typesetter = Typesetter(line_height(world, *self._half))
        self._passes: PassRenderer | None = None

    @classmethod
    def of_scene(cls, mirror: Mirror, options: ImageOptions, frames: int = 1) -> Self:
        """Returns a renderer for images of a mirrored scene with the requested options."""
        return cls(
            mirror.world,
            *options.size,
            options.camera,
            options.quality,
            options.stereo,
            options.eye_distance,
            options.follow,
            options.renderer,
            frames,
        )

    def render(self, data: mujoco.MjData, out: Pixels | None = None) -> Pixels:
        """Renders one frame into an array `out`, (height, width, 3), uint8, or into a new array."""
        self.decor.draw(data, self._look(data), self._renderer.scene)
        self._renderer.follow(data)
        text = self._typesetter.place(self.decor.panels)
        if self._stereo is None and self._scale == 1:
            pixels: Pixels = self._renderer.render(out=out)
            compose(pixels, text)
            return pixels if out is not None else pixels.view(ImageArray)
        pixels = np.zeros((*self.size[::-1], 3), np.uint8) if out is None else out
        if self._stereo == "anaglyph":
            pixels[:] = anaglyph(*self._eyes())
            compose(pixels, text)  # at the same pixels for both eyes
        elif self._stereo == "side-by-side":
            width = self._half[0]
            for k, half in enumerate(self._eyes()):
                compose(half, text)
                pixels[:, k * width : (k + 1) * width] = half
        else:
            pixels[:] = self._drawn()
            compose(pixels, text)
        return pixels if out is not None else pixels.view(ImageArray)

    def hold(self, poses: Iterable[mujoco.MjData], turns: Sequence[float] = (0.0,)) -> None:
        """Moves the camera so that robots are in the image in all poses, as `Framing.hold`.

        A camera that follows a robot, group or frame is not moved.
        """
        if self._follower is None:
            self._framing.hold(self.camera, poses, self._half, turns)

    def follow_nothing(self) -> None:
        self._follower = None

    def segmentation(self, data: mujoco.MjData) -> Ints:
        """Renders a segmentation image, which contains the number of the part at each pixel.

        Returns:
            part numbers, shape (height, width), int32, top row first. They are indices of
            `part_names`.
        """
        return self._filled(data).segmentation(self.decor.buffer)

    def depth(self, data: mujoco.MjData) -> Array:
        """Renders a depth image, without arrows and other visual features.

        Returns:
            distances from the camera along the viewing direction, shape (height, width), float32,
            m, top row first. They are infinite for the sky.
        """
        return self._filled(data).depth(self.decor.buffer)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts in segmentation images, indexed by part number."""
        return self._pass_renderer().parts.names

    def _pass_renderer(self) -> PassRenderer:
        if self._passes is None:
            self._passes = PassRenderer(
                self.world, make_renderer(self.world, *self.size, is_draft=True)
            )
        return self._passes

    def _filled(self, data: mujoco.MjData) -> PassRenderer:
        passes = self._pass_renderer()
        self._lay_out(data)
        self._fill(passes.scene, data, self.size)
        return passes

    def close(self) -> None:
        if self._passes is not None:
            self._passes.close()
        super().close()

    def render_blurred(
        self, subframes: Iterable[mujoco.MjData], out: Pixels | None = None
    ) -> Pixels:
        """Renders one frame with motion blur, as the mean of its subframes.

        The text of the first subframe is used, so that it stays sharp. Stereo is not supported.
        """
        exposure, text, scene = Exposure(), None, self._renderer.scene
        for data in subframes:
            view = self._look(data)
            if not exposure.moves(view, geom_corners(self.world.model, data)):
                exposure.add()
                continue
            self.decor.draw(data, view, scene)
            text = self._typesetter.place(self.decor.panels) if text is None else text
            exposure.add(self._drawn())
        pixels = np.zeros((*self.size[::-1], 3), np.uint8) if out is None else out
        pixels[:] = exposure.image()
        if text is not None:
            compose(pixels, text)
        return pixels if out is not None else pixels.view(ImageArray)

    def _drawn(self) -> Pixels:
        drawn: Pixels = self._renderer.render()
        if self._scale == 1:
            return drawn
        return np.array(Image.fromarray(drawn).reduce(self._scale))

    def _eyes(self) -> list[Pixels]:
        scene = self._renderer.scene
        distance = looked_at(scene, self.camera, self._centre)
        return [self._drawn() for _ in each_eye(scene, self._eye_distance, distance)]

    def _look(self, data: mujoco.MjData) -> ImageView:
        scene = self._renderer.scene
        if self._follower is not None:
            self.camera.lookat = self.camera.lookat + self._follower.displacement(data)
        else:
            self._framing.fit(self.camera, data)
        self._fill(scene, data, self._half)
        return ImageView.of_scene(scene, *self._half, self._typesetter.font)

    def _fill(self, scene: mujoco.MjvScene, data: mujoco.MjData, size: tuple[int, int]) -> None:
        self.decor.fill(data, self.camera, scene)
        stand_back(scene, self.camera, *size, self._framing.needed)
        if self._surroundings is not None:
            self._surroundings.add(scene)

    def _pixel(self, x: float, y: float) -> Pixel:
        width = self._half[0]
        is_right = self._stereo == "side-by-side" and x >= width
        return self.decor.from_above(x - width if is_right else x, y)


def make_renderer(world: WorldView, width: int, height: int, *, is_draft: bool) -> Any:
    """Returns a classic renderer with an OpenGL context for images of the requested size in pixels.

    Raises:
        RenderError: OpenGL is not available, or the size is too large.
    """
    model = world.model
    adopt_backend()
    try:
        with offscreen_size(model, width, height, is_draft=is_draft):
            if not is_draft:
                return ClassicRenderer(model, height, width)
            with without_textures(model) as textures:
                renderer = ClassicRenderer(model, height, width)
        upload_textures(model, context_of(renderer), textures)
        return renderer
    except Exception as error:  # each OpenGL backend has its own errors
        remedy = "`sero-mj check` lists missing packages"
        why = backend_problem() or f"{error or type(error).__name__}; {remedy}"
        raise RenderError(f"cannot render an image of {width}x{height}: {why}") from error


NEXT_WITHIN = 0.5  # time within which a live source should send its next packet, s
# Maximum number of video frames (nine hours at 30 fps). A larger number is probably a typing error.
MAX_FRAMES = 1_000_000
OnProgress = Callable[[int, int], None]


def render_image(
    scene: Scene,
    path: Path | str,
    options: ImageOptions | None = None,
    *,
    at: float = 0.0,
    painter: Callable[[Mirror, ImageOptions], Painter] = HeadlessRenderer.of_scene,
    **keywords: Any,
) -> list[str]:
    """Renders an image of the current state of a scene into a file.

    Args:
        path: image file in .png format or another format of Pillow.
        options: options of the image (default: `keywords`).
        at: time since the start of recordings and simulations, s.
        painter: function that returns the renderer.
        **keywords: fields of `ImageOptions`, such as `size` (width, height), `quality`, `camera`,
            `follow`, `clicks`, `shown` and `wait`.

    Returns:
        names of the sources without data, whose robots are in their declared pose.

    Raises:
        SeroError: the scene, its sources, the camera, an option or the file is invalid.
    """
    path, options = Path(path), options or ImageOptions(**keywords)
    if options.render_pass != "colour":
        check_pass_file(path)
    with Mirror(scene) as mirror:
        check_writable(path)
        with painter(mirror, options) as drawn:
            silent = mirror.wait(options.wait)
            mirror.wait_fresh(min(options.wait, NEXT_WITHIN), at)
            apply_switches(mirror.world, drawn.toggles, options.shown, options.selected)
            held = HeldTorques(mirror, drawn.toggles)
            held.update(mirror.data)
            perform_clicks(drawn, mirror.data, options.clicks)
            held.update(mirror.data)  # clicks may switch billboards on
            if isinstance(drawn, HeadlessRenderer):
                drawn.hold([mirror.data])
            if options.render_pass != "colour":
                _save_pass(path, drawn, mirror.data, options.render_pass)
                return silent
            dpi = PRINT_DPI if options.quality == "fine" else None
            save_image(path, drawn.render(mirror.data), dpi)
    return silent


def _save_pass(path: Path, drawn: Painter, data: mujoco.MjData, which: Pass) -> None:
    if not isinstance(drawn, HeadlessRenderer):
        raise UsageError(f"--pass {which} cannot be combined with --over")
    if which == "segmentation":
        save_segmentation(path, drawn.segmentation(data), drawn.part_names)
    else:
        save_depth(path, drawn.depth(data))


def render_video(
    scene: Scene,
    path: Path | str,
    options: VideoOptions | None = None,
    *,
    on_progress: OnProgress | None = None,
    **keywords: Any,
) -> list[str]:
    """Renders a video of a scene into a file, in real time if the scene has live sources.

    Args:
        path: video file with the extension .mp4, .webm or .gif.
        options: options of the video (default: `keywords`).
        on_progress: function that is called with the numbers of written frames and of all frames.
        **keywords: fields of `VideoOptions`: `duration` (s), `fps`, `orbit` (degrees),
            `camera_path` (a file), and all keywords of `render_image`. Clicks are performed before
            the first frame.

    Returns:
        names of the sources without data.

    Raises:
        SeroError: the scene, its sources, the camera, an option or the file is invalid.
    """
    path, options = Path(path), options or VideoOptions(**keywords)
    if options.render_pass != "colour":
        expected = (
            "an image, because video compression changes the colors that encode parts and depths"
        )
        raise RenderError(Problem(file=str(path), found=options.render_pass, expected=expected))
    fps = options.fps or default_fps(path)
    count = max(round(options.duration * fps), 1)
    if count > MAX_FRAMES:
        raise RenderError(f"found a video of {count} frames; expected at most {MAX_FRAMES}")
    drawn = count * (SUBFRAMES if options.quality == "fine" else 1)
    with Mirror(scene) as mirror, HeadlessRenderer.of_scene(mirror, options, drawn) as renderer:
        clicks = partial(perform_clicks, renderer, clicks=options.clicks)
        held = HeldTorques(mirror, renderer.toggles)
        frames = video_frames(mirror, renderer, count, fps, options, clicks, held.update)
        return write_video(
            mirror, renderer, path, frames,
            fps=fps, count=count, options=options, on_progress=on_progress,
        )  # fmt: skip


def write_video(
    mirror: Mirror,
    painter: Painter,
    path: Path,
    frames: Iterable[Pixels],
    *,
    fps: float,
    count: int,
    options: ImageOptions,
    on_progress: OnProgress | None,
) -> list[str]:
    """Writes rendered frames to a video file, and returns the names of the sources without data."""
    with VideoWriter(path, *painter.size, fps) as film:
        silent = mirror.wait(options.wait)
        apply_switches(mirror.world, painter.toggles, options.shown, options.selected)
        for frame in frames:
            film.add(frame)
            if on_progress is not None:
                on_progress(film.frames, max(count, film.frames))
    return silent
