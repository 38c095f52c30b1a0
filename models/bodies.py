"""Bodies of links, for the scripts that write the meshes of this folder's robots.

All robots consist of the same few kinds of bodies, in meters, in the frames of their links: bodies
of revolution (rings, drums, caps, lenses) and lofts, which pass through outlines that change along
a path. Each body is closed, so MuJoCo can compute its mass. A link is a table of parts by color.
`write_links` writes one binary STL file for each color. Every run writes identical files.

The shapes are this project's own design; no manufacturer's data is used.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

X, Y, Z = np.eye(3)
ROUND_SIDES = 24  # facets of the small bodies of revolution
RING_INSET = 0.0016  # m, dark seam rings lie this far below the shells beside them

Parts = Mapping[str, Sequence[trimesh.Trimesh]]  # by color


def ramp(x: np.ndarray | float, start: float, stop: float) -> np.ndarray:
    """Returns a quintic step of `x`, 0 before `start` and 1 after `stop` (same units)."""
    t = np.clip((np.asarray(x, float) - start) / (stop - start), 0.0, 1.0)
    return t**3 * (t * (6.0 * t - 15.0) + 10.0)


def mix(a: float, b: float, t: float) -> float:
    """Returns `a` at t = 0 and `b` at t = 1 (any units)."""
    return a + (b - a) * t


def fillet(points: list[tuple], steps: int = 3) -> np.ndarray:
    """Rounds the corners of an open (r, z) polyline in meters.

    A point (r, z, f) with a third number is replaced by an arc of radius `f` (meters) with `steps`
    chords. End points and points without `f` stay sharp.
    """
    out = []
    for i, point in enumerate(points):
        p = np.array(point[:2], float)
        if len(point) == 2:
            out.append(p)
            continue
        a = np.array(points[i - 1][:2]) - p
        b = np.array(points[i + 1][:2]) - p
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        half = 0.5 * np.arccos(np.clip(a @ b, -1.0, 1.0))
        bisector = (a + b) / np.linalg.norm(a + b)
        centre = p + bisector * point[2] / np.sin(half)
        start = p + a * point[2] / np.tan(half) - centre
        stop = p + b * point[2] / np.tan(half) - centre
        angle = np.pi - 2.0 * half
        for t in np.linspace(0.0, 1.0, steps + 1):
            s0, s1 = np.sin((1.0 - t) * angle), np.sin(t * angle)
            out.append(centre + (s0 * start + s1 * stop) / np.sin(angle))
    return np.array(out)


def strip(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the triangles between two rows of vertex numbers of the same length."""
    upper = np.column_stack([a[:-1], a[1:], b[1:]])
    return np.vstack([upper, np.column_stack([a[:-1], b[1:], b[:-1]])])


def close(ring: np.ndarray) -> np.ndarray:
    """Returns a row of vertex numbers with its first number repeated at the end."""
    return np.append(ring, ring[0])


def skin(rings: np.ndarray) -> trimesh.Trimesh:
    """Joins closed rings of points, shape (rings, points, 3) in meters, to a closed surface.

    The first and last rings are closed by a fan around their mean. Repeated points collapse.
    """
    points = np.vstack([rings.reshape(-1, 3), rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    count, size = rings.shape[:2]
    rows = np.arange(count * size).reshape(count, size)
    rows = np.vstack([np.full(size, count * size), rows, np.full(size, count * size + 1)])
    return solid(points, np.vstack([strip(close(a), close(b)) for a, b in pairwise(rows)]))


def solid(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """Merges points (meters, to 0.1 um), drops collapsed faces and orients all normals outward."""
    keys = np.round(vertices * 1e7).astype(np.int64)
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = label.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    mesh = trimesh.Trimesh(vertices[first], faces, process=False)
    if mesh.volume < 0.0:
        mesh.invert()
    if not mesh.is_watertight:
        raise ValueError("part is not watertight")
    return mesh


def place(mesh: trimesh.Trimesh, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """Rotates a part's z axis to `axis` (a unit vector) and moves it to `origin` (meters)."""
    side = X if abs(axis[0]) < 0.5 else Y
    u = side - axis * (side @ axis)
    u /= np.linalg.norm(u)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([u, np.cross(axis, u), axis])
    pose[:3, 3] = origin
    return mesh.copy().apply_transform(pose)


def revolve(profile, axis=Z, origin=(0.0, 0.0, 0.0), sides: int = ROUND_SIDES) -> trimesh.Trimesh:
    """Revolves an open (r, z) profile in meters about `axis` through `origin` and closes it."""
    profile = np.asarray(profile, float)
    angle = np.arange(sides) * 2.0 * np.pi / sides
    r, z = profile[:, :1], profile[:, 1:]
    rings = np.stack([r * np.cos(angle), r * np.sin(angle), z + 0.0 * angle], axis=-1)
    return place(skin(rings), np.asarray(axis, float), origin)


def superellipse(a: float, b: float, power: float, sides: int) -> np.ndarray:
    """Returns an outline (sides, 2) with half widths `a` and `b` (meters).

    With `power` 2, it is an ellipse, and with 4, a box with round corners.
    """
    angle = np.arange(sides) * 2.0 * np.pi / sides
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack(
        [a * np.sign(c) * np.abs(c) ** (2 / power), b * np.sign(s) * np.abs(s) ** (2 / power)]
    )


def smooth(stations: np.ndarray, steps: int) -> np.ndarray:
    """Interpolates the rows of `stations` over the first column, with `steps` rows per interval.

    Tangents come from the parabola through three neighbors, limited so that the curve does not
    overshoot (Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5, 1984, 300-304).
    """
    w, values = stations[:, 0], stations[:, 1:]
    slope = np.diff(values, axis=0) / np.diff(w)[:, None]
    tangent = np.vstack([slope[:1], 0.5 * (slope[1:] + slope[:-1]), slope[-1:]])
    lower = np.minimum(np.abs(slope[1:]), np.abs(slope[:-1]))
    limited = np.clip(tangent[1:-1], -3.0 * lower, 3.0 * lower)
    tangent[1:-1] = np.where(slope[1:] * slope[:-1] > 0.0, limited, 0.0)
    rows = [stations[:1]]
    for i, (start, stop) in enumerate(pairwise(w)):
        t = np.linspace(0.0, 1.0, steps + 1)[1:, None]
        h = stop - start
        rows.append(
            np.hstack(
                [
                    start + h * t,
                    (2 * t**3 - 3 * t**2 + 1) * values[i]
                    + (t**3 - 2 * t**2 + t) * h * tangent[i]
                    + (3 * t**2 - 2 * t**3) * values[i + 1]
                    + (t**3 - t**2) * h * tangent[i + 1],
                ]
            )
        )
    return np.vstack(rows)


def loft(
    stations: Sequence[tuple],
    axes: tuple[np.ndarray, np.ndarray, np.ndarray] = (X, Y, Z),
    origin=(0.0, 0.0, 0.0),
    *,
    edges: tuple[float, float] = (0.004, 0.004),
    steps: int = 2,
    sides: int = 24,
) -> trimesh.Trimesh:
    """Returns a closed surface through superellipses, with rounded ends.

    Args:
        stations: (w, a, b, power, u, v): position along the path, half widths, power of the
            outline, and optionally center of the outline, m.
        axes: unit vectors of u, v and w.
        origin: point at which u, v and w are zero, m.
        edges: radii of the edges at both ends, m.
        steps: number of rings from one station to the next.
        sides: number of facets around the path.
    """
    rows = np.array([(*station, 0.0, 0.0)[:6] for station in stations], float)
    rows = smooth(rows, steps)
    first, last = (_end(rows, k, edges[k]) for k in (0, -1))
    between = rows[(rows[:, 0] > first[0, 0]) & (rows[:, 0] < last[0, 0])]
    rings = []
    for w, a, b, power, u, v in np.vstack([first[::-1], between, last]):
        outline = superellipse(a, b, power, sides) + np.array([u, v])
        rings.append(np.column_stack([outline, np.full(sides, w)]) @ np.array(axes))
    return skin(np.array(rings) + np.asarray(origin))


def _end(rows: np.ndarray, k: int, edge: float) -> np.ndarray:
    """Returns the rings (3, 6) of the rounded end at row `k`, from the flank to the face."""
    edge = min(edge, 0.95 * rows[k, 1], 0.95 * rows[k, 2])
    inwards = 1.0 if k == 0 else -1.0
    out = []
    for angle in np.deg2rad([0.0, 40.0, 90.0]):
        w = rows[k, 0] + inwards * edge * (1.0 - np.sin(angle))
        ring = np.array([np.interp(w, rows[:, 0], column) for column in rows.T])
        ring[1:3] -= edge * (1.0 - np.cos(angle))
        out.append(ring)
    return np.array(out)


def drum(
    radius: float,
    half: float,
    axis=Z,
    origin=(0.0, 0.0, 0.0),
    edge: float = 0.004,
    sides: int = ROUND_SIDES,
) -> trimesh.Trimesh:
    """Returns a round body with rounded edges, `half` to both sides along `axis`, in meters."""
    edge = min(edge, 0.9 * half, 0.9 * radius)
    flank = [(radius, half, edge), (0.0, half)]
    profile = [(0.0, -half), (radius, -half, edge), *flank]
    return revolve(fillet(profile, 3), axis, origin, sides)


def limb(start, stop, radii: tuple[float, float], power: float = 2.0) -> trimesh.Trimesh:
    """Returns a round bar between two points, with rounded ends, in meters."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    length = float(np.linalg.norm(stop - start))
    w = (stop - start) / length
    u = np.cross(Y if abs(w[1]) < 0.9 else X, w)
    u /= np.linalg.norm(u)
    stations = [(-0.6 * radii[0], radii[0], radii[0], power)]
    stations += [(length + 0.6 * radii[1], radii[1], radii[1], power)]
    edges = (0.6 * radii[0], 0.6 * radii[1])
    return loft(stations, (u, np.cross(w, u), w), start, edges=edges, steps=4, sides=24)


def seam_ring(radius: float, centre: float, axis=Z) -> trimesh.Trimesh:
    """Returns the dark disc that fills a seam at `centre` along `axis`, in meters.

    It reaches into the shells on either side, so no joint angle opens a gap.
    """
    return revolve([(radius, centre - 0.004), (radius, centre + 0.004)], axis)


def cap(radius: float, face: float, axis: np.ndarray) -> dict[str, list[trimesh.Trimesh]]:
    """Returns a domed joint cap in an orange ring on a drum face at `face` along `axis` (m)."""
    r, low = radius, face - 0.003
    dome = [(r, low), (r - 0.0008, face + 0.0028), (r - 0.004, face + 0.004), (0.0, face + 0.0052)]
    ring = [(r + 0.0032, low), (r + 0.0024, face + 0.0015), (0.0, face + 0.0015)]
    return {"grey": [revolve(dome, axis, sides=26)], "orange": [revolve(ring, axis, sides=26)]}


def link_cap(radius: float, face: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> dict:
    """Returns a joint cap like `cap`, about an axis through `origin`, in meters."""
    shift = np.asarray(origin, float)
    return {
        colour: [part.copy().apply_translation(shift) for part in parts]
        for colour, parts in cap(radius, face, axis).items()
    }


def tool_flange(face: float, holes: Sequence[float], radius: float = 0.033) -> Parts:
    """Returns an ISO 9409-1-50 flange in the frame of its joint: steel plate, dark bolt holes.

    Args:
        face: position of the mounting face along z, m.
        holes: angles of the holes around z on the 50 mm circle, rad.
        radius: radius of the plate, m.
    """
    plate = [
        (radius - 0.0010, face - 0.0090),
        (radius, face - 0.0080),
        (radius, face - 0.0008),
        (radius - 0.0008, face),
        (0.0168, face),
        (0.0160, face - 0.0008),
        (0.0150, face - 0.0040),
    ]
    # Dark discs that protrude by 0.1 mm; at this scale, a hole looks like a dark spot.
    spot = [(0.0030, face - 0.0010), (0.0028, face + 0.0001)]
    places = [(0.025 * np.cos(angle), 0.025 * np.sin(angle), 0.0) for angle in holes]
    return {
        "steel": [revolve(plate, sides=24)],
        "grey": [revolve(spot, Z, place, 8) for place in places],
    }


def pedestal(
    column: Sequence[tuple],
    foot: Sequence[tuple],
    seam: tuple[float, float],
    bolt: tuple[float, float, float, float],
) -> Parts:
    """Returns a round column on a foot with six bolts, and the ring of the seam above it.

    Args:
        column: (r, z) profile of the column, see `fillet`, m.
        foot: (r, z) profile of the foot, m.
        seam: radius and height of the ring, m.
        bolt: radius and half height of a bolt, radius of the bolt circle, height of the bolt
            centers, m.
    """
    radius, half, circle, height = bolt
    angles = (np.arange(6) + 0.5) * np.pi / 3
    bolts = [
        drum(radius, half, Z, (circle * np.cos(a), circle * np.sin(a), height)) for a in angles
    ]
    return {
        "white": [revolve(fillet(column), sides=40)],
        "grey": [revolve(fillet(foot), sides=40), seam_ring(*seam), *bolts],
    }


def wrist_fork(collar: Sequence[tuple], cheek: Sequence[tuple], axis: np.ndarray) -> Parts:
    """Returns a collar about a roll axis, and a fork of two cheeks about z with caps, in meters.

    Args:
        collar: (r, z) profile of the collar along `axis`, see `fillet`.
        cheek: stations of a cheek, opposite to `axis`, see `loft`.
        axis: unit vector from the middle of the fork to the collar.
    """
    sides = [1.0, -1.0]
    cheeks = [
        loft(cheek, (X, Z, -axis), 0.0345 * s * Z, edges=(0.004, 0.010), steps=4, sides=32)
        for s in sides
    ]
    caps = (link_cap(0.017, 0.042, s * Z) for s in sides)
    return merge({"white": [revolve(fillet(collar), axis, sides=32), *cheeks]}, *caps)


def wrist_drum(radius: float, length: float, seam: float) -> Parts:
    """Returns the drum about y between the cheeks of `wrist_fork`, and a neck along z, in meters.

    Args:
        radius: radius of the neck.
        length: length of the neck from the axis of the drum.
        seam: height of the ring above it.
    """
    neck = [(radius, 0.0), (radius, length, 0.002), (0.0, length)]
    return {
        "white": [drum(0.030, 0.0255, Y, edge=0.006, sides=32), revolve(fillet(neck), sides=32)],
        "grey": [seam_ring(radius - 0.0015, seam)],
    }


def recolour(parts: Parts, colours: Mapping[str, str]) -> dict[str, list[trimesh.Trimesh]]:
    """Returns a table of parts with other color names."""
    return merge(*({colours.get(name, name): items} for name, items in parts.items()))


def merge(*tables: Parts) -> dict[str, list[trimesh.Trimesh]]:
    """Joins tables of parts by color."""
    out: dict[str, list[trimesh.Trimesh]] = {}
    for table in tables:
        for colour, parts in table.items():
            out.setdefault(colour, []).extend(parts)
    return out


def write_links(folder: Path, links: Mapping[str, Parts], label: str) -> None:
    """Writes the parts of every link to `folder` and prints their triangle counts.

    Args:
        folder: output folder, which is created if it does not exist.
        links: parts by link name; files are named `<link>_<color>.stl`.
        label: text in the headers of the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    total = 0
    for name, colours in links.items():
        for colour, parts in sorted(colours.items()):
            count = write_stl(folder / f"{name}_{colour}.stl", parts, label)
            total += count
            print(f"{name}_{colour}.stl {count}")
    print("total", total)


def write_stl(path: Path, parts: Sequence[trimesh.Trimesh], label: str) -> int:
    """Writes parts (meters) to a binary STL file and returns the number of triangles."""
    # Rounded to 0.1 um, so that a sine that differs in its last bit does not change the file.
    triangles = np.round(np.vstack([part.triangles for part in parts]), 7) + 0.0
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    layout = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]
    record = np.zeros(len(triangles), layout)
    record["normal"] = np.round(normals, 4) + 0.0
    record["corners"] = triangles
    head = label.encode().ljust(80) + struct.pack("<I", len(record))
    path.write_bytes(head + record.tobytes())
    return len(record)
