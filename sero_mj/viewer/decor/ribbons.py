"""Ribbons: the geoms of round arrows.

A ribbon is a row of thin boxes along an arc. Its heads consist of triangles and taper in width and
thickness, so that they are visible from the side and along the axis of the arrow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from .geom_buffer import GeomBuffer, Kind, place_triangles

_STRIPE_RGB = (0.08, 0.08, 0.09)

_ARC = np.deg2rad(315.0)
_HEAD_ARC = np.deg2rad(46.0)
# Number of heads, and number of steps along the arc of each head, finest first. The last head is at
# the tip of the arrow. Other heads stay visible if the link hides the last one.
_HEADS = ((3, 3), (3, 2), (2, 2), (2, 1), (1, 1))
_FEWEST_BOXES = 8  # minimum number of boxes if there is more than one head
_MARK_SIZE = 0.7  # protrusion of the other heads, fraction of the protrusion of the last head
_NECK = 0.25  # width in front of the other heads, fraction of the ribbon width
_THICKNESS = 0.05  # thickness of the ribbon, fraction of the radius
_HEAD_THICKNESS = 0.30  # maximum thickness of the heads, fraction of the radius
# Width of the heads: factor of the ribbon width, plus fraction of the radius.
_HEAD_WIDER = (1.5, 0.28)
# Ribbon width at which heads reach full size (about 2 % of the limit), fraction of the radius.
_FULL_HEAD_WIDTH = 0.14


@dataclass(frozen=True, eq=False)
class Ribbons:
    """Positions and appearance of k round arrows.

    Attributes:
        items: index of the item that each arrow shows, shape (k,).
        centre: centers of the arrows, shape (k, 3), m.
        axes: orientations of the arrows, which run around the z axes, shape (k, 3, 3).
        phase: angle from x to the tail of the arrow in its direction, shape (k,), rad.
        sign: direction, 1 for the right-hand rule or -1 for the opposite direction, shape (k,).
        radius: radii of the arrows, shape (k,), m.
        width: widths of the ribbons, shape (k,), m.
        striped: mask of arrows that are striped because their values exceed the limit, shape (k,).
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


def draw_ribbons(buffer: GeomBuffer, kind: Kind, ribbons: Ribbons, budget: int) -> None:
    """Adds round arrows to a buffer, with at most `budget` geoms for each arrow."""
    shape = ribbon_shape(budget)
    count, boxes = len(ribbons.items), len(shape.middle)
    box, triangle = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_TRIANGLE)
    rows = buffer.take(count * shape.geoms, box, kind, np.repeat(ribbons.items, shape.geoms))
    if not len(rows):
        return
    grid = rows.reshape(count, shape.geoms)
    grid["rgba"] = ribbons.rgba[:, None]
    if ribbons.striped.any():
        grid["rgba"][..., :3] = np.where(
            (ribbons.striped[:, None] & shape.dark)[..., None], _STRIPE_RGB, grid["rgba"][..., :3]
        )
    _place_boxes(grid[:, :boxes], ribbons, shape)
    grid["type"][:, boxes:] = triangle
    _place_heads(grid[:, boxes:], ribbons, shape)


def _angles(ribbons: Ribbons, along: Array) -> Array:
    return np.asarray(ribbons.sign[:, None] * (ribbons.phase[:, None] + along))


def _directions(ribbons: Ribbons, cos: Array, sin: Array) -> Array:
    x, y = ribbons.axes.T[:2, ..., None]
    return np.asarray(cos * x + sin * y)


def _place_boxes(grid: NDArray[Any], ribbons: Ribbons, shape: RibbonShape) -> None:
    radius = ribbons.radius[:, None]
    angles = _angles(ribbons, shape.middle)
    cos, sin = np.cos(angles), np.sin(angles)
    outward = _directions(ribbons, cos, sin)
    grid["pos"] = np.moveaxis(ribbons.centre.T[..., None] + radius * outward, 0, -1)
    grid["mat"][..., 0] = np.moveaxis(outward, 0, -1)
    grid["mat"][..., 1] = np.moveaxis(_directions(ribbons, -sin, cos), 0, -1)
    grid["mat"][..., 2] = ribbons.axes[:, None, :, 2]
    grid["size"][..., 0] = _THICKNESS / 2 * radius
    # Adjacent boxes meet at the outer edge of the ribbon.
    grid["size"][..., 1] = radius * (1.0 + _THICKNESS / 2) * np.tan(shape.half_angle)
    grid["size"][..., 2] = ribbons.width[:, None] / 2


def _place_heads(grid: NDArray[Any], ribbons: Ribbons, shape: RibbonShape) -> None:
    radius, widths = ribbons.radius[:, None], ribbons.width[:, None]
    # A head of constant size on a very thin arrow would make noise look like a torque.
    grown = np.minimum(widths / (_FULL_HEAD_WIDTH * radius), 1.0)
    wider = (_HEAD_WIDER[0] - 1.0) * widths + _HEAD_WIDER[1] * radius * grown
    width = widths * shape.own + wider * shape.flare
    thickness = radius * np.maximum(_HEAD_THICKNESS * grown * shape.flare, _THICKNESS)
    thickness *= shape.own > 0  # the tip is a point
    # The shape of an arrow with a negative sign is flipped, so that its triangles face outward.
    out = radius[..., None] + thickness[..., None] / 2 * (1.0, 1.0, -1.0, -1.0)
    aside = (ribbons.sign[:, None] * width)[..., None] / 2 * (1.0, -1.0, -1.0, 1.0)
    angles = _angles(ribbons, shape.rings)
    outward = _directions(ribbons, np.cos(angles), np.sin(angles))
    corners = (  # coordinates, arrows, corners of rings
        ribbons.centre.T[..., None, None]
        + out * outward[..., None]
        + aside * ribbons.axes.T[2, ..., None, None]
    ).reshape(3, len(grid), -1)
    place_triangles(grid, *(corners[..., each] for each in shape.triangles.T))


@dataclass(frozen=True, eq=False)
class RibbonShape:
    """The shape that all round arrows with the same number of geoms share.

    A head is the surface between rectangles (cross sections) at increasing angles.

    Attributes:
        middle: angles from the tail to the center of each box, shape (b,), rad.
        half_angle: half of the angle that each box covers, shape (b,), rad.
        rings: angles from the tail to each rectangle of the heads, shape (r,), rad.
        own: factor of the ribbon width at each rectangle, shape (r,).
        flare: factor of the head protrusion at each rectangle, shape (r,).
        triangles: indices of the corners of each triangle among the 4 r corners of the rectangles,
            counterclockwise as seen from outside, shape (t, 3).
        dark: mask of the boxes and triangles that are dark in a striped arrow, shape (b + t,).
    """

    middle: Array
    half_angle: Array
    rings: Array
    own: Array
    flare: Array
    triangles: NDArray[np.intp]
    dark: NDArray[np.bool_]

    @property
    def geoms(self) -> int:
        return len(self.dark)


def _triangles_of(heads: int, steps: int) -> int:
    return heads * (8 * steps + 2) - 4


@cache
def ribbon_shape(budget: int) -> RibbonShape:
    """Returns the shape of round arrows with at most `budget` geoms.

    The budget must be at least six. With a small budget, arrows consist only of heads.
    """
    heads, steps = next(
        (heads, steps)
        for heads, steps in _HEADS
        if _triangles_of(heads, steps) + _FEWEST_BOXES <= budget or (heads, steps) == _HEADS[-1]
    )
    boxes = max(budget - _triangles_of(heads, steps), 0)
    tips = np.linspace(0.0, _ARC, heads + 1)
    counts = np.diff(np.linspace(0, boxes, heads + 1).round().astype(int))
    edges = [
        np.linspace(begin, end - _HEAD_ARC, count + 1)
        for begin, end, count in zip(tips, tips[1:], counts, strict=False)
    ]
    taper = np.tile(np.linspace(1.0, 0.0, steps + 1), heads)
    is_last = np.arange(len(taper)) >= (heads - 1) * (steps + 1)

    # The corners of a rectangle are in this order: outside on the first and on the second side,
    # inside on the second and on the first side. Triangles connect each edge of a rectangle to the
    # next rectangle. The last rectangle is a point.
    triangles, is_dark = [], []
    for head in range(heads):
        back = 4 * head * (steps + 1)
        triangles += [(back, back + 3, back + 2), (back, back + 2, back + 1)]
        is_dark += [False, False]
        for step in range(steps):
            for side in range(4):
                a, b = back + 4 * step + side, back + 4 * step + (side + 1) % 4
                triangles.append((a, b, b + 4))
                if (head, step) != (heads - 1, steps - 1):
                    triangles.append((a, b + 4, a + 4))
            is_dark += [step % 2 == 1] * (len(triangles) - len(is_dark))
    return RibbonShape(
        middle=np.concatenate([(edge[:-1] + edge[1:]) / 2 for edge in edges]),
        half_angle=np.concatenate([np.diff(edge) / 2 for edge in edges]),
        rings=np.repeat(tips[1:], steps + 1) - _HEAD_ARC * taper,
        # Only the last head ends in a point, so that the ribbon has no gaps.
        own=np.where(is_last, taper, _NECK + (1.0 - _NECK) * taper),
        flare=np.where(is_last, 1.0, _MARK_SIZE) * taper,
        triangles=np.array(triangles, np.intp),
        dark=np.append(np.arange(boxes) % 2 == 1, is_dark),
    )
