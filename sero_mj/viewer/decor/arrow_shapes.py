"""The shapes of arrows and axes, which are meshes: tubes with conical heads.

A round arrow consists of three tubes that follow each other about the z axis. Its mesh has radius
1. Scaling the mesh along z sets the width exactly. The depth of the tubes and the length of the
heads cannot be scaled. Therefore, there is a mesh for each of `RATIOS`, and an arrow uses the
nearest one.

In a `GeomBuffer`, an arrow has type `mjGEOM_MESH`, a rotation `mat`, and a `size` with the factors
that scale the mesh along its axes. `dataid` is `FIRST_SHAPE` plus the index in `shapes`.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools, Ints
from .geom_buffer import FIRST_SHAPE, GeomBuffer, Kind

# Ratios of width to radius for which there is a mesh of a round arrow.
RATIOS = np.geomspace(0.02, 1.0, 17)
# Number of tubes of a round arrow. If there were two, both links of a straight arm would hide both
# heads of its elbow at once.
COPIES = 3
_SWEEP = np.deg2rad(104.0)  # angle from the tail of a tube to the tip of its head
_TAIL = 0.9  # width of the tail, fraction of the width at the neck
_INSIDE = 0.94  # distance of the heads from the axis, fraction of the radius
_FULL_HEAD = 0.06  # ratio from which heads have the minimum size; thinner arrows have smaller heads
HEAD_BARBS = 0.02  # distance of the barbs behind the neck, fraction of the head length
_POINT = 0.01  # size of tips, fraction of the size of the surface; faces need an area
_LIFT = 0.006  # distance of the dark bands of striped arrows from the surface, widths

STRIPE_RGB = (0.08, 0.08, 0.09)

# Sizes of straight arrows, in units of the width of the shaft.
STRAIGHT_HEAD_WIDTH, STRAIGHT_HEAD_LENGTH = 2.3, 2.9
_STRAIGHT_TAIL = 0.6
LONGEST_HEAD = 0.5  # maximum length of the head of a straight arrow, fraction of its length
DARKER = 0.4  # brightness factor of a straight arrow beyond its limit
# Sizes of the head of an axis: fraction of its length, and factor of its width.
_AXIS_HEAD_LENGTH, _AXIS_HEAD_WIDTH = 0.16, 2.0


_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


class Detail(NamedTuple):
    """Numbers of faces of round arrows.

    Attributes:
        sides: sides of a tube; a multiple of 4, or the tube would be narrower than its width.
        head_sides: sides of a head, and of straight arrows and axes.
        tail: steps along the rounded tail.
        tube: steps along the tube.
        head: steps along the head.
        bands: first and last step of each dark band on the tube.
        head_bands: first and last step of each dark band on the head.
    """

    sides: int
    head_sides: int
    tail: int = 2
    tube: int = 7
    head: int = 3
    bands: tuple[tuple[int, int], ...] = ((1, 2), (3, 4), (5, 6))
    head_bands: tuple[tuple[int, int], ...] = ((1, 2),)


# The fewest faces with which the surface is within a pixel of the ideal one if an arrow is 200
# pixels wide.
THIN = Detail(8, 12)
THICK = Detail(12, 16, tail=3, head=4, head_bands=((1, 3),))
_THICK = 0.17  # ratio of width to radius from which arrows are thick
COARSE = Detail(4, 4, 1, 3, 1, ((1, 2),), ())  # for scenes in which each triangle is a geom


class Shape(NamedTuple):
    """A triangle mesh.

    Surfaces that meet at an edge share no vertices, because normals are smoothed at vertices.

    Attributes:
        vertices: shape (v, 3).
        faces: indices of vertices, counterclockwise as seen from outside, shape (f, 3).
    """

    vertices: Array
    faces: Ints


class _Rings(NamedTuple):
    # Ellipses along a curve: positions along it, and full sizes away from the axis and along it.
    along: Array
    depths: Array
    widths: Array

    def part(self, first: int, last: int) -> _Rings:
        return _Rings(*(each[first : last + 1] for each in self))


def depth_of(ratio: Array | float) -> Array:
    """Returns the depth of tubes, away from the axis, in radii for ratios of width to radius."""
    return np.asarray(0.7 * ratio / (1.0 + 0.6 * np.asarray(ratio)))


def _round_rings(ratio: float, detail: Detail) -> tuple[float, list[_Rings]]:
    """Returns the distance from the axis, and the rings of the tube, the back and the head."""
    depth, grown = float(depth_of(ratio)), min(ratio / _FULL_HEAD, 1.0)
    head_width, head_depth = 1.7 * ratio + 0.20 * grown, 1.5 * depth + 0.15 * grown
    distance = _INSIDE + head_depth / 2
    length = min(0.17 + 0.72 * head_width / distance, 0.9)  # rad
    barbs = _SWEEP - length
    neck = barbs + HEAD_BARBS * length
    # The tail is half an ellipsoid.
    turn = np.linspace(_POINT, np.pi / 2, detail.tail, endpoint=False)
    tail = _TAIL * ratio / 2 / distance * (1.0 - np.cos(turn))
    share = np.linspace(0.0, 1.0, detail.tube + 1)
    start = _TAIL * ratio / 2 / distance
    along = np.concatenate([tail, start + (neck - start) * share])
    size = np.concatenate([_TAIL * np.sin(turn), _TAIL + (1.0 - _TAIL) * share])
    cone = np.linspace(1.0, _POINT, detail.head + 1)
    tube = _Rings(along, depth * size, ratio * size)
    head = _Rings(_SWEEP - length * cone, head_depth * cone, head_width * cone)
    back = _Rings(
        np.array([neck, barbs]), np.array([depth, head_depth]), np.array([ratio, head_width])
    )
    return distance, [tube, back, head]


def round_arrow(ratio: float, detail: Detail) -> Shape:
    """Returns the round arrow of radius 1 with a ratio of width to radius, right-handed about z."""
    distance, (tube, *head) = _round_rings(ratio, detail)
    surfaces = [_bent(tube, distance, detail.sides)]
    return _copied(surfaces + [_bent(each, distance, detail.head_sides) for each in head])


def round_bands(ratio: float, detail: Detail) -> Shape:
    """Returns the dark bands of the striped round arrow with a ratio of width to radius."""
    distance, (tube, _, head) = _round_rings(ratio, detail)
    bands = [
        (tube.part(detail.tail + first, detail.tail + last), detail.sides)
        for first, last in detail.bands
    ]
    bands += [(head.part(*each), detail.head_sides) for each in detail.head_bands]
    return _copied(
        [
            _bent(
                _Rings(each.along, each.depths + _LIFT * ratio, each.widths + _LIFT * ratio),
                distance,
                sides,
            )
            for each, sides in bands
        ]
    )


def straight_shaft(detail: Detail) -> Shape:
    """Returns the shaft of a straight arrow from z = 0 to 1, of width 1 at its front end."""
    sections = ([0.0, 0.0], [_POINT, _STRAIGHT_TAIL]), ([0.0, 1.0], [_STRAIGHT_TAIL, 1.0])
    return _joined([_upright(*each, detail) for each in sections])


def straight_head(detail: Detail) -> Shape:
    """Returns the head of a straight arrow from z = 0 to 1, of width 1 at its barbs."""
    sections = ([HEAD_BARBS, 0.0], [_POINT, 1.0]), ([0.0, 1.0], [1.0, _POINT])
    return _joined([_upright(*each, detail) for each in sections])


def axis_bar(detail: Detail) -> Shape:
    """Returns the bar of a coordinate axis from z = 0 to 1 with a shaft of width 1."""
    neck = 1.0 - _AXIS_HEAD_LENGTH
    sections = (
        ([0.0, 0.0], [_POINT, 1.0]),
        ([0.0, neck], [1.0, 1.0]),
        ([neck, neck], [1.0, _AXIS_HEAD_WIDTH]),
        ([neck, 1.0], [_AXIS_HEAD_WIDTH, _POINT]),
    )
    return _joined([_upright(*each, detail) for each in sections])


@cache
def shapes(detail: Detail | None = None) -> tuple[Shape, ...]:
    """Returns all meshes: round arrows and bands by `RATIOS`, then `SHAFT`, `HEAD` and `AXIS`.

    Args:
        detail: numbers of faces (default: `THIN` or `THICK`, depending on the ratio).
    """
    found = [
        make(ratio, detail or (THIN if ratio < _THICK else THICK))
        for make in (round_arrow, round_bands)
        for ratio in RATIOS.tolist()
    ]
    straight = detail or THIN
    return (*found, straight_shaft(straight), straight_head(straight), axis_bar(straight))


BANDS = len(RATIOS)  # index of the first bands in `shapes`
SHAFT, HEAD, AXIS = 2 * BANDS, 2 * BANDS + 1, 2 * BANDS + 2


def nearest_ratio(ratios: Array) -> Ints:
    """Returns the indices of the nearest `RATIOS`, shape (k,), for ratios of width to radius."""
    steps = (len(RATIOS) - 1) / np.log(RATIOS[-1] / RATIOS[0])
    index = np.rint(steps * np.log(np.maximum(ratios, RATIOS[0]) / RATIOS[0]))
    return np.asarray(np.minimum(index, len(RATIOS) - 1), np.intp)


@cache
def shapes_model() -> mujoco.MjModel:
    """Returns a model whose meshes are `shapes`, for renderers.

    It is not part of any world, so that exported files do not contain these meshes.
    """
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(size=[0.1, 0.1, 0.1])  # a renderer needs an extent
    for k, (vertices, faces) in enumerate(shapes()):
        mesh = spec.add_mesh(name=str(k), uservert=vertices.ravel(), userface=faces.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # bands have no volume
    model = spec.compile()
    model.vis.global_.offwidth = model.vis.global_.offheight = 16
    model.vis.quality.shadowsize = model.vis.quality.offsamples = 0
    turn = np.empty(9)
    for k, (vertices, _) in enumerate(shapes()):
        # The compiler moves each mesh to its center of mass and principal axes.
        first, count = int(model.mesh_vertadr[k]), len(vertices)
        model.mesh_vert[first : first + count] = vertices
        mujoco.mju_quat2Mat(turn, model.mesh_quat[k])
        first, count = int(model.mesh_normaladr[k]), int(model.mesh_normalnum[k])
        normals = model.mesh_normal[first : first + count]
        model.mesh_normal[first : first + count] = normals @ turn.reshape(3, 3).T
    return model


def _bent(rings: _Rings, distance: float, sides: int) -> NDArray[np.float64]:
    # Returns ellipses about a circle, shape (n, sides, 3).
    turn = -np.arange(sides) * 2.0 * np.pi / sides  # faces are on the outer side
    out = distance + rings.depths[:, None] / 2 * np.cos(turn)
    cos, sin = np.cos(rings.along)[:, None], np.sin(rings.along)[:, None]
    return np.stack([out * cos, out * sin, rings.widths[:, None] / 2 * np.sin(turn)], axis=2)


def _upright(heights: list[float], widths: list[float], detail: Detail) -> NDArray[np.float64]:
    # Returns circles about the z axis, shape (n, sides, 3).
    turn = np.arange(detail.head_sides) * 2.0 * np.pi / detail.head_sides
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(detail.head_sides)], axis=1) / 2
    return np.array(widths)[:, None, None] * circle + np.array(heights)[:, None, None] * (0, 0, 1)


def _copied(surfaces: list[NDArray[np.float64]]) -> Shape:
    copies = []
    for angle in np.arange(COPIES) * 2.0 * np.pi / COPIES:
        cos, sin = np.cos(angle), np.sin(angle)
        turned = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        copies += [each @ turned for each in surfaces]
    return _joined(copies)


def _joined(surfaces: list[NDArray[np.float64]]) -> Shape:
    vertices, faces, count = [], [], 0
    for surface in surfaces:
        rings, sides = surface.shape[:2]
        index = count + np.arange(rings * sides).reshape(rings, sides)
        beside = np.roll(index, -1, axis=1)
        a, b, c, d = index[:-1], beside[:-1], beside[1:], index[1:]
        faces += [np.stack(half, axis=-1).reshape(-1, 3) for half in ((a, b, c), (a, c, d))]
        vertices.append(surface.reshape(-1, 3))
        count += rings * sides
    return Shape(np.concatenate(vertices), np.concatenate(faces))


def draw_round(
    buffer: GeomBuffer,
    kind: Kind,
    items: Ints,
    *,
    centre: Array,
    axes: Array,
    phase: Array,
    sign: Array,
    radius: Array,
    width: Array,
    rgba: Array,
    striped: Bools,
) -> None:
    """Draws k round arrows, with one geom each and another one for stripes.

    Args:
        items: index of the item that each arrow shows, shape (k,).
        centre: centers of the arrows, shape (k, 3), m.
        axes: orientations of the arrows, which run around the z axes, shape (k, 3, 3).
        phase: angle from x to the tail of the arrow in its direction, shape (k,), rad.
        sign: direction, 1 for the right-hand rule or -1 for the opposite direction, shape (k,).
        radius: radii of the arrows, shape (k,), m.
        width: maximum widths of the tubes, shape (k,), m.
        rgba: colors, shape (k, 4).
        striped: mask of arrows that are striped because their values exceed the limit, shape (k,).
    """
    count, over = len(items), striped.nonzero()[0]
    index = np.concatenate([np.arange(count), over])
    rows = buffer.take(len(index), _MESH, kind, items[index])
    if not len(rows):
        return
    ratio = nearest_ratio(width / radius)
    turned = np.zeros((count, 3, 3))
    turned[:, 0, 0], turned[:, 0, 1] = np.cos(phase), -np.sin(phase)
    # For the negative direction, the arrow is rotated by 180 deg about x.
    turned[:, 1, 0], turned[:, 1, 1] = sign * np.sin(phase), sign * np.cos(phase)
    turned[:, 2, 2] = sign
    size = np.stack([radius, radius, width / RATIOS[ratio]], axis=1)
    rows["dataid"] = FIRST_SHAPE + np.concatenate([ratio, BANDS + ratio[over]])
    rows["pos"], rows["mat"], rows["size"] = centre[index], (axes @ turned)[index], size[index]
    rows["rgba"] = rgba[index]
    rows["rgba"][count:, :3] = STRIPE_RGB


def draw_straight(
    buffer: GeomBuffer,
    kind: Kind,
    items: Ints,
    *,
    start: Array,
    axes: Array,
    length: Array,
    width: Array,
    rgba: Array,
    over: Bools | None = None,
    emission: float | None = None,
) -> None:
    """Draws k straight arrows with two geoms each.

    Args:
        items: index of the item that each arrow shows, shape (k,).
        start: tails of the arrows, shape (k, 3), m.
        axes: orientations of the arrows, which point along the z axes, shape (k, 3, 3).
        length: lengths of the arrows, shape (k,), m.
        width: widths of the shafts at the head, shape (k,), m.
        rgba: colors, shape (k, 4).
        over: mask of the arrows that are dark because their values exceed the limit, shape (k,).
        emission: emission of the geoms (default: that of the buffer).
    """
    rows = buffer.take(2 * len(items), _MESH, kind, np.repeat(items, 2))
    if not len(rows):
        return
    head = np.minimum(STRAIGHT_HEAD_LENGTH * width, LONGEST_HEAD * length)
    grid = rows.reshape(-1, 2)
    grid["dataid"] = FIRST_SHAPE + SHAFT, FIRST_SHAPE + HEAD
    grid["mat"] = axes[:, None]
    grid["pos"] = start[:, None]
    grid["pos"][:, 1] += axes[:, :, 2] * (length - head)[:, None]
    grid["size"][:, 0] = np.stack([width, width, length - (1.0 - HEAD_BARBS) * head], axis=1)
    barbs = STRAIGHT_HEAD_WIDTH * width
    grid["size"][:, 1] = np.stack([barbs, barbs, head], axis=1)
    grid["rgba"] = rgba[:, None]
    if over is not None:
        grid["rgba"][over, :, :3] *= DARKER
    if emission is not None:
        rows["emission"] = emission
