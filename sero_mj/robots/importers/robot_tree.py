"""Converts a tree of links and joints, as in URDF, to the tables of a robot file.

Links that are fixed to each other are merged, with their inertias and geometries. The result is a
base and one link per movable joint. The z axis of a link's frame is the joint axis. If possible, a
chain is described by a Denavit-Hartenberg table. Other trees are described by joint frames.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...base.frames import Array, frame
from ..kinematics.dh_from_frames import DhChain, dh_from_frames
from .joint_names import joint_names_of, parents_of

MOVING = ("revolute", "prismatic")
_NO_NAME = re.compile(r"[^A-Za-z0-9_-]+")
_OF_LINK = re.compile(r"_?(link|frame)$")
_FLANGES = (
    "tool0", "flange", "tcp", "tool_center_point", "ee_link", "end_effector", "eef", "ee", "tool",
    "gripper_tcp", "hand_tcp", "grasp", "gripper", "hand",
)  # fmt: skip
_MAX_LENGTH_RATIO = 10.0  # maximum ratio of a length in a DH table to the reach
_MOMENT_ROUNDING, _ZERO = 1e-6, 1e-12  # relative tolerances, as in `robots.declared.dynamics`
NO_LIMIT = 1e3  # position limits of this size and more are ignored, rad or m
TOO_FAR = f"limits of {NO_LIMIT:g} rad or m and more are ignored"


def flange_body(parents: Sequence[int]) -> int:
    """Returns the index of the body that carries the flange.

    This is the last body of the longest branch, or the body that carries its fingers.

    Args:
        parents: parents of the bodies 1, 2, ..., where 0 is the base.
    """
    paths = [[0]]  # bodies between the base and each body
    for body, parent in enumerate(parents, 1):
        paths.append([*paths[parent], body])
    longest = max(map(len, paths))
    deepest = [path for path in paths if len(path) == longest]
    # Fingers share most of their paths, unlike the arms of a humanoid.
    common = [same[0] for same in zip(*deepest, strict=True) if len({*same}) == 1]
    is_gripper = len(common) > 1 and 2 * (len(common) - 1) >= longest - 1
    return common[-1] if is_gripper else deepest[0][-1]


@dataclass
class Geometry:
    """A mesh or a primitive shape of a link.

    Attributes:
        frame: pose in the frame of the link, shape (4, 4), m.
        file: absolute path of the mesh; None for a primitive shape.
        shape: primitive shape, `box`, `sphere`, `cylinder` or `capsule`.
        size: dimensions of the shape as in `robots.declared.surroundings.SHAPE_SIZES`, m.
        color: name and RGBA values of the color.
    """

    frame: Array
    file: Path | None = None
    scale: Array | None = None
    shape: str = ""
    size: Array | None = None
    color: tuple[str, Array] | None = None
    opacity: float = 1.0
    line: int | None = None


@dataclass
class UrdfLink:
    """A link with its geometry, mass, center of mass (3,), and inertia tensor (3, 3).

    The tensor is about the center of mass. Units are kg, m and kg m2.
    """

    name: str
    line: int | None = None
    mass: float = 0.0
    center: Array = field(default_factory=lambda: np.zeros(3))
    tensor: Array = field(default_factory=lambda: np.zeros((3, 3)))
    visuals: list[Geometry] = field(default_factory=list)
    collisions: list[Geometry] = field(default_factory=list)


@dataclass
class Joint:
    """A joint between two links.

    Attributes:
        kind: joint type, `revolute`, `prismatic` or `fixed`.
        frame: pose of the child in the frame of the parent at joint value zero, shape (4, 4), m.
        axis: joint axis in the frame of the child, shape (3,).
        mimic: name of the driving joint, ratio and offset of a coupled joint, or None.
    """

    name: str
    kind: str
    parent: str
    child: str
    frame: Array
    axis: Array
    line: int | None = None
    lower: float = -np.inf
    upper: float = np.inf
    limit_line: int | None = None
    velocity: float = np.inf
    effort: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    mimic: tuple[str, float, float] | None = None


@dataclass
class _Body:
    """A group of links that are fixed to each other: the base, or the links that a joint moves."""

    joint: Joint | None
    parent: int
    T_parent: Array  # pose in the parent body at joint value zero, with z along the joint axis
    links: list[tuple[UrdfLink, Array]] = field(default_factory=list)  # links and poses T_body_link
    fixed: dict[str, str] = field(default_factory=dict)  # parent names by name of a fixed link


class TreeTables:
    """The tables of a robot file that describe a tree of links, built by the constructor.

    Attributes:
        bodies: names of the links of each body, base first.
        flange: name of the link at the flange.
        T_body_link: index of the body and pose in its frame (4, 4) for each link, by name. The
            frames are those of `tables`.
    """

    def __init__(
        self,
        name: str,
        links: list[UrdfLink],
        joints: list[Joint],
        root: str,
        convention: Literal["craig", "standard"] = "craig",
    ) -> None:
        self.tables: dict[str, Any] = {}
        self.lines: dict[str, int] = {}
        self.warnings: list[str] = []
        self._name = name
        self._convention = convention
        self._bodies = _merged(links, joints, root)
        self.joints = [body.joint for body in self._bodies[1:] if body.joint is not None]
        self.bodies = [[link.name for link, _ in body.links] for body in self._bodies]
        self._in_dh: DhChain | None = None
        self._names = self._joint_names()
        carrier, self.flange, T_flange = self._flange()
        if self.joints:
            self._kinematics(carrier, T_flange)
        # Transformations from the frames of the bodies to the frames of the tables.
        self._carried = [np.eye(4) for _ in self._bodies]
        if self._in_dh is not None:
            self._carried[1:] = list(self._in_dh.link_frames)
        self.T_body_link = {
            link.name: (i, self._carried[i] @ T)
            for i, body in enumerate(self._bodies)
            for link, T in body.links
        }
        if self.joints:
            on = ["base", *(f"link{i + 1}" for i in range(len(self.joints)))]
            self.tables["link_frames"] = {
                name: {"on": on[i], "frame": T.tolist()}
                for name, (i, T) in self.T_body_link.items()
            }
            self._limits()
            self._dynamics()
        self._geometry()

    def _line(self, key: str, line: int | None) -> None:
        if line is not None:
            self.lines[key] = line

    def _joint_names(self) -> list[str]:
        names, changed = joint_names_of(joint.name for joint in self.joints)
        for i, joint in enumerate(self.joints):
            for key in ("joint_names", "joint_types", "joint_frames", "dh_params", "parents"):
                self._line(f"{key}.{i}", joint.line)
        if changed:
            self.warnings.append(f"joints were renamed: {', '.join(changed)}")
        return names

    def _flange(self) -> tuple[int, str, Array]:
        body = flange_body([each.parent for each in self._bodies[1:]])
        links = self._bodies[body].links
        plain = [_NO_NAME.sub("_", link.name).lower() for link, _ in links]
        plain += [_OF_LINK.sub("", name) for name in plain]  # "end_effector_link"
        for wanted in _FLANGES:
            for (link, T), name in zip([*links, *links], plain, strict=True):
                if name == wanted or name.endswith(f"_{wanted}"):
                    return body, link.name, T
        fixed = self._bodies[body].fixed
        ends = [(link, T) for link, T in links[1:] if link.name not in fixed.values()]
        link, T = ends[0] if len(ends) == 1 else links[0]
        return body, link.name, T

    def _kinematics(self, carrier: int, T_flange: Array) -> None:
        bodies = self._bodies[1:]
        frames = np.array([body.T_parent for body in bodies])
        revolute = np.array([joint.kind == "revolute" for joint in self.joints])
        is_chain = all(body.parent == i for i, body in enumerate(bodies))
        if is_chain and carrier == len(bodies):
            steps = np.linalg.norm([*frames[:, :3, 3], T_flange[:3, 3]], axis=1)
            slides = [max(abs(x) for x in (j.lower, j.upper, 0) if np.isfinite(x))
                      for j in self.joints if j.kind == "prismatic"]  # fmt: skip
            far = _MAX_LENGTH_RATIO * max(float(steps.sum()) + sum(slides), 0.1)
            chain = dh_from_frames(frames, revolute, T_flange, self._convention)
            if chain is not None and np.abs(chain.rows[:, [1, 3]]).max() < far:
                self._in_dh = chain
        if self._in_dh is not None:
            self.tables |= {"dh_convention": self._in_dh.convention,
                            "dh_params": self._in_dh.rows.tolist()}  # fmt: skip
            self._frame("dh_base_frame", self._in_dh.base_frame)
            self._frame("flange_frame", self._in_dh.flange_frame)
        else:
            self.tables["joint_frames"] = [T.tolist() for T in frames]
            self._frame("flange_frame", T_flange)
        if not revolute.all():
            self.tables["joint_types"] = [joint.kind for joint in self.joints]
        self.tables["joint_names"] = self._names
        self.tables["link_names"] = [links[0] for links in self.bodies]
        if not is_chain:
            parents = parents_of([body.parent for body in bodies], self._names)
            self.tables["parents"] = parents
        if carrier != len(bodies):
            self.tables["flange_on"] = self._names[carrier - 1]
        by_name = dict(zip((joint.name for joint in self.joints), self._names, strict=True))
        couplings: dict[str, Any] = {}
        for joint, name in zip(self.joints, self._names, strict=True):
            if joint.mimic is not None:
                to, ratio, offset = joint.mimic
                couplings[name] = {"to": by_name[to], "ratio": ratio, "offset": offset}
                self._line(f"couplings.{name}", joint.line)
        if couplings:
            self.tables["couplings"] = couplings

    def _frame(self, key: str, T: Array) -> None:
        if not np.array_equal(T, np.eye(4)):
            self.tables[key] = T.tolist()

    def _limits(self) -> None:
        for key, values in (
            ("position_limits", [[joint.lower, joint.upper] for joint in self.joints]),
            ("velocity_limits", [joint.velocity for joint in self.joints]),
            ("torque_limits", [joint.effort for joint in self.joints]),
        ):
            if np.isfinite(values).any():
                self.tables[key] = values
                for i, joint in enumerate(self.joints):
                    self._line(f"{key}.{i}", joint.limit_line)
        self._home()

    def _home(self) -> None:
        home = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in self.joints}
        if not any(home.values()):
            return
        by_name = {joint.name: joint for joint in self.joints}

        def value(joint: Joint) -> float:
            if joint.mimic is None:
                return home[joint.name]
            to, ratio, offset = joint.mimic
            return ratio * value(by_name[to]) + offset

        self.tables["joint_angles"] = [value(joint) for joint in self.joints]

    def _dynamics(self) -> None:
        dynamics: dict[str, Any] = {}
        if any(link.mass > 0 for body in self._bodies for link, _ in body.links):
            sums = [
                joint_inertia([(link, T_carried @ T) for link, T in body.links])
                for body, T_carried in zip(self._bodies, self._carried, strict=True)
            ]
            dynamics = {
                "masses": [mass for mass, _, _ in sums],
                "centers_of_mass": [center.tolist() for _, center, _ in sums],
                "inertias": [six_of(tensor) for _, _, tensor in sums],
            }
            self._check_masses(sums, dynamics)
        else:
            self.warnings.append("no link has a mass; the simulation estimates all masses")
        for key, values in (
            ("viscous_friction", [joint.damping for joint in self.joints]),
            ("coulomb_friction", [joint.friction for joint in self.joints]),
        ):
            if any(values):
                dynamics[key] = values
        if dynamics:
            self.tables["dynamics"] = dynamics
        for i, body in enumerate(self._bodies):
            for key in ("masses", "centers_of_mass", "inertias"):
                self._line(f"dynamics.{key}.{i}", body.links[0][0].line)

    def _check_masses(self, sums: list[tuple[float, Array, Array]], dynamics: Any) -> None:
        massless, odd = [], []
        for i, (mass, _, tensor) in enumerate(sums):
            name = self.bodies[i][0]
            if mass == 0.0 and i > 0:
                massless.append(f"'{name}'")
            elif mass > 0.0:
                low, middle, high = np.linalg.eigvalsh(tensor)
                if low <= _ZERO * high or low + middle < high * (1 - _MOMENT_ROUNDING):
                    odd.append(f"'{name}'")
        if massless:
            self.warnings.append(f"moving links without mass: {', '.join(massless)}")
        if odd:
            dynamics["inertia_repair"] = "balance"
            self.warnings.append(
                f"the inertia tensors of {', '.join(odd)}, including links fixed to them, are "
                "physically impossible and are replaced by the closest possible tensors"
            )

    def _geometry(self) -> None:
        all_links = [link for body in self._bodies for link, _ in body.links]
        drawn = "visuals" if any(link.visuals for link in all_links) else "collisions"
        colors = _Colors()
        files = [
            Path(geometry.file)
            for link in all_links
            for geometry in (*link.visuals, *link.collisions)
            if geometry.file is not None
        ]
        folder = _common_folder(files)
        if files:
            self.tables["directory"] = str(folder)
        for key, which, look in (
            ("filenames", drawn, colors.name),
            ("collisions", "collisions", None),
        ):
            entries: list[list[dict[str, Any]]] = []
            for i, (body, T_carried) in enumerate(zip(self._bodies, self._carried, strict=True)):
                entries.append([])
                for link, T in body.links:
                    for geometry in getattr(link, which):
                        self._line(f"{key}.{i}.{len(entries[i])}", geometry.line)
                        entries[i].append(_entry(geometry, T_carried @ T, folder, look))
                self._line(f"{key}.{i}", body.links[0][0].line)
            if key == "collisions" or any(entries):
                self.tables[key] = entries
        if colors.by_name:
            self.tables["colors"] = {key: rgba.tolist() for key, rgba in colors.by_name.items()}


class _Colors:
    def __init__(self) -> None:
        self.by_name: dict[str, Array] = {}
        self._taken: set[str] = set()

    def name(self, color: tuple[str, Array]) -> str:
        wanted, rgba = color
        for name, known in self.by_name.items():
            if np.array_equal(known, rgba):
                return name
        name = plain_name(wanted or "color", self._taken)
        self.by_name[name] = rgba
        return name


def plausible_limits(limits: Array) -> Array:
    """Replaces position limits (..., 2) of 1000 rad or m (`NO_LIMIT`) or more by infinity."""
    return np.where(np.abs(limits) < NO_LIMIT, limits, [-np.inf, np.inf])


def plain_name(name: str, taken: set[str]) -> str:
    """Converts a name to letters, digits, _ and -, makes it unique, and adds it to `taken`."""
    plain = _NO_NAME.sub("_", name)
    if not re.match(r"[A-Za-z_]", plain):
        plain = f"_{plain}"
    unique, count = plain, 1
    while unique in taken:
        count += 1
        unique = f"{plain}_{count}"
    taken.add(unique)
    return unique


def aligned(axis: Array) -> Array:
    """Returns a rotation matrix whose z axis is parallel to `axis`, exact for coordinate axes."""
    axis = axis / np.linalg.norm(axis)
    # The x axis is derived from x or y, depending on which one is farther from the axis.
    helper = np.eye(3)[0 if abs(axis[0]) <= abs(axis[1]) else 1]
    if abs(axis[0]) < 1e-12 and abs(axis[1]) < 1e-12:
        z = np.sign(axis[2])
        return np.diag([1.0, z, z])
    x = helper - (helper @ axis) * axis
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _merged(links: list[UrdfLink], joints: list[Joint], root: str) -> list[_Body]:
    by_name = {link.name: link for link in links}
    below: dict[str, list[Joint]] = {}
    for each in joints:
        below.setdefault(each.parent, []).append(each)
    order = {id(each): k for k, each in enumerate(joints)}
    bodies = [_Body(None, 0, np.eye(4))]
    # Branches to visit, each with a movable joint, its parent body, and T_body_parent.
    waiting: list[tuple[Joint | None, int, Array]] = [(None, 0, np.eye(4))]
    while waiting:
        joint, parent, T = waiting.pop()
        name, at, T_body = root, 0, np.eye(4)
        if joint is not None:
            turned = frame(aligned(joint.axis))
            bodies.append(_Body(joint, parent, T @ joint.frame @ turned))
            name, at, T_body = joint.child, len(bodies) - 1, frame(turned[:3, :3].T)
        found: list[tuple[Joint | None, int, Array]] = []
        same: list[tuple[str, Array]] = [(name, T_body)]
        while same:
            name, T_body = same.pop(0)
            bodies[at].links.append((by_name[name], T_body))
            for other in below.get(name, []):
                if other.kind in MOVING:
                    found.append((other, at, T_body))
                else:
                    bodies[at].fixed[other.child] = name
                    same.append((other.child, T_body @ other.frame))
        waiting += sorted(found, key=lambda each: -order[id(each[0])])
    return bodies


def joint_inertia(parts: list[tuple[UrdfLink, Array]]) -> tuple[float, Array, Array]:
    """Returns the total mass, center of mass and inertia tensor of links with poses (4, 4)."""
    mass = sum(link.mass for link, _ in parts)
    if mass <= 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centers = [T[:3, :3] @ link.center + T[:3, 3] for link, T in parts]
    center = sum((link.mass * c for (link, _), c in zip(parts, centers, strict=True)), np.zeros(3))
    center = center / mass
    tensor = np.zeros((3, 3))
    for (link, T), c in zip(parts, centers, strict=True):
        away = c - center
        tensor += T[:3, :3] @ link.tensor @ T[:3, :3].T
        tensor += link.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return float(mass), center, (tensor + tensor.T) / 2


def six_of(tensor: Array) -> list[float]:
    """Returns the entries Ixx, Iyy, Izz, Ixy, Ixz and Iyz of an inertia tensor (3, 3)."""
    entries = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    return [float(tensor[i, j]) for i, j in entries]


def _common_folder(files: list[Path]) -> Path:
    if not files:
        return Path()
    return Path(os.path.commonpath([file.parent for file in files]))


def _entry(
    geometry: Geometry,
    T_body_link: Array,
    folder: Path,
    look: Callable[[tuple[str, Array]], str] | None,
) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    if geometry.file is not None:
        entry["file"] = geometry.file.relative_to(folder).as_posix()
        if geometry.scale is not None and not (geometry.scale == 1.0).all():
            same = (geometry.scale == geometry.scale[0]).all()
            entry["scale"] = float(geometry.scale[0]) if same else geometry.scale.tolist()
    else:
        assert geometry.size is not None  # All primitive shapes have a size.
        entry |= {"shape": geometry.shape, "size": geometry.size.tolist()}
    if look is not None and geometry.color is not None:
        entry["color"] = look(geometry.color)
    if look is not None and geometry.opacity != 1.0:
        entry["opacity"] = geometry.opacity
    T = T_body_link @ geometry.frame
    if not np.array_equal(T, np.eye(4)):
        entry["frame"] = T.tolist()
    return entry
