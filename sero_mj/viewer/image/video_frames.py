"""Renders the frames of a video from states of a mirror, with camera motion and motion blur."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...data.drive.mirror import Mirror, restore
from ...robots.assemble.world import World
from ...robots.assemble.world_view import WorldView
from ..decor.image_view import ImageView
from .camera_motion import CameraMotion, orbit, read_camera_path
from .image_files import Pixels
from .image_options import VideoOptions
from .sampling import known_poses, sampled_states

_TURNS = 24  # number of steps of an orbit, at all of which the robots must be in the image
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)
SUBFRAMES = 8  # number of subframes of a frame with motion blur
SHUTTER = 0.5  # exposure time, fraction of the time between two frames
_MIN_SHIFT = 0.5  # a subframe is rendered if a point has moved by this distance, pixels
_LEVELS = 1 << 16  # levels of linear light, enough to distinguish the two darkest colors
# Source: IEC 61966-2-1 (sRGB).
_CODES = np.arange(256) / 255
_LINEAR = np.where(
    _CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4
).astype(np.float32)  # fmt: skip
_LIGHT = np.arange(_LEVELS) / (_LEVELS - 1)
_CODE_OF = np.where(_LIGHT <= 0.0031308, 12.92 * _LIGHT, 1.055 * _LIGHT ** (1 / 2.4) - 0.055)
_SRGB = np.round(255 * _CODE_OF).astype(np.uint8)
OnState = Callable[[mujoco.MjData], None]


class VideoRenderer(Protocol):
    """A renderer for videos, such as `HeadlessRenderer`, whose camera may move between frames."""

    world: WorldView
    camera: mujoco.MjvCamera
    size: tuple[int, int]

    def follow_nothing(self) -> None: ...

    def hold(self, poses: Iterable[mujoco.MjData], turns: Sequence[float] = (0.0,)) -> None: ...

    def render(self, data: mujoco.MjData, out: Pixels | None = None) -> Pixels: ...

    def render_blurred(
        self, subframes: Iterable[mujoco.MjData], out: Pixels | None = None
    ) -> Pixels: ...


def video_frames(
    mirror: Mirror,
    renderer: VideoRenderer,
    count: int,
    fps: float,
    options: VideoOptions,
    on_first: OnState = lambda data: None,
    on_state: OnState = lambda data: None,
) -> Iterator[Pixels]:
    """Yields the rendered image of each frame of a video, always in the same array."""
    _check_motion(renderer, options)
    path = None if options.camera_path is None else read_camera_path(options.camera_path)
    if path is not None and path.has_look_at:
        if options.follow is not None:
            reason = f"look_at cannot be combined with --follow {options.follow}; remove one"
            raise UsageError(f"--camera-path {options.camera_path}: {reason}")
        renderer.follow_nothing()
    return _draw(mirror, renderer, count, fps, options, path, on_first, on_state)


def _draw(
    mirror: Mirror,
    renderer: VideoRenderer,
    count: int,
    fps: float,
    options: VideoOptions,
    motion: CameraMotion | None,
    on_first: OnState,
    on_state: OnState,
) -> Iterator[Pixels]:
    world, data = mirror.world, mirror.world.make_data()
    is_placed = motion is not None
    if not mirror.is_live and not is_placed:
        renderer.hold(known_poses(mirror, 0.0, count / fps), _turns(options))
    pixels = np.empty((*renderer.size[::-1], 3), np.uint8)
    is_blurred = options.quality == "fine" and options.stereo is None and not mirror.is_live
    count_of_frame = SUBFRAMES if is_blurred else 1

    def move(time: float) -> None:
        if motion is not None:
            motion(renderer.camera, time)

    for k, states in enumerate(_states(mirror, count, fps, count_of_frame)):
        if k == 0:
            restore(world, data, states[0])
            if mirror.is_live and not is_placed:
                renderer.hold([data], _turns(options))
            if options.orbit is not None:
                motion = orbit(renderer.camera, options.orbit, count / fps)
            move(0.0)
            on_state(data)
            on_first(data)
        times = (k + SHUTTER * np.arange(len(states)) / count_of_frame) / fps
        timed = zip(times.tolist(), states, strict=True)
        subframes = _subframes(world, data, timed, move, on_state)
        if is_blurred:
            yield renderer.render_blurred(subframes, out=pixels)
        else:
            yield renderer.render(next(subframes), out=pixels)


def _subframes(
    world: World,
    data: mujoco.MjData,
    states: Iterable[tuple[float, Array]],
    move: Callable[[float], None],
    on_state: OnState,
) -> Iterator[mujoco.MjData]:
    for time, state in states:
        restore(world, data, state)
        move(time)
        on_state(data)
        yield data


def _states(mirror: Mirror, count: int, fps: float, subframes: int) -> Iterator[list[Array]]:
    if subframes == 1:
        yield from ([state] for state in sampled_states(mirror, count, fps))
        return
    for k in range(count):
        states = []
        for j in range(subframes):
            mirror.advance((k + SHUTTER * j / subframes) / fps)
            states.append(mirror.state())
        yield states


def _turns(options: VideoOptions) -> list[float]:
    if options.orbit is None:
        return [0.0]
    end = min(max(options.orbit, -360.0), 360.0)
    return [end * i / _TURNS for i in range(_TURNS + 1)]


def _check_motion(renderer: VideoRenderer, options: VideoOptions) -> None:
    names = ("orbit", "camera_path")
    moved = [options.spelled(name) for name in names if getattr(options, name) is not None]
    if len(moved) > 1:
        raise UsageError(f"{' and '.join(moved)} both move the camera; remove one of them")
    if moved and renderer.camera.type != _FREE:
        name = renderer.world.model.camera(renderer.camera.fixedcamid).name
        expected = "the free camera, azimuth,elevation,distance or the scene's view"
        raise UsageError(Problem(moved[0], "cannot move camera", found=name, expected=expected))


class Exposure:
    """The mean of the images of all subframes of a frame, which are at equal intervals.

    If nothing has moved since the last subframe, its image is reused.
    """

    def __init__(self) -> None:
        self._seen: tuple[Array, Array] | None = None  # pixels and depths in the last image
        self._last: NDArray[np.float32] | None = None
        self._sum: NDArray[np.float32] | None = None
        self._count = 0

    def moves(self, view: ImageView, points: Array) -> bool:
        """Returns whether a subframe needs a new image, which the caller then passes to `add`.

        Args:
            view: view of the camera in this subframe.
            points: points on everything that may move, shape (..., 3), m.
        """
        pixels, depth = view.project(points)
        if self._seen is not None:
            before, depth_before = self._seen
            is_visible = view.sees(pixels, depth) | view.sees(before, depth_before)
            shift = np.abs(pixels - before)[is_visible]
            if not len(shift) or shift.max() < _MIN_SHIFT:
                return False
        self._seen = pixels, depth
        return True

    def add(self, image: Pixels | None = None) -> None:
        if image is not None:
            self._last = _LINEAR[image]
        assert self._last is not None
        if self._sum is None:
            self._sum = self._last.copy()
        else:
            self._sum += self._last
        self._count += 1

    def image(self) -> Pixels:
        assert self._sum is not None
        mean = self._sum * ((_LEVELS - 1) / self._count) + 0.5
        return np.asarray(_SRGB[mean.astype(np.int32).clip(0, _LEVELS - 1)])
