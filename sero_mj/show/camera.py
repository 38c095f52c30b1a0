"""Cameras: the scene's named ones, and a free one by azimuth, elevation and distance."""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.double import OUT_OF_SIGHT
from ..assemble.world_view import WorldView
from ..drive.place import Placer
from ..errors import DeclarationError, UnknownName, UsageError

_MARGIN = 1.12  # margin around the robots


def find_camera(world: WorldView, wanted: str | None = None) -> mujoco.MjvCamera:
    """Returns a camera for rendering.

    Args:
        world: the compiled scene.
        wanted: a camera's name; `azimuth,elevation,distance` (degrees, degrees, m); or None
            for the scene's `view`.

    Raises:
        UnknownName: no camera of that name.
        UsageError: not a text, not three numbers, or the distance is not positive.
    """
    if wanted is not None and not isinstance(wanted, str):
        raise UsageError(
            f"camera: found {wanted!r}; expected a name or 'azimuth,elevation,distance'"
        )
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
        camera.azimuth, camera.elevation, camera.distance = _three_numbers(wanted)
    return camera


def bounding_sphere(world: WorldView) -> tuple[NDArray[np.float64], float]:
    """Returns centre (3,), m, and radius, m, of a sphere about all but the floor, as declared.

    Objects that a route attaches to a robot's flange count at the flange.
    """
    model, data = world.model, world.make_data()
    if world.scene.routes:
        # Invalid routes are reported elsewhere, when they are wired.
        with contextlib.suppress(DeclarationError):
            Placer(world).place(data)
    solid = world.geoms_in_view()
    solid &= data.geom_xpos[:, 2] > OUT_OF_SIGHT[2] / 2  # doubles without a pose are far away
    if not solid.any():
        return np.zeros(3), 1.0
    box = model.geom_aabb[solid]
    rotation = data.geom_xmat[solid].reshape(-1, 3, 3)
    centre = data.geom_xpos[solid] + np.einsum("nij,nj->ni", rotation, box[:, :3])
    half = np.einsum("nij,nj->ni", np.abs(rotation), box[:, 3:])
    low, high = (centre - half).min(0), (centre + half).max(0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


def list_cameras(world: WorldView) -> list[str]:
    """Returns the names of the world's cameras, including those of MJCF pieces."""
    return [world.model.camera(i).name for i in range(world.model.ncam)]


def _three_numbers(text: str) -> tuple[float, float, float]:
    try:
        azimuth, elevation, distance = (float(part) for part in text.split(","))
    except ValueError:
        azimuth = elevation = distance = np.nan
    if not np.isfinite([azimuth, elevation, distance]).all() or distance <= 0:
        raise UsageError(
            f"camera '{text}': expected a name or azimuth,elevation,distance "
            "(degrees, degrees, m above 0), e.g. 150,-15,2.2"
        )
    return azimuth, elevation, distance
