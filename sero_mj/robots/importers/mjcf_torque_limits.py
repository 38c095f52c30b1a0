"""Torque limits of joints in a compiled MJCF model: the largest torque that actuators can exert.

MuJoCo (`mj_fwdActuation`) clamps a control to `ctrlrange`, an activation to `actrange`, an
actuator's force to `forcerange`, the forces of all actuators of a tendon to the tendon's
`actuatorfrcrange`, and their torque about a joint to the joint's `actuatorfrcrange`. Source:
https://mujoco.readthedocs.io/en/stable/computation/index.html#actuation-model
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from .mjcf_tree import ON_JOINT

_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_NO_BIAS, _AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)
_STATELESS = int(mujoco.mjtDyn.mjDYN_NONE)
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_OF_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_AXES = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_UNCLAMPED = int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
_POSES = 64  # in which moment arms that depend on the pose are evaluated
_WIDE = np.pi  # rad or m, to either side of the reference, where such a pose has no joint limits


def torque_limits(model: mujoco.MjModel, joints: Ints) -> Array:
    """Returns the largest torques that actuators can exert on joints (ids), (n,), Nm or N.

    They are infinite for joints without actuators, and if the force of an actuator depends on
    position or velocity and has no `forcerange`, as that of many position servos. If moment arms
    change with the pose, as those of spatial tendons, slider-cranks and sites, the torque is the
    largest found in 64 poses.
    """
    dofs = model.jnt_dofadr[joints]
    forces = _forces(model)
    clamped = model.jnt_actfrclimited[joints].astype(bool)
    low, high = np.where(clamped[:, None], model.jnt_actfrcrange[joints], [-np.inf, np.inf]).T
    most = np.zeros(len(joints))
    for moments in _moments(model) if model.nout else ():
        arms = moments[:, dofs]
        with np.errstate(invalid="ignore"):
            ends = np.where(arms == 0.0, 0.0, forces.T[:, :, None] * arms)
        least, largest = ends.min(axis=0).sum(axis=0), ends.max(axis=0).sum(axis=0)
        reached = np.maximum(-np.clip(least, low, high), np.clip(largest, low, high))
        most = np.maximum(most, reached)
    unknown = np.where(clamped, np.maximum(-low, high), np.inf)
    return np.where(most > 0, most, unknown)


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
            # Like MuJoCo: if the sum is outside the range, all forces are scaled alike.
            total = inside.sum(axis=0)
            scale = np.divide(np.clip(total, low, high), total, where=total != 0, out=np.ones(2))
            forces[rows] = inside * scale
    return forces


def _unclamped_force(model: mujoco.MjModel, actuator: int) -> Array:
    """Returns the range of gain * input + bias, (2,); infinite if the state decides on it as well.

    The input is the control, or an activation that is a filtered control or has a range.
    """
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
    """Yields the moment arms of all actuator outputs, (nout, nv), in poses that show all of them.

    One pose is enough if no moment arm depends on it.
    """
    data = mujoco.MjData(model)
    chance = np.random.default_rng(0)
    axes = np.flatnonzero(np.isin(model.jnt_type, _AXES))
    places, center = model.jnt_qposadr[axes], model.qpos0[model.jnt_qposadr[axes]]
    limited = model.jnt_limited[axes].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[axes], center[:, None] + [-_WIDE, _WIDE]).T
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
        data.qpos[places] = chance.uniform(low, high)


def _has_constant_arms(model: mujoco.MjModel) -> bool:
    for kind, (item, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        is_fixed = kind == _OF_TENDON and model.wrap_type[model.tendon_adr[item]] == _WRAPS_JOINT
        if kind not in ON_JOINT and not is_fixed:
            return False
    return True
