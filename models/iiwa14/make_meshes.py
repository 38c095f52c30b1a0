"""Writes the link meshes of the KUKA LBR iiwa 14 R820 to `models/iiwa14/meshes/`.

The shapes are an original design that uses only published dimensions. The roll seams are at the
joint origins of kroshu/kuka_robot_descriptions (157.5, 204.5, 184.5 and 81 mm from base or axis),
and the flange is that of ISO 9409-1-50. Radii are estimated. No data from KUKA is used.

One binary STL file is written per link and color, in meters, in the modified Denavit-Hartenberg
frame of the link. Like the LWR, the arm consists of bodies of revolution and five shells, see
`models/shells.py`.

Run `python models/iiwa14/make_meshes.py`; every run writes identical files.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import (
    RING_INSET,
    X,
    Y,
    Z,
    cap,
    drum,
    fillet,
    loft,
    recolour,
    revolve,
    seam_ring,
    tool_flange,
    write_links,
)
from shells import DISC_GAP, Shell, shell_mesh, wrist_ball

OUT = Path(__file__).resolve().parent / "meshes"

FINE = {"sides": 19, "turns": 18}
# The shoulders begin where the other shell, turned by 120 degrees, just clears them.
BENDS = ((0.096, 0.166), (0.052, 0.160), 0.036)
SHOULDER_1 = Shell(0.2025, 0.078, 0.083, DISC_GAP, 0.092, 0.036, *BENDS, **FINE)
SHOULDER_2 = Shell(0.2045, 0.075, 0.083, DISC_GAP, 0.092, 0.036, *BENDS, **FINE)
ELBOW_3 = Shell(0.2155, 0.075, 0.078, DISC_GAP, 0.086, 0.034, *BENDS, **FINE)
ELBOW_4 = Shell(
    0.1845, 0.069, 0.078, DISC_GAP, 0.086, 0.034, (0.092, 0.156), (0.050, 0.150), 0.034, **FINE
)
WRIST_5 = Shell(
    0.2155, 0.069, 0.056, 0.044, 0.083, 0.020, (0.046, 0.156), (0.034, 0.166), 0.024, **FINE
)

BALL = 0.068  # radius of link 6, m
BALL_CUT = -0.042  # position along z6 of its flat face toward link 5, m
BALL_FACE = 0.054  # position of its flat face under the cap, m
NECK = 0.044  # radius of link 7, m
SEAM_7 = 0.081  # distance of seam 7 from the wrist center, m
FLANGE = 0.152  # distance of the flange from the wrist center, m

Parts = dict[str, list[trimesh.Trimesh]]


def base() -> Parts:
    """Returns link 0 in the world frame (meters): foot, flared shell, box of plugs, seam ring."""
    foot = [(0.116, 0.0), (0.116, 0.0145), (0.114, 0.0165), (0.095, 0.0170)]
    z = np.linspace(0.0, 1.0, 8) ** 1.2
    side = np.column_stack([0.0785 + 0.0295 * (1.0 - z) ** 2.6, 0.020 + z * 0.1345])
    shell = np.vstack([[(0.1065, 0.0145), (0.1080, 0.0160)], side, [(0.0775, 0.1560)]])
    # The plugs are at the back of the foot.
    box = [(-0.148, 0.054, 0.030, 5.0, 0.0, 0.042), (-0.060, 0.060, 0.036, 5.0, 0.0, 0.046)]
    plugs = [drum(0.011, 0.006, X, (-0.149, y, 0.044), 0.002) for y in (-0.028, 0.0, 0.028)]
    bolt = [(0.0055, 0.0150), (0.0055, 0.0200), (0.0046, 0.0210)]
    at = 0.1115 * np.sqrt(0.5)
    bolts = [revolve(bolt, Z, (x, y, 0.0), 6) for x in (-at, at) for y in (-at, at)]
    return {
        "silver": [revolve(shell, sides=32), loft(box, (Y, Z, X), edges=(0.008, 0.004))],
        "steel": bolts,
        "grey": [
            revolve(foot, sides=36),
            *plugs,
            seam_ring(SHOULDER_1.tube - RING_INSET, 0.1575),
        ],
    }


def links() -> dict[str, Parts]:
    """Returns the parts of every link (meters, in the frame of the link) by link name and color."""
    out = {"base": base()}
    plan = [
        ("link1", SHOULDER_1, -Y, -Z),
        ("link2", SHOULDER_2, Z, -Y),
        ("link3", ELBOW_3, Y, -Z),
        ("link4", ELBOW_4, Z, Y),
        ("link5", WRIST_5, -Y, -Z),
    ]
    for name, shell, side, seam in plan:
        out[name] = shell_caps(cap(shell.drum - shell.rim - 0.002, shell.outer, side))
        out[name]["silver"].append(shell_mesh(shell, side, seam))
        if name in ("link2", "link4"):
            # The dark disc between two drums and the ring of a roll seam belong to the child link.
            out[name]["grey"] = [
                seam_ring(shell.drum - RING_INSET, 0.0, side),
                seam_ring(shell.tube - RING_INSET, shell.length, seam),
            ]
    ball = wrist_ball(BALL, BALL_CUT, BALL_FACE, NECK, SEAM_7, -Y)
    rings = ball["grey"][1:]
    ball["grey"] = ball["grey"][:1]
    return {**out, "link6": {**shell_caps(ball), "grey": rings}, "link7": flange()}


def shell_caps(parts: Parts) -> Parts:
    """Returns a cap whose dome has the color of the shells."""
    return recolour(parts, {"grey": "silver", "white": "silver"})


def flange() -> Parts:
    """Returns link 7 in its frame (meters): the media flange with its light ring, tool flange."""
    rim = [
        (NECK - 0.0008, SEAM_7 + 0.0015),
        (NECK, SEAM_7 + 0.0023),
        (NECK, 0.1250, 0.006),
        (0.0400, 0.1330, 0.004),
        (0.0400, 0.1455, 0.003),
        (0.0300, 0.1455),
    ]
    ring = drum(NECK + 0.0006, 0.0025, Z, (0.0, 0.0, 0.0950), 0.0008)
    parts = tool_flange(FLANGE, np.arange(7) * np.pi / 4.0)
    return {**parts, "silver": [revolve(fillet(rim, 3))], "grey": [*parts["grey"], ring]}


if __name__ == "__main__":
    write_links(OUT, links(), "sero-mj iiwa14 mesh")
