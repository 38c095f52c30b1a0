"""Cameras: the scene's named ones, a free one by azimuth, elevation and distance, moved ones."""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np

from ..base.errors import DeclarationError, Problem, UnknownName, UsageError
from ..base.frames import Array
from ..data.drive.place import Placer
from ..robots.assemble.solids import geom_boxes
from ..robots.assemble.world_view import WorldView
from ..robots.declared.double import OUT_OF_SIGHT

_MARGIN = 1.12  # margin around the robots
_DEGREES_PER_HEIGHT = 180.0  # rotation by a drag over the window's height
_STEEPEST_DEG = 89.0
_PER_NOTCH = 0.9  # change of distance for one step of the wheel
_NEAREST, _FARTHEST = 0.02, 500.0  # m
_WIDEST = 4 / 3  # width over height, at and above which no camera stands back
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)
_EXPECTED = (
    "a name or azimuth,elevation,distance (degrees, degrees, m above 0), e.g. 150,-15,2.2; with "
    ",x,y,z of what it looks at (m)"
)


def find_camera(world: WorldView, wanted: str | None = None) -> mujoco.MjvCamera:
    """Returns a camera for rendering.

    Args:
        world: the compiled scene.
        wanted: a camera's name; `azimuth,elevation,distance` (degrees, degrees, m), and if it does
            not look at the middle `,x,y,z` (m) of what it looks at; or None for the scene's `view`.
            In a narrow picture it stands farther away, see `needed_aspect`.

    Raises:
        UnknownName: no camera of that name.
        UsageError: not a text, neither three nor six numbers, or the distance is not positive.
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
    camera.distance = view.distance or _MARGIN * radius / np.sin(half_fovy)
    camera.lookat = centre if view.look_at is None else view.look_at
    if wanted is not None:
        numbers = _numbers(wanted)
        camera.azimuth, camera.elevation, camera.distance = numbers[:3]
        if len(numbers) == 6:
            camera.lookat = numbers[3:]
    return camera


def bounding_sphere(world: WorldView) -> tuple[Array, float]:
    """Returns centre (3,), m, and radius, m, of a sphere about the scene without its floor.

    Objects that a route attaches to a robot's flange count at the flange.
    """
    return _sphere(*_boxes(world, _declared(world)))


def _declared(world: WorldView) -> mujoco.MjData:
    data = world.make_data()
    if world.scene.routes:
        # Invalid routes are reported elsewhere, when they are wired.
        with contextlib.suppress(DeclarationError):
            Placer(world).place(data)
    return data


def _boxes(world: WorldView, data: mujoco.MjData) -> tuple[Array, Array]:
    """Lowest and highest corners of boxes about what stands in the picture, (k, 3) each, m."""
    solid = world.geoms_in_view()
    solid &= data.geom_xpos[:, 2] > OUT_OF_SIGHT[2] / 2  # doubles without a pose are far away
    lows, highs = geom_boxes(world.model, data)
    return lows[solid], highs[solid]


def _sphere(lows: Array, highs: Array) -> tuple[Array, float]:
    if not len(lows):
        return np.zeros(3), 1.0
    low, high = lows.min(axis=0), highs.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


class Framing:
    """Moves a camera back where data show robots outside of the picture of their declared pose.

    A robot that is mirrored stands anywhere. It acts when a coordinate first leaves its declared
    value, so that a picture does not move with a robot that is in it; and only until the camera is
    moved, on one that neither the scene nor the user has placed.

    Args:
        world: the compiled scene.
        camera: as returned by `find_camera`.
        wanted: as it was called with.
    """

    def __init__(
        self, world: WorldView, camera: mujoco.MjvCamera, wanted: str | None = None
    ) -> None:
        view = world.scene.view
        is_placed = wanted is not None or view.distance is not None or view.look_at is not None
        self._world = world
        self._placed = _pose(camera)
        self._acts = not is_placed and camera.type == _FREE
        if self._acts:
            self._declared = _declared(world)
            self._moved = np.zeros(world.model.nq, bool)

    def fit(self, camera: mujoco.MjvCamera, data: mujoco.MjData) -> None:
        """Moves the camera where a state needs it.

        Args:
            camera: changed in place.
            data: the state, with frames up to date.
        """
        if not self._acts:
            return
        moved = data.qpos != self._declared.qpos
        if not (moved & ~self._moved).any():
            return
        self._moved |= moved
        if _pose(camera) != self._placed:
            self._acts = False
            return
        lows, highs = _boxes(self._world, data)
        half_fovy = np.deg2rad(self._world.model.vis.global_.fovy) / 2
        seen = camera.distance * np.sin(half_fovy)  # m, radius of the sphere in the picture
        farthest = np.abs((lows + highs) / 2 - camera.lookat) + (highs - lows) / 2
        if not (np.linalg.norm(farthest, axis=1) > seen).any():
            return
        declared = _boxes(self._world, self._declared)
        centre, radius = _sphere(np.vstack((lows, declared[0])), np.vstack((highs, declared[1])))
        camera.lookat, camera.distance = centre, _MARGIN * radius / np.sin(half_fovy)
        self._placed = _pose(camera)


def _pose(camera: mujoco.MjvCamera) -> tuple[float, ...]:
    return (camera.type, camera.distance, camera.azimuth, camera.elevation, *camera.lookat)


def list_cameras(world: WorldView) -> list[str]:
    """Returns the names of the world's cameras, including those of MJCF pieces."""
    return [world.model.camera(i).name for i in range(world.model.ncam)]


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all() or numbers[2] <= 0:
        raise UsageError(Problem("camera", found=text, expected=_EXPECTED))
    return numbers


class Navigator:
    """A camera that the user moves.

    Drags are in units of the window's height, so that they act the same at all sizes.

    Args:
        world: the compiled scene.
        wanted: see `find_camera`.

    Attributes:
        camera: of the renderer.
        needed: as returned by `needed_aspect` for the initial view.
        following: the frame that it follows; None for none.

    Raises:
        UnknownName: no camera of that name.
    """

    def __init__(self, world: WorldView, wanted: str | None = None) -> None:
        self.camera = find_camera(world, wanted)
        self.needed = needed_aspect(world, self.camera)
        self.following: str | None = None
        self._world = world
        self._start = wanted
        self._framing = Framing(world, self.camera, wanted)
        self._last = np.zeros(3)  # last position of the followed frame

    def orbit(self, right: float, down: float) -> None:
        """Rotates about the look-at point by a drag, in window heights."""
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
        """Moves parallel to the picture, so that the look-at point follows the pointer.

        Args:
            right: of the drag, in window heights.
            down: likewise.
            tan_half_fovy: tangent of half the vertical field of view.
            depth: of the look-at point, m.
        """
        camera = self.camera
        _, to_right, to_up = axes(camera.azimuth, camera.elevation)
        height = 2.0 * tan_half_fovy * depth
        camera.lookat = camera.lookat + height * (down * to_up - right * to_right)

    def zoom(self, notches: float) -> None:
        """Reduces the distance by steps of the wheel, or increases it."""
        distance = self.camera.distance * _PER_NOTCH ** np.clip(notches, -100.0, 100.0)
        self.camera.distance = float(np.clip(distance, _NEAREST, _FARTHEST))

    def free(self, position: Array, forward: Array) -> None:
        """Replaces a fixed camera of the scene by a free one with the same pose.

        Args:
            position: of the camera, (3,), m.
            forward: unit vector (3,).
        """
        if self.camera.type == _FREE:
            return
        self.camera.type = _FREE
        self.camera.fixedcamid = -1
        self.camera.azimuth = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
        self.camera.elevation = float(np.rad2deg(np.arcsin(np.clip(forward[2], -1, 1))))
        self.camera.lookat = position + self.camera.distance * forward

    def choose(self, number: int) -> str:
        """Selects a camera by number, 1 for the first; 0 for the scene's own view.

        Returns:
            a message for the user.
        """
        names = list_cameras(self._world)
        if number == 0:
            self.camera = find_camera(self._world, self._start)
            self._framing = Framing(self._world, self.camera, self._start)
            self.following = None
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
        """Starts following a frame, or stops for None; returns a message for the user."""
        if frame is None or frame == self.following:
            self.following = None
            return "follows nothing"
        self._last = self._world.frame(data, frame)[:3, 3].copy()
        self.following = frame
        return f"follows {frame}"

    def advance(self, data: mujoco.MjData) -> None:
        """Moves with the followed frame, by its displacement since the last call.

        As long as nobody has moved the camera, it moves back where robots are out of the picture.

        Args:
            data: the state, with frames up to date.
        """
        if self.following is None:
            self._framing.fit(self.camera, data)
        if self.following is None or self.camera.type != _FREE:
            return
        now = self._world.frame(data, self.following)[:3, 3]
        if np.isfinite(now).all():
            self.camera.lookat = self.camera.lookat + now - self._last
            self._last = now.copy()


def axes(azimuth_deg: float, elevation_deg: float) -> tuple[Array, Array, Array]:
    """Returns the unit vectors forward, right and up (3,) of a free camera."""
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    forward = np.array([ca * ce, sa * ce, se])
    right = np.array([sa, -ca, 0.0])
    up = np.array([-ca * se, -sa * se, ce])
    return forward, right, up


def needed_aspect(world: WorldView, camera: mujoco.MjvCamera) -> float:
    """Returns the width of a picture over its height that a free camera needs, at most 4/3.

    It shows a sphere about the declared scene without its floor. Distances are those of pictures
    that are as wide; in narrower ones the camera stands back.
    """
    centre, radius = bounding_sphere(world)
    radius = _MARGIN * radius + float(np.linalg.norm(centre - camera.lookat))
    half = np.arcsin(min(radius / camera.distance, 1.0))
    tan_half_fovy = np.tan(np.deg2rad(world.model.vis.global_.fovy) / 2)
    return float(min(np.tan(min(half, np.pi / 3)) / tan_half_fovy, _WIDEST))


def standing_back(width: float, height: float, needed: float) -> float:
    """Returns by how much farther away a free camera stands in a narrow picture; 1 in others.

    Args:
        width: of the picture, pixels.
        height: of the picture, pixels.
        needed: as returned by `needed_aspect`.
    """
    return max(needed * height / max(width, 1.0), 1.0)


def stand_back(
    scene: mujoco.MjvScene, camera: mujoco.MjvCamera, width: float, height: float, needed: float
) -> None:
    """Moves the camera of a scene back for a narrow picture, see `standing_back`.

    Args:
        scene: that `mjv_updateScene` has filled.
        camera: with which it has; only a free one is moved.
        width: of the picture, pixels.
        height: of the picture, pixels.
        needed: as returned by `needed_aspect`.
    """
    back = (standing_back(width, height, needed) - 1.0) * camera.distance
    if back > 0.0 and camera.type == _FREE:
        for eye in scene.camera:
            eye.pos = np.array(eye.pos) - back * np.array(eye.forward)


def copy_camera(camera: mujoco.MjvCamera, to: mujoco.MjvCamera) -> None:
    """Gives a camera the pose, or the frame, of another one."""
    to.type, to.fixedcamid, to.trackbodyid = camera.type, camera.fixedcamid, camera.trackbodyid
    to.lookat[:], to.distance = camera.lookat, camera.distance
    to.azimuth, to.elevation = camera.azimuth, camera.elevation
