"""Generates link shapes from joint frames, for robots without meshes.

Each link has a cylinder about the axis of its revolute joint, or a rod if its joint is prismatic.
The rod slides through a box on the previous link. Capsules connect the joints. Sizes are positive
and in proportion to the reach. Trims are decorative covers on housings, collars on links, and a
flange. They have no mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from ...base.frames import Array
from ..kinematics.dh import DhTable
from ..kinematics.joint_tree import JointTree

SHELL = (0.93, 0.93, 0.91, 1.0)
JOINT = (0.36, 0.38, 0.41, 1.0)
_SEAM = (0.20, 0.21, 0.23, 1.0)
_STEEL = (0.62, 0.64, 0.66, 1.0)

_RADIUS_OF_REACH = 0.05
_SMALLEST_REACH = 0.05  # minimum reach in m, so that the joints of an all-zero DH table are visible
# Ratio of the radii of the last and the first link. With 1, nested joints would share surfaces.
_TAPER = 0.55
_HALF_HOUSING = 1.25  # half the length of a housing, in radii
_CLEAR_OF_HOUSING = 1.7  # ring radius in housing radii; the ends of the housing are at 1.6
_SHORTEST_SEGMENT = 1e-6  # m


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A generated primitive shape in the frame of a link.

    Attributes:
        size: radius of a capsule or cylinder, shape (1,), or half lengths of a box, shape (3,), m.
        ends: end points of the axis of the shape, shape (2, 3), m.
    """

    kind: Literal["capsule", "cylinder", "box"]
    size: Array
    ends: Array
    rgba: tuple[float, float, float, float]


def housing_radii(
    table: JointTree, flange_frame: Array, strokes: Array | None = None, flange_link: int = -1
) -> Array:
    """Returns the radii of the generated joint housings, shape (n,), m.

    `strokes` contains the maximum extensions of the joints, shape (n,), m. They determine the size
    of robots without link lengths, such as gantries.
    """
    steps, depths = table.step_lengths(), table.depths
    if strokes is not None:
        steps = np.maximum(steps, strokes)
    along = table.path_lengths(steps)
    along[flange_link] += float(np.linalg.norm(flange_frame[:3, 3]))
    reach = max(float(along.max()), _SMALLEST_REACH)
    longest = max(float(steps.max()), _SMALLEST_REACH / depths.max())
    # The link length limits the radius in chains of many short links.
    radius = min(_RADIUS_OF_REACH * reach, 0.4 * longest)
    return np.asarray(radius * np.linspace(1.0, _TAPER, depths.max())[depths - 1])


def clear_radii(table: JointTree, radii: Array) -> Array:
    """Returns radii of rings about the joint axes that do not touch housings, shape (n,), m.

    The housings of intersecting axes, as in a shoulder or wrist, overlap. Their rings are larger
    than the largest of these housings. `radii` contains the radii of all housings, shape (n,), m.
    """
    axes, centres = table.joint_axes(table.frames(np.zeros(len(table))))
    if isinstance(table, DhTable) and table.turns_in_carrier:
        lifted = np.where(table.revolute, table.d, 0.0) * table.signs
        centres = centres + lifted[:, None] * axes
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    is_near = apart < np.hypot(1.0, _HALF_HOUSING) * radii
    return np.asarray(_CLEAR_OF_HOUSING * np.where(is_near, radii, 0.0).max(axis=1))


def generate_shapes(
    table: JointTree,
    flange_frame: Array,
    strokes: Array | None = None,
    flange_link: int = -1,
) -> list[list[LinkShape]]:
    """Returns the generated shapes of the base and of each link, in the frames of the links.

    The arguments are those of `housing_radii`. The rod of a prismatic joint is at least as long as
    the stroke, so that it does not leave its housing.
    """
    n = len(table)
    strokes = np.zeros(n) if strokes is None else strokes
    housings = housing_radii(table, flange_frame, strokes, flange_link)
    links: list[list[LinkShape]] = [[] for _ in range(n + 1)]
    for i, parent in enumerate(table.carriers.tolist()):
        near, far = _segments(table, i, max(strokes[i], 2 * _HALF_HOUSING * housings[i]))
        before, housing = _capsules(near, housings[i]), _housing(table, i, housings[i])
        if not table.revolute[i]:
            before.append(housing)
        links[parent] += _on_root(before, table.root) if parent == 0 else before
        own = housings[i + 1] if i + 1 < n else housings[i] * 0.9
        links[i + 1] += _capsules(far, own)
        if table.revolute[i]:
            links[i + 1].append(housing)
    end = housings[flange_link - 1 if flange_link > 0 else -1] * 0.9
    links[flange_link] += _capsules(np.array([np.zeros(3), flange_frame[:3, 3]]), end)
    links[0] = [*map(_above_ground, links[0]), _pedestal(housings[0])]
    return links


def trims(
    links: list[list[LinkShape]], flange_frame: Array, flange_link: int
) -> list[list[LinkShape]]:
    """Returns decorative covers, collars and a flange for generated links, without mass."""
    found = [[trim for shape in link for trim in _trims_of(shape)] for link in links]
    own = [shape for shape in links[flange_link] if shape.kind != "box"] or links[0]
    radius = 0.8 * min(float(shape.size[0]) for shape in own)
    end, axis = flange_frame[:3, 3], flange_frame[:3, 2]
    for rgba, size, start in ((_STEEL, radius, 0.30), (_SEAM, 0.9 * radius, 0.42)):
        ends = np.array([end - start * radius * axis, end])
        ends[1] -= (0.0 if rgba is _STEEL else 0.2) * radius * axis
        found[flange_link].append(LinkShape("cylinder", np.array([size]), ends, rgba))
    return found


def _trims_of(shape: LinkShape) -> list[LinkShape]:
    start, end = shape.ends
    length = float(np.linalg.norm(end - start))
    radius = float(shape.size[0])
    axis = (end - start) / length
    if shape.kind == "cylinder" and length > radius:  # The pedestal has no covers.
        covers = []
        for face, out in ((start, -axis), (end, axis)):
            for rgba, size, high in ((SHELL, 0.84, 0.10), (_SEAM, 0.50, 0.13)):
                ends = np.array([face - 0.05 * radius * out, face + high * radius * out])
                covers.append(LinkShape("cylinder", np.array([size * radius]), ends, rgba))
        return covers
    from_end, wide = 1.7 * radius, 0.30 * radius
    if shape.kind != "capsule" or length < 2 * from_end + 4 * wide:
        return []
    collars = []
    for place, inwards in ((start, axis), (end, -axis)):
        for rgba, size, begin, high in ((SHELL, 1.14, 0.0, 1.0), (_SEAM, 1.06, 1.0, 1.25)):
            ends = place + np.outer(from_end + wide * np.array([begin, high]), inwards)
            collars.append(LinkShape("cylinder", np.array([size * radius]), ends, rgba))
    return collars


def _above_ground(shape: LinkShape) -> LinkShape:
    start, end = shape.ends
    length = float(np.linalg.norm(end - start))
    if shape.kind != "capsule" or start.any() or length <= shape.size[0]:
        return shape
    return replace(shape, ends=np.array([shape.size[0] / length * end, end]))


def _on_root(shapes: list[LinkShape], root: Array | None) -> list[LinkShape]:
    if root is None:
        return shapes
    moved = [replace(s, ends=s.ends @ root[:3, :3].T + root[:3, 3]) for s in shapes]
    radius = float(np.min(shapes[0].size)) if shapes else 0.0
    way = np.array([np.zeros(3), root[:3, 3]])
    return [*moved, *(_capsules(way, radius / 0.8) if radius else [])]


def _segments(table: JointTree, i: int, rod: float) -> tuple[Array, Array]:
    """Returns two polylines that connect the parent frame of joint i to the frame that it moves.

    The first is fixed in the parent frame, and includes the offset d along the joint axis. The
    second is fixed in the moving frame, and includes the rod of a prismatic joint.
    """
    zero = np.zeros(3)
    if not isinstance(table, DhTable):
        rod = 0.0 if table.revolute[i] else rod
        way = np.array([zero, table.transforms(np.zeros(len(table)))[i, :3, 3]])
        return way, np.array([[0, 0, -rod], zero])
    a, d, alpha = table.a[i], table.d[i], table.alpha[i]
    along_x, along_z = np.array([a, 0.0, 0.0]), np.array([0.0, 0.0, d])
    rod = 0.0 if table.revolute[i] else float(np.copysign(rod, d))
    if table.convention == "craig":
        z_next = np.array([0.0, -np.sin(alpha), np.cos(alpha)])
        return np.array([zero, along_x, along_x + d * z_next]), np.array([[0, 0, -rod], zero])
    # In the standard convention, Rz(theta) Tz(d) precedes Tx(a) Rx(alpha), so a is along x of
    # frame i + 1.
    z_joint = np.array([0.0, np.sin(alpha), np.cos(alpha)])
    return np.array([zero, along_z]), np.array([-along_x - rod * z_joint, -along_x, zero])


def _capsules(points: Array, radius: float) -> list[LinkShape]:
    return [
        LinkShape("capsule", np.array([0.8 * radius]), np.array([start, end]), SHELL)
        for start, end in pairwise(points)
        if np.linalg.norm(end - start) > _SHORTEST_SEGMENT
    ]


def _housing(table: JointTree, i: int, radius: float) -> LinkShape:
    """Returns the housing about the axis of joint i, at the end of the offset d.

    The housing of a revolute joint moves with frame i + 1. The housing of a prismatic joint is
    fixed in the parent frame, and the rod passes through it.
    """
    axis, centre = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    if not isinstance(table, DhTable):
        if not table.revolute[i]:
            T = table.transforms(np.zeros(len(table)))[i]
            axis, centre = T[:3, 2], T[:3, 3]
        return _housing_shape(bool(table.revolute[i]), axis, centre, radius)
    alpha, a, d = table.alpha[i], table.a[i], table.d[i]
    if table.convention == "craig" and not table.revolute[i]:
        axis = np.array([0.0, -np.sin(alpha), np.cos(alpha)])
        centre = np.array([a, 0.0, 0.0]) + d * axis
    elif table.convention == "standard" and not table.revolute[i]:
        centre = d * axis
    elif table.convention == "standard":
        axis, centre = np.array([0.0, np.sin(alpha), np.cos(alpha)]), np.array([-a, 0.0, 0.0])
    return _housing_shape(bool(table.revolute[i]), axis, centre, radius)


def _housing_shape(turns: bool, axis: Array, centre: Array, radius: float) -> LinkShape:
    half = _HALF_HOUSING * radius * axis
    ends = np.array([centre - half, centre + half])
    if turns:
        return LinkShape("cylinder", np.array([radius]), ends, JOINT)
    return LinkShape("box", np.array([radius, radius, _HALF_HOUSING * radius]), ends, JOINT)


def _pedestal(radius: float) -> LinkShape:
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5 * radius]])
    return LinkShape("cylinder", np.array([1.5 * radius]), ends, JOINT)
