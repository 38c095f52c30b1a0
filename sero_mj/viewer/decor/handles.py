"""Draws handles to drag a frame, a mark at an unreachable target, and a ring at a selected joint.

Users drag three arrows to move the frame along its axes, three rings to rotate it about its axes,
and a cube to move it in the image plane. The size of handles in the image does not depend on the
distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from .arrow_shapes import draw_straight
from .axes import AXIS_RGB, ONTO_AXIS
from .feature import Feature, Frame
from .geom_buffer import GeomBuffer, Kind
from .image_view import ImageView

# Names of the handles. The items of their geoms are indices of this tuple.
HANDLE_NAMES = (
    *(f"move along {axis}" for axis in "xyz"),
    *(f"rotate about {axis}" for axis in "xyz"),
    "move in the image plane",
)
CUBE = 6
# Sizes of the handles, fractions of the line height.
_ARROW_LENGTH = 6.4
_RING_RADIUS = 4.6
_ARROW_WIDTH = 0.44
_RING_HALF_WIDTH = 0.11
_CUBE_HALF = 0.30
_MARK_HALF = 0.16
SEGMENTS = 28  # number of boxes of a ring
_LIT_RGB = (1.00, 0.86, 0.25)
_CUBE_RGB = (0.92, 0.93, 0.95)
_MARK_RGBA = (0.90, 0.12, 0.10, 0.95)
_LARGEST = 0.16  # maximum length of the arrows, fraction of the image height


class HandleDecor(Feature):
    """The visual feature that draws the handles and the target mark of `Toggles.handles`."""

    order = 85

    def draw(self, frame: Frame) -> None:
        handles = frame.toggles.handles
        if handles is None:
            return
        if handles.pose is not None:
            draw_handles(frame.buffer, handles.pose, handles.lit, frame.view)
        if handles.mark is not None:
            _draw_mark(frame.buffer, handles.mark, frame.view)


def handle_length(point: Array, view: ImageView) -> float:
    """Returns the length in m at a point (3,) that appears as long as one line height."""
    depth = max(float((point - view.position) @ view.forward), view.near)
    line = min(view.font.height, _LARGEST * view.height / _ARROW_LENGTH)
    return float(view.pixel_size(depth)) * line


def ring_radius(point: Array, view: ImageView) -> float:
    """Returns the radius in m of the rings that rotate a frame with its origin at a point (3,)."""
    return _RING_RADIUS * handle_length(point, view)


def draw_handles(buffer: GeomBuffer, pose: Array, lit: int, view: ImageView) -> None:
    """Draws the handles of a frame with the pose T_world_frame, shape (4, 4), m."""
    origin, rotation = pose[:3, 3], pose[:3, :3]
    unit = handle_length(origin, view)
    rgb = np.array([*AXIS_RGB, *AXIS_RGB, _CUBE_RGB])
    if lit >= 0:
        rgb[lit] = _LIT_RGB
    onto = rotation @ ONTO_AXIS
    draw_straight(
        buffer, Kind.HANDLE, np.arange(3),
        start=origin + onto[..., 2] * (_CUBE_HALF + 0.1) * unit,
        axes=onto,
        length=np.full(3, _ARROW_LENGTH * unit),
        width=np.full(3, _ARROW_WIDTH * unit),
        rgba=np.column_stack([rgb[:3], np.ones(3)]),
        emission=0.6,
    )  # fmt: skip
    items = np.repeat(np.arange(3, 6), SEGMENTS)
    rows = buffer.take(3 * SEGMENTS, int(mujoco.mjtGeom.mjGEOM_BOX), Kind.HANDLE, items)
    if len(rows):
        for grid, axes, colour in zip(rows.reshape(3, -1), onto, rgb[3:6], strict=True):
            look = (*colour.tolist(), 0.95)
            fill_ring(grid, origin, axes, _RING_RADIUS * unit, _RING_HALF_WIDTH * unit, look)
        rows["emission"] = 0.6
    rows = buffer.take(1, int(mujoco.mjtGeom.mjGEOM_BOX), Kind.HANDLE, CUBE)
    if len(rows):
        rows["pos"], rows["mat"], rows["size"] = origin, rotation, _CUBE_HALF * unit
        rows["rgba"] = [*rgb[CUBE], 1.0]


def fill_ring(
    rows: NDArray[Any],
    centre: Array,
    axes: Array,
    radius: float,
    half_width: float,
    rgba: Sequence[float],
) -> None:
    """Arranges boxes in a ring.

    Args:
        rows: geoms of the boxes, shape (SEGMENTS,).
        axes: rotation whose third column is the axis of the ring, shape (3, 3).
        radius: radius of the ring, m.
        half_width: half width of the ring, m.
    """
    phase = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    x, y, z = axes.T
    outwards = np.cos(phase)[:, None] * x + np.sin(phase)[:, None] * y
    rows["pos"] = centre + radius * outwards
    along = np.broadcast_to(z, outwards.shape)
    rows["mat"] = np.stack([outwards, np.cross(along, outwards), along], axis=2)
    rows["size"] = [half_width, 1.02 * radius * np.pi / SEGMENTS, half_width]
    rows["rgba"] = rgba


def _draw_mark(buffer: GeomBuffer, mark: Array, view: ImageView) -> None:
    target, actual = mark
    half = _MARK_HALF * handle_length(target, view)
    rows = buffer.take(4, int(mujoco.mjtGeom.mjGEOM_BOX))
    if not len(rows):
        return
    rows["pos"], rows["rgba"] = target, _MARK_RGBA
    rows["mat"] = view.facing
    turn = np.sqrt(0.5) * np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]])
    rows["mat"][:2] = view.facing @ turn
    rows["size"][:2] = [[5 * half, half, half], [half, 5 * half, half]]
    rows["size"][2] = half
    between = target - actual
    length = float(np.linalg.norm(between))
    rows["pos"][3] = (target + actual) / 2
    if length > 1e-9:
        z = between / length
        x = np.cross(z, view.forward)
        x = x / max(float(np.linalg.norm(x)), 1e-9)
        rows["mat"][3] = np.column_stack([x, np.cross(z, x), z])
    rows["size"][3] = 0.4 * half, 0.4 * half, length / 2
    rows["emission"] = 0.7


_RGBA = (0.16, 0.75, 0.95, 0.95)
_LARGER = 1.3  # radius of the ring, in radii of the arrow of the joint
_HALF_WIDTH = 1.4  # half width of the ring, pixels


class SelectionRing(Feature):
    """The visual feature that draws a ring around the selected joint."""

    order = 84

    def draw(self, frame: Frame) -> None:
        joint = frame.toggles.selected
        if joint is None or not frame.shown.joints[joint]:
            return
        joints, data = self.world.joints, frame.data
        site = joints.centre_site[joint]
        centre: Array = np.asarray(data.site_xpos[site])
        axes: Array = np.asarray(data.site_xmat[site]).reshape(3, 3)
        view = frame.view
        depth = max(float((centre - view.position) @ view.forward), view.near)
        rows = frame.buffer.take(SEGMENTS, int(mujoco.mjtGeom.mjGEOM_BOX), Kind.NONE)
        if len(rows):
            radius = _LARGER * float(joints.arrow_radius[joint])
            half = _HALF_WIDTH * float(view.pixel_size(depth))
            fill_ring(rows, centre, axes, radius, half, _RGBA)
            rows["emission"] = 0.9
