"""Converts geometry nodes of VRML97 and X3D to triangles.

Source: ISO/IEC 14772-1 (VRML97), clause 6.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.errors import Problem, mismatch
from ...base.frames import Array, Ints, rotation_about
from .vrml_nodes import Node, Problems, get, instance

_SIDES = 32  # number of sides of round shapes
_MAX_CORNERS = 2000  # maximum number of corners of a concave polygon, which needs quadratic time
_MAX_CONCAVE = 50_000  # maximum number of concave polygons
_MAX_COLORS = 24  # maximum number of colors of one shape; more vertex colors are averaged

Triangles = tuple[Array, Ints, Array | None]  # vertices (v, 3), triangles (f, 3), and RGBA (4,)


def _box(node: Node, problems: Problems) -> list[Triangles]:
    half = 0.5 * get(node, "size", "SFVec3f", np.full(3, 2.0), problems)
    _check_positive("size", half)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    sides = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    faces = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return [(corners[sides].reshape(-1, 3), faces, None)]


def _check_positive(name: str, values: Any) -> None:
    if not (np.asarray(values) > 0).all():
        raise mismatch(np.asarray(values).tolist(), "numbers above 0", key=name)


def _sphere(node: Node, problems: Problems) -> list[Triangles]:
    radius = get(node, "radius", "SFFloat", 1.0, problems)
    _check_positive("radius", radius)
    down = np.linspace(0.0, np.pi, _SIDES // 2 + 1)
    profile = np.column_stack([np.sin(down), np.cos(down)]) * radius
    profile[[0, -1], 0] = 0.0
    return [_revolved(profile)]


def _cylinder(node: Node, problems: Problems) -> list[Triangles]:
    radius = get(node, "radius", "SFFloat", 1.0, problems)
    top = 0.5 * get(node, "height", "SFFloat", 2.0, problems)
    _check_positive("radius and height", [radius, top])
    return _profiles(
        node, problems, {"top": [[0, top], [radius, top]], "side": [[radius, top], [radius, -top]],
                         "bottom": [[radius, -top], [0, -top]]},
    )  # fmt: skip


def _cone(node: Node, problems: Problems) -> list[Triangles]:
    radius = get(node, "bottomRadius", "SFFloat", 1.0, problems)
    top = 0.5 * get(node, "height", "SFFloat", 2.0, problems)
    _check_positive("bottomRadius and height", [radius, top])
    profiles = {"side": [[0, top], [radius, -top]], "bottom": [[radius, -top], [0, -top]]}
    return _profiles(node, problems, profiles)


def _profiles(node: Node, problems: Problems, parts: dict[str, Any]) -> list[Triangles]:
    return [
        _revolved(np.array(profile, dtype=np.float64))
        for name, profile in parts.items()
        if get(node, name, "SFBool", True, problems)
    ]


def _revolved(profile: Array) -> Triangles:
    k = len(profile)
    turns = rotation_about(1, np.arange(_SIDES) * 2 * np.pi / _SIDES)
    points = np.column_stack([profile[:, 0], profile[:, 1], np.zeros(k)])
    vertices = np.einsum("aij,kj->kai", turns, points).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(k - 1), np.arange(_SIDES), indexing="ij")
    a, b = i * _SIDES + j, i * _SIDES + (j + 1) % _SIDES
    quads = np.stack([a, a + _SIDES, b + _SIDES, a, b + _SIDES, b], axis=-1)
    faces = quads.reshape(-1, 3)
    # All vertices at a pole coincide, so only the first one is used.
    at_pole = np.repeat(np.flatnonzero(profile[:, 0] == 0.0) * _SIDES, _SIDES)
    renamed = np.arange(len(vertices))
    for first in np.unique(at_pole):
        renamed[first : first + _SIDES] = first
    faces = renamed[faces]
    is_flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2])
    is_flat |= faces[:, 0] == faces[:, 2]
    used, faces = np.unique(faces[~is_flat], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3), None


def _indexed_face_set(node: Node, problems: Problems) -> list[Triangles]:
    points = _points(node, problems)
    index = get(node, "coordIndex", "MFInt32", np.zeros(0), problems).astype(np.intp)
    _check_index("coordIndex", index, len(points))
    corners = _cut(points, index)
    return _of_corners(node, problems, points, index, corners)


def _indexed_triangle_set(node: Node, problems: Problems) -> list[Triangles]:
    points = _points(node, problems)
    index = get(node, "index", "MFInt32", np.zeros(0), problems).astype(np.intp)
    if node.kind == "TriangleSet":
        index = np.arange(len(points))
    index = index[: len(index) // 3 * 3]
    _check_index("index", index, len(points), low=0)
    corners = np.arange(len(index)).reshape(-1, 3)
    return _of_corners(node, problems, points, index, corners)


def _points(node: Node, problems: Problems) -> Array:
    coord: Node | None = get(node, "coord", "SFNode", None, problems)
    coord = coord and (instance(coord) or coord)
    if coord is None:
        return np.zeros((0, 3))
    kind = "MFVec3d" if coord.kind == "CoordinateDouble" else "MFVec3f"
    return np.asarray(get(coord, "point", kind, np.zeros((0, 3)), problems)).reshape(-1, 3)


def _check_index(name: str, index: Ints, count: int, low: int = -1) -> None:
    if index.size and not (low <= index.min() and index.max() < count):
        found = int(index.max() if index.max() >= count else index.min())
        points = f"0 to {count - 1}" if count else "no index, because there are no points"
        raise Problem(name, f"found {found}", expected=points).error()


def _cut(points: Array, index: Ints) -> Ints:
    """Triangulates polygons, whose point indices end with -1.

    Returns the positions of the triangles' corners in `index`, shape (f, 3).
    """
    ends = np.flatnonzero(np.append(index, -1) < 0)
    starts = np.append(0, ends[:-1] + 1)
    counts = ends - starts
    cut, bent = [], 0
    for count in np.unique(counts[counts >= 3]):
        polygons = starts[counts == count][:, None] + np.arange(count)
        if count == 3:
            cut.append(polygons)
            continue
        outlines = points[index[polygons]]
        outlines = outlines - outlines[:, :1]
        following = np.roll(outlines, -1, axis=1)
        normals = np.cross(outlines, following).sum(axis=1)
        before = np.roll(outlines, 1, axis=1)
        bends = np.cross(outlines - before, following - outlines)
        signs = np.einsum("pci,pi->pc", bends, normals)
        sizes = np.linalg.norm(normals, axis=1) ** 2
        if count == 4:  # A quadrilateral is cut at its concave corner, if it has one.
            turns = (np.argmin(signs, axis=1)[:, None] + np.arange(4)) % 4
            polygons = np.take_along_axis(polygons, turns, axis=1)
            signs = np.ones_like(signs)
        is_convex = (signs >= -1e-9 * sizes[:, None]).all(axis=1)
        fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], 1)
        cut.append(polygons[is_convex][:, fan].reshape(-1, 3))
        bent += int((~is_convex).sum())
        if bent > _MAX_CONCAVE:
            raise ValueError(f"has more than {_MAX_CONCAVE:,} concave polygons")
        for polygon, outline, normal in zip(
            polygons[~is_convex], outlines[~is_convex], normals[~is_convex], strict=True
        ):
            cut.append(polygon[clip_ears(outline, normal)])
    return np.concatenate([np.zeros((0, 3), np.intp), *cut])


def clip_ears(outline: Array, normal: Array) -> Ints:
    """Triangulates a planar polygon, shape (n, 3), which may be concave, by ear clipping.

    The corners are counterclockwise about the normal. Returns corner indices of the triangles,
    shape (n - 2, 3).

    Source: Meisters, Polygons Have Ears, 1975.
    """
    if len(outline) > _MAX_CORNERS:
        raise ValueError(
            f"found a concave polygon with {len(outline)} corners; expected at most {_MAX_CORNERS}"
        )
    # The polygon is projected to the coordinate plane in which it has the largest area.
    drop = int(np.abs(normal).argmax())
    flat = outline[:, [(drop + 1) % 3, (drop + 2) % 3]]
    if normal[drop] < 0:
        flat = flat[:, ::-1]
    left = list(range(len(flat)))
    triangles = []
    while len(left) > 3:
        ring = flat[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        turn = _cross(ring - before, after - ring)
        # Any ear is correct, although clipping the sharpest one first would look better.
        ears = np.flatnonzero(turn > 0)
        reflex = ring[turn <= 0]
        # An outline without ears intersects itself, but it must be cut as well.
        empty = (int(k) for k in ears if _is_empty(before[k], ring[k], after[k], reflex))
        ear = next(empty, int(np.argmin(np.abs(turn))))
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*triangles, left], dtype=np.intp)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _is_empty(a: Array, b: Array, c: Array, points: Array) -> bool:
    inside = (_cross(b - a, points - a) >= 0) & (_cross(c - b, points - b) >= 0)
    inside &= _cross(a - c, points - c) >= 0
    for corner in (a, b, c):
        inside &= (points != corner).any(axis=1)
    return not inside.any()


def _of_corners(
    node: Node, problems: Problems, points: Array, index: Ints, corners: Ints
) -> list[Triangles]:
    faces = index[corners]
    sides = points[faces]
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    is_real = np.linalg.norm(normals, axis=1) > 0
    corners, faces, normals = corners[is_real], faces[is_real], normals[is_real]
    if not get(node, "ccw", "SFBool", True, problems):
        corners, faces, normals = corners[:, ::-1], faces[:, ::-1], -normals
    polygon = np.cumsum(np.append(0, index < 0))[:-1]
    if node.kind != "IndexedFaceSet":
        polygon = np.arange(len(index)) // 3
    smooth = _smoothing(node, problems, normals, faces, corners, polygon)
    pieces = []
    for chosen, rgb in _by_color(node, problems, index, corners, polygon):
        pairs = np.stack([faces[chosen].ravel(), smooth[chosen].ravel()], axis=1)
        vertices, renamed = np.unique(pairs, axis=0, return_inverse=True)
        own = renamed.reshape(-1, 3)
        if not get(node, "solid", "SFBool", True, problems) and _has_ends(faces[chosen]):
            own = np.concatenate([own, own[:, ::-1] + len(vertices)])
            vertices = np.concatenate([vertices, vertices])
        pieces.append((points[vertices[:, 0]], own, rgb))
    return pieces


def is_open(vertices: Array, faces: Ints) -> bool:
    """Returns whether a surface of triangles has an edge that belongs to only one triangle."""
    _, names = np.unique(vertices, axis=0, return_inverse=True)
    return _has_ends(names.ravel()[faces])


def with_hull(vertices: Array) -> Array:
    """Appends an unused vertex next to the plane of vertices, shape (v, 3), if they are coplanar.

    MuJoCo cannot compute the convex hull of planar meshes.
    """
    center = vertices.mean(axis=0)
    _, extents, axes = np.linalg.svd(vertices - center, full_matrices=False)
    if len(extents) == 3 and extents[2] > 1e-5 * extents[0]:
        return vertices
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return np.concatenate([vertices, [center + 1e-3 * size * axes[2]]])


def _has_ends(faces: Ints) -> bool:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts == 1).any())


def _smoothing(
    node: Node, problems: Problems, normals: Array, faces: Ints, corners: Ints, polygon: Ints
) -> Ints:
    normal: Node | None = get(node, "normal", "SFNode", None, problems)
    if normal is not None:
        if not get(node, "normalPerVertex", "SFBool", True, problems):
            return polygon[corners]
        index = get(node, "normalIndex", "MFInt32", np.zeros(0), problems).astype(np.intp)
        if len(index) > corners.max(initial=-1):
            vectors = get(normal, "vector", "MFVec3f", np.zeros((0, 3)), problems)
            _check_index("normalIndex", index, len(vectors))
            same = np.unique(vectors.round(6), axis=0, return_inverse=True)[1].ravel()
            return np.asarray(same[index[corners]]) if len(same) else np.zeros_like(corners)
        return np.zeros_like(corners)
    if node.kind != "IndexedFaceSet":
        smooths = get(node, "normalPerVertex", "SFBool", True, problems)
        return np.zeros_like(corners) if smooths else polygon[corners]
    crease = get(node, "creaseAngle", "SFFloat", 0.0, problems)
    if crease >= np.pi:
        return np.zeros_like(corners)
    return smoothed(normals, faces, np.cos(max(crease, 0.0) + 1e-4))


def smoothed(normals: Array, faces: Ints, min_cosine: float) -> Ints:
    """Labels the corners of triangles. Corners that meet at smooth edges have the same label.

    At a smooth edge, the cosine of the angle between the normals is at least `min_cosine`. The
    shape of the returned labels is (f, 3), as that of the triangles' vertex indices `faces`.
    """
    units = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    count = len(faces)
    here = np.arange(3 * count).reshape(-1, 3)
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)  # vertices at both ends of each edge
    at = here[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], at[turned] = ends[turned][:, ::-1], at[turned][:, ::-1]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, at = ends[order], at[order]
    of = order // 3
    shared = (ends[1:] == ends[:-1]).all(axis=1)
    shared &= np.einsum("ij,ij->i", units[of[1:]], units[of[:-1]]) >= min_cosine
    first, second = at[:-1][shared].ravel(), at[1:][shared].ravel()
    labels = np.arange(3 * count)
    while True:
        lowest = np.minimum(labels[first], labels[second])
        new = labels.copy()
        np.minimum.at(new, first, lowest)
        np.minimum.at(new, second, lowest)
        new = new[new]
        if (new == labels).all():
            return labels.reshape(-1, 3)
        labels = new


def _by_color(
    node: Node, problems: Problems, index: Ints, corners: Ints, polygon: Ints
) -> list[tuple[Any, Array | None]]:
    everything: list[tuple[Any, Array | None]] = [(slice(None), None)]
    color: Node | None = get(node, "color", "SFNode", None, problems)
    if color is None or not len(corners):
        return everything
    kind = "MFColorRGBA" if color.kind == "ColorRGBA" else "MFColor"
    colors = np.asarray(get(color, "color", kind, np.zeros((0, 3)), problems))[..., :3]
    own = get(node, "colorIndex", "MFInt32", np.zeros(0), problems).astype(np.intp)
    if get(node, "colorPerVertex", "SFBool", True, problems):
        indices = own if len(own) else index
        if len(indices) <= corners.max():
            raise mismatch(len(indices), corners.max() + 1, key="colorIndex", of="entries")
        chosen = indices[corners]
    else:
        of = polygon[corners[:, 0]]
        if len(own) and len(own) <= of.max():
            raise mismatch(len(own), of.max() + 1, key="colorIndex", of="entries")
        chosen = (own[of] if len(own) else of)[:, None]
    _check_index("colors", chosen.ravel(), len(colors), low=0)
    means = np.clip(colors[chosen].mean(axis=1), 0.0, 1.0)
    values, which = np.unique(means.round(3), axis=0, return_inverse=True)
    if len(values) > _MAX_COLORS:
        return [(slice(None), means.mean(axis=0))]
    return [(which.ravel() == k, value) for k, value in enumerate(values)]


# Each function returns the triangles of one type of geometry nodes.
GEOMETRIES: dict[str, Any] = {
    "Box": _box,
    "Sphere": _sphere,
    "Cylinder": _cylinder,
    "Cone": _cone,
    "IndexedFaceSet": _indexed_face_set,
    "IndexedTriangleSet": _indexed_triangle_set,
    "TriangleSet": _indexed_triangle_set,
}
