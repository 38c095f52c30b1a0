"""Writes the link meshes of the Franka Research 3 to `models/fr3/meshes/`.

The shapes are an original design that uses only published dimensions. Radii and positions of the
housings are those of the self-collision capsules in franka_description (franka_arm.xacro of
frankaemika/franka_ros, Apache-2.0): 60 mm up to the forearm, 25 mm for its thin part, which is
80 mm beside the axis, 50 mm at joint 6, and 40 mm at joint 7. The flange is that of ISO 9409-1-50.
Seams are estimated. No shape data from Franka is used.

One binary STL file is written per link and color, in meters, in the modified Denavit-Hartenberg
frame of the link. Links 1 to 4 are shells, see `models/shells.py`. The shells of the elbow
lean to its axis, which is 82.5 mm beside them.

Run `python models/fr3/make_meshes.py`; every run writes identical files.
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

TUBE = 0.060  # radius of the housings, m
ELBOW = 0.0825  # distance from the elbow axis to the axes of the tubes, m
WRIST = 0.088  # distance from axis 6 to axis 7, m
SEAM_1 = 0.140  # height of seam 1 above the floor, m
SEAM_5 = 0.262  # distance of seam 5 below axis 6, m

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

DISC_6 = 0.050  # distance from axis 7 to the disc of joint 6 along axis 6, m
DRUM_6 = 0.050  # radius of link 6 about axis 6, m
COVER_6 = 0.112  # position of the outer face of the forearm end along axis 6, m
DRUM_7 = 0.045  # radius of link 6 about axis 7, m
SEAM_7 = 0.062  # position of seam 7 along axis 7, m
FLANGE = 0.107  # position of the flange along axis 7, m

Parts = dict[str, list[trimesh.Trimesh]]


def cover(radius: float, face: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> Parts:
    """Returns a dark joint cap at `face` along an axis through `origin`, in meters."""
    (dome,) = cap(radius, face, axis)["grey"]
    return {"grey": [dome.apply_translation(np.asarray(origin))]}


def base() -> Parts:
    """Returns link 0 in the world frame (meters): foot, body that extends back, plugs, ring."""
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
    """Returns the parts of every link (meters, in the frame of the link) by link name and color."""
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
            # The dark disc between two drums and the ring of a roll seam belong to the child link.
            ring = seam_ring(shell.tube - RING_INSET, shell.length, seam)
            aside = shell.offset * np.cross(side, seam)
            out[name]["grey"].append(seam_ring(shell.drum - RING_INSET, 0.0, side))
            out[name]["grey"].append(ring.apply_translation(aside))
    return {**out, "link5": forearm(), "link6": wrist(), "link7": flange()}


def forearm() -> Parts:
    """Returns link 5 in its frame (meters): from the round housing to one side of the wrist."""
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
    """Returns link 6 in its frame (meters): drum about z6, bridge along x6, drum about axis 7."""
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
    """Returns link 7 in its frame (meters): collar with a nose of plugs aside, tool flange."""
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
