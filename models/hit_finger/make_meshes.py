"""Writes the meshes of a DLR/HIT Hand II finger and of the hand's palm to `meshes/`.

The joint positions are those of eaa3/dlr_hit_hand_ii. The shapes are an original design. Parts of
the finger are in the modified Denavit-Hartenberg frames of their links, in meters: x along the
finger, y of links 2 to 4 in the bending direction, z sideways. The frame of the palm is at the
wrist: z toward the fingers, x out of the palm, y to the thumb side of a right hand.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, drum, limb, loft, write_links

OUT = Path(__file__).resolve().parent / "meshes"

PROXIMAL, MEDIAL, DISTAL = 0.055, 0.025, 0.025  # m
ALONG = (Y, Z, X)  # u in the bending direction, v sideways, w along the finger


def base():
    """Returns the housing of the finger drives in the palm."""
    block = [
        (-0.034, 0.0105, 0.0105, 3.5),
        (-0.020, 0.0115, 0.0110, 3.5),
        (-0.007, 0.010, 0.010, 3),
    ]
    return {"grey": [loft(block, (Z, Y, X), edges=(0.003, 0.003), sides=24)]}


def knuckle():
    """Returns link 1: the cross of the two axes that meet in the knuckle."""
    return {"steel": [drum(0.0072, 0.0092, Z, edge=0.002), drum(0.0062, 0.0098, Y, edge=0.002)]}


def phalanx(length: float, start: float, stop: float):
    """Returns a phalanx: a waisted shell, a dark pad on its inside, the drum of its joint."""
    shell = [
        (0.0045, 0.0085, 0.0082, 2.8),
        (0.35 * length, start, 0.95 * start, 3.0),
        (0.70 * length, stop, 0.95 * stop, 3.0),
        (length - 0.0055, 0.0078, 0.0074, 2.8),
    ]
    pad = [
        (0.28 * length, 0.0030, 0.62 * start, 3.0, 0.80 * start),
        (0.74 * length, 0.0030, 0.62 * stop, 3.0, 0.80 * stop),
    ]
    return {
        "white": [loft(shell, ALONG, edges=(0.003, 0.003), sides=24)],
        "grey": [drum(0.0078, 0.0084, Z, edge=0.0016), loft(pad, ALONG, edges=(0.002, 0.002))],
        "orange": [drum(0.0046, 0.0088, Z, edge=0.0004)],
    }


def fingertip():
    """Returns link 4: a round fingertip with a soft pad."""
    shell = [
        (0.004, 0.0080, 0.0078, 2.6),
        (0.012, 0.0084, 0.0080, 2.6),
        (0.021, 0.0074, 0.0072, 2.3),
        (DISTAL, 0.0062, 0.0062, 2.0),
    ]
    pad = [
        (0.007, 0.0040, 0.0060, 2.6, 0.0050),
        (0.018, 0.0040, 0.0056, 2.4, 0.0046),
        (0.0235, 0.0030, 0.0040, 2.0, 0.0034),
    ]
    return {
        "white": [loft(shell, ALONG, edges=(0.003, 0.006), sides=24)],
        "grey": [
            drum(0.0072, 0.0080, Z, edge=0.0016),
            loft(pad, ALONG, edges=(0.002, 0.002), sides=20),
        ],
        "orange": [drum(0.0042, 0.0084, Z, edge=0.0004)],
    }


def palm():
    """Returns the palm of a right hand: wrist, shell, dark inside, mount of the thumb."""
    upright = (X, Y, Z)
    shell = [
        (0.004, 0.024, 0.027, 2.4, -0.004, 0.000),
        (0.028, 0.025, 0.036, 2.8, -0.004, 0.002),
        (0.060, 0.024, 0.050, 3.2, -0.005, -0.002),
        (0.088, 0.020, 0.054, 3.4, -0.004, -0.004),
        (0.103, 0.014, 0.052, 3.2, -0.003, -0.003),
    ]
    inside = [
        (0.030, 0.006, 0.026, 3.0, 0.017, -0.004),
        (0.060, 0.006, 0.038, 3.2, 0.0165, -0.008),
        (0.088, 0.006, 0.042, 3.2, 0.0115, -0.005),
    ]
    back = [
        (0.040, 0.004, 0.022, 3.0, -0.0275, 0.0),
        (0.062, 0.004, 0.032, 3.2, -0.0275, 0.0),
        (0.084, 0.004, 0.034, 3.2, -0.0225, 0.0),
    ]
    thumb = np.array([0.062569, 0.044545, 0.080045])  # base of the thumb
    direction = np.array([0.4557, 0.1047, 0.8840])  # direction of its housing
    foot = thumb - 0.024 * direction
    return {
        "white": [loft(shell, upright, edges=(0.004, 0.008), sides=36),
                  limb((0.004, 0.030, 0.034), foot, (0.020, 0.0155))],
        "grey": [loft(inside, upright, edges=(0.004, 0.004)),
                 drum(0.0325, 0.008, Z, (-0.001, 0.0, 0.004), 0.003)],
        "blue": [loft(back, upright, edges=(0.003, 0.003))],
        "steel": [drum(0.031, 0.003, Z, (0.0, 0.0, -0.003), 0.001)],
    }  # fmt: skip


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": knuckle(),
        "link2": phalanx(PROXIMAL, 0.0094, 0.0088),
        "link3": phalanx(MEDIAL, 0.0086, 0.0082),
        "link4": fingertip(),
        "palm": palm(),
    }
    write_links(OUT, links, "sero-mj HIT hand mesh, approximate")
