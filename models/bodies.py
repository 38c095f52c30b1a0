"""Bodies of links, for the scripts that write the meshes of this folder's robots.

All robots are made of the same few kinds of body, in metres, in their links' frames: bodies of
revolution (rings, drums, caps, lenses) and lofts, which lead through outlines that change along a
path. Each is closed, so MuJoCo can weigh it. A link is a table of parts by colour; `write_links`
writes one binary STL file for each, the same byte for byte on every run.

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

Parts = Mapping[str, Sequence[trimesh.Trimesh]]  # by colour


def ramp(x: np.ndarray | float, start: float, stop: float) -> np.ndarray:
    """Return a quintic step of ``x``, 0 before ``start`` and 1 after ``stop`` (same units)."""
    t = np.clip((np.asarray(x, float) - start) / (stop - start), 0.0, 1.0)
    return t**3 * (t * (6.0 * t - 15.0) + 10.0)


def mix(a: float, b: float, t: float) -> float:
    """Return ``a`` at t = 0 and ``b`` at t = 1 (any units)."""
    return a + (b - a) * t


def fillet(points: list[tuple], steps: int = 3) -> np.ndarray:
    """Round the corners of an open (r, z) polyline in metres.

    A point (r, z, f) with a third number is replaced by an arc of radius ``f`` (metres) in
    ``steps`` chords; end points and points without ``f`` stay sharp.
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
    """Return the triangles between two rows of vertex numbers of the same length."""
    upper = np.column_stack([a[:-1], a[1:], b[1:]])
    return np.vstack([upper, np.column_stack([a[:-1], b[1:], b[:-1]])])


def close(ring: np.ndarray) -> np.ndarray:
    """Return a row of vertex numbers with its first number repeated at the end."""
    return np.append(ring, ring[0])


def skin(rings: np.ndarray) -> trimesh.Trimesh:
    """Join closed rings of points, shape (rings, points, 3) in metres, to one closed surface.

    First and last ring are closed by a fan round their mean; repeated points collapse.
    """
    points = np.vstack([rings.reshape(-1, 3), rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    count, size = rings.shape[:2]
    rows = np.arange(count * size).reshape(count, size)
    rows = np.vstack([np.full(size, count * size), rows, np.full(size, count * size + 1)])
    return solid(points, np.vstack([strip(close(a), close(b)) for a, b in pairwise(rows)]))


def solid(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """Weld points (metres, to 0.1 um), drop collapsed faces and turn all normals outwards."""
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
    """Turn a part's z axis to ``axis`` (a unit vector) and move it to ``origin`` (metres)."""
    side = X if abs(axis[0]) < 0.5 else Y
    u = side - axis * (side @ axis)
    u /= np.linalg.norm(u)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([u, np.cross(axis, u), axis])
    pose[:3, 3] = origin
    return mesh.copy().apply_transform(pose)


def revolve(profile, axis=Z, origin=(0.0, 0.0, 0.0), sides: int = ROUND_SIDES) -> trimesh.Trimesh:
    """Turn an open (r, z) profile in metres about ``axis`` through ``origin`` and close it."""
    profile = np.asarray(profile, float)
    angle = np.arange(sides) * 2.0 * np.pi / sides
    r, z = profile[:, :1], profile[:, 1:]
    rings = np.stack([r * np.cos(angle), r * np.sin(angle), z + 0.0 * angle], axis=-1)
    return place(skin(rings), np.asarray(axis, float), origin)


def superellipse(a: float, b: float, power: float, sides: int) -> np.ndarray:
    """Return an outline (sides, 2) with half widths ``a`` and ``b`` (metres).

    ``power`` 2 is an ellipse, 4 a box with round corners.
    """
    angle = np.arange(sides) * 2.0 * np.pi / sides
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack(
        [a * np.sign(c) * np.abs(c) ** (2 / power), b * np.sign(s) * np.abs(s) ** (2 / power)]
    )


def smooth(stations: np.ndarray, steps: int) -> np.ndarray:
    """Lead a curve through the rows of ``stations``, ``steps`` to each, over its first column.

    Tangents are those of the parabola through three neighbours, limited so that nothing swings
    over (Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5, 1984, 300-304).
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
    """Lead a skin through superellipses and close it with rounded ends.

    Args:
        stations: (w, a, b, power, u, v): place along the path, half widths, the outline's power,
            and optionally the outline's middle; metres.
        axes: unit vectors of u, v and w.
        origin: where u, v and w are zero, metres.
        edges: radii of the edges at both ends, metres.
        steps: rings from one station to the next.
        sides: facets round the path.
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
    """Return the rings (3, 6) of the rounded end at row ``k``: from the flank to the face."""
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
    """Return a round body with rounded edges, ``half`` to both sides along ``axis``, metres."""
    edge = min(edge, 0.9 * half, 0.9 * radius)
    flank = [(radius, half, edge), (0.0, half)]
    profile = [(0.0, -half), (radius, -half, edge), *flank]
    return revolve(fillet(profile, 3), axis, origin, sides)


def limb(start, stop, radii: tuple[float, float], power: float = 2.0) -> trimesh.Trimesh:
    """Return a round bar between two points with rounded ends, metres."""
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
    """Return the dark disc that fills a seam at ``centre`` along ``axis``, all in metres.

    It reaches into the shells on either side, so no angle opens a gap.
    """
    return revolve([(radius, centre - 0.004), (radius, centre + 0.004)], axis)


def cap(radius: float, face: float, axis: np.ndarray) -> dict[str, list[trimesh.Trimesh]]:
    """Return a domed joint cap in an orange ring on a drum face at ``face`` along ``axis`` (m)."""
    r, low = radius, face - 0.003
    dome = [(r, low), (r - 0.0008, face + 0.0028), (r - 0.004, face + 0.004), (0.0, face + 0.0052)]
    ring = [(r + 0.0032, low), (r + 0.0024, face + 0.0015), (0.0, face + 0.0015)]
    return {"grey": [revolve(dome, axis, sides=26)], "orange": [revolve(ring, axis, sides=26)]}


def link_cap(radius: float, face: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> dict:
    """Return a joint cap like `cap`, about an axis through ``origin``, metres."""
    shift = np.asarray(origin, float)
    return {
        colour: [part.copy().apply_translation(shift) for part in parts]
        for colour, parts in cap(radius, face, axis).items()
    }


def tool_flange(face: float, holes: Sequence[float], radius: float = 0.033) -> Parts:
    """Return a flange of ISO 9409-1-50 in its joint's frame: steel plate, dark bolt holes.

    Args:
        face: mounting face along z, metres.
        holes: their angles round z, rad, on the circle of 50 mm.
        radius: of the plate, metres.
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
    # Dark discs 0.1 mm proud: a hole at this scale is a dark spot.
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
    """Return a round column on a foot with six bolts, and the ring of the seam above it.

    Args:
        column: its (r, z) profile, see `fillet`, metres.
        foot: likewise.
        seam: radius and height of the ring, metres.
        bolt: radius and half height of a bolt, radius of their circle, height of their middles.
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
    """Return a collar about a roll axis, and a fork of two cheeks about z with caps, metres.

    Args:
        collar: its (r, z) profile along ``axis``, see `fillet`.
        cheek: stations of a cheek, against ``axis``, see `loft`.
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
    """Return the drum about y between the cheeks of `wrist_fork`, and a neck along z, metres.

    Args:
        radius: of the neck.
        length: of the neck, from the axis of the drum.
        seam: height of the ring above it.
    """
    neck = [(radius, 0.0), (radius, length, 0.002), (0.0, length)]
    return {
        "white": [drum(0.030, 0.0255, Y, edge=0.006, sides=32), revolve(fillet(neck), sides=32)],
        "grey": [seam_ring(radius - 0.0015, seam)],
    }


def recolour(parts: Parts, colours: Mapping[str, str]) -> dict[str, list[trimesh.Trimesh]]:
    """Return a table of parts under other names of colours."""
    return merge(*({colours.get(name, name): items} for name, items in parts.items()))


def merge(*tables: Parts) -> dict[str, list[trimesh.Trimesh]]:
    """Join tables of parts by colour."""
    out: dict[str, list[trimesh.Trimesh]] = {}
    for table in tables:
        for colour, parts in table.items():
            out.setdefault(colour, []).extend(parts)
    return out


def write_links(folder: Path, links: Mapping[str, Parts], label: str) -> None:
    """Write every link's parts to ``folder`` and print their triangle counts.

    Args:
        folder: made where it is not there.
        links: parts by link name; files are called ``<link>_<colour>.stl``.
        label: what stands in the files' heads.
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
    """Write parts (metres) to one binary STL file and return the number of triangles."""
    # Rounded to 0.1 um, so that a sine that differs in its last bit leaves the bytes alone.
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
