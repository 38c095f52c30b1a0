"""Draws round arrows as ribbons of thin boxes along an arc, with a tapered head.

The head tapers in width and in thickness, so that it is recognizable both from the side and along
the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from .pen import Kind, Pen

Array = NDArray[np.float64]

STRIPE_RGB = (0.08, 0.08, 0.09)
TURNING_SPEED = 1.6  # rad/s

_ARC = np.deg2rad(300.0)
_HEAD_ARC = np.deg2rad(52.0)
_THICKNESS = 0.05  # of the radius
_HEAD_THICKNESS = 0.30  # of the radius, maximum thickness of the head
# Width of the head: factor of the ribbon's width, plus fraction of the radius.
_HEAD_WIDER = (1.5, 0.28)
# Ribbon width from which heads have full size (about 2 % of the limit), of the radius.
_FULL_HEAD_WIDTH = 0.14


@dataclass(frozen=True, eq=False)
class Ribbons:
    """Pose and appearance of k round arrows.

    Attributes:
        items: indices of the items they belong to, (k,).
        centre: (k, 3), m.
        axes: rotations with z along the axis of the arrow (right-hand rule), (k, 3, 3).
        phase: angle of the tail about z from x, in the arrow's direction, (k,), rad.
        sign: 1, or -1 for the opposite direction, (k,).
        radius: (k,), m.
        width: (k,), m.
        rgba: (k, 4).
        striped: whether they are striped, for values beyond the limit, (k,) bool.
    """

    items: NDArray[np.intp]
    centre: Array
    axes: Array
    phase: Array
    sign: Array
    radius: Array
    width: Array
    rgba: Array
    striped: NDArray[np.bool_]


def draw_ribbons(pen: Pen, kind: Kind, ribbons: Ribbons, segments: int) -> None:
    """Draws round arrows.

    Args:
        pen: where to.
        kind: kind of the items they belong to.
        ribbons: the arrows.
        segments: number of boxes of each arrow.
    """
    count = len(ribbons.items)
    box = int(mujoco.mjtGeom.mjGEOM_BOX)
    rows = pen.take(count * segments, box, kind, np.repeat(ribbons.items, segments))
    if not len(rows):
        return
    middle, half_angle, head, taper = _shape(segments)
    sign, radius, widths = ribbons.sign[:, None], ribbons.radius, ribbons.width
    angle = sign * (ribbons.phase[:, None] + middle)
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = ribbons.axes[:, None, :, 0], ribbons.axes[:, None, :, 1]
    outward = cos * x + sin * y

    grid = rows.reshape(count, segments)
    grid["pos"] = ribbons.centre[:, None] + radius[:, None, None] * outward
    grid["mat"][..., 0] = outward
    grid["mat"][..., 1] = cos * y - sin * x
    grid["mat"][..., 2] = ribbons.axes[:, None, :, 2]
    # A head of constant size on a very thin arrow would make noise look like a torque.
    grown = np.minimum(widths / (_FULL_HEAD_WIDTH * radius), 1.0)
    head_width = _HEAD_WIDER[0] * widths + _HEAD_WIDER[1] * radius * grown
    width = np.where(head, head_width[:, None] * taper, widths[:, None])
    thickness = np.where(head, _HEAD_THICKNESS * grown[:, None] * taper, _THICKNESS)
    thickness = radius[:, None] * np.maximum(thickness, _THICKNESS)
    grid["size"][..., 0] = thickness / 2
    # Adjacent boxes meet at the ribbon's outer edge.
    grid["size"][..., 1] = (radius[:, None] + thickness / 2) * np.tan(half_angle)
    grid["size"][..., 2] = width / 2
    grid["rgba"] = ribbons.rgba[:, None]
    if ribbons.striped.any():
        stripes = grid[ribbons.striped, 1:segments:2]
        stripes["rgba"][..., :3] = STRIPE_RGB
        grid[ribbons.striped, 1:segments:2] = stripes


@cache
def _shape(segments: int) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Returns the ribbon's shape along its arc, from tail to tip.

    Returns:
        centre angle and half the angle of every segment (rad), which segments form the head, and
        the head's taper from 1 to 0.
    """
    heads = max(4, round(0.35 * segments))
    tails = segments - heads
    edges = np.concatenate(
        [
            np.linspace(0.0, _ARC - _HEAD_ARC, tails + 1),
            np.linspace(_ARC - _HEAD_ARC, _ARC, heads + 1)[1:],
        ]
    )
    head = np.arange(segments) >= tails
    taper = np.ones(segments)
    taper[head] = 1.0 - (np.arange(heads) + 0.5) / heads
    return (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2, head, taper
