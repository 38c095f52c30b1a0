"""Stereo images: one image for each eye, side by side or combined as a red-cyan anaglyph.

Both eyes look in the same direction. Their frustums are off-axis, so that points at the distance of
the look-at point are at the same pixel for both eyes. All text is drawn at this distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.errors import RenderError, shown
from .image_options import Stereo

STEREO: tuple[str, ...] = get_args(Stereo)
_MAX_DISTANCE = 1.0  # maximum distance between the eyes, m
_LAID_OUT = 2.0  # maximum depth of leaders, in units of the near plane distance
# Weights of the colors red, green and blue for the left eye (red filter) and the right eye (cyan
# filter). Source: Dubois, A projection method to generate anaglyph stereo images, ICASSP 2001, as
# published for common filters and screens.
_LEFT = np.array([[0.437, 0.449, 0.164], [-0.062, -0.062, -0.024], [-0.048, -0.050, -0.017]])
_RIGHT = np.array([[-0.011, -0.032, -0.007], [0.377, 0.761, 0.009], [-0.026, -0.093, 1.234]])
Pixels = NDArray[np.uint8]


def check_stereo(stereo: str | None, eye_distance: float) -> None:
    """Raises RenderError if a stereo mode is unknown or an eye distance in m is out of range."""
    if stereo is not None and stereo not in STEREO:
        raise RenderError(f"found stereo {shown(stereo)}; expected {' or '.join(STEREO)}")
    if not 0 < eye_distance <= _MAX_DISTANCE:
        expected = f"expected a distance above 0, up to {_MAX_DISTANCE:g} m"
        raise RenderError(f"found {eye_distance:g} m between the eyes; {expected}")


def each_eye(scene: mujoco.MjvScene, eye_distance: float, distance: float) -> Iterator[None]:
    """Moves the camera of a scene to the left and then to the right eye, and yields at each eye.

    Args:
        scene: scene with all geoms of a frame. Its camera is restored afterwards.
        eye_distance: distance between the eyes, m.
        distance: depth at which points have the same pixel for both eyes, m.
    """
    first = scene.camera[0]
    middle = (np.array(first.pos, np.float64) + np.array(scene.camera[1].pos)) / 2
    forward = np.array(first.forward, np.float64)
    to_right = np.cross(forward, np.array(first.up, np.float64))
    # Leaders of panels, which are laid out in pixels, are just behind the near plane.
    laid_out = []
    for geom in scene.geoms[: scene.ngeom]:
        position = np.array(geom.pos, np.float64)
        depth = float((position - middle) @ forward)
        if 0.0 < depth < _LAID_OUT * first.frustum_near:
            laid_out.append((geom, position, 1.0 - depth / distance))
    for eye in (-eye_distance / 2, eye_distance / 2):
        for camera in scene.camera:
            camera.pos = middle + eye * to_right
            camera.frustum_center = -eye * camera.frustum_near / distance
        for geom, position, share in laid_out:
            geom.pos = position + share * eye * to_right
        yield
    for camera in scene.camera:
        camera.pos, camera.frustum_center = middle, 0.0
    for geom, position, _ in laid_out:
        geom.pos = position


def looked_at(
    scene: mujoco.MjvScene, camera: mujoco.MjvCamera, centre: NDArray[np.float64]
) -> float:
    """Returns the distance from a camera to its look-at point in m.

    A camera of the model has no look-at point. For this camera, the result is the distance to
    `centre`, the center of the scene, shape (3,), m.
    """
    near = float(scene.camera[0].frustum_near)
    is_free = camera.type == mujoco.mjtCamera.mjCAMERA_FREE
    eyes = (np.array(scene.camera[0].pos) + np.array(scene.camera[1].pos)) / 2
    at = np.array(camera.lookat) if is_free else centre
    depth = float((at - eyes) @ np.array(scene.camera[0].forward, np.float64))
    return max(depth, (2.0 if is_free else 10.0) * near)


def anaglyph(left: Pixels, right: Pixels) -> Pixels:
    """Combines the images of both eyes for red-cyan glasses, with red for the left eye."""
    # Colors are mixed in linear light, which the filters of the glasses absorb.
    tables = (np.arange(256) / 255.0) ** 2.2
    mixed = tables[left] @ _LEFT.T + tables[right] @ _RIGHT.T
    return np.asarray((np.clip(mixed, 0.0, 1.0) ** (1 / 2.2) * 255.0).round(), np.uint8)
