"""Writes the link meshes of the DLR/KUKA light-weight robot to `models/lwr/meshes/`.

The shapes are an original design that uses only published dimensions of the arm. The seam offsets
are those of the public URDF `kuka_lwr.urdf.xacro` of CentroEPiaggio/kuka-lwr (Unlicense). No data
from DLR or KUKA is used.

One binary STL file is written per link and color, in meters, in the modified Denavit-Hartenberg
frame of the link. Colors (RGBA): white .93 .93 .92 1, grey .27 .265 .26 1, orange 1 .40 .04 1,
steel .72 .73 .75 1. The arm has two kinds of parts:

* bodies of revolution: base, seam rings, joint caps, wrist ball and flange;
* five shells, see `models/shells.py`.

Run `python models/lwr/make_meshes.py`; every run writes identical files.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import (
    RING_INSET,
    Y,
    Z,
    cap,
    fillet,
    revolve,
    seam_ring,
    tool_flange,
    write_links,
)
from shells import DISC_GAP, Shell, shell_mesh, wrist_ball

OUT = Path(__file__).resolve().parent / "meshes"

# The shoulders begin where the other shell, turned by 120 degrees, just clears them.
BENDS = ((0.082, 0.152), (0.045, 0.150), 0.032)
SHOULDER_1 = Shell(0.20, 0.066, 0.070, DISC_GAP, 0.074, 0.024, *BENDS)
SHOULDER_2 = Shell(0.20, 0.063, 0.070, DISC_GAP, 0.074, 0.024, *BENDS)
ELBOW_3 = Shell(0.20, 0.063, 0.067, DISC_GAP, 0.071, 0.024, *BENDS)
ELBOW_4 = Shell(0.20, 0.060, 0.067, DISC_GAP, 0.071, 0.024, *BENDS)
WRIST_5 = Shell(0.19, 0.060, 0.046, 0.038, 0.068, 0.014, (0.040, 0.140), (0.030, 0.150), 0.022)

BALL = 0.057  # radius of the wrist ball, m
BALL_CUT = -0.036  # position along z6 of its flat face toward link 5, m
BALL_FACE = 0.046  # position of its flat face under the cap, m
NECK = 0.0345  # radius of link 7, m; small enough to clear link 5


def base() -> dict[str, list[trimesh.Trimesh]]:
    """Returns link 0 in the world frame (meters): foot plate, bolts, flared shell, seam ring."""
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
    """Returns the parts of every link (meters, in the frame of the link) by link name and color."""
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
            # The dark disc between two drums and the ring of a roll seam belong to the child link.
            out[name]["grey"].append(seam_ring(shell.drum - RING_INSET, 0.0, side))
            out[name]["grey"].append(seam_ring(shell.tube - RING_INSET, shell.length, seam))
    return {**out, "link6": wrist(), "link7": flange()}


def wrist() -> dict[str, list[trimesh.Trimesh]]:
    """Returns link 6 in its frame (meters): ball cut flat toward link 5, neck along y6, cap."""
    return wrist_ball(BALL, BALL_CUT, BALL_FACE, NECK, 0.057, Y)


def flange() -> dict[str, list[trimesh.Trimesh]]:
    """Returns link 7 in its frame (meters): collar and tool flange with pilot bore and bolts."""
    rim = [(NECK - 0.0008, 0.0585), (NECK, 0.0593), (NECK, 0.0715, 0.003), (0.03, 0.0715)]
    # Seven of eight places have bolts; the eighth place has a dowel, as in ISO 9409 flanges.
    return {"white": [revolve(fillet(rim, 2))], **tool_flange(0.078, np.arange(7) * np.pi / 4.0)}


if __name__ == "__main__":
    write_links(OUT, links(), "sero-mj LWR mesh")
