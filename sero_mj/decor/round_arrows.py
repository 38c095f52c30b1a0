"""Round arrows: they turn about their joint and show a value by direction, colour and width.

An arrow turns at constant speed, by the right-hand rule about the joint's z for a positive torque;
the colour shows the sign as well. Arrows of doubles are transparent and slightly smaller.

Width: with a limit, `arrow_radius` (times `arrow_width_scale` / 0.01) at the limit and proportional
to the square root of the value below it, so that 2 % of the limit has a seventh of the full width;
zero in the dead band, from which it grows to that within another one. Without a limit,
`arrow_width_scale` m per unit, or as wide as the radius at the joint's `arrow_load`. Beyond the
limit the ribbon is striped. An arrow is a ribbon of thin boxes along an arc; its heads, of
triangles, taper in width and in thickness, so that they are recognizable both from the side and
along the axis. Source: the paper's section 2.2; square root, dead band and stripes are additions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..frames import Array
from .axes import AXIS_RGB
from .feature import Feature, Frame
from .panels import Panels, labels_at
from .pen import ARROW_SIZE_OF_LENGTH, GREY, MAX_GEOMS, Kind, Pen

STRIPE_RGB = (0.08, 0.08, 0.09)
TURNING_SPEED = 1.6  # rad/s

_ARC = np.deg2rad(315.0)
_HEAD_ARC = np.deg2rad(46.0)
# How many heads there may be, and steps along the arc that each has, finest first. The last head is
# at the tip; wherever the joint's link hides one, another is seen.
_HEADS = ((3, 3), (3, 2), (2, 2), (2, 1), (1, 1))
_FEWEST_BOXES = 8  # of the ribbon, where there is more than one head
_MARK_SIZE = 0.7  # how far the heads before the last protrude, of what the last does
_NECK = 0.25  # width in front of these heads, of the ribbon's
_THICKNESS = 0.05  # of the radius
_HEAD_THICKNESS = 0.30  # of the radius, maximum thickness of the head
# Width of the head: factor of the ribbon's width, plus fraction of the radius.
_HEAD_WIDER = (1.5, 0.28)
# Ribbon width from which heads have full size (about 2 % of the limit), of the radius.
_FULL_HEAD_WIDTH = 0.14

# Orange and blue: distinct for all common kinds of colour blindness (Okabe and Ito 2008).
POSITIVE_RGBA = (0.93, 0.45, 0.02, 1.0)
NEGATIVE_RGBA = (0.02, 0.36, 0.78, 1.0)

DEFAULT_WIDTH_SCALE = 0.01  # the default of `arrow_width_scale`
INVISIBLE_WIDTH = 0.03  # of the radius; narrower arrows (0.1 % of a torque limit) are not drawn
WIDEST = 1.5  # of the radius

_STRAIGHT_LENGTH = 2.5  # of the radius, for the straight arrow of a prismatic joint
_Z_LENGTH, _Z_WIDTH = 1.9, 0.02  # of the radius, and of the length
DARKER = 0.4  # brightness of a straight arrow beyond its limit
ARROW_GEOMS, _FEWEST_ARROW_GEOMS = 92, 10  # bounds of the geoms of an arrow
_FEWEST_ON_PAGE = 6  # where pages show no more geoms than `MAX_GEOMS`
_GEOMS_FOR_THE_REST = 60  # geoms reserved for legend, status, names and smart arrows


def arrow_widths(
    values: Array, limit: Array, radius: Array, width_scale: Array, dead_band: Array
) -> NDArray[np.float64]:
    """Returns the width of the arrow of every joint.

    Args:
        values: values of the arrows, (N,); the sign is ignored.
        limit: value at which an arrow has full width, (N,); inf for none.
        radius: `arrow_radius` (N,), m.
        width_scale: `arrow_width_scale` (N,): m per unit of the value, and with a limit, of which
            `DEFAULT_WIDTH_SCALE` gives full width, a factor.
        dead_band: fraction of the limit below which the width is zero, (N,).

    Returns:
        (N,), m; continuous and monotone in the value, 0 up to the dead band and for NaN, at most
        `WIDEST` times the radius.
    """
    size = np.abs(values)
    size[~np.isfinite(size)] = 0.0
    limited = np.isfinite(limit)
    share = size / np.where(limited, limit, 1.0)
    band = np.maximum(dead_band, 1e-9)
    grown = np.minimum(np.maximum(share / band - 1.0, 0.0), 1.0)
    of_limit = radius * (width_scale / DEFAULT_WIDTH_SCALE) * np.sqrt(share) * grown
    return np.minimum(np.where(limited, of_limit, size * width_scale), WIDEST * radius)


class RoundArrows(Feature):
    """The arrows of one world's joints."""

    order = 90  # last, so that arrows are dropped first if the capacity is exceeded

    def lay_out(self, frame: Frame) -> None:
        """Adds the names of the z axes of joints that were clicked on, at their tips."""
        clicked = (frame.shown.arrows & frame.toggles.details).nonzero()[0]
        if not len(clicked):
            return
        joints, view = self.world.joints, frame.view
        sites = joints.centre_site[clicked]
        z = frame.data.site_xmat[sites].reshape(-1, 3, 3)[:, :, 2]
        length = _Z_LENGTH * joints.arrow_radius[clicked][:, None]
        tips, depth = view.project(frame.data.site_xpos[sites] + 1.1 * length * z)
        tips = tips[view.sees(tips, depth)]
        if len(tips):
            lines = [[b"z"] for _ in tips]
            frame.panels.append(Panels(*labels_at(view, tips, lines), lines))

    def draw(self, frame: Frame) -> None:
        """Draws an arrow for every joint that has a value and whose arrow is shown."""
        pen, data, shown = frame.pen, frame.data, frame.shown
        values, limit, stale = frame.arrow_values, frame.arrow_limit, frame.stale_joints
        joints = self.world.joints
        by_load = np.isinf(limit) & np.isfinite(joints.arrow_load)
        scale = np.where(by_load, joints.arrow_radius / joints.arrow_load, joints.arrow_width_scale)
        widths = arrow_widths(values, limit, joints.arrow_radius, scale, joints.arrow_dead_band)
        # Between close joints the full width is less, and so is what no arrow exceeds.
        narrow = joints.arrow_width_scale / DEFAULT_WIDTH_SCALE
        widest = WIDEST * joints.arrow_radius * np.where(by_load, np.minimum(narrow, 1.0), 1.0)
        widths = np.minimum(widths, widest)
        visible = shown.arrows & (widths > INVISIBLE_WIDTH * joints.arrow_radius)
        over = np.abs(values) > limit  # false for NaN
        rgba = np.where((values > 0)[:, None], POSITIVE_RGBA, NEGATIVE_RGBA)
        rgba[stale, :3] = GREY
        rgba[:, 3] = joints.arrow_alpha
        turning = (visible & joints.revolute).nonzero()[0]
        sliding = (visible & ~joints.revolute).nonzero()[0]
        if len(turning):
            sites = joints.centre_site[turning]
            sign = np.sign(values[turning])
            # The site turns with its link; subtracting q keeps the arrow's speed constant while its
            # joint moves.
            phase = TURNING_SPEED * data.time - joints.angles(data)[turning] * sign
            ribbons = Ribbons(
                items=turning,
                centre=data.site_xpos[sites],
                axes=data.site_xmat[sites].reshape(-1, 3, 3),
                phase=phase,
                sign=sign,
                radius=joints.arrow_radius[turning],
                width=widths[turning],
                rgba=rgba[turning],
                striped=over[turning],
            )
            draw_ribbons(pen, Kind.ARROW, ribbons, _budget(frame))
        clicked = (shown.arrows & frame.toggles.details).nonzero()[0]
        if len(clicked):
            self._draw_z(frame, clicked)
        if len(sliding):
            self._draw_straight(pen, data, sliding, (values, widths, over, rgba))

    def _draw_z(self, frame: Frame, index: NDArray[np.intp]) -> None:
        """Draws the z axis, about which positive torques turn, of joints that were clicked on."""
        joints, pen = self.world.joints, frame.pen
        sites = joints.centre_site[index]
        length = _Z_LENGTH * joints.arrow_radius[index][:, None]
        centre = frame.data.site_xpos[sites]
        rows = pen.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW))
        if len(rows):
            rows["pos"] = centre
            rows["mat"] = frame.data.site_xmat[sites].reshape(-1, 3, 3)
            rows["size"][:, :2] = _Z_WIDTH * length
            rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length[:, 0]
            rows["rgba"] = (*AXIS_RGB[2], 1.0)

    def _draw_straight(
        self,
        pen: Pen,
        data: mujoco.MjData,
        index: NDArray[np.intp],
        look: tuple[Array, Array, NDArray[np.bool_], Array],
    ) -> None:
        """Draws the force of prismatic joints: straight arrows along the axis, beside the link.

        An arrow is one geom and cannot be striped; beyond the limit it is dark.
        """
        forces, widths, over, rgba = (of_all[index] for of_all in look)
        joints = self.world.joints
        rows = pen.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW), Kind.ARROW, index)
        if not len(rows):
            return
        mat = data.site_xmat[joints.centre_site[index]].reshape(-1, 3, 3).copy()
        mat[:, :, 1:] *= np.sign(forces)[:, None, None]  # a half turn about x: still a rotation
        radius = joints.arrow_radius[index][:, None]
        length = _STRAIGHT_LENGTH * radius
        centre = data.site_xpos[joints.centre_site[index]]
        rows["pos"] = centre + radius * mat[:, :, 0] - length / 2 * mat[:, :, 2]
        rows["mat"] = mat
        rows["size"][:, :2] = (widths / 4)[:, None]
        rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length[:, 0]
        rgba[over, :3] *= DARKER
        rows["rgba"] = rgba


def _budget(frame: Frame) -> int:
    """Returns how many geoms an arrow may have, such that all fit into the host's capacity.

    It depends on the toggles and not on the values, which would make arrows flicker.
    """
    of_cards = sum(2 + len(lines) for cards in frame.cards for lines in cards.texts)
    others = 3 * int(np.count_nonzero(frame.shown.axes)) + of_cards
    is_page = len(frame.pen.rows) <= MAX_GEOMS
    room = (1 if is_page else 2) * MAX_GEOMS - _GEOMS_FOR_THE_REST - others
    budget = room // max(int(np.count_nonzero(frame.shown.arrows)), 1)
    fewest = _FEWEST_ON_PAGE if is_page else _FEWEST_ARROW_GEOMS
    return min(max(budget, fewest), frame.arrow_geoms)


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


def draw_ribbons(pen: Pen, kind: Kind, ribbons: Ribbons, budget: int) -> None:
    """Draws round arrows.

    Args:
        pen: where to.
        kind: kind of the items they belong to.
        ribbons: the arrows.
        budget: number of geoms that each arrow may have.
    """
    shape = ribbon_shape(budget)
    count, boxes = len(ribbons.items), len(shape.middle)
    box, triangle = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_TRIANGLE)
    rows = pen.take(count * shape.geoms, box, kind, np.repeat(ribbons.items, shape.geoms))
    if not len(rows):
        return
    grid = rows.reshape(count, shape.geoms)
    grid["rgba"] = ribbons.rgba[:, None]
    if ribbons.striped.any():
        grid["rgba"][..., :3] = np.where(
            (ribbons.striped[:, None] & shape.dark)[..., None], STRIPE_RGB, grid["rgba"][..., :3]
        )
    _place_boxes(grid[:, :boxes], ribbons, shape)
    grid["type"][:, boxes:] = triangle
    _place_heads(grid[:, boxes:], ribbons, shape)


def _outward(ribbons: Ribbons, along: Array) -> tuple[Array, Array]:
    """Returns unit vectors away from the axis, and along it turned by +90 degrees, (k, n, 3)."""
    angle = ribbons.sign[:, None] * (ribbons.phase[:, None] + along)
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = ribbons.axes[:, None, :, 0], ribbons.axes[:, None, :, 1]
    return cos * x + sin * y, cos * y - sin * x


def _place_boxes(grid: NDArray[Any], ribbons: Ribbons, shape: RibbonShape) -> None:
    """Sets the boxes of ribbons (k, boxes): width along the axis, thickness outward."""
    radius = ribbons.radius[:, None]
    outward, tangent = _outward(ribbons, shape.middle)
    grid["pos"] = ribbons.centre[:, None] + radius[..., None] * outward
    grid["mat"][..., 0] = outward
    grid["mat"][..., 1] = tangent
    grid["mat"][..., 2] = ribbons.axes[:, None, :, 2]
    grid["size"][..., 0] = _THICKNESS / 2 * radius
    # Adjacent boxes meet at the ribbon's outer edge.
    grid["size"][..., 1] = radius * (1.0 + _THICKNESS / 2) * np.tan(shape.half_angle)
    grid["size"][..., 2] = ribbons.width[:, None] / 2


def _place_heads(grid: NDArray[Any], ribbons: Ribbons, shape: RibbonShape) -> None:
    """Sets the triangles of heads (k, triangles): rectangles along the arc, and their sides."""
    radius, widths = ribbons.radius[:, None], ribbons.width[:, None]
    # A head of constant size on a very thin arrow would make noise look like a torque.
    grown = np.minimum(widths / (_FULL_HEAD_WIDTH * radius), 1.0)
    wider = (_HEAD_WIDER[0] - 1.0) * widths + _HEAD_WIDER[1] * radius * grown
    width = widths * shape.own + wider * shape.flare
    thickness = radius * np.maximum(_HEAD_THICKNESS * grown * shape.flare, _THICKNESS)
    thickness *= shape.own > 0  # the tip is a point
    # Corners of each rectangle: outer and inner edge, on one side and on the other. To the other
    # direction an arrow is turned about x, so that the outside of the triangles stays outside.
    out = radius[..., None] + thickness[..., None] / 2 * (1.0, 1.0, -1.0, -1.0)
    aside = (ribbons.sign[:, None] * width)[..., None] / 2 * (1.0, -1.0, -1.0, 1.0)
    outward, _ = _outward(ribbons, shape.rings)
    corners = (
        ribbons.centre[:, None, None]
        + out[..., None] * outward[:, :, None]
        + aside[..., None] * ribbons.axes[:, None, None, :, 2]
    ).reshape(len(grid), -1, 3)
    tops = corners[:, shape.triangles]
    grid["pos"] = tops[:, :, 0]
    edges = tops[:, :, 1:] - tops[:, :, :1]
    sizes = np.sqrt(np.einsum("ktej,ktej->kte", edges, edges))
    edges /= sizes[..., None]
    grid["size"][..., :2] = sizes
    grid["mat"][..., :2] = edges.swapaxes(2, 3)
    normal = np.cross(edges[:, :, 0], edges[:, :, 1])
    grid["mat"][..., 2] = normal / np.sqrt(np.einsum("ktj,ktj->kt", normal, normal))[..., None]


@dataclass(frozen=True, eq=False)
class RibbonShape:
    """What all round arrows of the same number of geoms have in common.

    Attributes:
        middle: angle of the centre of every box from the tail, (b,), rad.
        half_angle: half the angle of every box, (b,), rad.
        rings: angle of every rectangle of the heads, from a head's barbs to its tip, (r,), rad.
        own: factor of the ribbon's width there, (r,).
        flare: factor of how far a full head protrudes there, (r,).
        triangles: the three of the corners (4 r) that form each triangle, outside anticlockwise,
            (t, 3).
        dark: which boxes and triangles are dark where an arrow is striped, (b + t,) bool.
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
        """Number of geoms of an arrow."""
        return len(self.dark)


def _triangles_of(heads: int, steps: int) -> int:
    """Returns the number of triangles of the heads: sides and backs, without those of no area."""
    return heads * (8 * steps + 2) - 4


@cache
def ribbon_shape(budget: int) -> RibbonShape:
    """Returns the shape of round arrows of at most `budget` geoms, of which there are six at least.

    Heads come first: with little to spend, they are all that is drawn.
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

    # Corners of a rectangle are outside and inside on one side, and the same on the other, in a
    # loop; its sides go on to the next rectangle. The last rectangle is a point.
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
        # The last head ends in a point; those before it do not, so that the ribbon holds together.
        own=np.where(is_last, taper, _NECK + (1.0 - _NECK) * taper),
        flare=np.where(is_last, 1.0, _MARK_SIZE) * taper,
        triangles=np.array(triangles, np.intp),
        dark=np.append(np.arange(boxes) % 2 == 1, is_dark),
    )
