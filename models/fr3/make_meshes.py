"""Write the link meshes of the Franka Research 3 to ``models/fr3/meshes/``.

The shapes are this project's own design, drawn after published dimensions only: radii and places
of the housings are those of the capsules of self-collision in franka_description (franka_arm.xacro
of frankaemika/franka_ros, Apache-2.0): 60 mm up to the forearm, whose thin part has 25 mm at 80 mm
aside, 50 mm at joint 6, 40 mm at joint 7; the flange is one of ISO 9409-1-50.  Seams are estimated.
No Franka data of shapes is used.

One binary STL file is written per link and colour, in metres, in the link's own modified
Denavit-Hartenberg frame.  Links 1 to 4 are shells, see ``models/shells.py``; those of the elbow
lean to its axis, 82.5 mm aside.

Run ``python models/fr3/make_meshes.py``; the output is the same byte for byte on every run.
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
    merge,
    revolve,
    seam_ring,
    tool_flange,
    write_links,
)
from shells import BEVEL, DISC_GAP, SEAM_GAP, Shell, shell_mesh

OUT = Path(__file__).resolve().parent / "meshes"

TUBE = 0.060  # m, radius of the housings
ELBOW = 0.0825  # m, from the elbow's axis to those of the tubes
WRIST = 0.088  # m, from axis 6 to axis 7
SEAM_1 = 0.140  # m, height above the floor
SEAM_5 = 0.262  # m, below axis 6

FINE = {"sides": 19, "turns": 18}
SHOULDER_1 = Shell(
    0.193, TUBE, 0.062, DISC_GAP, 0.098, 0.026, (0.076, 0.146), (0.040, 0.150), 0.03, **FINE
)
SHOULDER_2 = Shell(
    0.194, TUBE, 0.062, DISC_GAP, 0.098, 0.026, (0.076, 0.146), (0.040, 0.150), 0.03, **FINE
)
ELBOW_3 = Shell(
    0.122, TUBE, 0.060, DISC_GAP, 0.092, 0.024, (0.066, 0.116), (0.020, 0.112), 0.012, ELBOW, **FINE
)
ELBOW_4 = Shell(
    0.122, TUBE, 0.060, DISC_GAP, 0.092, 0.024, (0.066, 0.116), (0.020, 0.112), 0.012, ELBOW, **FINE
)

DISC_6 = 0.050  # m, from axis 7 to the disc of joint 6, along its axis
DRUM_6 = 0.050  # m, radius
COVER_6 = 0.112  # m, outer face of the forearm's end, along the axis of joint 6
DRUM_7 = 0.045  # m, radius of link 6 about axis 7
SEAM_7 = 0.062  # m, along axis 7
FLANGE = 0.107  # m, likewise

Parts = dict[str, list[trimesh.Trimesh]]


def cover(radius: float, face: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> Parts:
    """Return a dark joint cap at ``face`` along an axis through ``origin``, metres."""
    (dome,) = cap(radius, face, axis)["grey"]
    return {"grey": [dome.apply_translation(np.asarray(origin))]}


def base() -> Parts:
    """Return link 0 in the world frame (metres): foot, body that reaches back, plugs, seam ring."""
    body = [
        (0.006, 0.106, 0.094, 2.6, -0.036, 0.0),
        (0.034, 0.102, 0.088, 2.5, -0.033, 0.0),
        (0.072, 0.086, 0.073, 2.2, -0.019, 0.0),
        (0.106, 0.066, 0.063, 2.0, -0.004, 0.0),
        (0.124, TUBE, TUBE, 2.0),
        (SEAM_1 - SEAM_GAP, TUBE, TUBE, 2.0),
    ]
    foot = [(0.0, 0.110, 0.098, 2.6, -0.036, 0.0), (0.009, 0.110, 0.098, 2.6, -0.036, 0.0)]
    plugs = [drum(0.012, 0.005, X, (-0.139, y, 0.030), 0.002) for y in (-0.022, 0.022)]
    return {
        "white": [loft(body, edges=(0.003, BEVEL), steps=3, sides=40)],
        "grey": [
            loft(foot, edges=(0.0015, 0.0015), sides=40),
            seam_ring(TUBE - RING_INSET, SEAM_1),
            *plugs,
        ],
    }


def links() -> dict[str, Parts]:
    """Return every link's parts (metres, in the link's frame) by link name and colour."""
    out = {"base": base()}
    plan = [
        ("link1", SHOULDER_1, -Y, -Z, 0.0),
        ("link2", SHOULDER_2, Z, -Y, 0.0),
        ("link3", ELBOW_3, Y, -Z, ELBOW),
        ("link4", ELBOW_4, Z, Y, 0.0),
    ]
    for name, shell, side, seam, at in plan:
        out[name] = cover(shell.drum - shell.rim - 0.002, shell.outer, side, at * X)
        out[name]["white"] = [shell_mesh(shell, side, seam).apply_translation(at * X)]
        if name in ("link2", "link4"):
            # The child carries the dark disc between two drums and the ring of its roll seam.
            ring = seam_ring(shell.tube - RING_INSET, shell.length, seam)
            aside = shell.offset * np.cross(side, seam)
            out[name]["grey"].append(seam_ring(shell.drum - RING_INSET, 0.0, side))
            out[name]["grey"].append(ring.apply_translation(aside))
    return {**out, "link5": forearm(), "link6": wrist(), "link7": flange()}


def forearm() -> Parts:
    """Return link 5 in its frame (metres): from the round housing to one side of the wrist."""
    stations = [
        (-SEAM_5 + SEAM_GAP, TUBE, TUBE, 2.0),
        (-0.232, TUBE, TUBE, 2.0, 0.0, 0.001),
        (-0.196, 0.057, 0.051, 2.1, 0.0, 0.022),
        (-0.160, 0.048, 0.036, 2.4, 0.0, 0.056),
        (-0.125, 0.042, 0.028, 2.6, 0.0, 0.076),
        (-0.080, 0.041, 0.027, 2.8, 0.0, 0.081),
        (-0.040, 0.045, 0.028, 2.8, 0.0, 0.081),
        (0.000, 0.047, 0.029, 2.8, 0.0, 0.081),
    ]
    inner = DISC_6 + DISC_GAP
    middle, half = 0.5 * (inner + COVER_6), 0.5 * (COVER_6 - inner)
    return merge(
        {"white": [loft(stations, edges=(BEVEL, 0.01), steps=4, sides=36)]},
        {"white": [drum(DRUM_6, half, Y, (0.0, middle, 0.0), 0.010, 36)]},
        cover(DRUM_6 - 0.016, COVER_6, Y),
    )


def wrist() -> Parts:
    """Return link 6 in its frame (metres): drum about z6, bridge along x6, drum about axis 7."""
    bridge = [
        (0.000, 0.046, 0.045, 2.6),
        (0.040, 0.044, 0.043, 2.6),
        (WRIST, 0.044, 0.042, 2.4),
    ]
    top, bottom = 0.052, -SEAM_7 + SEAM_GAP
    middle, half = 0.5 * (top + bottom), 0.5 * (top - bottom)
    low, high = -DISC_6 + DISC_GAP, 0.048
    return merge(
        {
            "white": [
                drum(DRUM_6, 0.5 * (high - low), Z, (0.0, 0.0, 0.5 * (high + low)), 0.012, 36),
                loft(bridge, (Y, Z, X), edges=(0.01, 0.01), steps=3, sides=36),
                drum(DRUM_7, half, Y, (WRIST, middle, 0.0), 0.010, 36),
            ],
            "grey": [seam_ring(DRUM_6 - RING_INSET - 0.004, -DISC_6)],
        },
        cover(DRUM_6 - 0.018, high, Z),
        cover(DRUM_7 - 0.016, top, Y, (WRIST, 0.0, 0.0)),
    )


def flange() -> Parts:
    """Return link 7 in its frame (metres): collar with a nose of plugs aside, tool flange."""
    rim = [
        (DRUM_7 - BEVEL, SEAM_7 + SEAM_GAP),
        (DRUM_7, SEAM_7 + SEAM_GAP + BEVEL),
        (DRUM_7, 0.0985, 0.004),
        (0.0300, 0.0985),
    ]
    side = (X + Y) / np.sqrt(2.0)
    nose = [(0.020, 0.026, 0.0145, 3.2), (0.058, 0.024, 0.0135, 3.2), (0.070, 0.020, 0.0110, 3.2)]
    parts = tool_flange(FLANGE, (np.arange(4) + 0.5) * np.pi / 2.0, 0.0315)
    return {
        **parts,
        "white": [
            revolve(fillet(rim, 3), sides=36),
            loft(nose, (np.cross(Z, side), Z, side), 0.0812 * Z, edges=(0.004, 0.006)),
        ],
        "grey": [*parts["grey"], seam_ring(DRUM_7 - RING_INSET, SEAM_7)],
    }


if __name__ == "__main__":
    write_links(OUT, links(), "sero-mj FR3 mesh")
