"""Finds the robots in an external model: its kinematic trees with hinge or slide joints.

A tree consists of one child of the world and all of its descendants. Free and ball joints have no
single axis and therefore no arrow.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_DIRECT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED_GAIN, _NO_BIAS = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)
_RESERVED = ("world", "toggles")  # reserved names in routes


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
