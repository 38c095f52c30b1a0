"""Computes sizes of arrows and axes, and loads of joints, from a compiled model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from .robot_dynamics import GRAVITY
from .solids import Solids, geom_boxes, geoms_of

# Fractions that define the minimum radius of an arrow: of the link length, and of half the length
# of the shorter body at the joint, up to a fraction of the robot's extent.
_SMALLEST, _OF_HALF, _OF_ROBOT = 0.12, 0.25, 0.05
_OF_SKIN = 0.12  # fraction of the robot's extent, as a skin may be thicker than the bodies in it
_STEP = 1.12  # ratio of successive radii in the search
_HEIGHT = 0.3  # height of an arrow, relative to its radius
_MAX_HIDDEN = 0.47  # maximum hidden fraction of an arrow, as links extend on one or two sides
# An arrow is enlarged by a factor of e only if this reduces its hidden fraction by the first value.
# Beyond `_LARGEST` times the link length, the reduction must be the sum of the first two values.
_PER_SIZE, _PER_LARGE, _LARGEST = 0.06, 0.2, 0.75
_NEIGHBOURS = 5  # number of nearest joints with arrows of similar size
_MAX_GROWTH = 1.4  # maximum factor by which an arrow is enlarged to resemble its neighbors
_MIN_WIDTH = 0.1  # minimum of `Sizes.full_width`
_AXES = 2.0  # length of axes relative to the arrow radius, so that they extend out of housings
_AT_ONE_PLACE = 0.02  # maximum distance of coincident joints, relative to the robot's extent
_MIN_SHARE = 0.02  # minimum load of a joint, relative to the largest load of the robot


class MeasuredBodies(NamedTuple):
    """The elements of a model that belong to a robot.

    Attributes:
        bodies: ids of the bodies.
        joints: ids of the hinge and slide joints, shape (n,).
        trunk: ids of the geoms of the world body that belong to the robot.
        centres: ids of the sites at the arrow centers, shape (n,); None for the joint anchors.
    """

    bodies: Ints
    joints: Ints
    trunk: Ints
    centres: Ints | None = None


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the arrows and axes of a robot, measured in a compiled model.

    Attributes:
        link: typical distance between adjacent joints, m.
        arrow_radius: smallest radii at which links do not hide the arrows, shape (n,), m.
        full_width: factor of the full widths of the arrows, shape (n,): 1, or less for joints that
            are close to each other.
        axes: lengths of the coordinate axes of the bodies that the joints move, shape (n,), m.
        load: approximate maximum gravity torques or forces of the joints, shape (n,), Nm or N.
    """

    link: float
    arrow_radius: Array
    full_width: Array
    axes: Array
    load: Array


def measure(model: mujoco.MjModel, data: mujoco.MjData, robot: MeasuredBodies) -> Sizes:
    """Computes the sizes of a robot's arrows and axes from data after `mj_fwdPosition`."""
    anchors = data.xanchor[robot.joints]
    low, high = boxes = geom_boxes(model, data)
    mine = geoms_of(model, robot.bodies, robot.trunk)
    extent = float((high[mine].max(axis=0) - low[mine].min(axis=0)).max()) if len(mine) else 0.0
    links = _link_lengths(model, robot, anchors, extent)
    link = _median(links)
    radius = _radii(model, data, robot, boxes, links, extent)
    apart = np.linalg.norm(anchors[:, None] - anchors, axis=2)
    apart[apart <= _AT_ONE_PLACE * extent] = np.inf
    width = np.clip(apart.min(axis=1) / radius, _MIN_WIDTH, 1.0)
    return Sizes(link, radius, width, _AXES * radius, _loads(model, data, robot, link))


def _median(values: Array) -> float:
    ordered = np.sort(values)  # np.median and np.unique import numpy.ma, which takes 25 ms.
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _radii(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: MeasuredBodies,
    boxes: tuple[Array, Array],
    links: Array,
    extent: float,
) -> Array:
    # The result is the smallest visible radius. It is rarely larger than the bodies that the joint
    # connects, and if possible similar to the radii of adjacent joints.
    axes = data.xaxis[robot.joints]
    anchors = data.xanchor[robot.joints] if robot.centres is None else data.site_xpos[robot.centres]
    solids = Solids(model, data)
    of_skin = _OF_SKIN * extent if model.nskin else 0.0
    tried, hidden, smallest = [], [], []
    half = _half_lengths(model, boxes, robot)
    for i, body in enumerate(model.jnt_bodyid[robot.joints]):
        beside = model.body_weldid[[body, model.body_parentid[body]]]
        lengths = [half[weld] for weld in beside.tolist() if weld in half] or [0.0]
        low = max(_SMALLEST * links[i], min(_OF_HALF * min(lengths), _OF_ROBOT * extent))
        high = max(*lengths, of_skin, low)
        count = int(np.ceil(np.log(high / low) / np.log(_STEP))) + 1
        radii = np.geomspace(low, high, count)
        height = _HEIGHT * np.sqrt(low * high)
        shares = solids.hidden_shares(anchors[i], axes[i], radii, height)
        large = _LARGEST * max(links[i], _median(links))
        cost = np.maximum(shares - _MAX_HIDDEN, 0.0) + _PER_SIZE * np.log(radii / low)
        cost += _PER_LARGE * np.maximum(np.log(radii / large), 0.0)
        best = min(int(cost.argmin()) + 1, count - 1)  # One more step clears the surface.
        tried.append(radii[best:])
        hidden.append(shares[best:])
        smallest.append(radii[best])
    radius = np.empty(len(links))
    for i, (radii, shares) in enumerate(zip(tried, hidden, strict=True)):
        near = np.argsort(np.linalg.norm(anchors - anchors[i], axis=1), kind="stable")[:_NEIGHBOURS]
        wanted = min(_median(np.array(smallest)[near]), _MAX_GROWTH * smallest[i])
        fits = radii[shares <= max(_MAX_HIDDEN, shares[0])]
        radius[i] = fits[np.abs(np.log(fits / wanted)).argmin()]
    return radius


def _half_lengths(
    model: mujoco.MjModel, boxes: tuple[Array, Array], robot: MeasuredBodies
) -> dict[int, float]:
    low, high = boxes
    bodies = model.jnt_bodyid[robot.joints]
    lengths = {}
    connected = [*bodies, *model.body_parentid[bodies]]
    for weld in sorted(set(model.body_weldid[connected].tolist())):
        welded = (model.body_weldid == weld).nonzero()[0]
        mine = geoms_of(model, welded, robot.trunk if weld == 0 else None)
        if len(mine):
            lengths[weld] = float((high[mine].max(axis=0) - low[mine].min(axis=0)).max()) / 2
    return lengths


def _link_lengths(
    model: mujoco.MjModel, robot: MeasuredBodies, anchors: Array, extent: float
) -> Array:
    # Link lengths are distances to the farther adjacent joint. Coincident joints count as one.
    row = {int(body): i for i, body in enumerate(model.jnt_bodyid[robot.joints])}
    before = np.full(len(anchors), -1)  # row of the parent joint
    for i, body in enumerate(model.jnt_bodyid[robot.joints]):
        at = int(body)
        while at and before[i] < 0:
            at = int(model.body_parentid[at])
            k = row.get(at, -1)
            if k >= 0 and np.linalg.norm(anchors[i] - anchors[k]) > _AT_ONE_PLACE * extent:
                before[i] = k
    links = np.zeros(len(anchors))
    for i in (before >= 0).nonzero()[0].tolist():
        step = float(np.linalg.norm(anchors[i] - anchors[before[i]]))
        links[i], links[before[i]] = max(links[i], step), max(links[before[i]], step)
    for i in range(len(anchors)):  # Coincident joints share the longest length.
        beside = np.linalg.norm(anchors - anchors[i], axis=1) <= _AT_ONE_PLACE * extent
        links[i] = max(links[i], float(links[beside].max()))
    known = links > 0
    links[~known] = _median(links[known]) if known.any() else extent / 2 or 0.2
    return links


def _loads(model: mujoco.MjModel, data: mujoco.MjData, robot: MeasuredBodies, link: float) -> Array:
    bodies = model.jnt_bodyid[robot.joints]
    mass = model.body_subtreemass[bodies]
    lever = np.linalg.norm(data.subtree_com[bodies] - data.xanchor[robot.joints], axis=1)
    hinge = model.jnt_type[robot.joints] == mujoco.mjtJoint.mjJNT_HINGE
    load = GRAVITY * mass * np.where(hinge, np.maximum(lever, 0.1 * link), 1.0)
    for kind in (hinge, ~hinge):
        if kind.any():
            load[kind] = np.maximum(load[kind], _MIN_SHARE * load[kind].max())
    return np.asarray(np.maximum(load, 1e-9))
