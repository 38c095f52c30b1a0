"""Converts a scene in X3D's classic encoding, like the paper's Fig. 7, to tables of a scene file.

The nodes `SerialRobot`, `UdpReceiver` and `ShmReader` are the paper's protos (Fig. 3 and 5). Rows
of `dhParams` are alpha, a, theta and d by Craig's convention, in rad and m. The translation of a
matrix is in the fourth row, as required by X3D (ISO/IEC 19775-1, 5.3).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from ...base.errors import DeclarationError, did_you_mean
from ...base.frames import Array, frame_from, rotation_about
from ...robots.importers.imported_tables import ImportedTables
from ...robots.importers.mesh_files import read_mesh
from .protos import (
    FLANGE,
    MORE_ROBOT_FIELDS,
    MORE_SOURCE_FIELDS,
    MORE_UDP_FIELDS,
    PAPER_CONVENTION,
    ROBOT_FIELDS,
    ROBOT_INPUTS,
    ROBOT_OUTPUTS,
    SHM_FIELDS,
    SOURCE_EVENTS,
    UDP_FIELDS,
    own_kind,
)
from .surroundings import camera_table, light_table, object_table, rounded, view_axes
from .vrml import read_document
from .vrml_nodes import Document, FieldValue, Node, Problems, RouteStatement, get, read_field
from .wrl import VisitedNode, kind_of, matrix, transform_of, visit

_MAX_DEBUG_LEVEL = 3
_MAX_TRIANGLES = 500_000  # maximum number of triangles of a scene, without robots
_MISSING = "no such file"
Z_IS_UP = "z is up"  # text in the WorldInfo of scenes that sero-mj writes
# This matrix rotates y, which is up in X3D, to z.
_UPRIGHT = np.diag([1.0, 1.0, 1.0, 1.0])
_UPRIGHT[:3, :3] = rotation_about(0, np.pi / 2).round(12)


def read_x3d(path: Path) -> ImportedTables:
    """Reads a scene in X3D's classic encoding or in VRML97.

    Warnings list ignored nodes and missing geometry files of robots. Links without a file are
    generated from the DH table.

    Raises:
        DeclarationError: the scene has errors. The message lists all errors and their lines.
    """
    return _X3dReader(read_document(path)).described()


class _X3dReader:
    def __init__(self, document: Document) -> None:
        self.document, self.path = document, document.path
        self.problems = Problems(document.path)
        self.lines: dict[str, int] = {}
        self.warnings: list[str] = []
        self.not_shown: dict[str, int] = {}
        self.left_out: list[str] = []  # ROUTEs that are ignored
        self.names: dict[int, str] = {}  # mapping from ids of nodes to unique names
        self.placed: dict[int, Array] = {}  # frames of robots, sources and shapes
        self.waiting: list[VisitedNode] = []  # groups that a ROUTE moves
        self.fixed: set[int] = set()  # groups that became children of a robot
        self.taken: set[str] = set()
        self.robots: dict[str, dict[str, Any]] = {}
        self.sources: dict[str, dict[str, Any]] = {}
        self.objects: dict[str, dict[str, Any]] = {}
        self.cameras: dict[str, dict[str, Any]] = {}
        self.lights: dict[str, dict[str, Any]] = {}
        self.routes: dict[str, str] = {}
        self.missing: dict[str, str] = {}  # mapping from names of robots to missing files
        self.description = ""
        self.triangles = 0
        # Groups that a ROUTE moves are read after static groups.
        self.moved = {
            id(node)
            for route in document.routes
            if (node := document.names.get(route.target)) is not None
            and node.kind in ("MatrixTransform", "Transform")
        }

    def described(self) -> ImportedTables:
        seen = self._visit(self.document.nodes)
        for each in seen:  # Other names must differ from these names.
            if each.node.name:
                self._name(each.node)
        turn = self._turn(seen)
        for each in seen:
            self._take(VisitedNode(each.node, turn @ each.T, each.path))
        while self.waiting:
            self._take_group(self.waiting.pop(0))
        for route in self.document.routes:
            if (ends := self._ends(route)) is not None:
                self._route(route, *ends, is_turned=not np.array_equal(turn, np.eye(4)))
        self.problems.raise_all()
        self._warn()
        sections = {
            "description": self.description,
            "robots": self.robots,
            "sources": self.sources,
            "routes": self.routes,
            "objects": self.objects,
            "cameras": self.cameras,
            "lights": self.lights,
        }
        tables: dict[str, Any] = {key: value for key, value in sections.items() if value}
        if self.cameras:
            tables["view"] = {"camera": next(iter(self.cameras))}
        return ImportedTables(tables, self.lines, list(dict.fromkeys(self.warnings)))

    def _visit(self, nodes: list[Node]) -> list[VisitedNode]:
        return visit(nodes, self.path, self.problems, self._is_leaf)

    def _is_leaf(self, node: Node) -> bool:
        return bool(own_kind(node)) or id(node) in self.moved

    def _name(self, node: Node, text: str = "") -> str:
        if id(node) in self.names:
            return self.names[id(node)]
        wanted = node.name or text or node.kind.lower()
        name = base = re.sub(r"^(?=[0-9-])", "_", re.sub(r"[^A-Za-z0-9_-]", "_", wanted))
        count = 1
        while name in self.taken:
            count += 1
            name = f"{base}{count}"
        self.taken.add(name)
        self.names[id(node)] = name
        if node.name and name != node.name:
            self.warnings.append(f"'{node.name}' (line {node.line}) was renamed to '{name}'")
        return name

    def _turn(self, seen: list[VisitedNode]) -> Array:
        """Returns the rotation from y up to z up, or the identity if y is not up.

        In X3D, y is up, but z is up in the paper's scenes. The first viewpoint shows which axis is
        up. If there is no viewpoint, the bases of the robots show it.
        """
        infos = [each.node for each in seen if each.node.kind == "WorldInfo"]
        if any(Z_IS_UP in get(info, "info", "MFString", [], self.problems) for info in infos):
            return np.eye(4)
        ups = [
            (each.T[:3, :3] @ view_axes(each.node, self.problems))[:, 1]
            for each in seen
            if each.node.kind == "Viewpoint"
        ][:1]
        if not ups:
            ups = [
                (each.T @ self._frame(each.node, "baseFrame"))[:3, 2]
                for each in seen
                if own_kind(each.node) == "SerialRobot"
            ]
        if not ups or not all(abs(up[1]) > 0.9 * np.linalg.norm(up) for up in ups):
            return np.eye(4)
        self.warnings.append("y is up in this scene, so the scene is rotated to make z point up")
        return _UPRIGHT

    def _take(self, seen: VisitedNode) -> None:
        node, kind = seen.node, own_kind(seen.node)
        if kind == "SerialRobot":
            self._robot(seen)
        elif kind:
            self._source(node, kind)
        elif id(node) in self.moved:
            self.waiting.append(seen)
        elif node.kind == "Shape":
            for name, table in self._shapes(seen):
                self.objects[name] = table
                self.lines[f"objects.{name}"] = node.line
        elif node.kind == "Viewpoint":
            self._camera(seen)
        elif node.kind in ("DirectionalLight", "SpotLight"):
            self._light(seen)
        elif node.kind == "WorldInfo":
            title = get(node, "title", "SFString", "", self.problems)
            self.description = " ".join(title.split())
        elif not node.kind.startswith("Metadata"):
            self.not_shown.setdefault(kind_of(node), node.line)

    # Robots and sources.

    def _robot(self, seen: VisitedNode, mount: str | None = None) -> None:
        node = seen.node
        if id(node) in self.placed:
            message = "is used twice; expected a second SerialRobot node instead of USE"
            self.problems.add(node.label, message, node.line)
            return
        label = get(node, "name", "SFString", "", self.problems)
        name = self._name(node, label or "robot")
        self.placed[id(node)] = seen.T
        place = f"robots.{name}"
        self.lines[place] = node.line
        table: dict[str, Any] = {}
        if mount is not None:
            table["mount"] = mount
        if label and label != name:
            table["description"] = label
        fields = {**ROBOT_FIELDS, **MORE_ROBOT_FIELDS}
        events = ("torques", "billboardValues", FLANGE)
        found = self._fields(node, fields, place, ("name", "children", "metadata"), events)
        table["dh_convention"] = found.pop("dh_convention", PAPER_CONVENTION)
        rows = len(found.get("dh_params", [[]]))
        for key in ("joint_angles", "offsets_to_center_of_joints"):  # proto default: one zero
            if key in found and rows != 1 and len(found[key]) == 1 and not np.any(found[key]):
                del found[key]
        for key, field in (("base_frame", "baseFrame"), ("flange_frame", "flangeFrame")):
            if key in found:
                found[key] = self._frame(node, field).tolist()
        with self.problems.collect(f"{name}.baseFrame", node.line):
            found["base_frame"] = rounded(_rigid(seen.T) @ found.get("base_frame", np.eye(4)))
            if np.array_equal(found["base_frame"], np.eye(4)):
                del found["base_frame"]
        table |= self._with_files(found, node, name)
        self.robots[name] = table
        children = self._visit(get(node, "children", "MFNode", [], self.problems))
        table_children = [entry for child in children for entry in self._child(child, name)]
        if table_children:
            table["children"] = table_children

    def _child(self, seen: VisitedNode, robot: str) -> list[dict[str, Any]]:
        if own_kind(seen.node) == "SerialRobot":
            self._robot(seen, f"{robot}/flange")
        elif own_kind(seen.node) or seen.node.kind in (
            "Viewpoint",
            "DirectionalLight",
            "SpotLight",
        ):
            message = "expected this node outside the children of the robot"
            self.problems.add(seen.node.label, f"found {seen.node.kind}; {message}", seen.node.line)
        elif seen.node.kind == "Shape":
            return [{"name": name, **table} for name, table in self._shapes(seen)]
        elif not seen.node.kind.startswith("Metadata"):
            self.not_shown.setdefault(kind_of(seen.node), seen.node.line)
        return []

    def _with_files(self, found: dict[str, Any], node: Node, name: str) -> dict[str, Any]:
        directory = found.get("directory", "")
        if "://" in directory:
            value = node.value("directory")
            line = node.line if value is None else value.line
            message = f"found '{directory}'; expected a folder"
            self.problems.add(f"{name}.directory", message, line)
            directory = ""
        if directory:
            found["directory"] = PureWindowsPath(directory).as_posix()
        files = [file for file in found.get("filenames", []) if file]
        if not files:
            found.pop("filenames", None)
            found.pop("directory", None)
            return found
        folder = self.path.parent / found.get("directory", "")
        lost = {file: why for file in files if (why := _why_not(folder / file))}
        missing = [file for file, why in lost.items() if why == _MISSING]
        if missing:
            place = f" in {found['directory']}" if found.get("directory") else ""
            self.missing[name] = ", ".join(missing) + place
        for file, why in lost.items():
            if why != _MISSING:
                self.warnings.append(
                    f"{file} of {name} is replaced by a link generated from the DH table: {why}"
                )
        found["filenames"] = [
            {"shape": "generated"} if file in lost else file for file in found["filenames"]
        ]
        if len(lost) == len({*files}):
            del found["filenames"]
            found.pop("directory", None)
        return found

    def _source(self, node: Node, kind: str) -> None:
        if id(node) in self.placed:
            return
        self.placed[id(node)] = np.eye(4)
        name = self._name(node, "udp" if kind == "UdpReceiver" else "shm")
        is_udp = kind == "UdpReceiver"
        fields = (
            {**UDP_FIELDS, **MORE_UDP_FIELDS} if is_udp else {**SHM_FIELDS, **MORE_SOURCE_FIELDS}
        )
        place = f"sources.{name}"
        self.lines[place] = node.line
        table: dict[str, Any] = {"kind": "udp" if is_udp else "shm", "structure": ""}
        table |= self._fields(node, fields, place, ("metadata",), [*SOURCE_EVENTS])
        if "debug_level" in table:
            table["debug_level"] = min(table["debug_level"], _MAX_DEBUG_LEVEL)
        self.sources[name] = table

    def _fields(
        self,
        node: Node,
        fields: Mapping[str, tuple[str, str]],
        place: str,
        others: Collection[str],
        events: Collection[str],
    ) -> dict[str, Any]:
        found: dict[str, Any] = {}
        declared = {} if node.proto is None else node.proto.fields
        for name, value in _values(node).items():
            key = f"{node.label}.{name}"
            if name in events:
                message = f"is an event without a value; expected a ROUTE TO {node.label}.{name}"
                self.problems.add(key, message, value.line)
            elif name in fields:
                kind, ours = fields[name]
                with self.problems.collect(key, value.line):
                    read = read_field(value, kind)
                    found[ours] = read.tolist() if isinstance(read, np.ndarray) else read
                    self.lines[f"{place}.{ours}"] = value.line
            elif name not in others and name not in declared:
                known = [*fields, *others]
                self.problems.add(key, f"unknown field{did_you_mean(name, known)}", value.line)
        return found

    def _frame(self, node: Node, name: str) -> Array:
        value = node.value(name)
        if value is None:
            return np.eye(4)
        with self.problems.collect(f"{node.label}.{name}", value.line):
            numbers = read_field(value, "SFMatrix4f")
            T, other = matrix(numbers), matrix(numbers).T
            if T[3, :3].any() and not other[3, :3].any():
                # The matrix is in row-major order, as in mathematics.
                self.warnings.append(
                    f"{node.label}.{name} (line {value.line}) has the translation in the fourth "
                    "column instead of the fourth row, and is transposed"
                )
                T = other
            try:
                return frame_from(T, np.asarray)
            except ValueError:
                found = " ".join(f"{number:g}" for number in numbers)
                message = "expected a rotation matrix, with translation and 1 in the fourth row"
                raise ValueError(f"found {found}; {message}") from None
        return np.eye(4)

    # Surroundings.

    def _shapes(self, seen: VisitedNode) -> list[tuple[str, dict[str, Any]]]:
        shape = seen.node
        table, text, count = object_table(seen, self.problems.of(seen.path), self.not_shown)
        self.triangles += count
        if self.triangles > _MAX_TRIANGLES:
            message = f"shapes have more than {_MAX_TRIANGLES:,} triangles"
            self.problems.add(shape.label, message, shape.line)
            self.problems.raise_all()
        if table is None:
            return []
        # Each use of a shape becomes a separate object.
        is_first = id(shape) not in self.placed
        self.placed[id(shape)] = seen.T
        name = self._name(shape if is_first else Node(shape.kind, shape.line), shape.name or text)
        return [(name, table)]

    def _camera(self, seen: VisitedNode) -> None:
        node = seen.node
        description = get(node, "description", "SFString", "", self.problems)
        name = self._name(node, description or "view")
        self.cameras[name], roll = camera_table(seen, self.problems)
        self.lines[f"cameras.{name}"] = node.line
        if roll:
            self.warnings.append(
                f"Viewpoint '{name}' (line {node.line}) has a roll of {roll:.0f} degrees, which is "
                "ignored"
            )

    def _light(self, seen: VisitedNode) -> None:
        table = light_table(seen, self.problems)
        if table is not None:
            name = self._name(seen.node, "light")
            # Only the first light has a shadow, because each shadow needs a rendering pass.
            self.lights[name] = {**table, "cast_shadow": False} if self.lights else table
            self.lines[f"lights.{name}"] = seen.node.line

    # Routes.

    def _take_group(self, seen: VisitedNode) -> None:
        """Reads the contents of a group that a ROUTE moves.

        If the ROUTE comes from a robot's flange (section 3.1 of the paper), the contents become
        children of the robot. Otherwise, they are fixed at their declared pose.
        """
        group = seen.node
        inside = self._visit(get(group, "children", "MFNode", [], self.problems))
        for route in self.document.routes:
            robot = self.document.names.get(route.origin)
            is_there = self.document.names.get(route.target) is group
            if not is_there or robot is None or route.input.removeprefix("set_") != "matrix":
                continue
            if self._carries(robot, route.event, seen.T):
                name = self.names[id(robot)]
                entries = [entry for each in inside for entry in self._child(each, name)]
                if entries:
                    self.robots[name].setdefault("children", []).extend(entries)
                self.fixed.add(id(group))
                return
        T = seen.T
        with self.problems.collect(group.label, group.line):
            T = seen.T @ transform_of(group)
        for each in inside:
            self._take(VisitedNode(each.node, T @ each.T, each.path))

    def _carries(self, robot: Node, event: str, T: Array) -> bool:
        is_flange = event.removesuffix("_changed") == FLANGE
        table = self.robots.get(self.names.get(id(robot), ""))
        if not is_flange or own_kind(robot) != "SerialRobot" or table is None:
            return False
        base = np.array(table.get("base_frame", np.eye(4)))
        return "mount" not in table and np.allclose(base, T, rtol=0, atol=1e-9)

    def _ends(self, route: RouteStatement) -> tuple[str, str, str] | None:
        """Returns the source, target robot and text of a ROUTE, or None if it is ignored."""
        names, line = self.document.names, route.line
        text = f"{route.origin}.{route.event} TO {route.target}.{route.input}"
        for name in (route.origin, route.target):
            if name not in names:
                message = f"no DEF '{name}'{did_you_mean(name, names)}"
                self.problems.add(f"ROUTE {text}", message, line)
                return None
        origin, target = names[route.origin], names[route.target]
        if id(target) in self.fixed:
            return None
        kind = own_kind(origin)
        is_known = bool(kind) and {id(origin), id(target)} <= self.placed.keys()
        if not is_known or own_kind(target) != "SerialRobot":
            self._leave_out(text, line)
            return None
        event, name = route.event.removesuffix("_changed"), self.names[id(origin)]
        if kind != "SerialRobot":
            return f"{name}.{SOURCE_EVENTS.get(event, event)}", self.names[id(target)], text
        if event in ROBOT_OUTPUTS:
            return f"{name}.{ROBOT_OUTPUTS[event]}", self.names[id(target)], text
        if event in ROBOT_FIELDS or event in ROBOT_INPUTS:
            self._leave_out(text, line)
        else:
            message = f"no output '{event}'{did_you_mean(event, ROBOT_OUTPUTS)}"
            self.problems.add(f"ROUTE {text}", message, line)
        return None

    def _route(
        self, route: RouteStatement, origin: str, robot: str, text: str, *, is_turned: bool
    ) -> None:
        field, line = route.input.removeprefix("set_"), route.line
        target = self.document.names[route.target]
        if field in ("flangeFrame", "axesTransparency", "enableTouchSensor", "children"):
            self._leave_out(text, line)  # The paper allows such ROUTEs, but scene files do not.
        elif field not in ROBOT_INPUTS:
            message = f"no input '{field}'{did_you_mean(field, ROBOT_INPUTS)}"
            self.problems.add(f"ROUTE {text}", message, line)
        elif field == "baseFrame" and self._carries(
            self.document.names[route.origin], route.event, self.placed[id(target)]
        ):
            table = self.robots[robot]
            table["mount"] = f"{origin.partition('.')[0]}/flange"
            table.pop("base_frame", None)
        elif field == "baseFrame" and (
            is_turned or not np.array_equal(self.placed[id(target)], np.eye(4))
        ):
            self._leave_out(text, line)  # In scene files, routed frames are relative to the world.
        elif (key := f"{robot}.{ROBOT_INPUTS[field]}") in self.routes:
            message = f"a ROUTE from {self.routes[key]} has the same target; expected one ROUTE"
            self.problems.add(f"ROUTE {text}", message, line)
        else:
            self.routes[key] = origin
            self.lines[f"routes.{key}"] = line

    def _leave_out(self, text: str, line: int) -> None:
        self.left_out.append(f"{text} (line {line})")

    def _warn(self) -> None:
        for name, files in self.missing.items():
            self.warnings.append(
                f"missing geometry files {files}; the links of {name} are generated from the DH "
                "table"
            )
        if self.not_shown:
            shown = (f"{kind} (line {line})" for kind, line in self.not_shown.items())
            self.warnings.append(f"these nodes are not shown: {', '.join(shown)}")
        if self.left_out:
            self.warnings.append(f"these routes are ignored: {', '.join(self.left_out)}")


def _why_not(file: Path) -> str:
    if "\0" in str(file) or not file.is_file():
        return _MISSING
    try:
        read_mesh(file)
    except DeclarationError as error:
        return str(error.problems[0])
    return ""


def _values(node: Node) -> dict[str, FieldValue]:
    declared = {} if node.proto is None else node.proto.fields
    defaults = {name: each.value for name, each in declared.items() if each.value is not None}
    return {**defaults, **node.fields}


def _rigid(T: Array) -> Array:
    try:
        return frame_from(T, np.asarray)
    except ValueError:
        raise ValueError("is in a Transform with a scale, but robots cannot be scaled") from None
