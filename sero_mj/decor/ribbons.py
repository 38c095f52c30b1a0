"""The ribbon of a round arrow: thin boxes along an arc, with a head that tapers.

The head tapers in width and in thickness, so that it reads as an arrow head both from the side
and along the axis.
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
_HEAD_THICKNESS = 0.30  # of the radius, where the head is thickest
_HEAD_WIDER = (1.5, 0.28)  # the head is this times the width, plus this of the radius, wide
_FULL_HEAD_WIDTH = 0.14  # of the radius: the width at 2 % of the limit, from where heads are full


@dataclass(frozen=True, eq=False)
class Ribbons:
    """Where k round arrows stand and what they look like.

    Attributes:
        items: what they belong to, (k,).
        centre: (k, 3), m.
        axes: rotations whose z they turn about by the right-hand rule, (k, 3, 3).
        phase: angle of their tail about z from x, turning the way they point, (k,), rad.
        sign: 1, or -1 for one that turns the other way, (k,).
        radius: (k,), m.
        width: (k,), m.
        rgba: (k, 4).
        striped: beyond the limit they are striped like a warning tape, (k,).
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
    """Draws round arrows of so many boxes each."""
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
    # A head of constant size on a hair-thin arrow would make noise look like a torque.
    grown = np.minimum(widths / (_FULL_HEAD_WIDTH * radius), 1.0)
    head_width = _HEAD_WIDER[0] * widths + _HEAD_WIDER[1] * radius * grown
    width = np.where(head, head_width[:, None] * taper, widths[:, None])
    thickness = np.where(head, _HEAD_THICKNESS * grown[:, None] * taper, _THICKNESS)
    thickness = radius[:, None] * np.maximum(thickness, _THICKNESS)
    grid["size"][..., 0] = thickness / 2
    # Neighbours meet at the ribbon's outer edge.
    grid["size"][..., 1] = (radius[:, None] + thickness / 2) * np.tan(half_angle)
    grid["size"][..., 2] = width / 2
    grid["rgba"] = ribbons.rgba[:, None]
    if ribbons.striped.any():
        stripes = grid[ribbons.striped, 1:segments:2]
        stripes["rgba"][..., :3] = STRIPE_RGB
        grid[ribbons.striped, 1:segments:2] = stripes


@cache
def _shape(segments: int) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """The ribbon's shape along its arc, from tail to tip.

    Returns:
        middle angle and half the angle of every segment (rad), which ones are of the head, and
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
