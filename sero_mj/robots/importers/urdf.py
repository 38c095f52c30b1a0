"""Reads URDF and xacro files as the tables of a robot file.

The reader follows the URDF 1.0 specification (wiki.ros.org/urdf/XML) and tolerates common errors.
For cases that the specification does not cover, it follows other tools: colors of a mesh file
override the `<material>` (RViz), and a range of zero means no limit (MuJoCo). All errors are
reported together, with line numbers. MuJoCo's own reader supports neither COLLADA nor `package://`,
and yourdfpy reports no line numbers.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np

from ...base.declaration import LARGEST
from ...base.errors import DeclarationError, Problem, did_you_mean, first_of, raise_any, reason_of
from ...base.frames import Array, frame, rotation_from_rpy
from ...base.paths import format_of_file, read_file
from .imported_tables import ImportedTables, NoJoints
from .mesh_files import read_mesh
from .package_files import ARGUMENTS_VARIABLE, find_file, package_folders, package_of
from .robot_tree import (
    MOVING,
    TOO_FAR,
    Geometry,
    Joint,
    TreeTables,
    UrdfLink,
    aligned,
    plain_name,
    plausible_limits,
)
from .xml_file import Element, XmlError, parse_loose_xml, parse_xml

_MAX_BYTES = 50_000_000
_MAX_JOINTS = 128  # maximum number of movable joints
_MAX_LINKS = 10_000  # maximum number of links, because some steps take quadratic time
_FREEING = ("floating", "planar")
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_SHAPES = {"box": "size", "cylinder": "radius, length", "sphere": "radius",
           "capsule": "radius, length"}  # fmt: skip
_XACRO = re.compile(r"\{[^}]*xacro[^}]*\}")
_COMMAS = re.compile(r"\s*,\s*")
_SECOND_POINT = re.compile(r"^([+-]?[0-9]+\.[0-9]*)\.$")
_FROM_ENVIRONMENT = re.compile(r"\$\((?:env\s+(\w+)|optenv\s+(\w+)([^()]*))\)")
_NO_ARGUMENT = re.compile(r"Undefined substitution argument (\w+)")
_NO_XACRO = (
    "is a xacro file. Install the xacro reader with `pip install sero-mj[xacro]`, or convert the "
    "file on a machine with ROS: `xacro {name} > robot.urdf`"
)
_UNEXPANDED = (
    'xacro elements are ignored; add xmlns:xacro="http://www.ros.org/wiki/xacro" to expand them'
)


def read_urdf(
    path: Path | str,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Reads a robot from a URDF file, or from a xacro file if the package `xacro` is installed.

    A chain is converted to a DH table in Craig's convention if possible. Other robots have
    `joint_frames`.

    Args:
        packages: folders of ROS packages by name, for `package://NAME/...`. Other packages are
            searched for in folders above the file and in paths from the environment.
        arguments: values of xacro arguments by name.

    Raises:
        NoJoints: the file has no movable joint. Use `read_rigid_urdf` instead.
        DeclarationError: the file or the arguments are invalid. The exception lists all errors.
    """
    file = UrdfFile(Path(path), packages, arguments)
    file.check()
    return file.described


def read_rigid_urdf(path: Path | str) -> ImportedTables:
    """Reads a URDF file without movable joints, such as a tool, as a robot with only a base."""
    file = UrdfFile(Path(path))
    if file.tree.joints:
        raise Problem(
            "robot",
            found=len(file.tree.joints),
            of="movable joints",
            expected=f'none in an object; declare a robot with model = "{file.path.name}"',
            file=str(path),
        ).error()
    return file.described


class _Arguments(dict[str, str]):
    def __init__(self, arguments: Mapping[str, Any]) -> None:
        over = json.loads(os.environ.get(ARGUMENTS_VARIABLE) or "{}")
        super().__init__({name: _as_text(value) for name, value in {**arguments, **over}.items()})
        self.declared = set(self)
        self.used: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.used.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.used.add(name)
        return super().__getitem__(name)


def _as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class UrdfFile:
    """A URDF or xacro file that the constructor has read and converted.

    `convention` is the convention of the DH table if the robot has one.

    Attributes:
        tree: converted tree of links.
        described: tables of the robot, with line numbers and warnings.
    """

    def __init__(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
        convention: Literal["craig", "standard"] = "craig",
    ) -> None:
        self.path = path
        self._arguments = _Arguments(arguments or {})
        self._packages = {name: Path(folder) for name, folder in (packages or {}).items()}
        self._problems: list[Problem] = []
        self._warnings: list[str] = []
        self._is_xacro, self._has_lines = False, True
        self._missing: dict[str, None] = {}  # names of missing mesh files
        self._found: dict[str, Path | None] = {}  # mesh files by name in the URDF
        self._last_found: dict[str, Path] = {}  # folders by package
        self._unreadable: dict[Path, str] = {}  # error messages by mesh file
        self._colored: dict[Path, bool] = {}  # whether a mesh file has colors, by file
        self._flat: set[Path] = set()
        self._notes: dict[str, list[str]] = {}  # affected elements by warning
        root = self._root()
        self._root_line = root.sourceline if self._has_lines else None
        if (count := sum(1 for _ in _children(root, "link"))) > _MAX_LINKS:
            found = f"{count} links; expected at most {_MAX_LINKS}"
            self._problem(root, "robot", f"found {found}")
            self._stop()
        self._materials = self._colors(root)
        links = self._links(root)
        joints = self._joints(root, {link.name for link in links})
        self._stop()
        base = self._tree(links, joints)
        base_frame, free_base = self._free_base(base, links, joints)
        self._stop()
        self._check_mimics(joints)
        moving = [joint for joint in joints if joint.kind in MOVING]
        if len(moving) > _MAX_JOINTS:
            found = f"{len(moving)} movable joints"
            self._problem(root, "robot", f"found {found}; expected at most {_MAX_JOINTS}")
        self._stop()
        self._warn_about_meshes(links)
        robot = (root.get("name") or "").strip()
        base = base if free_base is None else free_base.child
        self.tree = TreeTables(robot, links, joints, base, convention)
        name = plain_name(robot or path.stem, set())
        tables: dict[str, Any] = {
            "name": name,
            "description": f"{len(moving)} joint{'s' * (len(moving) > 1)}, from {path.name}",
        }
        if free_base is not None:
            tables["free_base"] = free_base.kind == "floating" or free_base.kind
            tables["base_joint"] = plain_name(free_base.name, set())
            normal = (free_base.axis / np.linalg.norm(free_base.axis)).tolist()
            if free_base.kind == "planar" and normal != [0, 0, 1]:
                tables["base_normal"] = normal
        if not np.array_equal(base_frame, np.eye(4)):
            tables["base_frame"] = base_frame.tolist()
        tables |= {**self.tree.tables, "fit_arrows": True}
        warnings = [
            *(f"{what}: {first_of(where)}" for what, where in self._notes.items()),
            *self._warnings,
            *self.tree.warnings,
        ]
        lines = {"name": root.sourceline, **self.tree.lines} if self._has_lines else {}
        self.described = ImportedTables(tables, {k: v for k, v in lines.items() if v}, warnings)

    def check(self) -> None:
        """Raises NoJoints if no joint is movable, and DeclarationError for unknown arguments."""
        used = self._arguments.used
        for name in sorted(self._arguments.declared - used):
            message = f"unknown xacro argument '{name}'{did_you_mean(name, used)}"
            if not self._is_xacro:
                message = "only xacro files have arguments; this file is plain URDF"
            self._problem(None, f"arguments.{name}", message)
        self._stop()
        if not self.tree.joints:
            message = (
                "has no movable joint; expected one or more. Add a rigid body to a scene as an "
                f'object with urdf = "{self.path.name}"'
            )
            raise NoJoints([Problem("robot", message, str(self.path), self._root_line)])

    def _problem(self, element: Element | None, key: str, message: str) -> None:
        line = None if element is None or not self._has_lines else element.sourceline
        self._problems.append(Problem(key, message, str(self.path), line))

    def _stop(self) -> None:
        raise_any(self._problems)

    def _note(self, what: str, element: Element, key: str) -> None:
        line = f" (line {element.sourceline})" if self._has_lines else ""
        self._notes.setdefault(what, []).append(f"{key}{line}")

    def _root(self) -> Element:
        try:
            root, warnings = parse_loose_xml(read_file(self.path, _MAX_BYTES))
            self._warnings += warnings
            if any(_XACRO.match(name) for each in root.iter() for name in _names(each)):
                root = self._expanded()
            else:
                self._fill_in_environment(root)
                self._note_unexpanded(root)
        except DeclarationError:
            raise
        except XmlError as error:
            self._problems += [
                Problem("", f"not valid XML: {reason}", str(self.path), line)
                for line, reason in error.reasons
            ]
        except FileNotFoundError:
            self._problem(None, "", "no such file")
        except (OSError, ValueError) as error:
            self._problem(None, "", f"cannot be read: {reason_of(error)}")
        self._stop()
        if _tag(root) != "robot":
            found = format_of_file(self.path) or f"XML <{_tag(root)}>"
            self._problem(root, "", f"is {found}; expected a URDF file, whose root is <robot>")
        self._stop()
        return root

    def _note_unexpanded(self, root: Element) -> None:
        for element in root.iter("*"):
            if element.prefix == "xacro":
                self._note(_UNEXPANDED, element, f"<xacro:{_tag(element)}>")

    def _fill_in_environment(self, root: Element) -> None:
        def value(found: re.Match[str]) -> str:
            name, optional, default = found.groups()
            if name is not None and name not in os.environ:
                message = f"found {found[0]}, but the environment variable {name} is not set"
                self._problem(element, f"<{_tag(element)}>", message)
            return os.environ.get(name or optional, (default or "").strip())

        for element in root.iter():
            for key, text in element.attrib.items():
                if "$(" in text:
                    element.set(key, _FROM_ENVIRONMENT.sub(value, text))

    def _expanded(self) -> Element:
        try:
            import simpleeval  # noqa: F401  # `xacro_file` needs both
            import xacro  # noqa: F401

            from . import xacro_file
        except ImportError:
            self._problem(None, "", _NO_XACRO.format(name=self.path.name))
            self._stop()
        self._is_xacro, self._has_lines = True, False  # xacro discards line numbers.

        def find(package: str) -> str:
            folders = package_folders(package, self.path, self._packages)
            found = next((str(folder) for folder in folders if folder.is_dir()), None)
            if found is None:
                raise ValueError(
                    f"package '{package}' not found; set its folder with --package {package}=DIR"
                )
            return found

        try:
            text = xacro_file.expand(self.path, self._arguments, find)
        except (Exception, SystemExit) as error:  # xacro raises any exception for invalid files.
            reason = " ".join(str(error).split()) or type(error).__name__
            if (missing := _NO_ARGUMENT.search(reason)) is not None:
                reason += f"; set it with --arg {missing[1]}=VALUE"
            self._problem(None, "", f"xacro cannot expand the file: {reason}")
            self._stop()
        return parse_xml(text.encode())

    def _colors(self, root: Element) -> dict[str, Array]:
        colors: dict[str, Array] = {}
        inner = [
            material for each in _children(root, "link") for material in _all(each, "material")
        ]
        for material in (*_children(root, "material"), *inner):
            name, color = material.get("name", ""), _child(material, "color")
            if color is not None and name and name not in colors:
                rgba = self._rgba(color, f"material '{name}'")
                if rgba is not None:
                    colors[name] = rgba
        return colors

    def _rgba(self, color: Element, key: str) -> Array | None:
        rgba = self._numbers(color, "rgba", key, (3, 4))
        return None if rgba is None else np.clip([*rgba, 1.0][:4], 0.0, 1.0)

    def _links(self, root: Element) -> list[UrdfLink]:
        links: list[UrdfLink] = []
        lines: dict[str, int | None] = {}
        for element in _children(root, "link"):
            name = self._name(element, "link")
            if name in lines:
                self._problem(
                    element, f"link '{name}'", f"is already defined in line {lines[name]}"
                )
                continue
            lines[name] = element.sourceline
            link = UrdfLink(name, element.sourceline)
            self._inertial(element, link)
            for tag, geometries in (("visual", link.visuals), ("collision", link.collisions)):
                for each in _children(element, tag):
                    geometry = self._geometry(each, tag, name)
                    if geometry is not None:
                        geometries.append(geometry)
            links.append(link)
        if not links:
            self._problem(root, "robot", "has no <link>; expected at least one link")
        return links

    def _inertial(self, element: Element, link: UrdfLink) -> None:
        inertial, key = _child(element, "inertial"), f"link '{link.name}'"
        if inertial is None:
            return
        T = self._origin(inertial, key)
        mass, inertia = _child(inertial, "mass"), _child(inertial, "inertia")
        value = None
        if mass is None or mass.get("value") is None:
            self._note("<inertial> without <mass value=...> is ignored", inertial, key)
        elif (value := self._number(mass, "value", key)) is not None and value < 0:
            self._problem(mass, key, f"<mass>: found {value:g} kg; expected 0 or more")
        elif value == 0 and _all(element, "geometry"):  # A link without geometry is only a frame.
            self._note("links with zero mass", mass, f"'{link.name}'")
        tensor = np.zeros((3, 3))
        if inertia is not None:
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            found = [
                self._number(inertia, name, key, None if name[1] == name[2] else 0.0)
                for name in names
            ]
            if None not in found:
                xx, yy, zz, xy, xz, yz = found
                tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], np.float64)
        if value and not tensor.any():
            self._note("links with a mass but no inertia tensor", inertial, f"'{link.name}'")
        if value and value > 0:
            link.mass, link.center = value, T[:3, 3]
            link.tensor = T[:3, :3] @ tensor @ T[:3, :3].T

    def _geometry(self, element: Element, tag: str, link: str) -> Geometry | None:
        key = f"link '{link}'"
        T = self._origin(element, key)
        outer = _child(element, "geometry")
        inner = None if outer is None else next(iter(_children(outer)), None)
        if inner is None:
            self._note(f"<{tag}> without geometry", element, f"'{link}'")
            return None
        color = self._color(element, key)
        if _tag(inner) == "mesh":
            return self._mesh(inner, tag, link, T, color)
        if _tag(inner) not in _SHAPES:
            near = did_you_mean(_tag(inner), ["mesh", *_SHAPES])
            self._problem(inner, key, f"<{tag}>: unknown geometry <{_tag(inner)}>{near}")
            return None
        names = _SHAPES[_tag(inner)].split(", ")
        if _tag(inner) == "box":
            size = self._numbers(inner, "size", key, (3,))
        else:
            values = [self._number(inner, name, key) for name in names]
            size = None if None in values else np.array(values, np.float64)
        if size is None:
            return None
        if (size <= 0).any():
            self._note(f"<{tag}> shapes without a positive size are left out", inner, f"'{link}'")
            return None
        return Geometry(T, shape=_tag(inner), size=size, color=color, line=element.sourceline)

    def _color(self, element: Element, key: str) -> tuple[str, Array] | None:
        material = _child(element, "material")
        if material is None:
            return None
        name, color = material.get("name", ""), _child(material, "color")
        rgba = None if color is None else self._rgba(color, f"{key}, material '{name}'")
        if rgba is None:
            rgba = self._materials.get(name)
        if rgba is None and _child(material, "texture") is not None:
            self._note("textures are not shown", material, f"material '{name}'")
        return None if rgba is None else (name, rgba)

    def _mesh(
        self, mesh: Element, tag: str, link: str, T: Array, color: tuple[str, Array] | None
    ) -> Geometry | None:
        key = f"link '{link}'"
        name = (mesh.get("filename") or "").strip()
        if not name:
            self._problem(mesh, key, '<mesh> has no filename; expected filename="..."')
            return None
        scale = np.ones(3)
        if mesh.get("scale") is not None:
            values = self._numbers(mesh, "scale", key, (1, 3))
            if values is None:
                return None
            scale = np.broadcast_to(values, 3).copy()
        if (scale == 0).any():
            self._note("meshes with a scale of 0 are left out", mesh, f"'{link}'")
            return None
        file = self._mesh_file(mesh, name, tag, link)
        if file is None:
            return None
        if color is None or not self._colored[file]:
            return Geometry(T, file, scale, color=color, line=mesh.sourceline)
        # As in RViz, colors of a mesh file override the color of the material, but not its opacity.
        alpha = float(color[1][3]) or 1.0
        return Geometry(T, file, scale, opacity=alpha, line=mesh.sourceline)

    def _mesh_file(self, mesh: Element, name: str, tag: str, link: str) -> Path | None:
        if name not in self._found:
            self._found[name] = self._search(name)
        file = self._found[name]
        if file is None:
            self._missing[name] = None
            return None
        if file not in self._colored and file not in self._unreadable:
            try:
                pieces = read_mesh(file)
                self._colored[file] = any(piece.rgba is not None for piece in pieces)
                if any(piece.is_flat for piece in pieces):
                    self._flat.add(file)
            except DeclarationError as error:
                self._unreadable[file] = str(error.problems[0])
        if tag == "collision" and file in self._flat:
            self._note(
                "flat <collision> meshes are left out, because they have no convex hull",
                mesh,
                f"'{link}'",
            )
            return None
        return None if file in self._unreadable else file

    def _search(self, name: str) -> Path | None:
        file = find_file(name, self.path, {**self._last_found, **self._packages})
        package = package_of(name)
        if file is not None and package is not None:
            inside = Path(unquote(name).partition(f"{package}/")[2])
            if file.parts[-len(inside.parts) :] == inside.parts:
                self._last_found[package] = file.parents[len(inside.parts) - 1]
        return file

    def _warn_about_meshes(self, links: list[UrdfLink]) -> None:
        if self._missing:
            wanted = {
                package for name in self._missing if (package := package_of(name)) is not None
            }
            unknown = [
                package
                for package in sorted(wanted)
                if not any(f.is_dir() for f in package_folders(package, self.path, self._packages))
            ]
            how = "".join(f"; set its folder with --package {package}=DIR" for package in unknown)
            if not any(link.visuals for link in links) and any(link.collisions for link in links):
                how = f"; collision shapes are shown instead{how}"
            count = len(self._missing)
            self._warnings.append(
                f"{count} mesh file{'s were' if count > 1 else ' was'} not found{how}: "
                f"{first_of(list(self._missing), 3)}"
            )
        self._warnings += [
            f"{reason}; the mesh is not shown" for reason in self._unreadable.values()
        ]

    def _joints(self, root: Element, links: set[str]) -> list[Joint]:
        joints: list[Joint] = []
        lines: dict[str, int | None] = {}
        carried: dict[str, str] = {}
        for element in _children(root, "joint"):
            name = self._name(element, "joint")
            key = f"joint '{name}'"
            if name in lines:
                self._problem(element, key, f"is already defined in line {lines[name]}")
                continue
            lines[name] = element.sourceline
            kind = (element.get("type") or "").strip()
            if kind not in _KINDS:
                found = f"found type '{kind}'" if kind else "has no type"
                near = did_you_mean(kind, _KINDS) if kind else ""
                near = near if "did you mean" in near else f"; expected {', '.join(_KINDS)}"
                self._problem(element, key, f"{found}{near}")
                continue
            ends = [self._end(element, tag, key, links) for tag in ("parent", "child")]
            T = self._origin(element, key)
            if None in ends:
                continue
            parent, child = ends
            assert parent is not None and child is not None
            if child in carried:
                message = f"link '{child}' is already the child of joint '{carried[child]}'"
                self._problem(element, key, f"{message}; expected one parent joint per link")
                continue
            carried[child] = name
            joint = Joint(name, kind, parent, child, T, np.array([1.0, 0, 0]), element.sourceline)
            if kind not in ("fixed", "floating"):
                self._axis(element, joint)
            if kind in ("revolute", "continuous", "prismatic"):
                self._moving(element, joint)
            joints.append(joint)
        return joints

    def _end(self, element: Element, tag: str, key: str, links: set[str]) -> str | None:
        end = _child(element, tag)
        link = None if end is None else (end.get("link") or "").strip()
        if end is None or not link:
            self._problem(element, key, f'has no <{tag} link="...">')
            return None
        if link not in links:
            self._problem(end, key, f"<{tag}>: no link '{link}'{did_you_mean(link, links)}")
            return None
        return link

    def _axis(self, element: Element, joint: Joint) -> None:
        axis, key = _child(element, "axis"), f"joint '{joint.name}'"
        if axis is None:
            what = "use the x axis" if joint.kind != "planar" else "move in the yz plane"
            self._note(f"joints without <axis> {what}", element, f"'{joint.name}'")
        else:
            values = self._numbers(axis, "xyz", key, (3,))
            if values is not None and np.linalg.norm(values) < 1e-9:
                found = " ".join(f"{value:g}" for value in values)
                self._problem(axis, key, f"<axis>: found {found}; expected a nonzero vector")
            elif values is not None:
                joint.axis = values

    def _moving(self, element: Element, joint: Joint) -> None:
        key = f"joint '{joint.name}'"
        limit = _child(element, "limit")
        if limit is not None:
            joint.limit_line = limit.sourceline
            self._limit(limit, joint, key)
        elif joint.kind != "continuous":
            self._note("joints without <limit>", element, f"'{joint.name}'")
        joint.kind = "revolute" if joint.kind == "continuous" else joint.kind
        dynamics = _child(element, "dynamics")
        if dynamics is not None:
            self._friction(dynamics, joint, key)
        mimic = _child(element, "mimic")
        if mimic is not None:
            ratio = self._number(mimic, "multiplier", key, 1.0)
            offset = self._number(mimic, "offset", key, 0.0)
            to = (mimic.get("joint") or "").strip()
            if not to:
                self._problem(mimic, key, '<mimic> has no joint; expected joint="..."')
            elif ratio is not None and offset is not None:
                joint.mimic = (to, ratio, offset)

    def _friction(self, dynamics: Element, joint: Joint, key: str) -> None:
        for what in ("damping", "friction"):
            value = self._number(dynamics, what, key, 0.0, largest=np.inf) or 0.0
            if value < 0:
                self._problem(dynamics, key, f"{what}: found {value:g}; expected 0 or more")
            elif value > LARGEST:
                self._note(f"{what} is clipped to {LARGEST:g}", dynamics, key)
            setattr(joint, what, min(value, LARGEST))

    def _limit(self, limit: Element, joint: Joint, key: str) -> None:
        if joint.kind != "continuous":
            lower = self._number(limit, "lower", key, 0.0, largest=np.inf)
            upper = self._number(limit, "upper", key, 0.0, largest=np.inf)
            if lower is not None and upper is not None:
                if lower >= upper:
                    how = "equal" if lower == upper else "swapped"
                    what = f"joints with {how} limits are treated as unlimited"
                    self._note(what, limit, f"'{joint.name}'")
                else:
                    joint.lower, joint.upper = plausible_limits(np.array([lower, upper])).tolist()
                    if (joint.lower, joint.upper) != (lower, upper):
                        self._note(TOO_FAR, limit, f"'{joint.name}'")
        for name in ("velocity", "effort"):
            value = self._number(limit, name, key, 0.0, largest=np.inf)
            if value is not None and value < 0:
                message = f"<limit>: found {name} = {value:g}; expected 0 or more"
                self._problem(limit, key, message)
            elif value and value < LARGEST:  # 0 means unknown.
                setattr(joint, name, value)

    def _tree(self, links: list[UrdfLink], joints: list[Joint]) -> str:
        carrying = {joint.child: joint for joint in joints}
        roots = [link for link in links if link.name not in carrying]
        below: dict[str, list[Joint]] = {}
        for joint in joints:
            below.setdefault(joint.parent, []).append(joint)
        whole = {root.name: _reached(root.name, below) for root in roots}
        base = max(whole, key=lambda name: len(whole[name]), default="")
        for link in roots:
            if link.name != base:
                message = (
                    f"is not the child of a joint, but the base is '{base}'; expected a single base"
                )
                self._item_problem("link", link, message)
        everywhere = set().union(*whole.values()) if whole else set()
        loop = [link for link in links if link.name not in everywhere]
        if loop:
            names = ", ".join(f"'{link.name}'" for link in loop[:6])
            message = f"the joints form a loop: {names}; expected a tree"
            self._item_problem("link", loop[0], message)
        return base

    def _free_base(
        self, root: str, links: list[UrdfLink], joints: list[Joint]
    ) -> tuple[Array, Joint | None]:
        """Returns the pose of the base in the root frame, and the joint of a free base or None.

        The joint of a free base is the floating or planar joint that is fixed to the root and
        carries all movable joints. Links and joints that it does not carry are removed. Other
        floating joints become fixed joints, because MuJoCo supports free joints only at the top
        level. Each other planar joint becomes three joints.
        """
        below: dict[str, list[Joint]] = {}
        for joint in joints:
            below.setdefault(joint.parent, []).append(joint)
        inside: dict[str, set[str]] = {}  # links that a joint carries, by joint
        freeing: list[tuple[Array, Joint]] = []
        waiting = [(root, np.eye(4))]
        while waiting:  # This visits the links that are fixed to the root.
            name, T = waiting.pop()
            for joint in below.get(name, []):
                T_child = T @ joint.frame
                if joint.kind in _FREEING:
                    freeing.append((T_child, joint))
                    inside[joint.name] = _reached(joint.child, below)
                if joint.kind not in MOVING:
                    waiting.append((joint.child, T_child))

        def worth(joint: Joint) -> tuple[int, int]:
            mine = inside[joint.name]
            solid = [link for link in links if link.name in mine and (link.mass or link.visuals)]
            return sum(each.kind in MOVING for each in joints if each.parent in mine), len(solid)

        T, chosen = max(freeing, key=lambda each: worth(each[1]), default=(np.eye(4), None))
        moving = sum(joint.kind in MOVING for joint in joints)
        if chosen is not None and worth(chosen)[0] < moving:
            T, chosen = np.eye(4), None  # The root carries movable joints, too.
        if chosen is not None:
            mine = inside[chosen.name]
            out = [link for link in links if link.name not in mine]
            if lost := [f"'{link.name}'" for link in out if link.mass or link.visuals]:
                message = f"links that '{chosen.name}' does not move are left out"
                self._warnings.append(f"{message}: {first_of(lost)}")
            links[:] = [link for link in links if link.name in mine]
            joints[:] = [joint for joint in joints if joint.parent in mine]
        if held := [f"'{joint.name}'" for joint in joints if joint.kind == "floating"]:
            message = "floating joints inside a robot become fixed joints at their origins"
            self._warnings.append(f"{message}: {first_of(held)}")
        for joint in [each for each in joints if each.kind == "planar"]:
            at = joints.index(joint)
            joints[at : at + 1], added = _single_axes(joint, {link.name for link in links})
            links += added
            names = ", ".join(f"'{each.name}'" for each in joints[at : at + 3])
            self._warnings.append(f"planar joint '{joint.name}' became three joints: {names}")
        return T, chosen

    def _item_problem(self, kind: str, item: UrdfLink | Joint, message: str) -> None:
        line = item.line if self._has_lines else None
        self._problems.append(Problem(f"{kind} '{item.name}'", message, str(self.path), line))

    def _check_mimics(self, joints: list[Joint]) -> None:
        by_name = {joint.name: joint for joint in joints}
        moving = [joint.name for joint in joints if joint.kind in MOVING]
        for joint in joints:
            if joint.mimic is None:
                continue
            to, ratio, _ = joint.mimic
            reason = ""
            if to not in by_name:
                reason = f"no joint '{to}'{did_you_mean(to, moving)}"
            elif _follows_itself(joint, by_name):
                reason = "the joint follows itself"
            elif to not in moving:
                reason = f"joint '{to}' is not movable"
            elif ratio == 0:
                reason = "the multiplier is 0"
            if reason:
                line = f" (line {joint.line})" if self._has_lines else ""
                self._notes.setdefault("ignored <mimic> elements", []).append(
                    f"'{joint.name}'{line}: {reason}"
                )
                joint.mimic = None

    def _name(self, element: Element, kind: str) -> str:
        name = (element.get("name") or "").strip()
        if not name:
            self._problem(element, kind, 'has no name; expected name="..."')
        return name or f"{kind} of line {element.sourceline}"

    def _origin(self, element: Element, key: str) -> Array:
        origin = _child(element, "origin")
        if origin is None:
            return np.eye(4)
        xyz = self._numbers(origin, "xyz", key, (3,), np.zeros(3))
        rpy = self._numbers(origin, "rpy", key, (3,), np.zeros(3))
        if xyz is None or rpy is None:
            return np.eye(4)
        return frame(rotation_from_rpy(rpy) if rpy.any() else None, xyz)

    def _number(
        self,
        element: Element,
        name: str,
        key: str,
        default: float | None = None,
        largest: float = LARGEST,
    ) -> float | None:
        fallback = None if default is None else np.array([default])
        found = self._numbers(element, name, key, (1,), fallback, largest)
        return None if found is None else float(found[0])

    def _numbers(
        self,
        element: Element,
        name: str,
        key: str,
        counts: tuple[int, ...],
        default: Array | None = None,
        largest: float = LARGEST,
    ) -> Array | None:
        text = element.get(name)
        if text is None:
            if default is None:
                self._problem(element, key, f'<{_tag(element)}> has no {name}="..."')
            return default
        expected = f"{' or '.join(map(str, counts))} number{'s' if counts[-1] > 1 else ''}"
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = self._tolerant_numbers(element, text, key, counts)
        if len(values) > counts[-1] and not np.isnan(values).any():
            self._note(f"extra values of {name} are ignored", element, key)
            values = values[: counts[-1]]
        if len(values) not in counts or np.isnan(values).any() or (abs(values) > largest).any():
            found = f"{name} = '{text[:80]}'"
            limit = f" up to {largest:g}" if (abs(values) > largest).any() else ""
            self._problem(
                element, key, f"<{_tag(element)}>: found {found}; expected {expected}{limit}"
            )
            return None
        return values

    def _tolerant_numbers(
        self, element: Element, text: str, key: str, counts: tuple[int, ...]
    ) -> Array:
        words = [_SECOND_POINT.sub(r"\1", word) for word in _COMMAS.split(text.strip())]
        if len(words) == 1:
            words = [_SECOND_POINT.sub(r"\1", word) for word in text.split()]
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            return np.array([np.nan])
        if len(values) not in counts:
            return np.array([np.nan])
        self._note(f"'{text[:80]}' is read as {' '.join(words)}", element, key)
        return values


def _names(element: Element) -> Iterator[str]:
    if isinstance(element.tag, str):
        yield element.tag
        yield from (str(name) for name in element.attrib)


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _children(element: Element, tag: str | None = None) -> list[Element]:
    return [
        each for each in element if isinstance(each.tag, str) and (tag is None or _tag(each) == tag)
    ]


def _child(element: Element, tag: str) -> Element | None:
    return next(iter(_children(element, tag)), None)


def _all(element: Element, tag: str) -> list[Element]:
    return [each for each in element.iter() if _tag(each) == tag]


def _reached(root: str, below: Mapping[str, list[Joint]]) -> set[str]:
    found, waiting = {root}, [root]
    while waiting:
        for joint in below.get(waiting.pop(), []):
            if joint.child not in found:
                found.add(joint.child)
                waiting.append(joint.child)
    return found


def _single_axes(joint: Joint, taken: set[str]) -> tuple[list[Joint], list[UrdfLink]]:
    """Converts a planar joint to two prismatic joints, a revolute joint, and links in between."""
    axes = aligned(joint.axis).T
    made: list[Joint] = []
    added = [UrdfLink(plain_name(f"{joint.name}_{axis}", taken), joint.line) for axis in "xy"]
    parent, T = joint.parent, joint.frame
    for kind, what, axis, link in zip(
        ("prismatic", "prismatic", "revolute"), ("x", "y", "yaw"), axes,
        [*added, None], strict=True,
    ):  # fmt: skip
        child = joint.child if link is None else link.name
        made.append(Joint(f"{joint.name}_{what}", kind, parent, child, T, axis, joint.line))
        parent, T = child, np.eye(4)
    return made, added


def _follows_itself(joint: Joint, by_name: Mapping[str, Joint]) -> bool:
    seen = {joint.name}
    at: Joint | None = joint
    while at is not None and at.mimic is not None:
        name = at.mimic[0]
        if name in seen:
            return name == joint.name
        seen.add(name)
        at = by_name.get(name)
    return False
