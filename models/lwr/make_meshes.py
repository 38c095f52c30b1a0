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

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import (
    RING_INSET,
    Y,
    Z,
    cap,
    close,
    fillet,
    mix,
    ramp,
    revolve,
    seam_ring,
    solid,
    strip,
    write_links,
)

OUT = Path(__file__).resolve().parent / "meshes"

HALF_SIDES = 13  # facets of half a shell's circumference; odd, so a flat flank has two edges
DRUM_STEPS = 12  # facets of the half turn round a pitch axis
# Stations of a shoulder's bend, 0 to 1, close together where it curves most.
BEND = np.array([0.02, 0.20, 0.32, 0.50, 0.66, 0.78, 0.89, 1.0])
# Which outline points the drum keeps: its small inner edge needs only three of six.
DRUM_POINTS = np.array([0, 1, 1, 4, 4, 6, 6, *range(7, HALF_SIDES + 1)])

SEAM_GAP = 0.0015  # m, from a shell's rim to the middle of its roll seam
DISC_GAP = 0.0020  # m, from a drum's face to the middle of its pitch disc
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


if __name__ == "__main__":
    write_links(OUT, links(), "sero-mj LWR mesh")
