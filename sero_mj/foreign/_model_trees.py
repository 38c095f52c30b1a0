"""Finds the robots in an external model, and measures them for the sizes of their decor.

A robot is a kinematic tree with hinge or slide joints: one child of the world and all of its
descendants. Free and ball joints have no single axis and therefore no arrow.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from ..assemble.robot_dynamics import GRAVITY
from ..frames import Array, Ints

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_DIRECT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED_GAIN, _NO_BIAS = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)
_RESERVED = ("world", "toggles")  # reserved names in routes
_CLEAR = 1.45  # radius of an arrow over that of the housing it encloses
# Bounds of an arrow's radius, fractions of the link length.
_SMALLEST, _LARGEST = 0.12, 0.5
_AXES = 2.0  # length of axes over the radius of arrows, so that they extend out of the housings
_OF_PARENT = 1.4  # largest considered ratio of the housing of the parent to that of the moving body
# Half the length along the axis in which the housing is measured, fraction of the link length.
_SLAB = 0.2
_SECTORS = 12
_MOST_POINTS = 1500  # of a mesh
_SHOWN_GROUPS = 3  # MuJoCo shows the groups 0 to 2
_AT_ONE_PLACE = 0.02  # of the robot's extent
_LEAST_SHARE = 0.02  # minimum load of a joint, fraction of the largest load of the robot
_ROUND = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_RING = np.stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros(len(_ROUND))], axis=1)
_TYPES = mujoco.mjtGeom


@dataclass(frozen=True, eq=False)
class Tree:
    """One kinematic tree.

    Attributes:
        name: of the root body, made unique and valid in routes.
        bodies: ids, parents before children, the root first.
        joints: ids of its hinges and slides, (n,).
        joint_names: without their common scope, n.
        chain: indices of the joints between the root and the first branch; these move the
            tool of a serial arm.
        last: id of the body at the end of that chain.
    """

    name: str
    bodies: Ints
    joints: Ints
    joint_names: list[str]
    chain: Ints
    last: int


def find_trees(model: mujoco.MjModel) -> list[Tree]:
    """Returns all trees of a model that have a hinge or a slide, in the order of their bodies."""
    trees: list[Tree] = []
    single = np.isin(model.jnt_type, (_HINGE, _SLIDE))
    tree_of_joint = model.body_rootid[model.jnt_bodyid]
    for root in np.unique(tree_of_joint[single]):
        bodies = (model.body_rootid == root).nonzero()[0]
        joints = (single & (tree_of_joint == root)).nonzero()[0]
        chain, last = _serial_part(model, int(root), joints)
        name = _unlike(_as_name(model.body(int(root)).name), [tree.name for tree in trees])
        trees.append(Tree(name, bodies, joints, _joint_names(model, joints), chain, last))
    return trees


def _as_name(text: str) -> str:
    """Converts a body's name to a valid name of a robot."""
    name = re.sub(r"[^A-Za-z0-9_-]", "_", text.strip("/"))
    if not name:
        return "robot"
    return name if re.match(r"[A-Za-z_]", name) else f"_{name}"


def _unlike(name: str, taken: Iterable[str]) -> str:
    """Returns the name, with a number appended if it is taken."""
    taken = {*taken, *_RESERVED}
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}{number}", number + 1
    return candidate


def _joint_names(model: mujoco.MjModel, joints: Ints) -> list[str]:
    """Returns the names of joints; an unnamed joint has its body's name, else its number."""
    names: list[str] = []
    for joint in joints:
        name = model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name
        names.append(_unlike(name or f"joint{joint}", names))
    return without_scope(names)


def without_scope(names: list[str]) -> list[str]:
    """Returns names without their common scopes (`jaco/` in `jaco/hand/finger_1`)."""
    split = [name.split("/") for name in names]
    common, most = 0, min((len(parts) - 1 for parts in split), default=0)
    while common < most and len({parts[common] for parts in split}) == 1:
        common += 1
    return ["/".join(parts[common:]) for parts in split]


def _serial_part(model: mujoco.MjModel, root: int, joints: Ints) -> tuple[Ints, int]:
    """Returns the joints from the root to the first branch, and the last body of that chain."""
    moving = set(model.jnt_bodyid[joints].tolist())
    below: dict[int, list[int]] = {}  # children that have joints or descendants with joints
    carries = set(moving)
    for body in range(model.nbody - 1, 0, -1):
        if body in carries:
            carries.add(int(model.body_parentid[body]))
            below.setdefault(int(model.body_parentid[body]), []).append(body)
    along, body = {root}, root
    while len(below.get(body, [])) == 1:
        body = below[body][0]
        along.add(body)
    if body not in below:  # end of the chain: the tool is the last body fixed to it
        fixed = [b for b in range(body + 1, model.nbody) if int(model.body_weldid[b]) == body]
        body = fixed[-1] if fixed else body
    chain = np.array([i for i, j in enumerate(joints) if int(model.jnt_bodyid[j]) in along])
    return chain.astype(np.intp), body


def torque_limits(model: mujoco.MjModel, joints: Ints) -> Array:
    """Returns the torque limits of joints, (n,), Nm or N; inf where the model states none.

    The lower of the joint's `actuatorfrcrange` and the `forcerange` of its actuators (for a motor
    without one its `ctrlrange`) times their gear.
    """
    limits = np.full(len(joints), np.inf)
    for i, joint in enumerate(joints):
        mine = np.isin(model.actuator_trntype, _DIRECT) & (model.actuator_trnid[:, 0] == joint)
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
    points, of_body = _surface(model, data, tree.bodies)
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


def _surface(model: mujoco.MjModel, data: mujoco.MjData, bodies: Ints) -> tuple[Array, Ints]:
    """Returns points on the visible geoms of bodies (k, 3), m, and the body of each, (k,)."""
    mine = np.isin(model.geom_bodyid, bodies)
    shown = mine & (model.geom_group < _SHOWN_GROUPS) & (model.geom_rgba[:, 3] > 0)
    points, owners = [np.empty((0, 3))], [np.empty(0, np.intp)]
    for geom in (shown if shown.any() else mine).nonzero()[0]:
        local = _geom_points(model, int(geom))
        points.append(data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T)
        owners.append(np.full(len(local), model.geom_bodyid[geom], np.intp))
    return np.concatenate(points), np.concatenate(owners)


def _geom_points(model: mujoco.MjModel, geom: int) -> Array:
    """Returns points on the surface of a geom in its own frame, (k, 3), m."""
    kind, size = _TYPES(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    if kind == _TYPES.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        step = max(count // _MOST_POINTS, 1)
        return np.array(model.mesh_vert[first : first + count : step], np.float64)
    ring = _RING
    if kind in (_TYPES.mjGEOM_SPHERE, _TYPES.mjGEOM_ELLIPSOID):
        return _ball(np.full(3, size[0]) if kind == _TYPES.mjGEOM_SPHERE else size)
    if kind in (_TYPES.mjGEOM_CAPSULE, _TYPES.mjGEOM_CYLINDER, _TYPES.mjGEOM_BOX):
        if kind == _TYPES.mjGEOM_BOX:  # the ring projected onto a rectangle
            ring = ring / np.abs(ring).max(axis=1, keepdims=True) * [size[0], size[1], 1.0]
            half = size[2]
        else:
            ring, half = ring * size[0], size[1]
        heights = np.linspace(-half, half, 15)[:, None, None]
        points = (ring + heights * [0.0, 0.0, 1.0]).reshape(-1, 3)
        if kind == _TYPES.mjGEOM_CAPSULE:
            ends = _ball(np.full(3, size[0]))
            points = np.concatenate([points, ends + np.sign(ends[:, 2:]) * [0.0, 0.0, half]])
        return np.asarray(points)
    return np.empty((0, 3))  # planes and height fields are not part of a robot


def _ball(radii: Array) -> Array:
    """Returns points on an ellipsoid, (k, 3)."""
    polar = np.linspace(0.0, np.pi, 13)[:, None, None]
    return np.asarray(
        ((np.sin(polar) * _RING + np.cos(polar) * [0.0, 0.0, 1.0]) * radii).reshape(-1, 3)
    )
