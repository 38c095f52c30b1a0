"""Dragging a frame by its handles: what a move of the pointer makes of its pose."""

from __future__ import annotations

import numpy as np

from ...base.frames import Array
from ..decor.handles import CUBE, ring_radius
from ..decor.image_view import ImageView
from ..image.picking import Pixel

_EDGE_ON = 0.2  # of a ring's axis along the line of sight; below it the ring is seen from the side
_HEAD_ON = 0.05  # of 1 - the same for an arrow; below it the arrow points at the camera


def dragged(pose: Array, handle: int, view: ImageView, begin: Pixel, now: Pixel) -> Array:
    """Returns the pose of a frame whose handle the pointer has dragged.

    An arrow moves it by what the point of its axis nearest to the line of sight moves; a ring turns
    it by the angle about its centre, in its plane, or where that is seen from the side by the way
    along its edge; the cube moves it in the plane of the picture.
    """
    found = pose.copy()
    origin = pose[:3, 3]
    if handle == CUBE:
        there, then = (_in_picture(view, origin, pixel) for pixel in (now, begin))
        found[:3, 3] += there - then
    elif handle < 3:
        axis = pose[:3, handle]
        found[:3, 3] += (_along(view, origin, axis, now) - _along(view, origin, axis, begin)) * axis
    else:
        axis = pose[:3, handle - 3]
        angle = _about(view, origin, axis, begin, now)
        found[:3, :3] = _rotation(axis, angle) @ pose[:3, :3]
    return found


def _ray(view: ImageView, pixel: Pixel) -> Array:
    ray = view.at(np.array(pixel, float), 1.0) - view.position
    return np.asarray(ray / np.linalg.norm(ray))


def _in_picture(view: ImageView, origin: Array, pixel: Pixel) -> Array:
    ray = view.at(np.array(pixel, float), 1.0)
    return target_of(view.position, view.forward, origin, ray)


def _along(view: ImageView, origin: Array, axis: Array, pixel: Pixel) -> float:
    ray = _ray(view, pixel)
    across = float(ray @ axis)
    apart = 1.0 - across**2
    if apart < _HEAD_ON:
        return 0.0
    way = view.position - origin
    return float((way @ axis - across * (way @ ray)) / apart)


def _about(view: ImageView, origin: Array, axis: Array, begin: Pixel, now: Pixel) -> float:
    sight = (origin - view.position) / np.linalg.norm(origin - view.position)
    if abs(float(sight @ axis)) < _EDGE_ON:
        # The nearer side of the ring goes along this line of the picture.
        along = np.cross(axis, -sight)
        moved = _in_picture(view, origin, now) - _in_picture(view, origin, begin)
        return float(moved @ along) / ring_radius(origin, view)
    arms = []
    for pixel in (begin, now):
        ray = _ray(view, pixel)
        slope = float(ray @ axis)
        depth = float((origin - view.position) @ axis) / (slope if abs(slope) > 1e-6 else 1e-6)
        arms.append(view.position + depth * ray - origin)
    first, last = arms
    return float(np.arctan2(axis @ np.cross(first, last), first @ last))


def _rotation(axis: Array, angle: float) -> Array:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def target_of(eye: Array, forward: Array, point: Array, ray: Array) -> Array:
    """Returns where a ray meets the plane through a point that is parallel to the picture.

    Args:
        point: of the plane, (3,), m.
    """
    depth = (point - eye) @ forward
    return eye + (ray - eye) * (depth / ((ray - eye) @ forward))
