"""Write the link meshes of the DLR/KUKA light-weight robot to ``models/lwr/meshes/``.

The shapes are this project's own design, drawn after the published dimensions of the arm only:
the seam offsets come from the public URDF ``kuka_lwr.urdf.xacro`` of CentroEPiaggio/kuka-lwr
(Unlicense).  No DLR or KUKA data is used.

One binary STL file is written per link and colour, in metres, in the link's own modified
Denavit-Hartenberg frame.  Colours (rgba): white .93 .93 .92 1, grey .27 .265 .26 1, orange
1 .40 .04 1, steel .72 .73 .75 1.  The arm is built from two kinds of part:

* bodies of revolution: base, seam rings, joint caps, wrist ball and flange;
* five *shells*.  Each is a round tube at its roll seam that leans sideways into half a drum at
  its pitch joint.  The two shells of a pitch joint meet in a flat disc across the pitch axis, so
  that both can pass each other up to +-120 degrees.

Run ``python models/lwr/make_meshes.py``; the output is the same byte for byte on every run.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

OUT = Path(__file__).resolve().parent / "meshes"

X, Y, Z = np.eye(3)
HALF_SIDES = 13  # facets of half a shell's circumference; odd, so a flat flank has two edges
DRUM_STEPS = 12  # facets of the half turn round a pitch axis
# Stations of a shoulder's bend, 0 to 1, close together where it curves most.
BEND = np.array([0.02, 0.20, 0.32, 0.50, 0.66, 0.78, 0.89, 1.0])
# Which outline points the drum keeps: its small inner edge needs only three of six.
DRUM_POINTS = np.array([0, 1, 1, 4, 4, 6, 6, *range(7, HALF_SIDES + 1)])
ROUND_SIDES = 24  # facets of the small bodies of revolution

SEAM_GAP = 0.0015  # m, from a shell's rim to the middle of its roll seam
DISC_GAP = 0.0020  # m, from a drum's face to the middle of its pitch disc
RING_INSET = 0.0016  # m, dark seam rings lie this far below the shells beside them
BEVEL = 0.0010  # m, at a shell's rim; MuJoCo gives a sharp rim one smeared normal without it
DISC_EDGE = 0.0040  # m, edge radius of a drum at the pitch disc


@dataclass(frozen=True)
class Shell:
    """Dimensions of one shell in metres; ``w`` runs from the pitch axis to the roll seam."""

    length: float  # pitch axis to roll seam
    tube: float  # tube radius at the seam
    drum: float  # drum radius at the pitch axis
    inner: float  # disc face, measured along the pitch axis towards the shell's own side
    outer: float  # cap face, likewise
    rim: float  # edge radius at the cap face
    shoulder: tuple[float, float]  # w where the far side of the tube swells out
    lean: tuple[float, float]  # w where the near side leans back to the tube
    dome: float  # height of the domed shoulder over its edges


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


def shell_section(shell: Shell, w: float) -> np.ndarray:
    """Return half the outline of a shell at ``w`` (metres) as (u, v) points, inner to outer.

    Two elliptic corners joined by flats: small corners give the drum, full ones the round tube.
    """
    swell, lean = ramp(w, *shell.shoulder), ramp(w, *shell.lean)
    soft = ramp(w, 0.35 * shell.drum, shell.shoulder[1])
    a = mix(shell.drum, shell.tube, ramp(w, 0.0, shell.shoulder[1]))
    v0 = mix(shell.inner, -shell.tube, swell)
    v1 = mix(shell.outer, shell.tube, lean)
    middle = 0.5 * (v0 + v1)
    theta = np.arange(HALF_SIDES + 1) * np.pi / HALF_SIDES
    inside = theta < 0.5 * np.pi
    small = np.where(inside, DISC_EDGE, shell.rim)
    reach = np.where(inside, middle - v0, v1 - middle)
    fu = mix(small, a, soft)
    fv = mix(small, reach, soft)
    edge = np.where(inside, v0 + fv, v1 - fv)
    u = a - fu + fu * np.sin(theta)
    u[[0, -1]] = 0.0
    return np.column_stack([u, edge - fv * np.cos(theta)])


def shell_mesh(shell: Shell, side: np.ndarray, seam: np.ndarray) -> trimesh.Trimesh:
    """Sweep a shell's outline from its drum to its roll seam (metres).

    ``side`` is the unit vector along the pitch axis to the shell's own side, ``seam`` the unit
    vector from the pitch axis to the roll seam.
    """
    start, stop = shell.shoulder
    seam_edge = shell.length - SEAM_GAP
    tube = []
    for w in [0.0, 0.5 * start, *(start + (stop - start) * BEND), seam_edge - BEVEL]:
        half = shell_section(shell, w)
        u, v = half.T
        # The shoulder's middle may rise into the wedge that the other shell never sweeps.
        depth = np.clip(-v / shell.tube, 0.0, 1.0) * (1.0 - (u / u.max()) ** 2)
        lift = shell.dome * depth * (1.0 - ramp(w, stop, shell.length))
        half = np.column_stack([half, w - lift])
        tube.append(np.vstack([half, half[-2:0:-1] * (-1.0, 1.0, 1.0)]))
    bevel = 1.0 - BEVEL / shell.tube
    tube.append(tube[-1] * (bevel, bevel, 0.0) + (0.0, 0.0, seam_edge))
    tube.append(np.tile([0.0, 0.0, seam_edge], (2 * HALF_SIDES, 1)))

    u, v = shell_section(shell, 0.0)[DRUM_POINTS].T
    turns = np.linspace(0.0, np.pi, DRUM_STEPS + 1)[1:-1]
    drum = [np.column_stack([u * np.cos(t), v, -u * np.sin(t)]) for t in turns]

    rows = np.arange(len(tube) * 2 * HALF_SIDES).reshape(len(tube), -1)
    faces = [strip(close(a), close(b)) for a, b in pairwise(rows)]
    # The drum's half turn leads from the first ring's right half to its left half.
    right, left = rows[0, : HALF_SIDES + 1], close(rows[0])[HALF_SIDES:][::-1]
    rows = rows.size + np.arange(len(drum) * (HALF_SIDES + 1)).reshape(len(drum), -1)
    faces += [strip(b, a) for a, b in pairwise([right, *rows, left])]
    axes = np.column_stack([np.cross(side, seam), side, seam])
    return solid(np.vstack(tube + drum) @ axes.T, np.vstack(faces))


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


# The shoulders begin where the other shell, turned by 120 degrees, just clears them.
BENDS = ((0.082, 0.152), (0.045, 0.150), 0.032)
SHOULDER_1 = Shell(0.20, 0.066, 0.070, DISC_GAP, 0.074, 0.024, *BENDS)
SHOULDER_2 = Shell(0.20, 0.063, 0.070, DISC_GAP, 0.074, 0.024, *BENDS)
ELBOW_3 = Shell(0.20, 0.063, 0.067, DISC_GAP, 0.071, 0.024, *BENDS)
ELBOW_4 = Shell(0.20, 0.060, 0.067, DISC_GAP, 0.071, 0.024, *BENDS)
WRIST_5 = Shell(0.19, 0.060, 0.046, 0.038, 0.068, 0.014, (0.040, 0.140), (0.030, 0.150), 0.022)

BALL = 0.057  # m, wrist ball radius
BALL_CUT = -0.036  # m, its flat towards link 5, along z6
BALL_FACE = 0.046  # m, its flat under the cap
NECK = 0.0345  # m, radius of link 7; below the ball's flat, so link 5 stays clear of it


def base() -> dict[str, list[trimesh.Trimesh]]:
    """Return link 0 in the world frame (metres): foot plate, bolts, flared shell, seam ring."""
    foot = [(0.110, 0.0), (0.110, 0.0105), (0.1085, 0.012), (0.090, 0.0125)]
    z = np.linspace(0.0, 1.0, 7) ** 1.3
    side = np.column_stack([0.0665 + 0.0255 * (1.0 - z) ** 3.4, 0.016 + z * 0.0915])
    shell = np.vstack([[(0.0905, 0.010), (0.0920, 0.0115)], side, [(0.0655, 0.1085)]])
    bolt = [(0.0050, 0.009), (0.0050, 0.0140), (0.0042, 0.0148)]
    at = 0.1005 * np.sqrt(0.5)
    bolts = [revolve(bolt, Z, (x, y, 0.0), 6) for x in (-at, at) for y in (-at, at)]
    return {
        "white": [revolve(shell, sides=30)],
        "steel": bolts,
        "grey": [revolve(foot, sides=36), seam_ring(SHOULDER_1.tube - RING_INSET, 0.11)],
    }


def links() -> dict[str, dict[str, list[trimesh.Trimesh]]]:
    """Return every link's parts (metres, in the link's frame) by link name and colour."""
    out = {"base": base()}
    plan = [
        ("link1", SHOULDER_1, Y, -Z),
        ("link2", SHOULDER_2, Z, Y),
        ("link3", ELBOW_3, Y, -Z),
        ("link4", ELBOW_4, -Z, -Y),
        ("link5", WRIST_5, Y, -Z),
    ]
    for name, shell, side, seam in plan:
        out[name] = cap(shell.drum - shell.rim - 0.004, shell.outer, side)
        out[name]["white"] = [shell_mesh(shell, side, seam)]
        if name in ("link2", "link4"):
            # The child carries the dark disc between two drums and the ring of its roll seam.
            out[name]["grey"].append(seam_ring(shell.drum - RING_INSET, 0.0, side))
            out[name]["grey"].append(seam_ring(shell.tube - RING_INSET, shell.length, seam))
    return {**out, "link6": wrist(), "link7": flange()}


def wrist() -> dict[str, list[trimesh.Trimesh]]:
    """Return link 6 in its frame (metres): ball cut flat towards link 5, neck along y6, cap."""
    turn = np.linspace(np.arccos(BALL_CUT / BALL), np.arccos(BALL_FACE / BALL), 10)
    arc = BALL * np.column_stack([np.sin(turn), np.cos(turn)])
    rim = arc[0, 0]
    arc[0] += (-0.0004, 0.0010)
    body = revolve(np.vstack([[(rim - 0.0012, BALL_CUT)], arc]), Z, sides=26)
    neck = [(NECK - 0.001, 0.039), (NECK, 0.040), (NECK, 0.0548), (NECK - 0.0007, 0.0555)]
    parts = cap(arc[-1, 0] - 0.004, BALL_FACE, Z)
    parts["white"] = [body, revolve(neck, Y)]
    parts["grey"] += [
        seam_ring(rim - RING_INSET, BALL_CUT - 0.001),
        seam_ring(NECK - RING_INSET, 0.057, Y),
    ]
    return parts


def flange() -> dict[str, list[trimesh.Trimesh]]:
    """Return link 7 in its frame (metres): collar and tool flange with pilot bore and bolts."""
    rim = [(NECK - 0.0008, 0.0585), (NECK, 0.0593), (NECK, 0.0715, 0.003), (0.03, 0.0715)]
    plate = [
        (0.0320, 0.069),
        (0.0330, 0.070),
        (0.0330, 0.0772),
        (0.0322, 0.078),
        (0.0168, 0.078),
        (0.0160, 0.0772),
        (0.0150, 0.0740),
    ]
    holes = []
    for i in range(7):  # seven of eight: the eighth place is the dowel's, as on ISO 9409 flanges
        a = i * np.pi / 4.0
        at = (0.0250 * np.cos(a), 0.0250 * np.sin(a), 0.0)
        # Dark discs 0.1 mm proud: a hole at this scale is a dark spot.
        holes.append(revolve([(0.0030, 0.0770), (0.0028, 0.0781)], Z, at, 8))
    return {"white": [revolve(fillet(rim, 2))], "steel": [revolve(plate, sides=24)], "grey": holes}


def write_stl(path: Path, parts: list[trimesh.Trimesh]) -> int:
    """Write parts (metres) to one binary STL file and return the number of triangles."""
    # Rounded to 0.1 um, so that a sine that differs in its last bit leaves the bytes alone.
    triangles = np.round(np.vstack([part.triangles for part in parts]), 7) + 0.0
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    layout = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]
    record = np.zeros(len(triangles), layout)
    record["normal"] = np.round(normals, 4) + 0.0
    record["corners"] = triangles
    head = b"sero-mj LWR mesh".ljust(80) + struct.pack("<I", len(record))
    path.write_bytes(head + record.tobytes())
    return len(record)


def main() -> None:
    """Write all files and print their triangle counts."""
    OUT.mkdir(parents=True, exist_ok=True)
    total = 0
    for name, colours in links().items():
        for colour, parts in sorted(colours.items()):
            count = write_stl(OUT / f"{name}_{colour}.stl", parts)
            total += count
            print(f"{name}_{colour}.stl {count}")
    print("total", total)


if __name__ == "__main__":
    main()
