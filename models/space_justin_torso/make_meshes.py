"""Writes the link meshes of SpaceJustin's torso to `meshes/`: Justin's chest on a pedestal.

An original design; no data from DLR is used. Each part is in the modified Denavit-Hartenberg frame
of its link, in meters, with x forward and z up. The frame of the base is on the floor, and the
frame of link 1 is in the waist.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import drum, loft, merge, revolve, write_links
from justin_torso.make_meshes import chest

OUT = Path(__file__).resolve().parent / "meshes"

WAIST = 0.85  # height of the joint frame, m
CHEST = 0.12  # distance from the joint frame to the foot of Justin's chest, m
# Justin's chest has x up, y forward and z to the left.
UPRIGHT = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, CHEST], [0, 0, 0, 1]])


def base():
    """Returns the pedestal."""
    column = [
        (0.035, 0.150, 0.150, 2.2),
        (0.120, 0.098, 0.098, 2.2),
        (0.400, 0.086, 0.086, 2.2),
        (0.700, 0.092, 0.096, 2.3),
        (WAIST - 0.085, 0.104, 0.108, 2.2),
    ]
    band = [(0.560, 0.0925, 0.0935, 2.25), (0.590, 0.0935, 0.0945, 2.25)]
    return {
        "white": [loft(column, edges=(0.01, 0.012), sides=32)],
        "grey": [
            drum(0.24, 0.018, origin=(0.0, 0.0, 0.018), edge=0.008),
            revolve([(0.102, WAIST - 0.088), (0.102, WAIST - 0.072)], sides=32),
        ],
        "blue": [loft(band, edges=(0.002, 0.002), steps=1, sides=32)],
    }


def torso():
    """Returns link 1: the waist, and Justin's chest on it."""
    waist = [
        (-0.072, 0.104, 0.108, 2.2),
        (-0.020, 0.092, 0.100, 2.3),
        (0.060, 0.072, 0.082, 2.5),
        (0.150, 0.076, 0.096, 2.6),
    ]
    upper = {
        colour: [part.copy().apply_transform(UPRIGHT) for part in parts]
        for colour, parts in chest().items()
    }
    return merge({"white": [loft(waist, edges=(0.008, 0.02), sides=32)]}, upper)


if __name__ == "__main__":
    write_links(OUT, {"base": base(), "link1": torso()}, "sero-mj Justin mesh, approximate")
