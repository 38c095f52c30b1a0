"""Shells of arms whose joints alternately roll and pitch, for the scripts that write their meshes.

A shell is a round tube at its roll seam that leans sideways into half a drum at its pitch joint.
The two shells of a pitch joint meet in a flat disc across the pitch axis, so that both can pass
each other up to +-120 degrees, or fold if their tubes are beside that axis.

The shapes are this project's own design; no manufacturer's data is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from bodies import RING_INSET, Z, cap, close, mix, ramp, revolve, seam_ring, solid, strip

# Stations of a shoulder's bend, 0 to 1, close together where it curves most.
BEND = np.array([0.02, 0.20, 0.32, 0.50, 0.66, 0.78, 0.89, 1.0])
SEAM_GAP = 0.0015  # m, from a shell's rim to the middle of its roll seam
DISC_GAP = 0.0020  # m, from a drum's face to the middle of its pitch disc
BEVEL = 0.0010  # m, at a shell's rim; without it, MuJoCo averages the normals of the sharp rim
DISC_EDGE = 0.0040  # m, edge radius of a drum at the pitch disc


@dataclass(frozen=True)
class Shell:
    """Dimensions of a shell in meters; `w` runs from the pitch axis to the roll seam.

    `sides` is the number of facets of half its circumference, 6 k + 1: odd, so that a flat flank
    has two edges. `turns` is the number of facets of the half turn around the pitch axis.
    """

    length: float  # pitch axis to roll seam
    tube: float  # tube radius at the seam
    drum: float  # drum radius at the pitch axis
    inner: float  # disc face, measured along the pitch axis toward the shell's own side
    outer: float  # cap face, measured in the same way
    rim: float  # edge radius at the cap face
    shoulder: tuple[float, float]  # range of w in which the far side widens to the tube
    lean: tuple[float, float]  # range of w in which the near side leans back to it
    dome: float  # height of the domed shoulder above its edges
    offset: float = 0.0  # from the pitch axis to the roll seam, along side x seam
    sides: int = 13
    turns: int = 12


def shell_section(shell: Shell, w: float) -> np.ndarray:
    """Returns half the outline of a shell at `w` (meters) as (u, v) points, inner to outer.

    It has two elliptic corners joined by flats. Small corners form the drum, and full corners the
    round tube.
    """
    swell, lean = ramp(w, *shell.shoulder), ramp(w, *shell.lean)
    soft = ramp(w, 0.35 * shell.drum, shell.shoulder[1])
    a = mix(shell.drum, shell.tube, ramp(w, 0.0, shell.shoulder[1]))
    v0 = mix(shell.inner, -shell.tube, swell)
    v1 = mix(shell.outer, shell.tube, lean)
    middle = 0.5 * (v0 + v1)
    theta = np.arange(shell.sides + 1) * np.pi / shell.sides
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
    """Sweeps the outline of a shell from its drum to its roll seam, in meters.

    `side` is the unit vector along the pitch axis to the shell's own side. `seam` is the unit
    vector from the pitch axis to the roll seam.
    """
    start, stop = shell.shoulder
    sides, third = shell.sides, shell.sides // 6
    seam_edge = shell.length - SEAM_GAP
    tube, aside = [], []
    # Flanks that lean from the pitch axis curve from there.
    low = start * np.linspace(0.0, 1.0, 8 if shell.offset else 2, endpoint=False)
    for w in [*low, *(start + (stop - start) * BEND), seam_edge - BEVEL]:
        half = shell_section(shell, w)
        u, v = half.T
        # The shoulder's middle may rise into the wedge that the other shell never sweeps.
        depth = np.clip(-v / shell.tube, 0.0, 1.0) * (1.0 - (u / u.max()) ** 2)
        lift = shell.dome * depth * (1.0 - ramp(w, stop, shell.length))
        half = np.column_stack([half, w - lift])
        tube.append(np.vstack([half, half[-2:0:-1] * (-1.0, 1.0, 1.0)]))
        aside.append(shell.offset * ramp(w, 0.0, stop))
    bevel = 1.0 - BEVEL / shell.tube
    tube.append(tube[-1] * (bevel, bevel, 0.0) + (0.0, 0.0, seam_edge))
    tube.append(np.tile([0.0, 0.0, seam_edge], (2 * sides, 1)))
    aside += [shell.offset] * 2
    shifts = np.outer(aside, (1.0, 0.0, 0.0))
    tube = [ring + shift for ring, shift in zip(tube, shifts, strict=True)]

    # The drum has only three points of its small inner edge.
    inner = np.repeat([1, 2 * third, 3 * third], third)
    kept = np.array([0, *inner, *range(3 * third + 1, sides + 1)])
    u, v = shell_section(shell, 0.0)[kept].T
    turns = np.linspace(0.0, np.pi, shell.turns + 1)[1:-1]
    drum = [np.column_stack([u * np.cos(t), v, -u * np.sin(t)]) for t in turns]

    rows = np.arange(len(tube) * 2 * sides).reshape(len(tube), -1)
    faces = [strip(close(a), close(b)) for a, b in pairwise(rows)]
    # The drum's half turn leads from the first ring's right half to its left half.
    right, left = rows[0, : sides + 1], close(rows[0])[sides:][::-1]
    rows = rows.size + np.arange(len(drum) * (sides + 1)).reshape(len(drum), -1)
    faces += [strip(b, a) for a, b in pairwise([right, *rows, left])]
    axes = np.column_stack([np.cross(side, seam), side, seam])
    return solid(np.vstack(tube + drum) @ axes.T, np.vstack(faces))


def wrist_ball(
    radius: float, cut: float, face: float, neck: float, seam: float, axis: np.ndarray
) -> dict[str, list[trimesh.Trimesh]]:
    """Returns the ball of a wrist in its frame: flat cut toward its carrier, neck, cap.

    Args:
        radius: radius of the ball, m.
        cut: position of the flat cut along z, m, negative.
        face: position of the flat under the cap along z, m.
        neck: radius of the neck, m.
        seam: distance from the center to the seam of the neck, m.
        axis: unit vector along the neck.
    """
    turn = np.linspace(np.arccos(cut / radius), np.arccos(face / radius), 10)
    arc = radius * np.column_stack([np.sin(turn), np.cos(turn)])
    rim = arc[0, 0]
    arc[0] += (-0.0004, 0.0010)
    body = revolve(np.vstack([[(rim - 0.0012, cut)], arc]), Z, sides=26)
    stub = [
        (neck - 0.0010, seam - 0.0180),
        (neck, seam - 0.0170),
        (neck, seam - 0.0022),
        (neck - 0.0007, seam - 0.0015),
    ]
    parts = cap(arc[-1, 0] - 0.004, face, Z)
    parts["white"] = [body, revolve(stub, axis)]
    parts["grey"] += [
        seam_ring(rim - RING_INSET, cut - 0.001),
        seam_ring(neck - RING_INSET, seam, axis),
    ]
    return parts
