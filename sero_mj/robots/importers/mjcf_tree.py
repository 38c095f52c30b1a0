"""Finds the robot in a compiled MJCF model: its joints, its links, and their poses.

Every hinge and slide becomes a joint of the robot with a separate link; for a body with several
joints the last link is the body, and the preceding ones are empty. The base consists of the bodies
fixed to the world, or is the root body if that has a free joint. If the model has actuators, the
robot consists of the trees that they drive; loose objects are not part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ...base.errors import Problem
from ...base.frames import Array, Ints, frame, inverse, rotation_about, rotation_to_z
from .imported_tables import NoJoints, first_of

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_OF_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_OF_SITE = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))
_GRAVITY = 9.81  # m/s2
_SQUARE = 1e-6  # largest cosine of axes at right angles
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)


@dataclass(frozen=True, eq=False)
class MjcfTree:
    """A robot in a compiled model, in its reference pose (`qpos0`).

    Attributes:
        joints: ids of its hinges and slides, (n,), depth first.
        parents: index of each joint's parent link, (n,): 0 for the base.
        links: link of every body, (nbody,): 0 for the base; -1 for bodies that are not part of the
            robot.
        bodies: T_world_body of every body in the reference pose, (nbody, 4, 4), m.
        poses: T_world_link of base and links in the reference pose, (n + 1, 4, 4), m; z of a link
            is the axis of its joint.
        free: ids of the joints of a free base: its free joint, or two slides and a hinge, which
            move it in a plane; empty for a fixed base.
        left_out: elements of the model that are not part of the robot, a sentence for each kind.
    """

    model: mujoco.MjModel
    joints: Ints
    parents: Ints
    links: Ints
    bodies: Array
    poses: Array
    free: Ints
    left_out: list[str]

    @property
    def joint_frames(self) -> Array:
        return frames_at_zero(self.model, self.joints, self.parents, self.poses)

    @property
    def geoms(self) -> Ints:
        """Ids of its geoms, without the world's planes."""
        model = self.model
        mine = self.links[model.geom_bodyid] >= 0
        mine &= ~((model.geom_bodyid == 0) & (model.geom_type == _PLANE))
        return np.flatnonzero(mine)


def find_tree(model: mujoco.MjModel) -> MjcfTree:
    """Returns the robot of a model; raises NoJoints if the model has no hinge or slide."""
    kinds = model.jnt_type
    is_axis = (kinds == _HINGE) | (kinds == _SLIDE)
    roots = model.body_rootid[model.jnt_bodyid]
    chosen, free = _chosen_roots(model, roots, is_axis)
    mine = is_axis & np.isin(roots, list(chosen))
    base_joints = np.array([free] if free >= 0 else _planar_base(model, mine), np.intp)
    mine[base_joints] = False
    joints = np.flatnonzero(mine).astype(np.intp)
    if not len(joints):
        message = (
            "found no hinge and no slide; expected a robot with joints: what is rigid is an "
            "object, mjcf = ..."
        )
        raise NoJoints([Problem("mjcf", message)])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = np.tile(np.eye(4), (model.nbody, 1, 1))
    bodies[:, :3, :3], bodies[:, :3, 3] = data.xmat.reshape(-1, 3, 3), data.xpos
    base_body = int(model.jnt_bodyid[base_joints[0]]) if len(base_joints) else 0
    links, parents, axes = _links(model, chosen, joints, base_body)
    poses = link_poses(model, data, axes, base_body)
    left_out = _left_out(model, mine, links)
    return MjcfTree(model, joints, parents, links, bodies, poses, base_joints, left_out)


def link_poses(model: mujoco.MjModel, data: mujoco.MjData, joints: Ints, base_body: int) -> Array:
    """T_world_link (n + 1, 4, 4), m, of a base and of links whose z is the axis of their joint."""
    rotations = data.xmat.reshape(-1, 3, 3)
    poses = [frame(rotations[base_body], data.xpos[base_body])]
    for joint, body in zip(joints, model.jnt_bodyid[joints], strict=True):
        rotation = rotation_to_z(rotations[body], data.xaxis[joint])
        poses.append(frame(rotation, data.xanchor[joint]))
    return np.array(poses)


def frames_at_zero(model: mujoco.MjModel, joints: Ints, parents: Ints, poses: Array) -> Array:
    """T_parent_i of joints at joint value zero, (n, 4, 4), m; see `SerialRobot.joint_frames`.

    Args:
        poses: of base and links in the reference pose, see `link_poses`.
    """
    fixed: Array = inverse(poses[parents]) @ poses[1:]
    back = np.tile(np.eye(4), (len(joints), 1, 1))  # MuJoCo's joint values start at `ref`
    ref = model.qpos0[model.jnt_qposadr[joints]]
    turns = model.jnt_type[joints] == _HINGE
    back[:, :3, :3] = rotation_about(2, np.where(turns, -ref, 0.0))
    back[:, 2, 3] = np.where(turns, 0.0, -ref)
    return np.asarray(fixed @ back)


def _chosen_roots(model: mujoco.MjModel, roots: Ints, is_axis: Array) -> tuple[set[int], int]:
    driven = driven_roots(model)
    trees = {int(root) for root in roots[is_axis]}
    trees = (trees & driven) or trees
    frees = [j for j in np.flatnonzero(model.jnt_type == _FREE).tolist() if int(roots[j]) in trees]
    fixed = trees - {int(roots[j]) for j in frees}
    if fixed or not frees:
        return fixed, -1
    sizes = [int((is_axis & (roots == roots[j])).sum()) for j in frees]
    free = frees[int(np.argmax(sizes))]
    return {int(roots[free])}, free


def _planar_base(model: mujoco.MjModel, mine: Array) -> list[int]:
    """Returns the joints of a passive planar base: two slides and a hinge of the root body.

    Empty if there is no such base. Joints that are driven, limited or not at right angles are
    joints of the robot.
    """
    roots = np.unique(model.body_rootid[model.jnt_bodyid[mine]])
    if len(roots) != 1 or model.body_jntnum[roots[0]] != 3:
        return []
    first = int(model.body_jntadr[roots[0]])
    ids = np.arange(first, first + 3)
    kinds, axes = model.jnt_type[ids].tolist(), model.jnt_axis[ids]
    is_driven = any(
        kind in ON_JOINT and item in ids
        for kind, (item, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True)
    )
    wraps = model.wrap_objid[model.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)]
    is_driven |= bool(np.isin(ids, wraps).any())
    is_square = np.abs(axes @ axes.T - np.eye(3)).max() < _SQUARE
    passive = not (is_driven or model.jnt_limited[ids].any() or model.jnt_stiffness[ids].any())
    is_planar = kinds == [_SLIDE, _SLIDE, _HINGE] and is_square and passive
    return ids.tolist() if is_planar and mine.sum() > len(ids) else []


def driven_roots(model: mujoco.MjModel) -> set[int]:
    """Returns the root bodies of the trees that have a joint with an actuator."""
    bodies: list[int] = []
    for kind, (item, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if kind in ON_JOINT:
            bodies.append(model.jnt_bodyid[item])
        elif kind == _OF_TENDON:
            first = model.tendon_adr[item]
            for wrap in range(first, first + model.tendon_num[item]):
                if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                    bodies.append(model.jnt_bodyid[model.wrap_objid[wrap]])
                elif model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_SITE:
                    bodies.append(model.site_bodyid[model.wrap_objid[wrap]])
        elif kind in _OF_SITE:
            bodies.append(model.site_bodyid[item])
    return {int(model.body_rootid[body]) for body in bodies}


def _links(
    model: mujoco.MjModel, chosen: set[int], joints: Ints, base_body: int
) -> tuple[Ints, Ints, Ints]:
    """Returns the link of every body, the parents of the joints, and these in the same order."""
    links = np.full(model.nbody, -1, np.intp)
    links[base_body] = 0
    parents: list[int] = []
    axes: list[int] = []
    mine = set(joints.tolist())
    for body in range(1, model.nbody):
        link = int(links[model.body_parentid[body]])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        ids = range(first, first + count) if count else range(0)
        if body == base_body or link < 0 or any(model.jnt_type[j] == _FREE for j in ids):
            continue
        if count and int(model.body_rootid[body]) not in chosen:
            continue  # of a tree that is not part of the robot
        if model.body_mocapid[body] >= 0:
            continue  # a marker
        for j in sorted(mine.intersection(ids)):
            parents.append(link)
            axes.append(j)
            link = len(axes)
        links[body] = link
    return links, np.array(parents, np.intp), np.array(axes, np.intp)


def _left_out(model: mujoco.MjModel, mine: Array, links: Ints) -> list[str]:
    def names(kind: mujoco.mjtObj, ids: Ints) -> str:
        return first_of([mujoco.mj_id2name(model, kind, int(i)) or f"number {i}" for i in ids])

    sentences = []
    held = np.flatnonzero(model.jnt_type == _BALL)
    held = held[links[model.jnt_bodyid[held]] >= 0]
    if len(held):
        what = names(mujoco.mjtObj.mjOBJ_JOINT, held)
        sentences.append(f"ball joints are held where they are, they have no single axis: {what}")
    others = np.flatnonzero(links[1:] < 0) + 1
    if len(others):
        what = names(mujoco.mjtObj.mjOBJ_BODY, others)
        sentences.append(f"bodies that no drive of the robot moves are left out: {what}")
    fixed = (model.geom_bodyid == 0) & (model.geom_type != _PLANE)  # scenes have their own floor
    spatial = model.wrap_type[model.tendon_adr] != int(mujoco.mjtWrap.mjWRAP_JOINT)
    for what, kind, ids in (
        ("geoms of the world", mujoco.mjtObj.mjOBJ_GEOM, np.flatnonzero(fixed)),
        ("spatial tendons", mujoco.mjtObj.mjOBJ_TENDON, np.flatnonzero(spatial)),
        ("cameras", mujoco.mjtObj.mjOBJ_CAMERA, np.arange(model.ncam)),
    ):
        if len(ids):
            sentences.append(f"{what} are left out: {names(kind, ids)}")
    springs = np.flatnonzero(mine & (model.jnt_stiffness > 0))
    if len(springs):
        what = names(mujoco.mjtObj.mjOBJ_JOINT, springs)
        sentences.append(f"springs of joints are left out: {what}")
    for count, what in ((model.nskin, "skin"), (model.nflex, "flex")):
        if count:
            sentences.append(
                f"the {what} is left out" if count == 1 else f"{count} {what}s left out"
            )
    gravity = float(np.linalg.norm(model.opt.gravity))
    if gravity and abs(gravity / _GRAVITY - 1.0) > 0.1:
        text = f"its gravity is {gravity:g}; expected {_GRAVITY:g} m/s2: is it in other units?"
        sentences.append(text)
    of_joints = (int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON))  # see mjcf_couplings
    loops = [i for i in range(model.neq) if int(model.eq_type[i]) not in of_joints]
    if loops:
        what = names(mujoco.mjtObj.mjOBJ_EQUALITY, np.array(loops))
        sentences.append(f"constraints other than of joints and tendons are left out: {what}")
    return sentences
