"""Writes the meshes of a DLR Hand II finger and of the hand's palm to `meshes/`.

An original design with the proportions of the hand: four equal fingers, larger than human fingers.
Parts of the finger are in the modified Denavit-Hartenberg frames of their links, in meters: x along
the finger, y of links 2 and 3 in the bending direction, z sideways. The frame of the palm is at the
wrist: z toward the fingers, x out of the palm, y to the thumb side of a right hand.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, drum, limb, loft, write_links

OUT = Path(__file__).resolve().parent / "meshes"

PROXIMAL = 0.075  # distance from the knuckle to the middle joint, m
MEDIAL, DISTAL, BEND = 0.040, 0.035, np.deg2rad(20.0)  # the last two phalanges form one link
ALONG = (Y, Z, X)  # u in the bending direction, v sideways, w along the finger


def base():
    """Returns the housing of the finger drives in the palm."""
    block = [
        (-0.050, 0.0150, 0.0150, 3.2),
        (-0.030, 0.0165, 0.0160, 3.2),
        (-0.010, 0.014, 0.014, 3),
    ]
    return {"grey": [loft(block, (Z, Y, X), edges=(0.004, 0.004), sides=24)]}


def knuckle():
    """Returns link 1: the cross of the two axes that meet in the knuckle."""
    return {"steel": [drum(0.0102, 0.0132, Z, edge=0.002), drum(0.0088, 0.0140, Y, edge=0.002)]}


def proximal():
    """Returns link 2: a waisted shell, a dark pad on its inside, the drum of its joint."""
    shell = [
        (0.006, 0.0120, 0.0118, 2.8),
        (0.026, 0.0136, 0.0130, 3.0),
        (0.054, 0.0126, 0.0120, 3.0),
        (PROXIMAL - 0.008, 0.0108, 0.0104, 2.8),
    ]
    pad = [(0.020, 0.0040, 0.0086, 3.0, 0.0108), (0.056, 0.0040, 0.0080, 3.0, 0.0100)]
    return {
        "white": [loft(shell, ALONG, edges=(0.004, 0.004), sides=26)],
        "grey": [drum(0.0112, 0.0122, Z, edge=0.002), loft(pad, ALONG, edges=(0.003, 0.003))],
        "orange": [drum(0.0066, 0.0127, Z, edge=0.0005)],
    }


def fingertip():
    """Returns link 3: the last two phalanges, which are one link in this model."""
    medial = [
        (0.005, 0.0112, 0.0108, 2.8),
        (0.020, 0.0118, 0.0112, 3.0),
        (MEDIAL - 0.004, 0.0102, 0.0098, 2.8),
    ]
    end = np.cos(BEND) * X + np.sin(BEND) * Y
    aside = np.cross(Z, end)
    middle = MEDIAL * X
    distal = [
        (0.004, 0.0104, 0.0100, 2.6),
        (0.016, 0.0108, 0.0104, 2.6),
        (0.028, 0.0096, 0.0094, 2.3),
        (DISTAL, 0.0080, 0.0080, 2.0),
    ]
    pad = [
        (0.008, 0.0050, 0.0078, 2.6, 0.0066),
        (0.024, 0.0050, 0.0072, 2.4, 0.0060),
        (0.0325, 0.0036, 0.0050, 2.0, 0.0046),
    ]
    axes = (aside, Z, end)
    return {
        "white": [
            loft(medial, ALONG, edges=(0.004, 0.004), sides=26),
            loft(distal, axes, middle, edges=(0.004, 0.008), sides=26),
        ],
        "grey": [
            drum(0.0104, 0.0116, Z, edge=0.002),
            drum(0.0094, 0.0104, Z, middle, 0.002),
            loft(pad, axes, middle, edges=(0.003, 0.003), sides=22),
        ],
        "orange": [drum(0.0060, 0.0121, Z, edge=0.0005), drum(0.0052, 0.0109, Z, middle, 0.0005)],
    }


def palm():
    """Returns the palm of a right hand: wrist, shell, dark inside, mount of the thumb."""
    upright = (X, Y, Z)
    shell = [
        (0.006, 0.034, 0.036, 2.3, -0.004, 0.000),
        (0.040, 0.036, 0.050, 2.8, -0.005, 0.002),
        (0.085, 0.034, 0.066, 3.2, -0.006, 0.000),
        (0.120, 0.028, 0.070, 3.4, -0.004, 0.000),
        (0.138, 0.021, 0.066, 3.2, -0.003, 0.000),
    ]
    inside = [
        (0.045, 0.007, 0.036, 3.0, 0.0270, -0.004),
        (0.085, 0.007, 0.050, 3.2, 0.0245, -0.006),
        (0.118, 0.007, 0.054, 3.2, 0.0195, -0.004),
    ]
    back = [
        (0.050, 0.005, 0.030, 3.0, -0.0385, 0.0),
        (0.085, 0.005, 0.044, 3.2, -0.0375, 0.0),
        (0.114, 0.005, 0.046, 3.2, -0.0310, 0.0),
    ]
    return {
        "white": [loft(shell, upright, edges=(0.005, 0.010), sides=36),
                  limb((0.006, 0.044, 0.046), (0.056, 0.058, 0.076), (0.027, 0.021))],
        "grey": [loft(inside, upright, edges=(0.005, 0.005)),
                 drum(0.0375, 0.010, Z, (-0.002, 0.0, 0.006), 0.004)],
        "blue": [loft(back, upright, edges=(0.004, 0.004))],
        "steel": [drum(0.032, 0.003, Z, (0.0, 0.0, -0.003), 0.001)],
    }  # fmt: skip


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": knuckle(),
        "link2": proximal(),
        "link3": fingertip(),
        "palm": palm(),
    }
    write_links(OUT, links, "sero-mj DLR Hand II mesh, approximate")
