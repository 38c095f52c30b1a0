"""Synthetic photos of robots, by known cameras with a lens distortion."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from sero_mj import SerialRobot, World
from sero_mj.base.frames import Array
from sero_mj.extensions.photo.photo_camera import PhotoCamera, PlaneImage
from sero_mj.viewer.image.render import make_renderer

POSE = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]
LENSES: dict[str, tuple[str, list[float]]] = {
    "none": ("plumb_bob", []),
    "barrel": ("plumb_bob", [-0.28, 0.09, 0.001, -0.0005, 0.0]),
    "rational": ("rational_polynomial", [0.3, -0.1, 5e-4, 2e-4, 0.02, 0.5, -0.05, 0.01]),
    "fisheye": ("equidistant", [-0.02, 0.005, -0.001, 0.0]),
}


def lwr(**fields: Any) -> SerialRobot:
    return SerialRobot.from_model("lwr", **{"joint_angles": POSE, **fields})


def looking(at: Array, forward: Array, distance: float) -> Array:
    """Returns T_world_camera of a camera that looks at a point, with x to the right and y down."""
    z = np.asarray(forward, float) / np.linalg.norm(forward)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = np.asarray(at, float) - distance * z
    return T


def camera(lens: str = "barrel", size: tuple[int, int] = (640, 400)) -> PhotoCamera:
    """Returns a camera beside the LWR with fx unequal to fy, and an off-center principal point."""
    model, coefficients = LENSES[lens]
    width, height = size
    matrix = np.array([[0.62, 0, 0.47], [0, 0.64, 0.34], [0, 0, 1]]) * [[width], [width], [1]]
    T = looking([0.2, 0.0, 0.55], [-0.5, 0.8, -0.25], 1.6)
    return PhotoCamera(width, height, matrix, T, np.array(coefficients), model)  # type: ignore[arg-type]


def photo(world: World, data: mujoco.MjData, by: PhotoCamera) -> Array:
    """Returns a photo of a scene: a rendered image to which OpenCV adds the lens distortion."""
    plane = PlaneImage(by, (4096, 4096))
    renderer = make_renderer(world, *plane.size, is_draft=False)
    try:
        renderer.update_scene(data)
        plane.look(renderer.scene)
        return plane.to_photo(renderer.render(), 0)
    finally:
        renderer.close()
