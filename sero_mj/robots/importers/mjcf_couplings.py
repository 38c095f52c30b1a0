"""Couplings of joints in a compiled MJCF model: linear constraints between joints or tendons.

MuJoCo constrains `y - y0 = p(x - x0)`, where y and x are the values of two joints or the lengths of
two tendons, y0 and x0 those at `qpos0`, and p a polynomial. Without x it is `y - y0 = p(0)`. The
length of a fixed tendon is a weighted sum of joint values. Source:
https://mujoco.readthedocs.io/en/stable/XMLreference.html#equality-joint
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array
from .mjcf_tree import ON_JOINT, MjcfTree

_OF_JOINTS, _OF_TENDONS = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
_WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)


def couplings_of(tree: MjcfTree, names: list[str], lost: list[str]) -> dict[str, Any]:
    """Returns the couplings by the coupled joint; adds a sentence to `lost` for each other one.

    A constraint is a coupling if it is linear in two joints of the robot. Its first joint follows
    its second one, or the other way round if only the first one has an actuator or if it already
    follows another one. In a tendon, joints follow those before them.
    """
    model, found = tree.model, dict[str, Any]()
    ref = model.qpos0[model.jnt_qposadr[tree.joints]]
    on_joint = np.isin(model.actuator_trntype, ON_JOINT)
    driven = np.isin(tree.joints, model.actuator_trnid[on_joint, 0])
    for i in np.flatnonzero(np.isin(model.eq_type, (_OF_JOINTS, _OF_TENDONS))).tolist():
        joints, factors, reason = _linear(tree, i)
        if not model.eq_active0[i] or not (joints or reason):
            continue
        if not reason:
            first, second = joints
            if driven[first] and not driven[second]:
                first, second = second, first
            if _leads_back(found, names, first, second):
                first, second = second, first
            if _leads_back(found, names, first, second):
                reason = "others couple them already"
        if reason:
            who = ", ".join(names[k] for k in sorted(joints)) or f"number {i}"
            lost.append(f"the constraint of {who} is left out: {reason}")
            continue
        ratio = -factors[second] / factors[first]
        offset = ref[first] + model.eq_data[i, 0] / factors[first] - ratio * ref[second]
        found[names[first]] = {"to": names[second], "ratio": float(ratio), "offset": float(offset)}
    return found


def _linear(tree: MjcfTree, equality: int) -> tuple[list[int], Array, str]:
    """Returns a constraint's joints of the robot, the follower first, and their factors, (n,).

    The sum of factors times (q - qpos0) is the first number of its polynomial. The last value says
    why it is no coupling; it is empty if it is one.
    """
    model = tree.model
    items = model.eq_obj1id[equality], model.eq_obj2id[equality]
    sides = [_weights(model, equality, item) for item in items]
    row = {int(joint): k for k, joint in enumerate(tree.joints)}
    members = list(dict.fromkeys(joint for side in sides for joint in side))
    joints = [row[joint] for joint in members if joint in row]
    if model.eq_type[equality] == _OF_TENDONS:
        joints.sort(reverse=True)
    factors, slope = np.zeros(len(tree.joints)), float(model.eq_data[equality, 1])
    for side, factor in zip(sides, (1.0, -slope), strict=True):
        for joint in side.keys() & row.keys():
            factors[row[joint]] += factor * side[joint]
    reason = ""
    if any(item >= 0 and not side for item, side in zip(items, sides, strict=True)):
        reason = "the length of a spatial tendon is not linear"
    elif joints and len(joints) < len(members):
        reason = "it leads to a joint that is not part of the robot"
    elif sides[1] and model.eq_data[equality, 2:5].any():
        reason = "it is not linear"
    elif joints and (len(joints) != 2 or not factors[joints].all()):
        reason = "a coupling joins two joints"
    return joints, factors, reason


def _weights(model: mujoco.MjModel, equality: int, item: int) -> dict[int, float]:
    """Weights of joints in one side of a constraint, by their ids; empty for no joint or tendon.

    It is empty for spatial tendons as well, whose length is not linear.
    """
    if item < 0:
        return {}
    if model.eq_type[equality] == _OF_JOINTS:
        return {int(item): 1.0}
    first = model.tendon_adr[item]
    wraps = range(first, first + model.tendon_num[item])
    return {
        int(model.wrap_objid[k]): float(model.wrap_prm[k])
        for k in wraps
        if model.wrap_type[k] == _WRAPS_JOINT
    }


def _leads_back(couplings: dict[str, Any], names: list[str], one: int, other: int) -> bool:
    at: str | None = names[other]
    while at is not None and at != names[one]:
        at = couplings[at]["to"] if at in couplings else None
    return at is not None or names[one] in couplings
