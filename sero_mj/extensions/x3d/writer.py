"""Converts tables of a scene file to X3D in the classic encoding, with the paper's protos."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ...base.errors import shown
from ...base.frames import Array, frame, rotation_about, rotation_angle
from .protos import (
    PAPER_CONVENTION,
    ROBOT_FIELDS,
    ROBOT_INPUTS,
    ROBOT_OUTPUTS,
    SHM_FIELDS,
    SOURCE_EVENTS,
    UDP_FIELDS,
)
from .reader import Z_IS_UP
from .surroundings import LIGHT_SHARE

_WIDTH = 100
_KINDS = {"udp": ("UdpReceiver", UDP_FIELDS), "shm": ("ShmReader", SHM_FIELDS)}
_PROTOS = {
    "SerialRobot": "PROTO_serialRobot.wrl",
    "UdpReceiver": "PROTO_udpReceiver.wrl",
    "ShmReader": "PROTO_shmReader.wrl",
}
_IDENTITY = np.eye(4)


def x3d_text(tables: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Converts a scene to X3D text for `read_x3d`. Also returns the keys that X3D cannot express.

    `tables` are the tables of a scene file, in which robots have fields instead of `model`.
    """
    writer = _Writer(tables)
    return writer.text(), writer.left_out


class _Writer:
    def __init__(self, tables: Mapping[str, Any]) -> None:
        self.tables = tables
        self.left_out: list[str] = []
        self.used: dict[str, None] = {}  # names of the protos in the scene

    def text(self) -> str:
        known = ("name", "description", "robots", "sources", "routes", "objects", "cameras",
                 "lights", "view")  # fmt: skip
        body = self._world_info()
        for part in (self._cameras, self._lights, self._robots, self._sources, self._objects):
            body += part()
        routes = self._routes()
        self.left_out += [key for key in self.tables if key not in known]
        protos = [
            f'EXTERNPROTO {name} [] "{_PROTOS[name]}"' for name in _PROTOS if name in self.used
        ]
        lines = ["#X3D V3.0 utf8", "Scene {", *_indented(protos), "  children ["]
        return "\n".join([*lines, *_indented(_indented(body)), "  ]", *_indented(routes), "}", ""])

    def _world_info(self) -> list[str]:
        title = self.tables.get("description", "")
        return [f"WorldInfo {{ title {_text(title)} info {_text(Z_IS_UP)} }}"]

    # Robots and sources.

    def _robots(self) -> list[str]:
        robots = self.tables.get("robots", {})
        carried: dict[str, list[str]] = {}
        for name, robot in robots.items():
            below, _, label = robot.get("mount", "").partition("/")
            if below and label == "flange" and below in robots:
                carried.setdefault(below, []).append(name)
            elif below:
                self.left_out.append(f"robots.{name} (not mounted on a flange)")
        roots = [name for name, robot in robots.items() if not robot.get("mount")]
        return [line for name in roots for line in self._robot(name, robots, carried)]

    def _robot(self, name: str, robots: Any, carried: Mapping[str, list[str]]) -> list[str]:
        robot = dict(robots[name])
        reason = _unsupported(robot)
        if reason:
            above = [*_mounted_on(name, carried)]
            self.left_out += [f"robots.{each} ({reason})" for each in (name, *above)]
            return []
        self.used["SerialRobot"] = None
        lines = [f"DEF {name} SerialRobot {{"]
        description = robot.pop("description", "")
        if description:
            lines.append(f"  name {_text(description)}")
        robot.pop("mount", None)
        robot = self._by_craig(name, robot)
        for field, (kind, key) in ROBOT_FIELDS.items():
            value = robot.pop(key, None)
            if value is not None and not self._is_default(key, value):
                lines += _indented(_field(field, kind, value))
        children = [
            line for child in robot.pop("children", []) for line in self._child(name, child)
        ]
        for each in carried.get(name, []):
            children += self._robot(each, robots, carried)
        if children:
            lines += ["  children [", *_indented(_indented(children)), "  ]"]
        self.left_out += [f"robots.{name}.{key}" for key in robot]
        return [*lines, "}"]

    def _is_default(self, key: str, value: Any) -> bool:
        if key in ("base_frame", "flange_frame"):
            return np.array_equal(value, _IDENTITY)
        return key == "directory" and not value

    def _by_craig(self, name: str, robot: dict[str, Any]) -> dict[str, Any]:
        """Converts a standard DH table to Craig's convention, which the proto needs.

        A row in Craig's convention contains theta and d of the standard row with the same number,
        and alpha and a of the previous row. The flange frame includes the last alpha and a.
        """
        if robot.pop("dh_convention", PAPER_CONVENTION) == PAPER_CONVENTION:
            return robot
        rows = np.array(robot["dh_params"], np.float64)
        robot["dh_params"] = np.column_stack(
            [np.append(0.0, rows[:-1, 0]), np.append(0.0, rows[:-1, 1]), rows[:, 2:]]
        ).tolist()
        last = frame(rotation_about(0, rows[-1, 0]), np.array([rows[-1, 1], 0.0, 0.0]))
        robot["flange_frame"] = (last @ np.array(robot.get("flange_frame", _IDENTITY))).tolist()
        offsets = robot.get("offsets_to_center_of_joints")
        if offsets is not None:  # from frames i - 1 to frames i
            turned = [
                rotation_about(2, -row[2]) @ offset - [0.0, 0.0, row[3]]
                for row, offset in zip(rows, np.array(offsets, np.float64), strict=True)
            ]
            robot["offsets_to_center_of_joints"] = np.array(turned).round(12).tolist()
        if robot.pop("filenames", None) is not None:
            self.left_out.append(f"robots.{name}.filenames (meshes in frames of standard DH)")
        return robot

    def _child(self, robot: str, child: Mapping[str, Any]) -> list[str]:
        table = {key: value for key, value in child.items() if key != "on"}
        place = f"robots.{robot}.children.{child.get('name', '')}"
        if child.get("on", "flange") != "flange":
            self.left_out.append(f"{place} (not on the flange)")
            return []
        return self._object(place, str(table.pop("name", "")), table)

    def _sources(self) -> list[str]:
        lines = []
        for name, source in self.tables.get("sources", {}).items():
            kind, fields = _KINDS.get(source.get("kind"), ("", {}))
            if not kind:
                self.left_out.append(f"sources.{name} (of kind {shown(source.get('kind'))})")
                continue
            self.used[kind] = None
            lines.append(f"DEF {name} {kind} {{")
            by_key = {key: (field, each) for field, (each, key) in fields.items()}
            for key, value in source.items():
                if key in by_key:
                    lines += _indented(_field(*by_key[key], value))
                elif key != "kind":
                    self.left_out.append(f"sources.{name}.{key}")
            lines.append("}")
        return lines

    # Surroundings.

    def _objects(self) -> list[str]:
        objects = self.tables.get("objects", {})
        return [
            line
            for name, table in objects.items()
            for line in self._object(f"objects.{name}", name, table)
        ]

    def _object(self, place: str, name: str, table: Mapping[str, Any]) -> list[str]:
        rest = dict(table)
        T = np.array(rest.pop("frame", _IDENTITY), np.float64)
        rgba, shape = rest.pop("rgba", None), rest.pop("shape", None)
        size, text = rest.pop("size", None), rest.pop("mjcf", None)
        scale = np.ones(3)
        if shape == "box":
            geometries = [(f"Box {{ size {_numbers(size)} }}", rgba)]
        elif shape == "sphere":
            geometries = [(f"Sphere {{ radius {_numbers(size)} }}", rgba)]
        elif shape == "ellipsoid":
            geometries, scale = [("Sphere { radius 1.0 }", rgba)], np.array(size)
        elif shape == "cylinder":
            geometries = [(f"Cylinder {{ radius {size[0]!r} height {size[1]!r} }}", rgba)]
            T = T @ frame(rotation_about(0, np.pi / 2))  # The axis is y in X3D and z in MuJoCo.
        else:
            geometries = [] if text is None else [*_face_sets(text)]
        if not geometries:
            what = shape or ("mesh" if "mesh" in rest else "mjcf")
            self.left_out.append(f"{place} ({what})")
            return []
        self.left_out += [f"{place}.{key}" for key in rest]
        if len(geometries) == 1:
            geometry, color = geometries[0]
            return shape_lines(geometry, color, T, scale, name)
        return [line for geometry, color in geometries for line in shape_lines(geometry, color, T)]

    def _cameras(self) -> list[str]:
        cameras, view = self.tables.get("cameras", {}), self.tables.get("view", {})
        first = view.get("camera")
        self.left_out += [f"view.{key}" for key in view if key != "camera"]
        lines = []
        for name in sorted(cameras, key=lambda each: each != first):
            camera = dict(cameras[name])
            if not np.array_equal(camera.pop("frame", _IDENTITY), _IDENTITY):
                self.left_out.append(f"cameras.{name} (has a frame)")
                continue
            at = np.array(camera["position"], np.float64)
            looks_at = np.array(camera.get("look_at", np.zeros(3)), np.float64)
            angle = np.deg2rad(camera.get("fovy_deg", 45.0))
            lines.append(
                f"DEF {name} Viewpoint {{ position {_numbers(at)} "
                f"orientation {_rotation(_view_axes(looks_at - at))} "
                f"centerOfRotation {_numbers(looks_at)} fieldOfView {float(angle)!r} }}"
            )
        return lines

    def _lights(self) -> list[str]:
        lines = []
        for name, light in self.tables.get("lights", {}).items():
            diffuse = np.array(light.get("diffuse", np.full(3, LIGHT_SHARE)), np.float64)
            brightest = float(diffuse.max()) or 1.0
            if brightest > LIGHT_SHARE * (1 + 1e-9):
                self.left_out.append(f"lights.{name}.diffuse (above {LIGHT_SHARE:g})")
            color = _numbers((diffuse / brightest).round(12))
            intensity = float(np.round(min(brightest / LIGHT_SHARE, 1.0), 12))
            down = light.get("direction", [0.0, 0.0, -1.0])
            look = f"direction {_numbers(down)} color {color} intensity {intensity!r} }}"
            if light.get("directional", True):
                lines.append(f"DEF {name} DirectionalLight {{ {look}")
            else:
                lines.append(
                    f"DEF {name} SpotLight {{ location {_numbers(light['position'])} {look}"
                )
        return lines

    # Routes.

    def _routes(self) -> list[str]:
        inputs = {key: field for field, key in ROBOT_INPUTS.items()}
        outputs = {key: field for field, key in ROBOT_OUTPUTS.items()}
        events = {key: field for field, key in SOURCE_EVENTS.items()}
        robots, sources = self.tables.get("robots", {}), self.tables.get("sources", {})
        lines = []
        for target, origin in self.tables.get("routes", {}).items():
            name, _, key = target.partition(".")
            of, _, event = str(origin).partition(".")
            word = re.fullmatch(r"[A-Za-z_]\w*", event)
            if word and of in sources and sources[of].get("kind") in _KINDS:
                field = events.get(event, event)
            else:
                field = outputs.get(event, "") if of in robots else ""
            written = name in robots and not _unsupported(robots[name])
            if field and written and key in inputs:
                lines.append(f"ROUTE {of}.{field} TO {name}.{inputs[key]}")
            else:
                self.left_out.append(f"routes.{target}")
        return lines


def _unsupported(robot: Mapping[str, Any]) -> str:
    if "prismatic" in (robot.get("joint_types") or []):
        return "prismatic joints"
    if robot.get("mirrored"):
        return "mirrored"
    if robot.get("joint_frames") is not None or robot.get("parents") or robot.get("flange_on"):
        return "no DH table"
    is_at_base = np.array_equal(robot.get("dh_base_frame", _IDENTITY), _IDENTITY)
    return "" if is_at_base else "has dh_base_frame"


def _mounted_on(name: str, carried: Mapping[str, list[str]]) -> Iterator[str]:
    for each in carried.get(name, []):
        yield each
        yield from _mounted_on(each, carried)


def _field(name: str, kind: str, value: Any) -> list[str]:
    if kind == "SFBool":
        return [f"{name} {'TRUE' if value else 'FALSE'}"]
    if kind == "SFString":
        return [f"{name} {_text(value)}"]
    if kind in ("SFInt32", "SFFloat"):
        return [f"{name} {value!r}"]
    if kind == "SFMatrix4f":
        return [f"{name} {_numbers(np.array(value).T)}"]  # X3D has the translation in row 4.
    if kind == "MFString":
        entries = [_text(each) for each in value]
    else:
        entries = [_numbers(np.atleast_1d(each)) for each in value]
    lines = [f"{name} ["]
    for entry in entries:
        if len(lines[-1]) + len(entry) > _WIDTH - 10:
            lines.append("  ")
        lines[-1] += f" {entry},"
    lines[-1] = lines[-1].rstrip(",") + " ]"
    return lines


def _text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, np.float64).ravel())


def _rotation(R: Array) -> str:
    angle = rotation_angle(R)
    twice = R - R.T
    axis = np.array([twice[2, 1], twice[0, 2], twice[1, 0]])
    if np.linalg.norm(axis) < 1e-6:  # The angle is 0 or π.
        if angle < 1.0:
            return "0.0 0.0 1.0 0.0"
        square = (R + np.eye(3)) / 2
        axis = square[:, int(np.argmax(square.diagonal()))]
    return f"{_numbers(axis / np.linalg.norm(axis))} {angle!r}"


def _transform(T: Array, scale: Array) -> str:
    parts = []
    if T[:3, 3].any():
        parts.append(f"translation {_numbers(T[:3, 3])}")
    if not np.allclose(T[:3, :3], np.eye(3), rtol=0, atol=1e-15):
        parts.append(f"rotation {_rotation(T[:3, :3])}")
    if not np.array_equal(scale, np.ones(3)):
        parts.append(f"scale {_numbers(scale)}")
    return " ".join(parts)


def _view_axes(forward: Array) -> Array:
    back = -forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(up, back)) < 1e-9:
        up = np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back])


def shape_lines(
    geometry: str,
    rgba: Sequence[float] | None,
    T: Array = _IDENTITY,
    scale: Array | None = None,
    name: str = "",
) -> list[str]:
    """Returns the lines of a Shape node, in a Transform node if the Shape is moved or scaled."""
    lines = [f"{f'DEF {name} ' if name else ''}Shape {{ geometry {geometry}"]
    if rgba is not None:
        look = f"diffuseColor {_numbers(rgba[:3])}"
        if rgba[3] != 1.0:
            look += f" transparency {round(1.0 - rgba[3], 12)!r}"
        lines.append(f"  appearance Appearance {{ material Material {{ {look} }} }}")
    lines[-1] += " }"
    moved = _transform(T, np.ones(3) if scale is None else scale)
    return [f"Transform {{ {moved} children [", *_indented(lines), "] }"] if moved else lines


def _face_sets(mjcf: str) -> Iterator[tuple[str, list[float] | None]]:
    try:
        root = ElementTree.fromstring(mjcf)
    except ElementTree.ParseError:
        return
    meshes = {mesh.get("name"): mesh for mesh in root.iter("mesh")}
    geoms = [*root.iter("geom")]
    is_ours = all(
        geom.get("type") == "mesh" and not {"pos", "quat", "euler"} & {*geom.keys()}
        and (mesh := meshes.get(geom.get("mesh"))) is not None and mesh.get("face")
        for geom in geoms
    )  # fmt: skip
    if not is_ours or [*root.iter("body")]:
        return
    for geom in geoms:
        mesh = meshes[geom.get("mesh")]
        points = np.array((mesh.get("vertex") or "").split(), np.float64).reshape(-1, 3)
        faces = np.array((mesh.get("face") or "").split(), np.intp).reshape(-1, 3)
        rgba = geom.get("rgba")
        yield face_set(points, faces), None if rgba is None else [*map(float, rgba.split())]


def face_set(points: Array, faces: Any, crease: float = 3.2) -> str:
    """Returns an IndexedFaceSet of triangles, shape (f, 3), with vertices `points`, shape (k, 3).

    Edges are sharp above the angle `crease` in rad, and between duplicated vertices.
    """
    coordinates = ", ".join(" ".join(f"{value:.7g}" for value in point) for point in points)
    corners = " ".join(f"{a} {b} {c} -1" for a, b, c in np.asarray(faces).tolist())
    return (
        f"IndexedFaceSet {{ creaseAngle {crease!r} coord Coordinate {{ point [ {coordinates} ] }} "
        f"coordIndex [ {corners} ] }}"
    )


def _indented(lines: Sequence[str]) -> list[str]:
    return [f"  {line}" for line in lines]
