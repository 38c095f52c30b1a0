"""The frames of a film: states of a mirror, a camera that may move, and a shutter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import mujoco
import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...data.drive.mirror import Mirror, restore
from ...robots.assemble.world import World
from ...robots.assemble.world_view import WorldView
from .camera_motion import CameraMotion, orbit, read_camera_path
from .film import Pixels
from .motion_blur import SHUTTER, SUBFRAMES
from .picture_options import FilmOptions
from .sampling import known_poses, sampled_states

_TURNS = 24  # of a turntable, by which the camera is placed
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)
OnState = Callable[[mujoco.MjData], None]


class FilmRenderer(Protocol):
    """What draws a film: a `HeadlessRenderer`.

    Attributes:
        camera: may be moved between frames.
    """

    world: WorldView
    camera: mujoco.MjvCamera
    size: tuple[int, int]

    def follow_nothing(self) -> None: ...

    def hold(self, poses: Iterable[mujoco.MjData], turns: Sequence[float] = (0.0,)) -> None: ...

    def render(self, data: mujoco.MjData, out: Pixels | None = None) -> Pixels: ...

    def render_blurred(
        self, moments: Iterable[mujoco.MjData], out: Pixels | None = None
    ) -> Pixels: ...


def film_frames(
    mirror: Mirror,
    renderer: FilmRenderer,
    count: int,
    fps: float,
    options: FilmOptions,
    on_first: OnState = lambda data: None,
    on_state: OnState = lambda data: None,
) -> Iterator[Pixels]:
    """Draws the state at the time of every frame, always into the same array."""
    _check_motion(renderer, options)
    path = None if options.camera_path is None else read_camera_path(options.camera_path)
    if path is not None and path.has_look_at:
        if options.follow is not None:
            reason = f"its look_at does not go with --follow {options.follow}"
            raise UsageError(f"--camera-path {options.camera_path}: {reason}; leave one out")
        renderer.follow_nothing()
    return _draw(mirror, renderer, count, fps, options, path, on_first, on_state)


def _draw(
    mirror: Mirror,
    renderer: FilmRenderer,
    count: int,
    fps: float,
    options: FilmOptions,
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
    subframes = SUBFRAMES if is_blurred else 1

    def move(time: float) -> None:
        if motion is not None:
            motion(renderer.camera, time)

    for k, states in enumerate(_opened(mirror, count, fps, subframes)):
        if k == 0:
            restore(world, data, states[0])
            if mirror.is_live and not is_placed:
                renderer.hold([data], _turns(options))
            if options.orbit is not None:
                motion = orbit(renderer.camera, options.orbit, count / fps)
            move(0.0)
            on_state(data)
            on_first(data)
        times = (k + SHUTTER * np.arange(len(states)) / subframes) / fps
        moments = _moments(world, data, zip(times.tolist(), states, strict=True), move, on_state)
        if is_blurred:
            yield renderer.render_blurred(moments, out=pixels)
        else:
            yield renderer.render(next(moments), out=pixels)


def _moments(
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


def _opened(mirror: Mirror, count: int, fps: float, subframes: int) -> Iterator[list[Array]]:
    if subframes == 1:
        yield from ([state] for state in sampled_states(mirror, count, fps))
        return
    for k in range(count):
        states = []
        for j in range(subframes):
            mirror.advance((k + SHUTTER * j / subframes) / fps)
            states.append(mirror.state())
        yield states


def _turns(options: FilmOptions) -> list[float]:
    if options.orbit is None:
        return [0.0]
    end = min(max(options.orbit, -360.0), 360.0)
    return [end * i / _TURNS for i in range(_TURNS + 1)]


def _check_motion(renderer: FilmRenderer, options: FilmOptions) -> None:
    names = ("orbit", "camera_path")
    moved = [options.spelled(name) for name in names if getattr(options, name) is not None]
    if len(moved) > 1:
        raise UsageError(f"{' and '.join(moved)}: both move the camera; leave one of them out")
    if moved and renderer.camera.type != _FREE:
        name = renderer.world.model.camera(renderer.camera.fixedcamid).name
        expected = "the free camera, azimuth,elevation,distance or the scene's view"
        raise UsageError(Problem(moved[0], "cannot move camera", found=name, expected=expected))
