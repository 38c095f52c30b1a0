"""Reads the robot of an MJCF file as the tables of a robot file.

The geoms remain in the MJCF file, to which the robot's field `mjcf` refers. The module
`robots.assemble.mjcf_links` reads them with their meshes, materials and collision parameters.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base.declaration import LARGEST
from ...base.errors import DeclarationError, Problem, first_of
from ...base.frames import Array, Bools, Ints, frame, inverse, rotation_from_quat
from .imported_tables import ImportedTables
from .joint_names import joint_names_of, parents_of
from .mjcf_file import as_spec, is_file_name
from .mjcf_model import ON_JOINT, MjcfTree, find_tree, torque_limits
from .robot_tree import (
    TOO_FAR,
    UrdfLink,
    flange_body,
    joint_inertia,
    plain_name,
    plausible_limits,
    six_of,
)

_INITIAL_KEYS = ("home", "stand", "init", "default")  # names of keyframes with an initial pose
_TOOLS = re.compile(r"attach|ee|eef|end_?effector|flange|grip|pinch|tcp|tool", re.IGNORECASE)
_MAX_FACTOR = 10  # maximum plausible ratio of a torque limit to the torque that holds the robot
_TOLERANCE = 1e-4  # maximum joint value of a zero pose, rad or m
# MuJoCo's fields of degrees of freedom (`dof_...`) by key of `[dynamics]`.
_DOF_FIELDS = {
    "motor_inertias": "armature",
    "viscous_friction": "damping",
    "coulomb_friction": "frictionloss",
}

_RESISTING = ("damping", "frictionloss")
_OF_JOINTS, _OF_TENDONS = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
_WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)


def read_mjcf(path: Path) -> ImportedTables:
    """Reads the robot of an MJCF file. Raises NoJoints if the file has no movable joint."""
    try:
        tables, lost = mjcf_tables(path.name, path.parent)
    except DeclarationError as error:
        problems = [replace(problem, key="", file=str(path)) for problem in error.problems]
        raise type(error)(problems) from None
    return ImportedTables({"directory": "", **tables}, {}, lost)


def mjcf_tables(source: Any, folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Reads the robot in an MJCF source. Returns its tables and a warning for each lost element."""
    tree = tree_of(source, folder)
    model, joints = tree.model, tree.joints
    revolute = _turns(tree)
    names = _joint_names(model, joints)
    limited = model.jnt_limited[joints].astype(bool)
    declared = np.where(limited[:, None], model.jnt_range[joints], [-np.inf, np.inf])
    limits = plausible_limits(declared)
    lost = list(tree.left_out)
    if (far := (limits != declared).any(axis=1)).any():
        lost.append(f"{TOO_FAR}: {_some(names, far)}")
    if any(getattr(model, f"dof_{what}")[model.jnt_dofadr[tree.free]].any() for what in _RESISTING):
        lost.append("damping and friction of the joints of the base are left out")
    torques = _plausible(tree, torque_limits(model, joints), lost)
    dofs = model.jnt_dofadr[joints]
    link, T_link_flange = _flange(tree)
    couplings = _couplings(tree, names, lost)
    tables: dict[str, Any] = {
        "mjcf": source,
        "joint_frames": tree.joint_frames,
        "parents": parents_of(tree.parents.tolist(), names),
        "joint_names": names,
        "link_names": _link_names(tree),
        "link_frames": _link_frames(tree),
        "joint_types": ["revolute" if turns else "prismatic" for turns in revolute.tolist()],
        "flange_on": names[link - 1],
        "flange_frame": T_link_flange,
        "couplings": couplings,
        "base_frame": tree.poses[0],
        **_free_base(tree),
        "fit_arrows": True,
        "dynamics": {
            **_inertias(tree),
            **{
                key: _bounded(getattr(model, f"dof_{what}")[dofs], what, names, lost)
                for key, what in _DOF_FIELDS.items()
            },
        },
    }
    if np.isfinite(limits).any():
        tables["position_limits"] = limits
    if np.isfinite(torques).any():
        tables["torque_limits"] = torques
    if (tree.parents == np.arange(len(joints))).all():
        del tables["parents"]
    tables |= _initial_pose(tree, names, couplings)
    return tables, lost


def plain_tables(tables: dict[str, Any]) -> dict[str, Any]:
    """Removes entries that equal their defaults from the tables of an imported robot."""
    plain = {key: value for key, value in tables.items() if key != "directory"}
    for key in ("couplings", "free_base"):
        if not plain[key]:
            del plain[key]
    for key in ("base_frame", "flange_frame"):
        if np.array_equal(plain[key], np.eye(4)):
            del plain[key]
    dynamics = dict(plain["dynamics"])
    dynamics["inertias"] = [six_of(tensor) for tensor in dynamics["inertias"]]
    return {**plain, "dynamics": dynamics}


def _link_names(tree: MjcfTree) -> list[str]:
    found = ["base", *(f"link{i + 1}" for i in range(len(tree.joints)))]
    for link in range(len(found)):
        bodies = np.flatnonzero(tree.links == link)
        if len(bodies):
            found[link] = tree.model.body(int(bodies[0])).name or found[link]
    return found


def _link_frames(tree: MjcfTree) -> dict[str, Any]:
    back = inverse(tree.poses)
    found = {}
    for body in np.flatnonzero(tree.links >= 0).tolist():
        link, name = int(tree.links[body]), tree.model.body(body).name
        if name and body:
            on = f"link{link}" if link else "base"
            found[name] = {"on": on, "frame": back[link] @ tree.bodies[body]}
    return found


def tree_of(source: Any, folder: Path) -> MjcfTree:
    """Compiles an MJCF file, text or object, and finds the robot in the model."""
    spec = as_spec(source, folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MuJoCo warns about deprecated attributes.
            tree = find_tree(spec.compile())
    except DeclarationError:
        raise
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise Problem("mjcf", reason).error() from None
    if is_file_name(source):
        _cached[folder / source] = _modified(folder / source), tree
        while len(_cached) > _MAX_CACHED:
            del _cached[next(iter(_cached))]
    return tree


def cached_tree(source: Any, folder: Path) -> MjcfTree:
    """Finds the robot in an MJCF source like `tree_of`, but caches it until the file changes."""
    if is_file_name(source):
        modified, tree = _cached.get(folder / source, (0, None))
        if tree is not None and modified == _modified(folder / source):
            return tree
    return tree_of(source, folder)


_MAX_CACHED = 8
_cached: dict[Path, tuple[int, MjcfTree]] = {}  # modification times and trees by file


def _modified(file: Path) -> int:
    return file.stat().st_mtime_ns if file.is_file() else 0


def _joint_names(model: mujoco.MjModel, joints: Ints) -> list[str]:
    found = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(j)) for j in joints]
    named = [name or f"joint{k + 1}" for k, name in enumerate(found)]
    scopes = {name.rpartition("/")[0] for name in named}
    if len(scopes) == 1:
        named = [name.rpartition("/")[2] for name in named]
    return joint_names_of(named)[0]


def _inertias(tree: MjcfTree) -> dict[str, Any]:
    model, back = tree.model, inverse(tree.poses)
    parts: list[list[tuple[UrdfLink, Array]]] = [[] for _ in tree.poses]
    for body in np.flatnonzero(tree.links >= 0).tolist():
        axes = rotation_from_quat(model.body_iquat[body])
        tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
        part = UrdfLink("", None, float(model.body_mass[body]), model.body_ipos[body], tensor)
        link = int(tree.links[body])
        parts[link].append((part, back[link] @ tree.bodies[body]))
    masses, centers, tensors = zip(*map(joint_inertia, parts), strict=True)
    return {
        "masses": np.array(masses),
        "centers_of_mass": np.array(centers),
        "inertias": np.array(tensors),
        "inertia_repair": "balance",
    }


def _bounded(values: Array, what: str, names: list[str], lost: list[str]) -> Array:
    if (far := values > LARGEST).any():
        lost.append(f"{what} is clipped to {LARGEST:g}: {_some(names, far)}")
    if (negative := values < 0).any():
        lost.append(f"negative {what} is set to 0: {_some(names, negative)}")
    return np.clip(values, 0.0, LARGEST)


def _some(names: list[str], which: Bools) -> str:
    found = [name for name, is_one in zip(names, which.tolist(), strict=True) if is_one]
    return first_of(found)


def _plausible(tree: MjcfTree, limits: Array, lost: list[str]) -> Array:
    model = tree.model
    extent = float(np.linalg.norm(np.ptp(tree.poses[:, :3, 3], axis=0)))
    weight = float(model.body_mass[tree.links >= 0].sum() * np.linalg.norm(model.opt.gravity))
    most = _MAX_FACTOR * weight * np.where(_turns(tree), extent, 1.0)
    far = np.isfinite(limits) & (limits > most) & (most > 0)
    if far.any():
        many = "those of all joints" if far.all() else f"{int(far.sum())} of {len(far)}"
        largest = float(limits[far].max())
        lost.append(
            f"torque limits up to {largest:g} exceed {_MAX_FACTOR} times the torque that holds the "
            f"robot's weight at its full extent; {many} are ignored"
        )
    return np.where(far, np.inf, limits)


def _turns(tree: MjcfTree) -> Bools:
    kinds = tree.model.jnt_type[tree.joints]
    return np.asarray(kinds == int(mujoco.mjtJoint.mjJNT_HINGE))


def _flange(tree: MjcfTree) -> tuple[int, Array]:
    """Returns the index of the link that carries the flange, and the pose T_link_flange.

    The flange is at the first site of this link that is named like a tool, or else at the last body
    of the link.
    """
    model = tree.model
    link = flange_body(tree.parents.tolist())
    back = inverse(tree.poses[link])
    for site in np.flatnonzero(tree.links[model.site_bodyid] == link).tolist():
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site) or ""
        if _TOOLS.search(name):
            pose = frame(rotation_from_quat(model.site_quat[site]), model.site_pos[site])
            return link, back @ tree.bodies[model.site_bodyid[site]] @ pose
    return link, back @ tree.bodies[np.flatnonzero(tree.links == link)[-1]]


def _initial_pose(tree: MjcfTree, names: list[str], couplings: dict[str, Any]) -> dict[str, Any]:
    """Returns initial joint angles and base frame of a robot, from a keyframe or from `qpos0`.

    The keyframe is the first one with a name such as `home`, or the only keyframe if it is unnamed.
    """
    model = tree.model
    qpos = model.qpos0
    keys = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_KEY, k) or "" for k in range(model.nkey)]
    named = [k for k, name in enumerate(keys) if name.rpartition("/")[2].lower() in _INITIAL_KEYS]
    if keys == [""]:
        named = [0]
    if named:
        qpos = model.key_qpos[named[0]]
    q = qpos[model.jnt_qposadr[tree.joints]].copy()
    for _ in couplings:  # A chain may contain all couplings.
        for name, coupling in couplings.items():
            q[names.index(name)] = coupling["ratio"] * q[names.index(coupling["to"])]
            q[names.index(name)] += coupling["offset"]
    pose: dict[str, Any] = {} if np.abs(q).max() < _TOLERANCE else {"joint_angles": q}
    if len(tree.free):
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        body = model.jnt_bodyid[tree.free[0]]
        pose["base_frame"] = frame(data.xmat[body].reshape(3, 3), data.xpos[body])
    return pose


def _free_base(tree: MjcfTree) -> dict[str, Any]:
    if not len(tree.free):
        return {"free_base": False}
    name = mujoco.mj_id2name(tree.model, mujoco.mjtObj.mjOBJ_JOINT, int(tree.free[0]))
    base = {"base_joint": plain_name(name.rpartition("/")[2], set())} if name else {}
    if len(tree.free) == 1:
        return {"free_base": True, **base}
    normal = tree.model.jnt_axis[tree.free[2]]
    own = {} if np.array_equal(normal, [0, 0, 1]) else {"base_normal": normal}
    return {"free_base": "planar", **own}


def _couplings(tree: MjcfTree, names: list[str], lost: list[str]) -> dict[str, Any]:
    """Converts equality constraints of a model to couplings, by name of the coupled joint.

    A constraint has the form `y - y0 = p(x - x0)`: y and x are joint values or tendon lengths, y0
    and x0 are their values at `qpos0`, and p is a polynomial. Without x, the constraint is
    `y - y0 = p(0)`. The length of a fixed tendon is a weighted sum of joint values. Source:
    https://mujoco.readthedocs.io/en/stable/XMLreference.html#equality-joint

    A constraint becomes a coupling if it is linear in two joints of the robot. The first joint
    follows the second one, unless only the first one has an actuator or already follows another
    joint. In a tendon, a joint follows the joints before it. Other constraints are reported in
    `lost`.
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
                reason = "the joints are already coupled"
        if reason:
            who = ", ".join(names[k] for k in sorted(joints)) or f"number {i}"
            lost.append(f"the constraint of {who} is left out: {reason}")
            continue
        ratio = -factors[second] / factors[first]
        offset = ref[first] + model.eq_data[i, 0] / factors[first] - ratio * ref[second]
        found[names[first]] = {"to": names[second], "ratio": float(ratio), "offset": float(offset)}
    return found


def _linear(tree: MjcfTree, equality: int) -> tuple[list[int], Array, str]:
    """Returns the joints of a constraint, and factors of all n joints in its linear form.

    The coupled joint comes first. The linear form is sum(factors * (q - qpos0)) = p(0). The third
    value is the reason why the constraint is not a coupling, or "" if it is one.
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
        reason = "it contains a joint that is not part of the robot"
    elif sides[1] and model.eq_data[equality, 2:5].any():
        reason = "it is not linear"
    elif joints and (len(joints) != 2 or not factors[joints].all()):
        reason = "a coupling has two joints"
    return joints, factors, reason


def _weights(model: mujoco.MjModel, equality: int, item: int) -> dict[int, float]:
    """Returns the joint weights of one side of a constraint; empty for a spatial tendon."""
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
