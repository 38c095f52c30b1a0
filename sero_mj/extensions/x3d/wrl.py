"""Reads the geometry of VRML97 and X3D files as triangles, grouped by color.

Sources: ISO/IEC 14772-1 (VRML97), clause 6, and ISO/IEC 19775-1 for nodes of X3D.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.errors import DeclarationError, Problem, mismatch
from ...base.frames import Array
from ...base.paths import scene_endings
from .vrml import read_document
from .vrml_nodes import Node, Problems, get, instance, read_field
from .wrl_geometry import GEOMETRIES, Triangles

log = logging.getLogger(__name__)

_MAX_NODES = 100_000  # maximum number of visited nodes, which counts each USE and PROTO instance
_MAX_TRIANGLES = 5_000_000
_MAX_INLINES = 200
_DEFAULT_COLOR = (0.8, 0.8, 0.8)

# For each grouping node: the field with its children.
_GROUPS = {
    "Transform": "children", "MatrixTransform": "children", "Group": "children",
    "StaticGroup": "children", "Anchor": "children", "Billboard": "children",
    "Collision": "children", "CADLayer": "children", "CADAssembly": "children",
    "CADPart": "children", "Scene": "children", "Switch": "choice", "LOD": "level",
}  # fmt: skip
# These nodes have no visible effect, so no warning lists them.
_UNSEEN = {
    "WorldInfo", "NavigationInfo", "Viewpoint", "OrthoViewpoint", "Background", "Fog",
    "DirectionalLight", "PointLight", "SpotLight", "Script", "TimeSensor", "TouchSensor",
    "MetadataString", "MetadataSet",
}  # fmt: skip


class VisitedNode(NamedTuple):
    """A visited node of a scene. `T` is its affine transform T_root_node, shape (4, 4)."""

    node: Node
    T: Array
    path: Path


def read_wrl(path: Path) -> list[Triangles]:
    """Reads the geometry of a VRML97 file or of an X3D file in the classic encoding.

    A warning lists nodes that are not drawn, and missing files of Inline nodes.

    Returns:
        for each color: vertices in the file's unit, shape (v, 3); triangles, shape (f, 3); and
        RGBA, shape (4,), or None without a material. Triangles are counterclockwise seen from
        outside. Vertices are duplicated at edges that are sharp according to `creaseAngle` or
        normals.
    """
    problems = Problems(path)
    document = read_document(path)
    found = visit(document.nodes, path, problems)
    pieces: list[Triangles] = []
    left_out: dict[str, int] = {}
    count = 0
    for seen in found:
        if seen.node.kind != "Shape":
            if seen.node.kind not in _UNSEEN:
                left_out.setdefault(kind_of(seen.node), seen.node.line)
            continue
        for piece in triangles_of(seen, problems.of(seen.path), left_out):
            count += len(piece[1])
            if count > _MAX_TRIANGLES:
                message = f"has more than {_MAX_TRIANGLES:,} triangles"
                raise Problem("", message, str(path)).error()
            pieces.append(piece)
    problems.raise_all()
    if left_out:
        names = ", ".join(f"{kind} (line {line})" for kind, line in left_out.items())
        log.warning("%s: not drawn: %s", path, names)
    return by_color(pieces)


def by_color(pieces: list[Triangles]) -> list[Triangles]:
    """Joins all pieces of the same color to one piece."""
    same: dict[bytes | None, list[Triangles]] = {}
    for piece in pieces:
        same.setdefault(None if piece[2] is None else piece[2].tobytes(), []).append(piece)
    return [_joined(each) for each in same.values()]


def _joined(pieces: list[Triangles]) -> Triangles:
    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in pieces)])
    vertices = np.concatenate([vertices for vertices, _, _ in pieces])
    faces = np.concatenate(
        [faces + start for (_, faces, _), start in zip(pieces, starts, strict=False)]
    )
    return vertices, faces, pieces[0][2]


def visit(
    nodes: Sequence[Node],
    path: Path,
    problems: Problems,
    is_leaf: Callable[[Node], bool] = lambda _: False,
) -> list[VisitedNode]:
    """Traverses groups, transforms, PROTOs and inlined files, and returns all other nodes in order.

    If `is_leaf` returns True for a node, the node is returned instead of its children. Inlined
    files must be in the folder of the file `path`.
    """
    found: list[VisitedNode] = []
    inlined: dict[Path, list[Node]] = {}
    todo: list[tuple[VisitedNode, tuple[Path, ...]]] = [
        (VisitedNode(node, np.eye(4), path), (path,)) for node in reversed(nodes)
    ]
    count = 0
    while todo:
        seen, files = todo.pop()
        count += 1
        if count > _MAX_NODES:
            message = f"has more than {_MAX_NODES:,} nodes, including those of every USE"
            raise Problem("", message, str(path)).error()
        node, inner = seen.node, list[Node]()
        T, here = seen.T, problems.of(seen.path)
        if is_leaf(node):
            found.append(seen)
            continue
        made = instance(node)
        if made is not None:
            inner = [made]
        elif node.kind in _GROUPS:
            with here.collect(node.label, node.line):
                T = seen.T @ transform_of(node)
            inner = _children(node, here)
        elif node.kind == "Inline" and len(inlined) < _MAX_INLINES:
            file = None
            with here.collect(f"{node.label}.url", node.line):
                file = _inlined_file(node, seen.path)
            if file is None:
                found.append(seen)
            elif file not in files:
                if file not in inlined:
                    inlined[file] = _nodes_of(file, node, here)
                todo += [
                    (VisitedNode(each, T, file), (*files, file)) for each in reversed(inlined[file])
                ]
        else:
            found.append(seen)
        todo += [(VisitedNode(each, T, seen.path), files) for each in reversed(inner)]
    return found


def _children(node: Node, problems: Problems) -> list[Node]:
    key = _GROUPS[node.kind]
    if key not in node.fields and key != "children":
        key = "children"  # X3D has this field in Switch and LOD.
    children: list[Node] = get(node, key, "MFNode", [], problems)
    if node.kind == "Switch":
        choice = get(node, "whichChoice", "SFInt32", -1, problems)
        return children[choice : choice + 1] if 0 <= choice < len(children) else []
    return children[:1] if node.kind == "LOD" else children


def _inlined_file(node: Node, path: Path) -> Path | None:
    """Returns the first file of an Inline that exists in the folder of `path`, or None."""
    value = node.value("url")
    for url in [] if value is None else read_field(value, "MFString"):
        file = Path(url.removeprefix("file:"))
        is_inside = not file.is_absolute() and ".." not in file.parts and "\0" not in url
        if is_inside and "://" not in url and (path.parent / file).is_file():
            return path.parent / file
    return None


def kind_of(node: Node) -> str:
    """Returns the type of a node for messages. An Inline includes its URLs."""
    value = node.value("url")
    if node.kind != "Inline" or value is None:
        return node.kind
    return f"Inline of {', '.join(repr(url) for url in value.items if isinstance(url, str))}"


def _nodes_of(file: Path, node: Node, problems: Problems) -> list[Node]:
    if file.suffix.lower() not in scene_endings():
        message = (
            f"found '{file.name}'; expected a file with the extension {', '.join(scene_endings())}"
        )
        problems.add(f"{node.label}.url", message, node.line)
        return []
    try:
        return read_document(file).nodes
    except DeclarationError as error:
        problems.found += error.problems
        return []


def transform_of(node: Node) -> Array:
    """Returns the affine transform T_parent_node of a grouping node, shape (4, 4)."""
    if node.kind == "MatrixTransform":
        value = node.value("matrix")
        return np.eye(4) if value is None else matrix(read_field(value, "SFMatrix4f"))
    if node.kind != "Transform":
        return np.eye(4)

    def vector(name: str, default: float) -> Array:
        value = node.value(name)
        return np.full(3, default) if value is None else np.asarray(read_field(value, "SFVec3f"))

    def turned(name: str) -> Array:
        value = node.value(name)
        return np.eye(3) if value is None else rotation(read_field(value, "SFRotation"))

    center = vector("center", 0.0)
    oriented = turned("scaleOrientation")
    T = np.eye(4)
    T[:3, :3] = turned("rotation") @ oriented @ np.diag(vector("scale", 1.0)) @ oriented.T
    T[:3, 3] = vector("translation", 0.0) + center - T[:3, :3] @ center
    return T


def matrix(numbers: Array) -> Array:
    """Converts an SFMatrix4f, with the translation in the fourth row, to a frame, shape (4, 4)."""
    return numbers.reshape(4, 4).T.copy()


def rotation(axis_angle: Array) -> Array:
    """Converts an SFRotation, an axis of any length and an angle in rad, to a matrix, (3, 3)."""
    axis, angle = axis_angle[:3], float(axis_angle[3])
    length = np.linalg.norm(axis)
    if length == 0.0:
        if angle == 0.0:
            return np.eye(3)
        raise mismatch(angle, "an axis", "found a rotation about 0 0 0 by")
    x, y, z = axis / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def triangles_of(
    seen: VisitedNode, problems: Problems, left_out: dict[str, int]
) -> list[Triangles]:
    """Returns the triangles of a Shape for each color, in coordinates of the scene.

    The kind and line of an unknown geometry are added to `left_out`.
    """
    shape = seen.node
    node: Node | None = get(shape, "geometry", "SFNode", None, problems)
    node = node and (instance(node) or node)
    if node is None:
        return []
    build = GEOMETRIES.get(node.kind)
    if build is None:
        left_out.setdefault(node.kind, node.line)
        return []
    if not np.isfinite(seen.T).all():
        problems.add(shape.label, "is too far away", shape.line)
        return []
    try:
        pieces: list[Triangles] = build(node, problems)
    except ValueError as error:
        problems.add(node.label, str(error), node.line)
        return []
    rgba = color_of(shape, problems)
    is_mirrored = np.linalg.det(seen.T[:3, :3]) < 0
    placed = []
    for vertices, faces, own in pieces:
        if not len(faces):
            continue
        color = rgba
        if own is not None:
            color = np.append(own[:3], 1.0 if rgba is None else rgba[3])
        there = vertices @ seen.T[:3, :3].T + seen.T[:3, 3]
        placed.append((there, faces[:, ::-1] if is_mirrored else faces, color))
    return placed


def color_of(shape: Node, problems: Problems) -> Array | None:
    """Returns the RGBA color of a Shape's material, shape (4,), or None without a material."""
    appearance: Node | None = get(shape, "appearance", "SFNode", None, problems)
    appearance = appearance and (instance(appearance) or appearance)
    material: Node | None = appearance and get(appearance, "material", "SFNode", None, problems)
    material = material and (instance(material) or material)
    if material is None:
        return None
    base = "baseColor" if material.kind == "PhysicalMaterial" else "diffuseColor"
    color = get(material, base, "SFColor", np.array(_DEFAULT_COLOR), problems)
    if not np.any(color):  # The material is emissive or black.
        color = get(material, "emissiveColor", "SFColor", color, problems)
    alpha = 1.0 - get(material, "transparency", "SFFloat", 0.0, problems)
    return np.asarray(np.clip(np.append(color, alpha), 0.0, 1.0))
