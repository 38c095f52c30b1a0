"""Reads URDF, tolerating common errors, as the tables of a robot file.

Follows the specification of URDF 1.0 (wiki.ros.org/urdf/XML), and where it is silent, the viewers
that files are written for: colours of a mesh file override the `<material>` beside it (RViz), a
range of zero means no limit (MuJoCo), a joint without an axis has x. All errors are reported
together, with the lines of their elements. An unreadable mesh is left out.
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
    meant_limits,
    plain_name,
)
from .xml_file import Element, XmlError, parse_loose_xml, parse_xml

_MAX_BYTES = 50_000_000
_MAX_JOINTS = 128  # movable ones
_MAX_LINKS = 10_000  # with fixed ones; some steps take as long as the square of them
_MOST_FILES = 3  # that are missing, in one sentence
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
    "is xacro, which becomes URDF by a package: `pip install sero-mj[xacro]`, or on a machine "
    "with ROS `xacro {name} > robot.urdf`"
)


_UNEXPANDED = (
    'elements of xacro are left out; xmlns:xacro="http://www.ros.org/wiki/xacro" expands them'
)


def read_urdf(
    path: Path | str,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Reads a robot from a URDF file, or from xacro if the package `xacro` is installed.

    Args:
        packages: folders of ROS packages by name, for `package://NAME/...`; others are searched
            for above the file and on the paths that the environment names.
        arguments: of xacro by name, overriding its defaults.

    Returns:
        the tables of a robot file: a DH table (Craig's) for chains that have one, else
        `joint_frames`; `filenames`, `collisions`, `colors`, limits, couplings and `dynamics`.

    Raises:
        NoJoints: it has no movable joint; `read_rigid_urdf` reads it.
        DeclarationError: everything that is wrong in it, with lines, and arguments that it does
            not ask for.
    """
    file = UrdfFile(Path(path), packages, arguments)
    file.check()
    return file.described


def read_rigid_urdf(path: Path | str) -> ImportedTables:
    """Reads a URDF file without movable joints, a tool say, as a robot with the base alone.

    Raises DeclarationError with all errors in it, with lines, or if it has joints.
    """
    file = UrdfFile(Path(path))
    if file.tree.joints:
        raise Problem(
            "robot",
            found=len(file.tree.joints),
            of="joints that move",
            expected=f'none in an object: a robot is model = "{file.path.name}"',
            file=str(path),
        ).error()
    return file.described


class _Arguments(dict[str, str]):
    def __init__(self, arguments: Mapping[str, Any]) -> None:
        over = json.loads(os.environ.get(ARGUMENTS_VARIABLE) or "{}")
        super().__init__({name: _as_text(value) for name, value in {**arguments, **over}.items()})
        self.given = set(self)
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


def _as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class UrdfFile:
    """One URDF file that is being read.

    Args:
        convention: of its DH table, where it has one.

    Attributes:
        tree: its converted tree, with names that only comments need.
        described: the result of `read_urdf`.
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
        self._lost: dict[str, None] = {}  # missing mesh files
        self._found: dict[str, Path | None] = {}  # the file of each name
        self._last_found: dict[str, Path] = {}  # the folder of a package
        self._unread: dict[Path, str] = {}
        self._colored: dict[Path, bool] = {}  # whether a mesh file has colours
        self._flat: set[Path] = set()
        self._odd: dict[str, list[str]] = {}  # reinterpreted values, and where
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
            found = f"{len(moving)} joints that move"
            self._problem(root, "robot", f"found {found}; expected at most {_MAX_JOINTS}")
        self._stop()
        self._tell_about_meshes(links)
        given = (root.get("name") or "").strip()
        base = base if free_base is None else free_base.child
        self.tree = TreeTables(given, links, joints, base, convention)
        name = plain_name(given or path.stem, set())
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
            *(f"{what}: {first_of(where)}" for what, where in self._odd.items()),
            *self._warnings,
            *self.tree.warnings,
        ]
        lines = {"name": root.sourceline, **self.tree.lines} if self._has_lines else {}
        self.described = ImportedTables(tables, {k: v for k, v in lines.items() if v}, warnings)

    def check(self) -> None:
        """Refuses what an object may be and no robot.

        Raises NoJoints if no joint is movable, and DeclarationError for arguments that it does not
        ask for.
        """
        given, asked = self._arguments.given, self._arguments.asked
        for name in sorted(given - asked):
            message = f"xacro has no argument '{name}'{did_you_mean(name, asked)}"
            if not self._is_xacro:
                message = "is for xacro; this file is plain URDF"
            self._problem(None, f"arguments.{name}", message)
        self._stop()
        if not self.tree.joints:
            message = (
                "has no joint that moves; expected one or more: what is rigid is an object, "
                f'urdf = "{self.path.name}"'
            )
            raise NoJoints([Problem("robot", message, str(self.path), self._root_line)])

    def _problem(self, element: Element | None, key: str, message: str) -> None:
        line = None if element is None or not self._has_lines else element.sourceline
        self._problems.append(Problem(key, message, str(self.path), line))

    def _stop(self) -> None:
        raise_any(self._problems)

    def _note(self, what: str, element: Element, key: str) -> None:
        line = f" (line {element.sourceline})" if self._has_lines else ""
        self._odd.setdefault(what, []).append(f"{key}{line}")

    def _root(self) -> Element:
        try:
            root, told = parse_loose_xml(read_file(self.path, _MAX_BYTES))
            self._warnings += told
            if any(_XACRO.match(name) for each in root.iter() for name in _names(each)):
                root = self._expanded()
            else:
                self._fill_in_environment(root)
                self._note_unexpanded(root)
        except DeclarationError:
            raise
        except XmlError as error:
            self._problems += [
                Problem("", f"is not XML that can be read: {reason}", str(self.path), line)
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
                message = f"found {found[0]}; the environment has no {name}"
                self._problem(element, f"<{_tag(element)}>", message)
            return os.environ.get(name or optional, (default or "").strip())

        for element in root.iter():
            for key, text in element.attrib.items():
                if "$(" in text:
                    element.set(key, _FROM_ENVIRONMENT.sub(value, text))

    def _expanded(self) -> Element:
        try:
            import simpleeval  # noqa: F401  # both are needed by `xacro_file`
            import xacro  # noqa: F401

            from . import xacro_file
        except ImportError:
            self._problem(None, "", _NO_XACRO.format(name=self.path.name))
            self._stop()
        self._is_xacro, self._has_lines = True, False  # xacro keeps no lines

        def find(package: str) -> str:
            folders = package_folders(package, self.path, self._packages)
            found = next((str(folder) for folder in folders if folder.is_dir()), None)
            if found is None:
                raise ValueError(f"package '{package}' is not found: --package {package}=DIR")
            return found

        try:
            text = xacro_file.expand(self.path, self._arguments, find)
        except (Exception, SystemExit) as error:  # whatever xacro makes of a wrong file
            reason = " ".join(str(error).split()) or type(error).__name__
            if (lacking := _NO_ARGUMENT.search(reason)) is not None:
                reason += f"; --arg {lacking[1]}=VALUE says what it is"
            self._problem(None, "", f"xacro cannot expand it: {reason}")
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
                self._problem(element, f"link '{name}'", f"is there already, line {lines[name]}")
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
            self._problem(root, "robot", "has no <link>; expected one or more")
        return links

    def _inertial(self, element: Element, link: UrdfLink) -> None:
        inertial, key = _child(element, "inertial"), f"link '{link.name}'"
        if inertial is None:
            return
        T = self._origin(inertial, key)
        mass, inertia = _child(inertial, "mass"), _child(inertial, "inertia")
        value = None
        if mass is None or mass.get("value") is None:
            self._note("<inertial> without <mass value=...>, taken for none", inertial, key)
        elif (value := self._number(mass, "value", key)) is not None and value < 0:
            self._problem(mass, key, f"<mass>: found {value:g} kg; expected 0 or more")
        elif value == 0 and _all(element, "geometry"):  # else it is a named frame
            self._note("links whose mass is zero", mass, f"'{link.name}'")
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
            self._note("links with a mass and no tensor", inertial, f"'{link.name}'")
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
            self._problem(inner, key, f"<{tag}>: no geometry <{_tag(inner)}>{near}")
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
            self._note(f"shapes of <{tag}> without extent, left out", inner, f"'{link}'")
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
            given = self._numbers(mesh, "scale", key, (1, 3))
            if given is None:
                return None
            scale = np.broadcast_to(given, 3).copy()
        if (scale == 0).any():
            self._note("meshes scaled to nothing, left out", mesh, f"'{link}'")
            return None
        file = self._mesh_file(mesh, name, tag, link)
        if file is None:
            return None
        if color is None or not self._colored[file]:
            return Geometry(T, file, scale, color=color, line=mesh.sourceline)
        # As in RViz, colours of the mesh file take precedence, with the opacity of the material.
        alpha = float(color[1][3]) or 1.0
        return Geometry(T, file, scale, opacity=alpha, line=mesh.sourceline)

    def _mesh_file(self, mesh: Element, name: str, tag: str, link: str) -> Path | None:
        if name not in self._found:
            self._found[name] = self._search(name)
        file = self._found[name]
        if file is None:
            self._lost[name] = None
            return None
        if file not in self._colored and file not in self._unread:
            try:
                pieces = read_mesh(file)
                self._colored[file] = any(piece.rgba is not None for piece in pieces)
                if any(piece.is_flat for piece in pieces):
                    self._flat.add(file)
            except DeclarationError as error:
                self._unread[file] = str(error.problems[0])
        if tag == "collision" and file in self._flat:
            self._note(
                "flat meshes of <collision> left out, as they have no hull", mesh, f"'{link}'"
            )
            return None
        return None if file in self._unread else file

    def _search(self, name: str) -> Path | None:
        file = find_file(name, self.path, {**self._last_found, **self._packages})
        package = package_of(name)
        if file is not None and package is not None:
            inside = Path(unquote(name).partition(f"{package}/")[2])
            if file.parts[-len(inside.parts) :] == inside.parts:
                self._last_found[package] = file.parents[len(inside.parts) - 1]
        return file

    def _tell_about_meshes(self, links: list[UrdfLink]) -> None:
        if self._lost:
            wanted = {package for name in self._lost if (package := package_of(name)) is not None}
            unknown = [
                package
                for package in sorted(wanted)
                if not any(f.is_dir() for f in package_folders(package, self.path, self._packages))
            ]
            how = "".join(f"; --package {package}=DIR says where it is" for package in unknown)
            if not any(link.visuals for link in links) and any(link.collisions for link in links):
                how = f"; collision shapes are shown instead{how}"
            count = len(self._lost)
            self._warnings.append(
                f"{count} mesh file{'s are' if count > 1 else ' is'} not found and not shown{how}: "
                f"{first_of(list(self._lost), _MOST_FILES)}"
            )
        self._warnings += [f"{reason}; it is not shown" for reason in self._unread.values()]

    def _joints(self, root: Element, links: set[str]) -> list[Joint]:
        joints: list[Joint] = []
        lines: dict[str, int | None] = {}
        carried: dict[str, str] = {}
        for element in _children(root, "joint"):
            name = self._name(element, "joint")
            key = f"joint '{name}'"
            if name in lines:
                self._problem(element, key, f"is there already, line {lines[name]}")
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
                message = f"carries link '{child}', which joint '{carried[child]}' carries"
                self._problem(element, key, f"{message}; expected one joint for each link")
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
            what = "turn about x" if joint.kind != "planar" else "move in the yz plane"
            self._note(f"joints without <axis> {what}", element, f"'{joint.name}'")
        else:
            given = self._numbers(axis, "xyz", key, (3,))
            if given is not None and np.linalg.norm(given) < 1e-9:
                self._problem(axis, key, f"<axis>: found {_text(given)}; expected a direction")
            elif given is not None:
                joint.axis = given

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
                    how = "equal" if lower == upper else "in the wrong order"
                    what = f"joints whose limits are {how} are taken as without limits"
                    self._note(what, limit, f"'{joint.name}'")
                else:
                    joint.lower, joint.upper = meant_limits(np.array([lower, upper])).tolist()
                    if (joint.lower, joint.upper) != (lower, upper):
                        self._note(TOO_FAR, limit, f"'{joint.name}'")
        for name in ("velocity", "effort"):
            value = self._number(limit, name, key, 0.0, largest=np.inf)
            if value is not None and value < 0:
                message = f"<limit>: found {name} = {value:g}; expected 0 or more"
                self._problem(limit, key, message)
            elif value and value < LARGEST:  # zero means unknown
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
                message = f"no joint has it as <child>; expected one, as the base is '{base}'"
                self._item_problem("link", link, message)
        everywhere = set().union(*whole.values()) if whole else set()
        circle = [link for link in links if link.name not in everywhere]
        if circle:
            names = ", ".join(f"'{link.name}'" for link in circle[:6])
            message = f"joints go round in a circle: {names}; expected a tree"
            self._item_problem("link", circle[0], message)
        return base

    def _free_base(
        self, root: str, links: list[UrdfLink], joints: list[Joint]
    ) -> tuple[Array, Joint | None]:
        """The frame of the base in that of the root, and the joint that frees it, if there is one.

        It is the floating or planar joint above which nothing moves, and below which everything
        does. What is not below it is removed. Other floating joints are held at their origins, as
        MuJoCo has free joints at top level only, and other planar ones become three joints.
        """
        below: dict[str, list[Joint]] = {}
        for joint in joints:
            below.setdefault(joint.parent, []).append(joint)
        inside: dict[str, set[str]] = {}  # the links below a joint, by its name
        freeing: list[tuple[Array, Joint]] = []
        waiting = [(root, np.eye(4))]
        while waiting:  # through what is fixed to the root
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
            T, chosen = np.eye(4), None  # the root carries joints as well
        if chosen is not None:
            mine = inside[chosen.name]
            out = [link for link in links if link.name not in mine]
            if lost := [f"'{link.name}'" for link in out if link.mass or link.visuals]:
                message = f"links that '{chosen.name}' does not move are left out"
                self._warnings.append(f"{message}: {first_of(lost)}")
            links[:] = [link for link in links if link.name in mine]
            joints[:] = [joint for joint in joints if joint.parent in mine]
        if held := [f"'{joint.name}'" for joint in joints if joint.kind == "floating"]:
            message = "floating joints inside a robot are held at their origins"
            self._warnings.append(f"{message}: {first_of(held)}")
        for joint in [each for each in joints if each.kind == "planar"]:
            at = joints.index(joint)
            joints[at : at + 1], added = _single_axes(joint, {link.name for link in links})
            links += added
            names = ", ".join(f"'{each.name}'" for each in joints[at : at + 3])
            self._warnings.append(f"planar joint '{joint.name}' is three joints: {names}")
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
                reason = "it follows itself"
            elif to not in moving:
                reason = f"joint '{to}' does not move"
            elif ratio == 0:
                reason = "multiplier is 0"
            if reason:
                line = f" (line {joint.line})" if self._has_lines else ""
                self._odd.setdefault("joints whose <mimic> is left out", []).append(
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
            values = self._meant(element, text, key, counts)
        if len(values) > counts[-1] and not np.isnan(values).any():
            self._note(f"more than {expected} in {name}, the first are taken", element, key)
            values = values[: counts[-1]]
        if len(values) not in counts or np.isnan(values).any() or (abs(values) > largest).any():
            found = f"{name} = '{text[:80]}'"
            most = f" up to {largest:g}" if (abs(values) > largest).any() else ""
            self._problem(
                element, key, f"<{_tag(element)}>: found {found}; expected {expected}{most}"
            )
            return None
        return values

    def _meant(self, element: Element, text: str, key: str, counts: tuple[int, ...]) -> Array:
        words = [_SECOND_POINT.sub(r"\1", word) for word in _COMMAS.split(text.strip())]
        if len(words) == 1:
            words = [_SECOND_POINT.sub(r"\1", word) for word in text.split()]
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            return np.array([np.nan])
        if len(values) not in counts:
            return np.array([np.nan])
        self._note(f"'{text[:80]}' is taken for {' '.join(words)}", element, key)
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


def _text(values: Array) -> str:
    return " ".join(f"{value:g}" for value in values)


def _reached(root: str, below: Mapping[str, list[Joint]]) -> set[str]:
    found, waiting = {root}, [root]
    while waiting:
        for joint in below.get(waiting.pop(), []):
            if joint.child not in found:
                found.add(joint.child)
                waiting.append(joint.child)
    return found


def _single_axes(joint: Joint, taken: set[str]) -> tuple[list[Joint], list[UrdfLink]]:
    """Two prismatic joints and a revolute one instead of a planar one, and the links between them.

    Args:
        taken: names of links.
    """
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
