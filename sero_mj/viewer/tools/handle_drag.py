"""Computes the pose of a frame whose handle is dragged."""

from __future__ import annotations

import numpy as np

from ...base.frames import Array
from ..decor.handles import CUBE, ring_radius
from ..decor.image_view import ImageView
from ..image.picking import Pixel

_EDGE_ON = 0.2  # |axis . line of sight| below which a ring appears as a line
_HEAD_ON = 0.05  # sin^2 of the angle between arrow and line of sight below which drags are ignored


def dragged(pose: Array, handle: int, view: ImageView, begin: Pixel, now: Pixel) -> Array:
    """Returns the new pose of a frame, shape (4, 4), after a handle was dragged between two pixels.

    An arrow moves the frame along its axis, to the point nearest to the line of sight. A ring
    rotates the frame about its axis, by the angle of the pointer in the plane of the ring. If the
    ring appears as a line, the distance along this line determines the angle. The cube moves the
    frame parallel to the image plane.
    """
    found = pose.copy()
    origin = pose[:3, 3]
    if handle == CUBE:
        there, then = (_in_image(view, origin, pixel) for pixel in (now, begin))
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


def _in_image(view: ImageView, origin: Array, pixel: Pixel) -> Array:
    ray = view.at(np.array(pixel, float), 1.0)
    return target_of(view.position, view.forward, origin, ray)


def _along(view: ImageView, origin: Array, axis: Array, pixel: Pixel) -> float:
    ray = _ray(view, pixel)
    across = float(ray @ axis)
    apart = 1.0 - across**2
    if apart < _HEAD_ON:
        return 0.0
    offset = view.position - origin
    return float((offset @ axis - across * (offset @ ray)) / apart)


def _about(view: ImageView, origin: Array, axis: Array, begin: Pixel, now: Pixel) -> float:
    sight = (origin - view.position) / np.linalg.norm(origin - view.position)
    if abs(float(sight @ axis)) < _EDGE_ON:
        # The side of the ring near the camera moves along this line in the image.
        along = np.cross(axis, -sight)
        moved = _in_image(view, origin, now) - _in_image(view, origin, begin)
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
    """Returns the intersection of a line of sight with a plane parallel to the image plane.

    Args:
        eye: position of the camera, shape (3,), m.
        point: point of the plane, shape (3,), m.
        ray: point of the line of sight, shape (3,), m.
    """
    depth = (point - eye) @ forward
    return eye + (ray - eye) * (depth / ((ray - eye) @ forward))
