"""Measures the robots of an external model: limits and loads of joints, sizes of their decor."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ..assemble.robot_dynamics import GRAVITY
from ..frames import Array, Ints
from ._model_trees import ON_JOINT, Tree
from ._surfaces import surface

_FIXED_GAIN, _NO_BIAS = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)
_CLEAR = 1.45  # radius of an arrow over that of the housing it encloses
# Bounds of an arrow's radius, fractions of the link length.
_SMALLEST, _LARGEST = 0.12, 0.5
_AXES = 2.0  # length of axes over the radius of arrows, so that they extend out of the housings
_OF_PARENT = 1.4  # largest considered ratio of the housing of the parent to that of the moving body
# Half the length along the axis in which the housing is measured, fraction of the link length.
_SLAB = 0.2
_SECTORS = 12
_AT_ONE_PLACE = 0.02  # of the robot's extent
_LEAST_SHARE = 0.02  # minimum load of a joint, fraction of the largest load of the robot


def torque_limits(model: mujoco.MjModel, joints: Ints) -> Array:
    """Returns the torque limits of joints, (n,), Nm or N; inf where the model states none.

    The lower of the joint's `actuatorfrcrange` and the `forcerange` of its actuators (for a motor
    without one its `ctrlrange`) times their gear.
    """
    limits = np.full(len(joints), np.inf)
    for i, joint in enumerate(joints):
        mine = np.isin(model.actuator_trntype, ON_JOINT) & (model.actuator_trnid[:, 0] == joint)
        if mine.any():
            limits[i] = sum(_actuator_limit(model, int(k)) for k in mine.nonzero()[0])
        if model.jnt_actfrclimited[joint]:
            limits[i] = min(limits[i], np.abs(model.jnt_actfrcrange[joint]).max())
    return np.where(limits > 0, limits, np.inf)


def _actuator_limit(model: mujoco.MjModel, actuator: int) -> float:
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    is_motor = model.actuator_gaintype[actuator] == _FIXED_GAIN
    is_motor &= model.actuator_biastype[actuator] == _NO_BIAS
    if is_motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gear * gain * float(np.abs(model.actuator_ctrlrange[actuator]).max())
    return float("inf")


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of a robot's decor.

    Attributes:
        link: typical distance of neighbouring joints, m.
        arrow_radius: (n,), m; larger than the housing that the arrow encloses.
        axes: length of the coordinate axes of the body that each joint moves, (n,), m.
        load: approximate maximum gravity load of each joint, (n,), Nm or N: the weight it
            carries times its distance.
    """

    link: float
    arrow_radius: Array
    axes: Array
    load: Array


def measure(model: mujoco.MjModel, data: mujoco.MjData, tree: Tree) -> Sizes:
    """Computes the sizes of a robot's decor.

    Args:
        model: compiled.
        data: in the pose to measure, after `mj_fwdPosition`.
        tree: the robot.
    """
    anchors, axes = data.xanchor[tree.joints], data.xaxis[tree.joints]
    points, of_body = surface(model, data, tree.bodies, tree.trunk)
    bodies = model.jnt_bodyid[tree.joints]
    parents = model.body_parentid[bodies]
    links = _link_lengths(model, tree, anchors, points)
    link = float(np.median(links))
    radius = np.empty(len(tree.joints))
    for i in range(len(tree.joints)):
        own, other = (
            _housing_radius(points[of_body == around] - anchors[i], axes[i], _SLAB * links[i])
            for around in (bodies[i], parents[i])
        )
        # A finger is thinner than its palm; a body without a surface counts as part of its parent.
        housing = max(own, min(other, _OF_PARENT * own)) if own > 0 else other
        most = _LARGEST * max(links[i], link)
        radius[i] = np.clip(_CLEAR * housing, _SMALLEST * links[i], most)
    return Sizes(link, radius, _AXES * radius, _loads(model, data, tree, link))


def _link_lengths(model: mujoco.MjModel, tree: Tree, anchors: Array, points: Array) -> Array:
    """Returns every joint's distance to the farther of its neighbours in the tree, (n,), m.

    Joints that coincide, as in a wrist or a hip, count as one.
    """
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    row = {int(body): i for i, body in enumerate(model.jnt_bodyid[tree.joints])}
    before = np.full(len(anchors), -1)  # the parent joint of each
    for i, body in enumerate(model.jnt_bodyid[tree.joints]):
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
    for i in range(len(anchors)):  # coinciding joints share the longest
        beside = np.linalg.norm(anchors - anchors[i], axis=1) <= _AT_ONE_PLACE * extent
        links[i] = max(links[i], float(links[beside].max()))
    known = links > 0
    links[~known] = np.median(links[known]) if known.any() else extent / 2 or 0.2
    return links


def _housing_radius(points: Array, axis: Array, slab: float) -> float:
    """Returns the radius of a body about an axis on most sides; links extend on one or two, m.

    Args:
        points: of its surface, relative to the joint's anchor, (k, 3), m.
        axis: unit vector (3,).
        slab: half the length along the axis in which points count, m.
    """
    along = points @ axis
    across = points - along[:, None] * axis
    near = np.abs(along) <= slab
    if not near.any():
        return 0.0
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    angle = np.arctan2(across[near] @ np.cross(axis, side), across[near] @ side)
    sector = np.floor((angle / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    reach = np.zeros(_SECTORS)
    np.maximum.at(reach, sector, np.linalg.norm(across[near], axis=1))
    if not reach.any():
        return 0.0
    return float(np.median(reach)) or float(reach[reach > 0].min())


def _loads(model: mujoco.MjModel, data: mujoco.MjData, tree: Tree, link: float) -> Array:
    bodies = model.jnt_bodyid[tree.joints]
    mass = model.body_subtreemass[bodies]
    lever = np.linalg.norm(data.subtree_com[bodies] - data.xanchor[tree.joints], axis=1)
    hinge = model.jnt_type[tree.joints] == mujoco.mjtJoint.mjJNT_HINGE
    load = GRAVITY * mass * np.where(hinge, np.maximum(lever, 0.1 * link), 1.0)
    for kind in (hinge, ~hinge):
        if kind.any():
            load[kind] = np.maximum(load[kind], _LEAST_SHARE * load[kind].max())
    return np.asarray(np.maximum(load, 1e-9))
