"""Writes the link meshes of the Adept Cobra 600 to `models/scara/meshes/`.

The shapes are an original design about the published axes, arms and stroke. All other dimensions
are estimated. No shape data from the manufacturer is used.

One binary STL file is written per link and color, in meters, in the standard Denavit-Hartenberg
frame of the link.

Run `python models/scara/make_meshes.py`; every run writes identical files.
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
    revolve,
    seam_ring,
    write_links,
)

OUT = Path(__file__).resolve().parent / "meshes"

HEIGHT = 0.387  # height of the frame of the first arm, m
INNER, OUTER = 0.325, 0.275  # lengths of the arms, m
STROKE = 0.210  # stroke of the quill, m
ARM = 0.088  # height of the body of the first arm, m
COLUMN = 0.086  # radius of the column, m
GAP = 0.0015  # distance from a body to the middle of its seam, m
HOOD = 0.176  # height of the body of the second arm, m
QUILL = 0.0115  # radius of the quill, m

Parts = dict[str, list[trimesh.Trimesh]]


def base() -> Parts:
    """Returns link 0 in the world frame (meters): plate, column that reaches back, plugs, ring."""
    top = HEIGHT - ARM - GAP
    column = [
        (0.014, 0.098, 0.090, 4.0, -0.030, 0.0),
        (0.120, 0.094, 0.086, 3.6, -0.024, 0.0),
        (0.220, 0.088, 0.086, 2.6, -0.006, 0.0),
        (top - 0.030, COLUMN, COLUMN, 2.0),
        (top - GAP, COLUMN, COLUMN, 2.0),
    ]
    plate = [(0.0, 0.120, 0.105, 6.0, -0.030, 0.0), (0.016, 0.120, 0.105, 6.0, -0.030, 0.0)]
    plugs = [drum(0.016, 0.008, X, (-0.124, y, 0.070), 0.003) for y in (-0.040, 0.0, 0.040)]
    return {
        "white": [loft(column, edges=(0.004, 0.002), steps=3, sides=48)],
        "grey": [
            loft(plate, edges=(0.003, 0.003), sides=48),
            seam_ring(COLUMN - RING_INSET, top),
            *plugs,
        ],
    }


def inner_arm() -> Parts:
    """Returns link 1 in its frame (meters): an arm below it, from axis 1 to axis 2."""
    stations = [
        (-INNER - 0.088, 0.060, 0.5 * ARM - 0.004, 2.6),
        (-INNER - 0.040, 0.084, 0.5 * ARM, 4.0),
        (-INNER, 0.090, 0.5 * ARM, 4.5),
        (-0.180, 0.074, 0.5 * ARM - 0.003, 4.5),
        (-0.060, 0.068, 0.5 * ARM - 0.003, 4.5),
        (0.000, 0.068, 0.5 * ARM - 0.003, 4.0),
        (0.066, 0.044, 0.5 * ARM - 0.008, 2.6),
    ]
    arm = loft(stations, (Y, Z, X), -0.5 * ARM * Z, edges=(0.022, 0.022), steps=4, sides=48)
    return merge(
        {"white": [arm], "grey": [seam_ring(0.052, 0.0)]},
        link_cap(0.058, 0.001, Z, (-INNER, 0.0, 0.0)),
        link_cap(0.040, ARM - 0.004, -Z),
    )


def outer_arm() -> Parts:
    """Returns link 2 in its frame (meters; z down): hood over the motors, tower of the quill."""
    stations = [
        (-OUTER - 0.072, 0.048, 0.5 * HOOD - 0.020, 2.6),
        (-OUTER - 0.030, 0.066, 0.5 * HOOD - 0.008, 3.6),
        (-OUTER, 0.070, 0.5 * HOOD - 0.002, 4.0),
        (-0.120, 0.070, 0.5 * HOOD, 4.5),
        (0.000, 0.062, 0.5 * HOOD - 0.002, 4.0),
        (0.062, 0.042, 0.5 * HOOD - 0.018, 2.6),
    ]
    hood = loft(
        stations, (Y, Z, X), (-0.5 * HOOD - 0.005) * Z, edges=(0.026, 0.026), steps=4, sides=48
    )
    tower = [
        (-0.330, 0.026, 0.024, 3.0),
        (-0.300, 0.032, 0.030, 3.4),
        (-0.220, 0.040, 0.038, 3.4),
        (-0.120, 0.048, 0.046, 3.4),
    ]
    nut = [
        (0.0, -0.010),
        (0.036, -0.010),
        (0.034, 0.012, 0.004),
        (0.020, 0.018, 0.003),
        (0.0, 0.018),
    ]
    cable = [(0.0, -0.008), (0.030, -0.008), (0.030, 0.004, 0.003), (0.0, 0.004)]
    return merge(
        {
            "white": [hood, loft(tower, edges=(0.018, 0.004), steps=4, sides=40)],
            "grey": [
                revolve(fillet(nut), sides=32),
                revolve(fillet(cable), Z, (-0.110, 0.0, -HOOD - 0.005), 32),
            ],
        },
        link_cap(0.040, HOOD + 0.002, -Z, (-OUTER, 0.0, 0.0)),
    )  # fmt: skip


def quill() -> Parts:
    """Returns link 3 in its frame (meters; z down): the rod, which the tower hides when up."""
    rod = [(0.0, -0.305), (QUILL, -0.305, 0.001), (QUILL, -0.020), (0.0, -0.020)]
    return {"steel": [revolve(fillet(rod), sides=32)]}


def tip() -> Parts:
    """Returns link 4 in its frame (meters; z down): the end of the rod with a collar and a flat."""
    end = [(0.0, -0.020), (QUILL, -0.020), (QUILL, 0.0, 0.0008), (0.0, 0.0)]
    collar = [(0.0, -0.024), (0.021, -0.024, 0.001), (0.021, -0.010, 0.001), (0.0, -0.010)]
    screw = drum(0.003, 0.002, X, (0.021, 0.0, -0.017), 0.0005)
    return {
        "steel": [revolve(fillet(end), sides=32)],
        "grey": [revolve(fillet(collar), sides=32)],
        "orange": [screw],
    }


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": inner_arm(),
        "link2": outer_arm(),
        "link3": quill(),
        "link4": tip(),
    }
    write_links(OUT, links, "sero-mj Cobra 600 mesh")
