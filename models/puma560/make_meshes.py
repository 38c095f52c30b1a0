"""Writes the link meshes of the Unimation Puma 560 to `models/puma560/meshes/`.

The shapes are an original design about the published axes. The upper arm is 0.2435 m beside the
column, and the forearm is 0.0934 m closer (Armstrong, Khatib, Burdick, ICRA 1986). All other
dimensions are estimated. No shape data from the manufacturer is used.

One binary STL file is written per link and color, in meters, in the standard Denavit-Hartenberg
frame of the link.

Run `python models/puma560/make_meshes.py`; every run writes identical files.
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
    drum,
    fillet,
    link_cap,
    loft,
    merge,
    pedestal,
    revolve,
    seam_ring,
    tool_flange,
    wrist_drum,
    wrist_fork,
    write_links,
)

OUT = Path(__file__).resolve().parent / "meshes"

SHOULDER = 0.67183  # height of axis 2, m
UPPER_ARM = 0.4318  # distance from axis 2 to axis 3, m
FOREARM = 0.4318  # distance from axis 3 to the wrist along axis 4, m
ELBOW = 0.0203  # distance from axis 3 to axis 4, m
ASIDE = 0.2435  # distance from the column to the middle of the upper arm, m
HALF = 0.046  # half the thickness of upper arm and forearm, m
COLUMN = 0.092  # radius of the column, m
SEAM_1 = 0.230  # distance of seam 1 below axis 2, m
SHOULDER_DRUM = 0.098  # radius of the shoulder drum, m
GAP = 0.0015  # distance from a body to the middle of its seam, m

Parts = dict[str, list[trimesh.Trimesh]]


def base() -> Parts:
    """Returns link 0 in the world frame (meters): foot with bolts, column, seam ring."""
    top = SHOULDER - SEAM_1
    foot = [(0.165, 0.0), (0.165, 0.016, 0.004), (0.120, 0.020, 0.006), (COLUMN + 0.004, 0.052)]
    column = [(COLUMN, 0.040), (COLUMN, top - GAP, 0.002), (0.0, top - GAP)]
    seam = (COLUMN - RING_INSET, top)
    return pedestal(column, foot, seam, (0.009, 0.006, 0.145, 0.018))


def shoulder() -> Parts:
    """Returns link 1 in its frame (meters): trunk below axis 2, drum about it."""
    trunk = [
        (-SEAM_1 + GAP, COLUMN, COLUMN, 2.0),
        (-0.150, COLUMN, COLUMN, 2.0),
        (-0.070, 0.090, 0.096, 2.6),
        (0.000, 0.086, 0.098, 3.0),
    ]
    inner = ASIDE - HALF - GAP
    return merge(
        {
            "white": [
                loft(trunk, (X, -Z, Y), edges=(0.002, 0.01), steps=3, sides=40),
                drum(
                    SHOULDER_DRUM,
                    0.5 * (inner + 0.115),
                    Z,
                    (0, 0, 0.5 * (inner - 0.115)),
                    0.010,
                    40,
                ),
            ],
            "grey": [seam_ring(0.080, ASIDE - HALF, Z)],
        },
        link_cap(SHOULDER_DRUM - 0.022, 0.115, -Z),
    )


def upper_arm() -> Parts:
    """Returns link 2 in its frame (meters): a plate from behind the shoulder to the elbow."""
    stations = [
        (-0.660, 0.066, HALF - 0.006, 4.0),
        (-0.580, 0.092, HALF, 4.5),
        (-UPPER_ARM, 0.112, HALF + 0.003, 4.5),
        (-0.300, 0.104, HALF + 0.001, 4.5),
        (-0.120, 0.082, HALF - 0.004, 4.5),
        (0.000, 0.076, HALF - 0.005, 4.5),
        (0.068, 0.058, HALF - 0.008, 3.6),
    ]
    plate = loft(stations, (Y, Z, X), ASIDE * Z, edges=(0.030, 0.030), steps=4, sides=48)
    outer = ASIDE + HALF
    return merge(
        {"white": [plate], "grey": [seam_ring(0.055, ASIDE - HALF - GAP, Z)]},
        link_cap(0.074, outer + 0.001, Z, (-UPPER_ARM, 0.0, 0.0)),
        link_cap(0.048, outer - 0.007, Z),
    )


def forearm() -> Parts:
    """Returns link 3 in its frame (meters): a tapered body with the motors of the wrist behind."""
    stations = [
        (-0.190, 0.058, HALF - 0.008, 4.0, -ELBOW, 0.0),
        (-0.120, 0.074, HALF - 0.002, 4.5, -ELBOW, 0.0),
        (0.000, 0.076, HALF - 0.001, 4.5, -ELBOW, 0.0),
        (0.120, 0.060, HALF - 0.003, 4.5, -0.5 * ELBOW, 0.0),
        (0.280, 0.046, 0.041, 4.0),
        (FOREARM - 0.078, 0.041, 0.041, 2.2),
        (FOREARM - 0.066 - GAP, 0.040, 0.040, 2.0),
    ]
    face = -HALF + 0.001  # toward the upper arm, whose z is -y here
    return merge(
        {
            "white": [loft(stations, (X, Y, Z), edges=(0.022, 0.002), steps=4, sides=48)],
            "grey": [
                seam_ring(0.055, face, -Y).apply_translation(-ELBOW * X),
                seam_ring(0.040 - RING_INSET, FOREARM - 0.066),
            ],
        },
        link_cap(0.048, HALF - 0.002, Y, (-ELBOW, 0.0, 0.0)),
    )


def wrist() -> Parts:
    """Returns link 4 in its frame (meters): a collar about axis 4, and a fork about axis 5."""
    collar = [(0.0, 0.040), (0.040, 0.040, 0.003), (0.040, 0.066 - GAP, 0.002), (0.0, 0.066 - GAP)]
    cheek = [(-0.052, 0.036, 0.0075, 3.0), (0.0, 0.034, 0.0075, 3.0), (0.026, 0.020, 0.0065, 2.6)]
    return wrist_fork(collar, cheek, -Y)


def hand() -> Parts:
    """Returns link 5 in its frame (meters): a drum about axis 5, and a neck along axis 6."""
    return wrist_drum(0.024, 0.032, 0.033)


def flange() -> Parts:
    """Returns link 6 in its frame (meters): collar and plate."""
    collar = [(0.0, 0.034), (0.026, 0.034, 0.002), (0.026, 0.048, 0.002), (0.0, 0.048)]
    parts = tool_flange(0.056, np.arange(4) * np.pi / 2.0, 0.0315)
    return merge({"white": [revolve(fillet(collar), sides=32)]}, parts)


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": shoulder(),
        "link2": upper_arm(),
        "link3": forearm(),
        "link4": wrist(),
        "link5": hand(),
        "link6": flange(),
    }
    write_links(OUT, links, "sero-mj Puma 560 mesh")
