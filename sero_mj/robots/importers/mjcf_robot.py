"""Reads a robot from MJCF: its joints, limits, inertias, friction and couplings, as our tables.

Its geoms remain in the file, which the robot's `mjcf` names: `robots.assemble.mjcf_links` reads
them from there with their meshes, materials and collision parameters.
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
from ...base.errors import DeclarationError, Problem
from ...base.frames import Array, Bools, Ints, frame, inverse, rotation_from_quat
from .imported_tables import ImportedTables, first_of
from .joint_names import joint_names_of, parents_of
from .mjcf_couplings import couplings_of
from .mjcf_file import as_spec, is_file_name
from .mjcf_torque_limits import torque_limits
from .mjcf_tree import MjcfTree, find_tree
from .robot_tree import TOO_FAR, flange_body, meant_limits, plain_name, six_of

_INITIAL_KEYS = ("home", "stand", "init", "default")  # key frames used as the initial pose
_TOOLS = re.compile(r"attach|ee|eef|end_?effector|flange|grip|pinch|tcp|tool", re.IGNORECASE)
_MAX_FACTOR = 10  # times the torque that holds the whole robot, stretched
_TOLERANCE = 1e-4  # rad or m
# Keys of `[dynamics]` by MuJoCo's fields of degrees of freedom.
_DOF_FIELDS = {
    "motor_inertias": "armature",
    "viscous_friction": "damping",
    "coulomb_friction": "frictionloss",
}

_RESISTING = ("damping", "frictionloss")


def read_mjcf(path: Path) -> ImportedTables:
    """Reads the robot of an MJCF file; raises DeclarationError, and NoJoints without joints."""
    try:
        tables, lost = mjcf_tables(path.name, path.parent)
    except DeclarationError as error:
        problems = [replace(problem, key="", file=str(path)) for problem in error.problems]
        raise type(error)(problems) from None
    return ImportedTables({"directory": "", **tables}, {}, lost)


def mjcf_tables(source: Any, folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Returns the tables of a robot, and what was lost.

    Raises DeclarationError if it cannot be read or compiled, or has no joints.
    """
    tree = tree_of(source, folder)
    model, joints = tree.model, tree.joints
    revolute = _turns(tree)
    names = _names(model, joints)
    limited = model.jnt_limited[joints].astype(bool)
    stated = np.where(limited[:, None], model.jnt_range[joints], [-np.inf, np.inf])
    limits = meant_limits(stated)
    lost = list(tree.left_out)
    if (far := (limits != stated).any(axis=1)).any():
        lost.append(f"{TOO_FAR}: {_some(names, far)}")
    if any(getattr(model, f"dof_{what}")[model.jnt_dofadr[tree.free]].any() for what in _RESISTING):
        lost.append("damping and friction of the joints of the base are left out")
    torques = _plausible(tree, torque_limits(model, joints), lost)
    dofs = model.jnt_dofadr[joints]
    link, T_link_flange = _flange(tree)
    couplings = couplings_of(tree, names, lost)
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
    """Returns a robot's tables as written by hand: without entries that equal the defaults."""
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
    """Returns the robot in a piece of MJCF; raises DeclarationError."""
    spec = as_spec(source, folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about deprecated attributes
            tree = find_tree(spec.compile())
    except DeclarationError:
        raise
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise Problem("mjcf", reason).error() from None
    if is_file_name(source):
        _kept[folder / source] = _changed(folder / source), tree
        while len(_kept) > _MAX_KEPT:
            del _kept[next(iter(_kept))]
    return tree


def kept_tree(source: Any, folder: Path) -> MjcfTree:
    """As `tree_of`, but cached until the file changes."""
    if is_file_name(source):
        changed, tree = _kept.get(folder / source, (0, None))
        if tree is not None and changed == _changed(folder / source):
            return tree
    return tree_of(source, folder)


_MAX_KEPT = 8
_kept: dict[Path, tuple[int, MjcfTree]] = {}  # by file, with the time of its last change


def _changed(file: Path) -> int:
    return file.stat().st_mtime_ns if file.is_file() else 0


def _names(model: mujoco.MjModel, joints: Ints) -> list[str]:
    found = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(j)) for j in joints]
    given = [name or f"joint{k + 1}" for k, name in enumerate(found)]
    scopes = {name.rpartition("/")[0] for name in given}
    if len(scopes) == 1:
        given = [name.rpartition("/")[2] for name in given]
    return joint_names_of(given)[0]


def _inertias(tree: MjcfTree) -> dict[str, Any]:
    model, n = tree.model, len(tree.poses)
    masses, firsts, tensors = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    for body in np.flatnonzero(tree.links >= 0).tolist():
        link, mass = tree.links[body], float(model.body_mass[body])
        inertial = frame(rotation_from_quat(model.body_iquat[body]), model.body_ipos[body])
        T = inverse(tree.poses[link]) @ tree.bodies[body] @ inertial
        axes, at = T[:3, :3], T[:3, 3]
        masses[link] += mass
        firsts[link] += mass * at
        tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
        tensors[link] += tensor + mass * (at @ at * np.eye(3) - np.outer(at, at))
    centers = firsts / np.where(masses > 0, masses, 1.0)[:, None]
    for k, c in enumerate(centers):
        tensors[k] -= masses[k] * (c @ c * np.eye(3) - np.outer(c, c))
    tensors = np.where((masses > 0)[:, None, None], tensors, 0.0)
    return {
        "masses": masses,
        "centers_of_mass": centers,
        "inertias": tensors,
        "inertia_repair": "balance",
    }


def _bounded(values: Array, what: str, names: list[str], lost: list[str]) -> Array:
    if (far := values > LARGEST).any():
        lost.append(f"{what} is taken for {LARGEST:g}, the most: {_some(names, far)}")
    if (negative := values < 0).any():
        lost.append(f"negative {what} is taken for none: {_some(names, negative)}")
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
            f"torque limits up to {largest:g} are over {_MAX_FACTOR} times what holds all of its "
            f"weight at its extent; {many} are taken for none"
        )
    return np.where(far, np.inf, limits)


def _turns(tree: MjcfTree) -> Bools:
    kinds = tree.model.jnt_type[tree.joints]
    return np.asarray(kinds == int(mujoco.mjtJoint.mjJNT_HINGE))


def _flange(tree: MjcfTree) -> tuple[int, Array]:
    """Returns the link that carries the flange, and T_link_flange.

    The flange is at a site there whose name is that of a tool, else at the last body.
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
    """Returns the joint angles, and the frame of a free base, of a key frame, else of `qpos0`.

    The key frame is the first with a name for it, or the only one if it has no name.
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
    for _ in couplings:  # as often as a chain of couplings may have joints
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
    given = mujoco.mj_id2name(tree.model, mujoco.mjtObj.mjOBJ_JOINT, int(tree.free[0]))
    name = {"base_joint": plain_name(given.rpartition("/")[2], set())} if given else {}
    if len(tree.free) == 1:
        return {"free_base": True, **name}
    normal = tree.model.jnt_axis[tree.free[2]]
    own = {} if np.array_equal(normal, [0, 0, 1]) else {"base_normal": normal}
    return {"free_base": "planar", **own}
