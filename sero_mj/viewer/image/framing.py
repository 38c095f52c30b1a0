"""Computes the camera distance at which all robots are in the image."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from ...base.errors import DeclarationError
from ...base.frames import Array, Bools
from ...data.drive.place import Placer
from ...robots.assemble.parts import robots_of_bodies
from ...robots.assemble.solids import geom_boxes, geom_corners
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT

MARGIN = 1.12  # factor of the camera distance that leaves a margin around the robots
_WIDEST = 4 / 3  # aspect ratio above which cameras are not moved back for a sphere
_DECLARED_FOR = 1.6  # aspect ratio of the images for which scenes declare their view
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)


def axes(azimuth_deg: float, elevation_deg: float) -> tuple[Array, Array, Array]:
    """Returns the unit vectors forward, right and up of a free camera, shape (3,) each."""
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    forward = np.array([ca * ce, sa * ce, se])
    right = np.array([sa, -ca, 0.0])
    up = np.array([-ca * se, -sa * se, ce])
    return forward, right, up


def bounding_sphere(world: WorldView) -> tuple[Array, float]:
    """Returns the center (3,) and radius, in m, of a sphere around the scene without its floor.

    Objects that a route attaches to the flange of a robot are placed at the flange.
    """
    return _sphere(*_boxes(world, declared_data(world)))


def declared_data(world: WorldView) -> mujoco.MjData:
    """Returns the declared state of a world, with objects at the robots that carry them."""
    data = world.make_data()
    if world.scene.routes:
        # Invalid routes are reported when they are connected.
        with contextlib.suppress(DeclarationError):
            Placer(world).place(data)
    return data


def _boxes(world: WorldView, data: mujoco.MjData) -> tuple[Array, Array]:
    solid = world.geoms_in_view() & _is_in_sight(data)
    lows, highs = geom_boxes(world.model, data)
    return lows[solid], highs[solid]


def _is_in_sight(data: mujoco.MjData) -> Bools:
    return np.asarray(data.geom_xpos[:, 2] > OUT_OF_SIGHT[2] / 2)


def _sphere(lows: Array, highs: Array) -> tuple[Array, float]:
    if not len(lows):
        return np.zeros(3), 1.0
    low, high = lows.min(axis=0), highs.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


def _tan_half_fovy(world: WorldView) -> float:
    return float(np.tan(np.deg2rad(world.model.vis.global_.fovy) / 2))


class Framing:
    """Moves a camera back so that robots stay in the image if received data moves them out of it.

    `fit` is called for each frame. It checks whether robots have left the image only when a joint
    or base leaves its declared position for the first time, so that the camera does not follow
    every motion. It never moves a camera that the scene or the user has placed. `hold` is for poses
    that are known before the first image. It does not move a camera that the user has placed.
    """

    def __init__(
        self, world: WorldView, camera: mujoco.MjvCamera, wanted: str | None = None
    ) -> None:
        view = world.scene.view
        is_placed = wanted is not None or view.distance is not None or view.look_at is not None
        self._world = world
        self._placed = _pose(camera)
        self._is_wanted = wanted is not None
        self._acts = not is_placed and camera.type == _FREE
        self.needed = needed_aspect(world, camera, wanted)
        self._declared = declared_data(world)
        self._bases = [part.mocap for part in world.robots.values() if part.mocap >= 0]
        self._moved = np.zeros(world.model.nq + len(self._bases), bool)

    def fit(self, camera: mujoco.MjvCamera, data: mujoco.MjData) -> None:
        """Moves the camera back if robots have left the image in the current state."""
        if not self._acts:
            return
        at = (each.mocap_pos[self._bases] for each in (data, self._declared))
        bases_moved = np.not_equal(*at).any(axis=1)
        moved = np.append(data.qpos != self._declared.qpos, bases_moved)
        if not (moved & ~self._moved).any():
            return
        self._moved |= moved
        if _pose(camera) != self._placed:
            self._acts = False
            return
        lows, highs = _boxes(self._world, data)
        half_fovy = np.deg2rad(self._world.model.vis.global_.fovy) / 2
        radius = camera.distance * np.sin(half_fovy)  # radius of the visible sphere, m
        farthest = np.abs((lows + highs) / 2 - camera.lookat) + (highs - lows) / 2
        if not (np.linalg.norm(farthest, axis=1) > radius).any():
            return
        if not bases_moved.any():  # also show the declared poses, unless a base has moved
            declared = _boxes(self._world, self._declared)
            lows, highs = np.vstack((lows, declared[0])), np.vstack((highs, declared[1]))
        centre, radius = _sphere(lows, highs)
        camera.lookat, camera.distance = centre, MARGIN * radius / np.sin(half_fovy)
        self._placed = _pose(camera)

    def hold(
        self,
        camera: mujoco.MjvCamera,
        poses: Iterable[mujoco.MjData],
        size: tuple[int, int],
        turns: Sequence[float] = (0.0,),
    ) -> None:
        """Moves the camera so that robots and doubles are in the image in all poses.

        Parts that are outside of the image in the declared pose may stay outside. Nothing changes
        if all other parts are in the image, or if the user has placed the camera.

        Args:
            turns: azimuths of the camera relative to the current azimuth, degrees.
        """
        if self._is_wanted or camera.type != _FREE or _pose(camera) != self._placed:
            return
        aspect, tangent = size[0] / size[1], _tan_half_fovy(self._world)
        matters = _of_robots(self._world)
        back = standing_back(*size, self.needed) * camera.distance
        declared = geom_corners(self._world.model, self._declared)
        at = _Eye(camera).look(declared - camera.lookat)
        left_out = _is_in_sight(self._declared) & ~_is_inside(at, back, tangent, aspect).all(axis=1)
        matters &= ~left_out
        corners = [declared[matters & _is_in_sight(self._declared)].reshape(-1, 3)]
        for data in poses:
            shown = matters & _is_in_sight(data)
            corners.append(geom_corners(self._world.model, data, shown).reshape(-1, 3))
        points = np.concatenate(corners)
        if not len(points):
            return
        eyes = [_Eye(camera, turn) for turn in turns]
        at = camera.lookat
        if all(_is_inside(eye.look(points - at), back, tangent, aspect).all() for eye in eyes):
            return
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        found = [eye.look(points - centre) for eye in eyes]
        distance = max(_distance(each, tangent, _WIDEST) for each in found)
        camera.lookat, camera.distance = centre, max(distance, camera.distance)
        self.needed = max(_needed(each, camera.distance, tangent) for each in found)
        self._placed = _pose(camera)


class _Eye:
    def __init__(self, camera: mujoco.MjvCamera, turn_deg: float = 0.0) -> None:
        forward, right, up = axes(camera.azimuth + turn_deg, camera.elevation)
        self._axes = np.stack([right, up, forward], axis=1)

    def look(self, points: Array) -> Array:
        return np.asarray(points @ self._axes)


def _is_inside(at: Array, distance: float, tangent: float, aspect: float) -> Bools:
    depth = distance + at[..., 2]
    high = tangent * depth
    return np.asarray(
        (depth > 0) & (np.abs(at[..., 0]) < aspect * high) & (np.abs(at[..., 1]) < high)
    )


def _distance(at: Array, tangent: float, aspect: float) -> float:
    across = np.maximum(np.abs(at[:, 0]) / aspect, np.abs(at[:, 1]))
    return float((MARGIN * across / tangent - at[:, 2]).max())


def _needed(at: Array, distance: float, tangent: float) -> float:
    depth = np.minimum(distance, np.maximum(distance + at[:, 2], 1e-3 * distance))
    return float((np.abs(at[:, 0]) / (tangent * depth)).max())


def _of_robots(world: WorldView) -> Bools:
    model = world.model
    of_robot = robots_of_bodies(model, world.robots) >= 0
    for double in world.doubles.values():
        of_robot[double.bodies.ravel()] = True
    return np.asarray(of_robot[model.geom_bodyid] & world.geoms_in_view())


def _pose(camera: mujoco.MjvCamera) -> tuple[float, ...]:
    return (camera.type, camera.distance, camera.azimuth, camera.elevation, *camera.lookat)


def needed_aspect(world: WorldView, camera: mujoco.MjvCamera, wanted: str | None = None) -> float:
    """Returns the minimum aspect ratio (width over height) for which a camera pose is suitable.

    In narrower images, a free camera is moved back. At the returned ratio, the image contains a
    sphere around the declared scene without its floor. The sphere requires a ratio of at most 4/3,
    because a view may show only a part of the scene. If `wanted` is None, the camera is the
    declared view, which is designed for images of 1280x800. The image then also contains all robots
    that are visible at this size.
    """
    data, tangent = declared_data(world), _tan_half_fovy(world)
    centre, radius = _sphere(*_boxes(world, data))
    radius = MARGIN * radius + float(np.linalg.norm(centre - camera.lookat))
    half = np.arcsin(min(radius / camera.distance, 1.0))
    needed = float(min(np.tan(min(half, np.pi / 3)) / tangent, _WIDEST))
    if wanted is not None:
        return needed
    corners = geom_corners(world.model, data, _of_robots(world) & _is_in_sight(data))
    at = _Eye(camera).look(corners.reshape(-1, 3) - camera.lookat)
    at = at[_is_inside(at, camera.distance, tangent, _DECLARED_FOR)]
    if not len(at):
        return needed
    return max(needed, min(_needed(at, camera.distance, tangent), _DECLARED_FOR))


def standing_back(width: float, height: float, needed: float) -> float:
    """Returns the factor, at least 1, by which the distance of a camera grows in narrow images."""
    return max(needed * height / max(width, 1.0), 1.0)


def stand_back(
    scene: mujoco.MjvScene, camera: mujoco.MjvCamera, width: float, height: float, needed: float
) -> None:
    """Moves a free camera of a scene back if the image is narrower than the ratio `needed`."""
    back = (standing_back(width, height, needed) - 1.0) * camera.distance
    if back > 0.0 and camera.type == _FREE:
        for eye in scene.camera:
            eye.pos = np.array(eye.pos) - back * np.array(eye.forward)
