"""Finds the robot in a compiled MuJoCo model, with its joints, links, poses and torque limits."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from ...base.errors import Problem, first_of
from ...base.frames import Array, Ints, frame, inverse, rotation_about, rotation_to_z
from .imported_tables import NoJoints

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_OF_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_OF_SITE = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))
_WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_GRAVITY = 9.81  # m/s2
_SQUARE = 1e-6  # maximum cosine between perpendicular axes
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_NO_BIAS, _AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)
_STATELESS = int(mujoco.mjtDyn.mjDYN_NONE)
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_UNCLAMPED = int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
_POSES = 64  # number of poses in which pose-dependent moment arms are evaluated
_WIDE = np.pi  # range of these poses around `qpos0` for joints without limits, rad or m


@dataclass(frozen=True, eq=False)
class MjcfTree:
    """The robot in a compiled MuJoCo model, in the reference pose (`qpos0`).

    Every hinge and slide becomes a joint of the robot with its own link. A body with several joints
    belongs to the link of its last joint, and the links of its other joints are empty. The base
    consists of the bodies fixed to the world, or of the root body if that has a free joint. If the
    model has actuators, only the trees that they drive belong to the robot.

    Attributes:
        joints: ids of the robot's hinges and slides in depth-first order, shape (n,).
        parents: index of each joint's parent link, shape (n,), 0 for the base.
        links: index of each body's link, shape (nbody,), 0 for the base and -1 for bodies that do
            not belong to the robot.
        bodies: poses T_world_body of all bodies in the reference pose, shape (nbody, 4, 4), m.
        poses: poses T_world_link of the base and the links in the reference pose, shape
            (n + 1, 4, 4), m. The z axis of a link is the axis of its joint.
        free: ids of the joints of a moving base, which are one free joint, or two slides and a
            hinge for a planar base. Empty for a fixed base.
        left_out: one sentence for each kind of element that is not part of the robot.
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
        """Ids of the robot's geoms. Planes of the world body are excluded."""
        model = self.model
        mine = self.links[model.geom_bodyid] >= 0
        mine &= ~((model.geom_bodyid == 0) & (model.geom_type == _PLANE))
        return np.flatnonzero(mine)


def find_tree(model: mujoco.MjModel) -> MjcfTree:
    """Finds the robot in a compiled model. Raises NoJoints if the model has no hinge or slide."""
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
            "has no hinge and no slide; expected a robot with joints. Add a rigid body to a "
            "scene as an object with mjcf = ..."
        )
        raise NoJoints([Problem("mjcf", message)])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = np.tile(np.eye(4), (model.nbody, 1, 1))
    bodies[:, :3, :3], bodies[:, :3, 3] = data.xmat.reshape(-1, 3, 3), data.xpos
    base_body = int(model.jnt_bodyid[base_joints[0]]) if len(base_joints) else 0
    links, parents, axes = read_links(model, joints, base_body, _outside(model, chosen))
    poses = link_poses(model, data, axes, base_body)
    left_out = _left_out(model, mine, links)
    return MjcfTree(model, joints, parents, links, bodies, poses, base_joints, left_out)


def link_poses(model: mujoco.MjModel, data: mujoco.MjData, joints: Ints, base_body: int) -> Array:
    """Returns the poses T_world_link of the base body and of the joints' links.

    The poses have the shape (n + 1, 4, 4), in m. The z axis of a link is the axis of its joint.
    """
    rotations = data.xmat.reshape(-1, 3, 3)
    poses = [frame(rotations[base_body], data.xpos[base_body])]
    for joint, body in zip(joints, model.jnt_bodyid[joints], strict=True):
        rotation = rotation_to_z(rotations[body], data.xaxis[joint])
        poses.append(frame(rotation, data.xanchor[joint]))
    return np.array(poses)


def frames_at_zero(model: mujoco.MjModel, joints: Ints, parents: Ints, poses: Array) -> Array:
    """Returns the `joint_frames` of a `SerialRobot`, shape (n, 4, 4), from poses at `qpos0`."""
    fixed: Array = inverse(poses[parents]) @ poses[1:]
    back = np.tile(np.eye(4), (len(joints), 1, 1))  # In MuJoCo, the joint value is `ref` at qpos0.
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
    """Returns the ids of the two slides and the hinge of a passive planar base, or an empty list.

    The joints must be those of the root body, and be perpendicular. They must not have actuators,
    limits or springs.
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
    wraps = model.wrap_objid[model.wrap_type == _WRAPS_JOINT]
    is_driven |= bool(np.isin(ids, wraps).any())
    is_square = np.abs(axes @ axes.T - np.eye(3)).max() < _SQUARE
    passive = not (is_driven or model.jnt_limited[ids].any() or model.jnt_stiffness[ids].any())
    is_planar = kinds == [_SLIDE, _SLIDE, _HINGE] and is_square and passive
    return ids.tolist() if is_planar and mine.sum() > len(ids) else []


def driven_roots(model: mujoco.MjModel) -> set[int]:
    """Returns the ids of the root bodies of all trees that actuators drive."""
    bodies: list[int] = []
    for kind, (item, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if kind in ON_JOINT:
            bodies.append(model.jnt_bodyid[item])
        elif kind == _OF_TENDON:
            first = model.tendon_adr[item]
            for wrap in range(first, first + model.tendon_num[item]):
                if model.wrap_type[wrap] == _WRAPS_JOINT:
                    bodies.append(model.jnt_bodyid[model.wrap_objid[wrap]])
                elif model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_SITE:
                    bodies.append(model.site_bodyid[model.wrap_objid[wrap]])
        elif kind in _OF_SITE:
            bodies.append(model.site_bodyid[item])
    return {int(model.body_rootid[body]) for body in bodies}


def read_links(
    model: mujoco.MjModel, joints: Ints, base_body: int = 0, left_out: Collection[int] = ()
) -> tuple[Ints, Ints, Ints]:
    """Returns the link index of each body, the parent link of each joint, and the joint ids.

    Bodies in `left_out` and their descendants have link -1, and their joints are omitted.
    """
    links = np.full(model.nbody, -1, np.intp)
    links[base_body] = 0
    parents: list[int] = []
    axes: list[int] = []
    mine = set(joints.tolist())
    for body in range(1, model.nbody):
        link = int(links[model.body_parentid[body]])
        if body == base_body or link < 0 or body in left_out:
            continue
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            if j in mine:
                parents.append(link)
                axes.append(j)
                link = len(axes)
        links[body] = link
    return links, np.array(parents, np.intp), np.array(axes, np.intp)


def _outside(model: mujoco.MjModel, chosen: set[int]) -> set[int]:
    """Returns mocap bodies, free bodies, and bodies with joints in trees not in `chosen`."""
    free = set(model.jnt_bodyid[model.jnt_type == _FREE].tolist())
    jointed = np.flatnonzero(model.body_jntnum).tolist()
    others = {body for body in jointed if int(model.body_rootid[body]) not in chosen}
    return free | others | set(np.flatnonzero(model.body_mocapid >= 0).tolist())


def _left_out(model: mujoco.MjModel, mine: Array, links: Ints) -> list[str]:
    def names(kind: mujoco.mjtObj, ids: Ints) -> str:
        return first_of([mujoco.mj_id2name(model, kind, int(i)) or f"number {i}" for i in ids])

    sentences = []
    held = np.flatnonzero(model.jnt_type == _BALL)
    held = held[links[model.jnt_bodyid[held]] >= 0]
    if len(held):
        what = names(mujoco.mjtObj.mjOBJ_JOINT, held)
        sentences.append(
            f"ball joints become fixed joints, because they have no single axis: {what}"
        )
    others = np.flatnonzero(links[1:] < 0) + 1
    if len(others):
        what = names(mujoco.mjtObj.mjOBJ_BODY, others)
        sentences.append(f"bodies that no actuator of the robot moves are left out: {what}")
    fixed = (model.geom_bodyid == 0) & (model.geom_type != _PLANE)  # A scene has its own floor.
    spatial = model.wrap_type[model.tendon_adr] != _WRAPS_JOINT
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
            found = f"the {what} is" if count == 1 else f"{count} {what}s are"
            sentences.append(f"{found} left out")
    gravity = float(np.linalg.norm(model.opt.gravity))
    if gravity and abs(gravity / _GRAVITY - 1.0) > 0.1:
        text = f"gravity is {gravity:g} instead of {_GRAVITY:g} m/s2, so the units may not be SI"
        sentences.append(text)
    of_joints = (int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON))  # see `mjcf_robot`
    loops = [i for i in range(model.neq) if int(model.eq_type[i]) not in of_joints]
    if loops:
        what = names(mujoco.mjtObj.mjOBJ_EQUALITY, np.array(loops))
        sentences.append(f"constraints other than between joints or tendons are left out: {what}")
    return sentences


def torque_limits(model: mujoco.MjModel, joints: Ints) -> Array:
    """Returns the maximum torques that actuators can apply to joints, shape (n,), Nm or N.

    The limit is infinite for joints without actuators, and for actuators without `forcerange` whose
    force depends on position or velocity, such as position servos. If moment arms depend on the
    pose (spatial tendons, slider-cranks and sites), the limit is the maximum torque in 64 poses.

    MuJoCo (`mj_fwdActuation`) clamps a control to `ctrlrange`, an activation to `actrange`, an
    actuator's force to `forcerange`, the total force of a tendon's actuators to the tendon's
    `actuatorfrcrange`, and the torque about a joint to the joint's `actuatorfrcrange`. Source:
    https://mujoco.readthedocs.io/en/stable/computation/index.html#actuation-model
    """
    dofs = model.jnt_dofadr[joints]
    forces = _forces(model)
    clamped = model.jnt_actfrclimited[joints].astype(bool)
    low, high = np.where(clamped[:, None], model.jnt_actfrcrange[joints], [-np.inf, np.inf]).T
    largest = np.zeros(len(joints))
    for moments in _moments(model) if model.nout else ():
        arms = moments[:, dofs]
        with np.errstate(invalid="ignore"):
            ends = np.where(arms == 0.0, 0.0, forces.T[:, :, None] * arms)
        low_sum, high_sum = ends.min(axis=0).sum(axis=0), ends.max(axis=0).sum(axis=0)
        reached = np.maximum(-np.clip(low_sum, low, high), np.clip(high_sum, low, high))
        largest = np.maximum(largest, reached)
    unknown = np.where(clamped, np.maximum(-low, high), np.inf)
    return np.where(largest > 0, largest, unknown)


def _forces(model: mujoco.MjModel) -> Array:
    forces = np.tile([-np.inf, np.inf], (model.nout, 1))
    of_tendons: dict[int, list[int]] = {}
    for actuator in range(model.nactuator):
        first, count = int(model.actuator_outadr[actuator]), int(model.actuator_outnum[actuator])
        mine = forces[first : first + count]
        if count == 1:
            mine[:] = _unclamped_force(model, actuator)
        if model.actuator_forcelimited[actuator]:
            mine[:] = np.clip(mine, *model.actuator_forcerange[actuator])
        if model.actuator_trntype[actuator] == _OF_TENDON:
            of_tendons.setdefault(int(model.actuator_trnid[actuator, 0]), []).append(first)
    for tendon, rows in of_tendons.items():
        if model.tendon_actfrclimited[tendon]:
            low, high = model.tendon_actfrcrange[tendon]
            inside = np.clip(forces[rows], low, high)
            # As in MuJoCo, all forces are scaled by the same factor if their sum exceeds the range.
            total = inside.sum(axis=0)
            scale = np.divide(np.clip(total, low, high), total, where=total != 0, out=np.ones(2))
            forces[rows] = inside * scale
    return forces


def _unclamped_force(model: mujoco.MjModel, actuator: int) -> Array:
    """Returns the range of an actuator's force before clamping, shape (2,), possibly infinite."""
    unknown = np.array([-np.inf, np.inf])
    bias = int(model.actuator_biastype[actuator])
    offset, *slopes = model.actuator_biasprm[actuator, :3] if bias == _AFFINE_BIAS else (0.0,)
    if model.actuator_gaintype[actuator] != _FIXED_GAIN or any(slopes):
        return unknown
    if bias not in (_NO_BIAS, _AFFINE_BIAS) or model.actuator_ctrlnum[actuator] != 1:
        return unknown
    taken, dynamics = unknown, int(model.actuator_dyntype[actuator])
    control = int(model.actuator_ctrladr[actuator])
    is_clamped = model.actuator_ctrllimited[control] and not model.opt.disableflags & _UNCLAMPED
    if dynamics in (_STATELESS, *_FILTERS) and is_clamped:
        taken = model.actuator_ctrlrange[control]
    if dynamics != _STATELESS and model.actuator_actlimited[actuator]:
        taken = np.clip(taken, *model.actuator_actrange[actuator])
    gain = float(model.actuator_gainprm[actuator, 0])
    return np.sort(gain * taken + offset) if gain else np.full(2, offset)


def _moments(model: mujoco.MjModel) -> Iterator[Array]:
    """Yields the moment arms of all actuator outputs in one or 64 poses, shape (nout, nv)."""
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    axes = np.flatnonzero(np.isin(model.jnt_type, (_HINGE, _SLIDE)))
    places, center = model.jnt_qposadr[axes], model.qpos0[model.jnt_qposadr[axes]]
    limited = model.jnt_limited[axes].astype(bool)[:, None]
    ranges = np.where(limited, model.jnt_range[axes], center[:, None] + [-_WIDE, _WIDE])
    low, high = np.nan_to_num(ranges, nan=0.0, posinf=_WIDE, neginf=-_WIDE).T
    for _ in range(1 if _has_constant_arms(model) else _POSES):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_transmission(model, data)
        moments = np.zeros((model.nout, model.nv))
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr,
            data.moment_colind,
        )  # fmt: skip
        yield moments
        data.qpos[places] = random.uniform(low, high)


def _has_constant_arms(model: mujoco.MjModel) -> bool:
    for kind, (item, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        is_fixed = kind == _OF_TENDON and model.wrap_type[model.tendon_adr[item]] == _WRAPS_JOINT
        if kind not in ON_JOINT and not is_fixed:
            return False
    return True
