"""Cameras: named cameras of the scene, free cameras, and cameras that follow a robot."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import chain

import mujoco
import numpy as np

from ...base.errors import Problem, UnknownName, UsageError
from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ...robots.declared.mounts import carrier
from .framing import MARGIN, Framing, axes, bounding_sphere, declared_data

_DEGREES_PER_HEIGHT = 180.0  # rotation by a drag over the height of the window
_STEEPEST_DEG = 89.0
_PER_NOTCH = 0.9  # factor of the distance for one step of the wheel
_NEAREST, _FARTHEST = 0.02, 500.0  # m
_MAX_NUMBER = 1e6  # maximum magnitude of the numbers that describe a camera
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)
_EXPECTED = (
    "the name of a camera, or azimuth,elevation,distance (degrees, degrees, m above 0), optionally "
    "followed by the look-at point ,x,y,z (m), for example 150,-15,2.2"
)


def find_camera(world: WorldView, wanted: str | None = None) -> mujoco.MjvCamera:
    """Returns the camera with a name or pose, or the camera that the scene declares.

    Args:
        wanted: name of a camera, or `azimuth,elevation,distance` (degrees, degrees, m), optionally
            followed by the look-at point `,x,y,z` (m) (default: the `view` of the scene).

    Raises:
        UsageError: `wanted` is neither a camera name nor three or six numbers, or the distance is
            not positive.
    """
    if wanted is not None and not isinstance(wanted, str):
        raise UsageError(Problem("camera", found=wanted, expected=_EXPECTED))
    view = world.scene.view
    name = view.camera if wanted is None else wanted
    camera = mujoco.MjvCamera()
    if name is not None and "," not in name:
        index = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if index < 0:
            raise UnknownName("camera", name, list_cameras(world))
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = index
        return camera
    mujoco.mjv_defaultFreeCamera(world.model, camera)
    centre, radius = bounding_sphere(world)
    camera.azimuth, camera.elevation = view.azimuth_deg, view.elevation_deg
    half_fovy = np.deg2rad(world.model.vis.global_.fovy) / 2
    camera.distance = view.distance or MARGIN * radius / np.sin(half_fovy)
    camera.lookat = centre if view.look_at is None else view.look_at
    if wanted is not None:
        numbers = _numbers(wanted)
        camera.azimuth, camera.elevation, camera.distance = numbers[:3]
        if len(numbers) == 6:
            camera.lookat = numbers[3:]
    return camera


def list_cameras(world: WorldView) -> list[str]:
    """Returns the names of the cameras in a world, including those of MJCF objects."""
    return [world.model.camera(i).name for i in range(world.model.ncam)]


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all() or numbers[2] <= 0:
        raise UsageError(Problem("camera", found=text, expected=_EXPECTED))
    if np.abs(numbers).max() >= _MAX_NUMBER:
        raise UsageError(Problem("camera", found=text, expected=f"numbers below {_MAX_NUMBER:g}"))
    return numbers


class Navigator:
    """The camera of a window or page, which the user moves.

    Drags are in units of the window height, so that their effect does not depend on the size.

    Attributes:
        following: name of the robot, group or frame that the camera follows; None for none.
    """

    def __init__(self, world: WorldView, wanted: str | None = None) -> None:
        self.camera = find_camera(world, wanted)
        self._world = world
        self._start = wanted
        self._framing = Framing(world, self.camera, wanted)
        self._held: mujoco.MjvCamera | None = None
        self._follow_as_declared()

    def hold(self, poses: Iterator[mujoco.MjData], size: tuple[int, int]) -> None:
        """Moves the initial view so that the robots are visible in all poses, as `Framing.hold`.

        The view does not change if the camera follows a robot or if there are no poses.
        """
        if self.following is not None or (first := next(poses, None)) is None:
            return
        self._framing.hold(self.camera, chain([first], poses), size)
        self._held = mujoco.MjvCamera()
        copy_camera(self.camera, self._held)

    @property
    def needed(self) -> float:
        return self._framing.needed

    def _follow_as_declared(self) -> None:
        self.following = followed(self._world, self.camera)
        self._follower: Follower | None = None
        if self.following is not None:
            data = declared_data(self._world)
            self._follower = Follower(self._world, self.following, data)

    def orbit(self, right: float, down: float) -> None:
        camera = self.camera
        azimuth = camera.azimuth - _DEGREES_PER_HEIGHT * right
        camera.azimuth = (azimuth + 180.0) % 360.0 - 180.0
        camera.elevation = float(
            np.clip(
                camera.elevation - _DEGREES_PER_HEIGHT * down,
                min(-_STEEPEST_DEG, camera.elevation),
                max(_STEEPEST_DEG, camera.elevation),
            )
        )

    def pan(self, right: float, down: float, tan_half_fovy: float, depth: float) -> None:
        """Moves the camera parallel to the image, so that points at a depth follow the pointer.

        `tan_half_fovy` is the tangent of half the vertical field of view.
        """
        camera = self.camera
        _, to_right, to_up = axes(camera.azimuth, camera.elevation)
        height = 2.0 * tan_half_fovy * depth
        camera.lookat = camera.lookat + height * (down * to_up - right * to_right)

    def zoom(self, notches: float) -> None:
        """Multiplies the camera distance by 0.9 for each step (notch) of the mouse wheel."""
        distance = self.camera.distance * _PER_NOTCH ** np.clip(notches, -100.0, 100.0)
        self.camera.distance = float(np.clip(distance, _NEAREST, _FARTHEST))

    def free(self, position: Array, forward: Array) -> None:
        """Replaces a fixed camera of the scene with a free camera in the same pose."""
        if self.camera.type == _FREE:
            return
        self.camera.type = _FREE
        self.camera.fixedcamid = -1
        self.camera.azimuth = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
        self.camera.elevation = float(np.rad2deg(np.arcsin(np.clip(forward[2], -1, 1))))
        self.camera.lookat = position + self.camera.distance * forward

    def choose(self, number: int) -> str:
        """Selects a camera by its number from 1 on, or the initial view by 0; returns a message."""
        names = list_cameras(self._world)
        if number == 0:
            self.camera = find_camera(self._world, self._start)
            if self._held is None:
                self._framing = Framing(self._world, self.camera, self._start)
            else:
                copy_camera(self._held, self.camera)
            self._follow_as_declared()
            return "initial view"
        if number > len(names):
            count = f"{len(names)} cameras" if len(names) != 1 else "one camera"
            return f"no camera {number}: the scene has {count if names else 'none'}"
        distance, lookat = self.camera.distance, self.camera.lookat.copy()
        self.camera = find_camera(self._world, names[number - 1])
        self.camera.distance, self.camera.lookat = distance, lookat
        self.following = None
        return f"camera {names[number - 1]}"

    def follow(self, data: mujoco.MjData, frame: str | None) -> str:
        """Starts or stops following a robot, group or frame, and returns a message.

        The camera stops following if `frame` is None or is already followed. Raises UnknownName if
        there is no robot, group or frame with this name.
        """
        if frame is None or frame == self.following:
            self.following = None
            return "follows nothing"
        self._follower = Follower(self._world, frame, data)
        self.following = frame
        return f"follows {frame}"

    def advance(self, data: mujoco.MjData) -> None:
        """Moves the camera for the next frame.

        The camera moves with the robot, group or frame that it follows. If it follows none and the
        user has not moved it, it moves back when robots leave the image.
        """
        if self.following is None or self._follower is None:
            self._framing.fit(self.camera, data)
            return
        # The camera moves in real time, so that it also reaches the target on a paused timeline.
        moved = self._follower.displacement(data, time.monotonic())
        if self.camera.type == _FREE:
            self.camera.lookat = self.camera.lookat + moved


def followed(world: WorldView, camera: mujoco.MjvCamera, wanted: str | None = None) -> str | None:
    """Returns the name of the robot, group or frame that a camera follows, or None.

    Args:
        wanted: requested name (default: the name in the `view` of the scene, which fixed cameras
            ignore).

    Raises:
        UsageError: `wanted` is set, but the camera is fixed.
    """
    if camera.type == _FREE:
        return world.scene.view.follow if wanted is None else wanted
    if wanted is not None:
        name = world.model.camera(camera.fixedcamid).name
        reason = (
            f"requires the free camera, but camera '{name}' of the scene is fixed; cannot follow"
        )
        raise UsageError(Problem("follow", reason, found=wanted))
    return None


def copy_camera(camera: mujoco.MjvCamera, to: mujoco.MjvCamera) -> None:
    """Copies the type and pose of a camera to another one."""
    to.type, to.fixedcamid, to.trackbodyid = camera.type, camera.fixedcamid, camera.trackbodyid
    to.lookat[:], to.distance = camera.lookat, camera.distance
    to.azimuth, to.elevation = camera.azimuth, camera.elevation


TIME_CONSTANT = 0.4  # time constant of the low-pass filter, s
_JUMP = 1.0  # maximum time step in s; after longer or negative steps, the camera moves immediately


def roots(world: WorldView, name: str) -> list[str]:
    """Returns the robots of a group that no other robot of the group carries.

    A robot name is treated as a group of one robot. The list is empty for other names.
    """
    members = world.scene.members(name) or [name]
    robots = {each: world.robots[each].robot for each in members if each in world.robots}
    return [each for each, robot in robots.items() if carrier(robot) not in robots]


class Follower:
    """The motion of a camera that follows a robot, group or frame with a low-pass filter.

    If time stops or jumps, the camera moves immediately.

    Args:
        name: name of a robot or group, whose bases are followed, or of a frame.

    Raises:
        UnknownName: there is no robot, group or frame with this name.
    """

    def __init__(self, world: WorldView, name: str, data: mujoco.MjData) -> None:
        self._world, self._name = world, name
        self._roots = [int(world.robots[each].bodies[0]) for each in roots(world, name)]
        if not self._roots and world.scene.frame_name(name) not in world.frames.names:
            scene = world.scene
            names = [*scene.robots, *scene.groups, *world.frames.names]
            raise UnknownName("robot, group or frame", name, names)
        self._last = self._position(data)
        self._time: float | None = None
        self._remaining = np.zeros(3)  # displacement that the camera still has to make, m

    def _position(self, data: mujoco.MjData) -> Array:
        if not self._roots:
            return np.array(self._world.frame(data, self._name)[:3, 3])
        return np.asarray(self._world.state(data).xpos[self._roots].mean(axis=0))

    def displacement(self, data: mujoco.MjData, now: float | None = None) -> Array:
        """Returns the displacement of the camera since the last call, shape (3,), m."""
        position, now = self._position(data), float(data.time) if now is None else now
        if not np.isfinite(position).all():
            return np.zeros(3)
        moved, self._last = position - self._last, position
        elapsed = 0.0 if self._time is None else now - self._time
        self._time = now
        if not 0.0 < elapsed <= _JUMP:
            return moved
        remaining = (self._remaining + moved) * np.exp(-elapsed / TIME_CONSTANT)
        moved, self._remaining = self._remaining + moved - remaining, remaining
        return np.asarray(moved)
