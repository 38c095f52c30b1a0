"""Writes the link meshes of the Stanford arm to `models/stanford/meshes/`.

The shapes are an original design about the published axes and lengths. All other dimensions are
estimated. As on the arm in the museum, there are a column, a shoulder drum, a square boom that
rolls through its carriage, a wrist with three axes, and a hand with two jaws.

One binary STL file is written per link and color, in meters, in the standard Denavit-Hartenberg
frame of the link.

Run `python models/stanford/make_meshes.py`; every run writes identical files.
"""

from __future__ import annotations

import sys
from pathlib import Path

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
    wrist_drum,
    wrist_fork,
    write_links,
)

OUT = Path(__file__).resolve().parent / "meshes"

HEIGHT = 0.412  # height of axis 2, m
ASIDE = 0.154  # distance from axis 1 to the boom, m
HAND = 0.263  # distance from the wrist to the grasp, m
LONGEST, SHORTEST = 0.9144, 0.2032  # distances from axis 2 to the wrist, m
COLUMN = 0.074  # radius of the column, m
SEAM_1 = 0.120  # distance of seam 1 below axis 2, m
DRUM = 0.080  # radius of the shoulder, m
BOOM = 0.0318  # half the width of the boom, m
GAP = 0.0015  # distance from a body to the middle of its seam, m

Parts = dict[str, list[trimesh.Trimesh]]


def base() -> Parts:
    """Returns link 0 in the world frame (meters): foot with bolts, column, seam ring."""
    top = HEIGHT - SEAM_1
    foot = [(0.150, 0.0), (0.150, 0.014, 0.003), (0.105, 0.018, 0.006), (COLUMN + 0.004, 0.046)]
    column = [(COLUMN, 0.036), (COLUMN, top - GAP, 0.002), (0.0, top - GAP)]
    seam = (COLUMN - RING_INSET, top)
    return pedestal(column, foot, seam, (0.008, 0.005, 0.130, 0.016))


def shoulder() -> Parts:
    """Returns link 1 in its frame (meters; y down): trunk, and the drum about axis 2."""
    trunk = [
        (-SEAM_1 + GAP, COLUMN, COLUMN, 2.0),
        (-0.085, COLUMN, COLUMN, 2.0),
        (-0.030, 0.072, 0.072, 2.8),
        (0.000, 0.070, 0.070, 3.2),
    ]
    inner, outer = -0.118, ASIDE - BOOM - 0.030 - GAP
    half, middle = 0.5 * (outer - inner), 0.5 * (outer + inner)
    return merge(
        {
            "white": [
                loft(trunk, (X, Z, -Y), edges=(0.002, 0.008), steps=3, sides=40),
                drum(DRUM, half, Z, (0.0, 0.0, middle), 0.010, 40),
            ],
            "grey": [seam_ring(0.058, outer + GAP, Z)],
        },
        link_cap(DRUM - 0.020, -inner, -Z),
    )


def carriage() -> Parts:
    """Returns link 2 in its frame (meters): a frame with rollers about the boom, along z."""
    wall, tall = BOOM + 0.030, 0.105
    plates = [
        (-tall, wall - 0.006, wall - 0.006, 6.0),
        (-tall + 0.012, wall, wall, 7.0),
        (tall - 0.012, wall, wall, 7.0),
        (tall, wall - 0.006, wall - 0.006, 6.0),
    ]
    rollers = [
        drum(0.016, 0.020, Y, (s * (BOOM + 0.017), 0.0, e * (tall + 0.010)), 0.003)
        for s in (-1.0, 1.0)
        for e in (-1.0, 1.0)
    ]
    motor = loft(
        [(0.0, 0.036, 0.040, 3.6), (0.085, 0.032, 0.036, 3.0)],
        (Y, Z, X),
        (wall - 0.004) * X,
        edges=(0.003, 0.012),
        steps=3,
        sides=40,
    )
    return merge(
        {
            "white": [loft(plates, edges=(0.004, 0.004), sides=48), motor],
            "grey": rollers,
        },
        link_cap(0.048, wall - 0.001, Y),
    )


def boom() -> Parts:
    """Returns link 3 in its frame (meters): a square tube that ends before the wrist."""
    start, end = -LONGEST - 0.140, -0.060
    tube = [(start, BOOM, BOOM, 8.0), (end, BOOM, BOOM, 8.0)]
    rack = [(start + 0.040, 0.006, 0.003, 8.0), (end - 0.060, 0.006, 0.003, 8.0)]
    collar = [(0.0, end - 0.002), (0.042, end - 0.002, 0.003), (0.042, -0.044 - GAP, 0.002)]
    return {
        "steel": [loft(tube, edges=(0.003, 0.003), sides=48)],
        "white": [revolve(fillet([*collar, (0.0, -0.044 - GAP)]), sides=32)],
        "grey": [
            loft(rack, (X, Y, Z), -(BOOM + 0.001) * Y, edges=(0.001, 0.001)),
            seam_ring(0.042 - RING_INSET, -0.044),
        ],
    }


def wrist() -> Parts:
    """Returns link 4 in its frame (meters; the boom is along -y): a fork about axis 5."""
    collar = [(0.0, 0.024), (0.042, 0.024, 0.004), (0.042, 0.044 - GAP, 0.002), (0.0, 0.044 - GAP)]
    cheek = [(-0.036, 0.036, 0.0075, 3.0), (0.0, 0.034, 0.0075, 3.0), (0.026, 0.020, 0.0065, 2.6)]
    return wrist_fork(collar, cheek, Y)


def yoke() -> Parts:
    """Returns link 5 in its frame (meters): a drum about axis 5, and a neck along axis 6."""
    return wrist_drum(0.025, 0.044, 0.0455)


def hand() -> Parts:
    """Returns link 6 in its frame (meters): a hand with two jaws that meet in the origin."""
    start = -HAND + 0.047
    body = [
        (start, 0.026, 0.026, 2.0),
        (start + 0.022, 0.030, 0.030, 2.2),
        (start + 0.060, 0.062, 0.028, 4.0),
        (-0.110, 0.066, 0.026, 5.0),
    ]
    jaws = []
    for side in (-1.0, 1.0):
        shape = [
            (-0.112, 0.010, 0.017, 5.0, side * 0.050, 0.0),
            (-0.060, 0.009, 0.016, 5.0, side * 0.046, 0.0),
            (-0.020, 0.007, 0.013, 4.0, side * 0.026, 0.0),
            (0.014, 0.005, 0.011, 4.0, side * 0.018, 0.0),
        ]
        jaws.append(loft(shape, edges=(0.002, 0.003), steps=4, sides=32))
    return {"white": [loft(body, edges=(0.003, 0.008), steps=3, sides=40)], "grey": jaws}


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": shoulder(),
        "link2": carriage(),
        "link3": boom(),
        "link4": wrist(),
        "link5": yoke(),
        "link6": hand(),
    }
    write_links(OUT, links, "sero-mj Stanford arm mesh")
