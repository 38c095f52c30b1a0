"""Finds the robots in an external model and determines their names.

A robot is a kinematic tree with hinge or slide joints, which consists of a child of the world and
its descendants. There are two exceptions:

- If a model has actuators, only the trees that they drive are robots. Doors and knobs are not.
- MuJoCo fuses a fixed trunk with the world, so that its limbs become separate trees. Limbs that
  touch the same solid geoms of the world form one robot.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ..assemble.solids import geom_boxes, geoms_of
from ..importers.mjcf_model import driven_roots, read_links

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_RESERVED = ("world", "toggles")  # reserved names in routes
# Names of root bodies with only these words do not identify a robot.
_PART_WORDS = frozenset(
    {
        *("b", "base", "body", "chassis", "footprint", "frame", "link", "main", "mount", "pelvis"),
        *("platform", "robot", "root", "torso", "trunk", "world"),
    }
)
_UNNAMED = "MuJoCo Model"  # MuJoCo's name for an unnamed model
_TOUCHING = 0.2  # maximum gap between touching geoms, relative to the world geom's diagonal
_TYPES = mujoco.mjtGeom


@dataclass(frozen=True, eq=False)
class Tree:
    """A robot in an external model: one kinematic tree, or several trees on a fused trunk.

    Attributes:
        name: unique name for routes, which is the name of the root body, or of the model if the
            root has a generic name such as `base_link`.
        bodies: ids of the bodies, parents before children. The first body is the root, or the world
            if there is a trunk.
        trunk: ids of the geoms of the world body that form the fused trunk.
        joints: ids of the hinges and slides, shape (n,).
        joint_names: names of the n joints without their common scope.
        chain: indices of the joints between the root and the first branch, which move the tool of a
            serial arm.
        last: id of the body at the end of the chain.
    """

    name: str
    bodies: Ints
    trunk: Ints
    joints: Ints
    joint_names: list[str]
    chain: Ints
    last: int

    def carriers(self, model: mujoco.MjModel) -> Ints:
        """Returns the index of each joint's parent link, shape (n,), 0 for the root."""
        return read_links(model, self.joints)[1]


def find_trees(model: mujoco.MjModel, wanted: Collection[str] = ()) -> list[Tree]:
    """Returns the robots of a model in the order of their bodies.

    `wanted` contains names of trees that are robots even if they have no actuators.
    """
    single = np.isin(model.jnt_type, (_HINGE, _SLIDE))
    tree_of_joint = model.body_rootid[model.jnt_bodyid]
    groups = _fused_groups(model, np.unique(tree_of_joint[single]))
    driven = driven_roots(model)
    drives = [not driven.isdisjoint(roots) for roots, _ in groups]
    if not any(drives):
        drives = [True] * len(groups)
    trees: list[Tree] = []
    names: list[str] = []
    for (roots, trunk), has_drives in zip(groups, drives, strict=True):
        is_alone = sum(drives) == 1 and has_drives
        name = _unlike(_robot_name(model, roots, is_alone), names)
        names.append(name)
        if not (has_drives or name in wanted):
            continue
        bodies = np.isin(model.body_rootid, roots).nonzero()[0]
        root = int(roots[0])
        if len(trunk):
            root, bodies = 0, np.concatenate([[0], bodies])
        joints = (single & np.isin(tree_of_joint, roots)).nonzero()[0]
        chain, last = _serial_part(model, root, joints)
        joint_names = _joint_names(model, joints)
        trees.append(Tree(name, bodies, trunk, joints, joint_names, chain, last))
    return trees


def _fused_groups(model: mujoco.MjModel, roots: Ints) -> list[tuple[Ints, Ints]]:
    alone = np.empty(0, np.intp)
    hinged = [int(root) for root in roots if _is_limb(model, int(root))]
    solid = (model.geom_bodyid == 0) & (model.geom_type != _TYPES.mjGEOM_PLANE)
    solid &= model.geom_type != _TYPES.mjGEOM_HFIELD
    if len(hinged) < 2 or not solid.any():
        return [(np.array([root]), alone) for root in roots]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = geom_boxes(model, data)
    limbs = []
    for root in hinged:
        own = geoms_of(model, np.array([root]))
        # The box includes the origin of the body, because a limb may have no geoms.
        corners = np.vstack([data.xpos[root], low[own], high[own]])
        limbs.append(np.stack([corners.min(axis=0), corners.max(axis=0)]))
    size = np.concatenate([np.ptp(limb, axis=0) for limb in limbs]).reshape(-1, 3)
    largest = 2 * np.linalg.norm(size, axis=1).sum()
    nodes: list[tuple[int, Array, float]] = []  # as in `_touching`
    nodes += [(root, box, 0.0) for root, box in zip(hinged, limbs, strict=True)]
    for geom in solid.nonzero()[0]:
        box = np.stack([low[geom], high[geom]])
        diagonal = float(np.linalg.norm(box[1] - box[0]))
        if diagonal <= largest:  # Larger geoms are furniture and walls.
            nodes.append((-1 - int(geom), box, _TOUCHING * diagonal))
    groups: list[tuple[Ints, Ints]] = []
    joined: set[int] = set()
    for root in roots.tolist():
        if root in joined:
            continue
        members = _touching(root, nodes) if root in hinged else [root]
        scope = _scope(model, root)
        mine = sorted(node for node in members if node >= 0 and _scope(model, node) == scope)
        if len(mine) > 1:
            joined.update(mine)
            trunk = np.array(sorted(-1 - node for node in members if node < 0), np.intp)
            groups.append((np.array(mine), trunk))
        else:
            groups.append((np.array([root]), alone))
    return groups


def _is_limb(model: mujoco.MjModel, root: int) -> bool:
    first = int(model.body_jntadr[root])
    kinds = model.jnt_type[first : first + int(model.body_jntnum[root])]
    is_free = (kinds == int(mujoco.mjtJoint.mjJNT_FREE)).any() or (kinds == _SLIDE).sum() > 1
    return len(kinds) > 0 and not is_free


def _touching(start: int, nodes: list[tuple[int, Array, float]]) -> list[int]:
    """Returns the ids of the limbs and world geoms that a trunk connects to the limb `start`.

    A trunk consists of world geoms that touch each other. A node is a limb or a world geom, with
    an id (negative for geoms), a box (2, 3), and the maximum gap at which it touches other nodes.
    """
    found, todo = {start}, [node for node in nodes if node[0] == start]
    while todo:
        key, box, reach = todo.pop()
        for node in nodes:
            if node[0] in found or (key >= 0 and node[0] >= 0):
                continue  # Two limbs do not connect each other.
            gap = max(reach, node[2])
            if (box[0] - gap <= node[1][1]).all() and (node[1][0] - gap <= box[1]).all():
                found.add(node[0])
                todo.append(node)
    return sorted(found)


def _scope(model: mujoco.MjModel, body: int) -> str:
    return str(model.body(body).name).strip("/").rpartition("/")[0]


def _robot_name(model: mujoco.MjModel, roots: Ints, is_alone: bool) -> str:
    """Returns the name of the root body. If it is generic, returns its scope or the model name."""
    name = str(model.body(int(roots[0])).name).strip("/")
    model_name = model.names[: model.names.index(b"\0")].decode(errors="replace")
    model_name = "" if model_name == _UNNAMED else re.sub(r"[ _-]*scene$", "", model_name)
    scope, _, own = name.rpartition("/")
    known = _PART_WORDS | set(_words(model_name))
    if len(roots) == 1 and not known.issuperset(_words(own)):
        return _as_name(name)
    return _as_name(scope or (model_name if is_alone else "") or name)


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+", name.lower())


def _as_name(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_-]", "_", text.strip("/"))
    if not name:
        return "robot"
    return name if re.match(r"[A-Za-z_]", name) else f"_{name}"


def _unlike(name: str, taken: Iterable[str]) -> str:
    taken = {*taken, *_RESERVED}
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}{number}", number + 1
    return candidate


def _joint_names(model: mujoco.MjModel, joints: Ints) -> list[str]:
    names: list[str] = []
    for joint in joints:
        name = model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name
        names.append(_unlike(name or f"joint{joint}", names))
    return without_scope(names)


def without_scope(names: list[str]) -> list[str]:
    """Removes the common scope from names, such as `jaco/` from `jaco/hand/finger_1`."""
    split = [name.split("/") for name in names]
    common, limit = 0, min((len(parts) - 1 for parts in split), default=0)
    while common < limit and len({parts[common] for parts in split}) == 1:
        common += 1
    return ["/".join(parts[common:]) for parts in split]


def _serial_part(model: mujoco.MjModel, root: int, joints: Ints) -> tuple[Ints, int]:
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
    if body not in below:  # The tool is the last body that is fixed to the end of the chain.
        fixed = [b for b in range(body + 1, model.nbody) if int(model.body_weldid[b]) == body]
        body = fixed[-1] if fixed else body
    chain = np.array([i for i, j in enumerate(joints) if int(model.jnt_bodyid[j]) in along])
    return chain.astype(np.intp), body
