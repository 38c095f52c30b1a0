"""Writes the link meshes of Rollin' Justin's platform and torso to `meshes/`.

An original design with the published height of 1.91 m; no data from DLR is used. Each part is in
the modified Denavit-Hartenberg frame of its link, in meters. The frame of the base is on the floor,
with x forward. The frame of link 1 is at the height of the first pitch joint. The frames of links 2
and 3 have x along the link (up in the zero pose), y forward and z to the left.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, drum, link_cap, loft, merge, revolve, write_links

OUT = Path(__file__).resolve().parent / "meshes"

PITCH = 0.77  # height of the first pitch joint, m
LINK = 0.30  # distance from the first to the second pitch joint, m
SHOULDERS = 0.34  # distance from the second pitch joint to the bases of the arms, m
ARM = 0.19  # distance from the middle to the base of an arm, m
TILT = np.deg2rad(60.0)  # angle between the first axes of the arms and the vertical
UP, FORWARD, LEFT = X, Y, Z  # in the frames of links 2 and 3
UPRIGHT = (Y, Z, X)  # u forward, v left, w up


def base():
    """Returns the platform: a rounded body, its dark skirt and deck, the collar of the torso."""
    body = [
        (0.20, 0.235, 0.205, 3.6),
        (0.30, 0.275, 0.240, 3.4),
        (0.44, 0.270, 0.235, 3.2),
        (0.54, 0.225, 0.200, 3.0),
        (0.585, 0.190, 0.175, 2.8),
    ]
    skirt = [(0.145, 0.205, 0.175, 3.6), (0.23, 0.240, 0.210, 3.6)]
    band = [(0.335, 0.2795, 0.2445, 3.3), (0.365, 0.2795, 0.2445, 3.3)]
    deck = [(0.57, 0.165, 0.150, 2.6), (0.605, 0.150, 0.135, 2.4)]
    sensor = [(0.25, 0.030, 0.075, 3.0), (0.29, 0.030, 0.075, 3.0)]
    return {
        "white": [loft(body, edges=(0.02, 0.03), sides=40)],
        "grey": [
            loft(skirt, edges=(0.03, 0.006), sides=40),
            loft(deck, edges=(0.004, 0.012), sides=32),
            loft(sensor, origin=(0.262, 0.0, 0.0), edges=(0.008, 0.008), steps=1),
            revolve([(0.125, 0.59), (0.125, 0.622), (0.118, 0.628)], sides=32),
        ],
        "blue": [loft(band, edges=(0.002, 0.002), steps=1, sides=40)],
    }


def waist():
    """Returns link 1: the rotating column, and the fork of the first pitch joint."""
    column = [
        (0.630 - PITCH, 0.112, 0.112, 2.0),
        (0.665 - PITCH, 0.110, 0.108, 2.1),
        (0.710 - PITCH, 0.088, 0.092, 2.4),
        (0.745 - PITCH, 0.070, 0.098, 3.0),
    ]
    cheeks = [drum(0.072, 0.021, Y, (0.0, side * 0.078, 0.0), 0.010) for side in (-1, 1)]
    caps = [link_cap(0.044, 0.099, side * Y) for side in (-1, 1)]
    ring = revolve([(0.108, 0.622 - PITCH), (0.108, 0.640 - PITCH)], sides=32)
    own = {"white": [loft(column, edges=(0.006, 0.010)), *cheeks], "grey": [ring]}
    return merge(own, *caps)


def spine():
    """Returns link 2: a bar between the two pitch joints."""
    bar = [
        (0.0, 0.056, 0.046, 2.6),
        (0.09, 0.060, 0.050, 3.0),
        (0.20, 0.058, 0.054, 3.0),
        (LINK, 0.050, 0.048, 2.6),
    ]
    joints = [
        drum(0.066, 0.054, LEFT, edge=0.008),
        drum(0.060, 0.060, LEFT, (LINK, 0.0, 0.0), 0.008),
    ]
    caps = [link_cap(0.038, 0.060, side * LEFT, (LINK, 0.0, 0.0)) for side in (-1, 1)]
    plate = [(0.09, 0.004, 0.030, 4.0), (0.20, 0.004, 0.034, 4.0)]
    front = loft(plate, UPRIGHT, (0.0, 0.0590, 0.0), edges=(0.003, 0.003))
    own = {"white": [loft(bar, UPRIGHT, edges=(0.02, 0.02))], "grey": joints, "blue": [front]}
    return merge(own, *caps)


def chest():
    """Returns link 3: a chest with a blue front, the sockets of the arms, and a neck collar."""
    # Outlines: position along w, half depth, half width, exponent, forward offset.
    shell = [
        (-0.020, 0.062, 0.075, 2.6, 0.000),
        (0.060, 0.080, 0.105, 2.7, 0.006),
        (0.160, 0.100, 0.140, 2.8, 0.012),
        (0.270, 0.112, 0.172, 2.9, 0.012),
        (0.345, 0.106, 0.176, 2.8, 0.006),
        (0.405, 0.082, 0.130, 2.5, -0.004),
        (0.430, 0.062, 0.080, 2.3, -0.008),
    ]
    front = [
        (0.120, 0.040, 0.070, 3.2, 0.072),
        (0.200, 0.048, 0.106, 3.2, 0.083),
        (0.290, 0.046, 0.118, 3.2, 0.084),
        (0.345, 0.038, 0.094, 3.0, 0.074),
    ]
    pack = [(0.08, 0.040, 0.090, 4.0, -0.080), (0.34, 0.045, 0.110, 4.0, -0.085)]
    parts = {
        "white": [loft(shell, UPRIGHT, edges=(0.02, 0.02), steps=3, sides=40)],
        "blue": [loft(front, UPRIGHT, edges=(0.02, 0.02), steps=5, sides=32)],
        "grey": [
            loft(pack, UPRIGHT, edges=(0.015, 0.015)),
            revolve([(0.052, 0.415), (0.052, 0.458), (0.049, 0.461)], UP, (0.0, -0.008, 0.0)),
        ],
        "orange": [],
    }
    for side in (-1.0, 1.0):
        axis = np.cos(TILT) * UP + side * np.sin(TILT) * LEFT
        at = SHOULDERS * UP + side * ARM * LEFT
        # The base of the arm is on the face of the socket.
        parts["white"].append(revolve([(0.100, -0.110), (0.108, -0.035)], axis, at, 32))
        parts["grey"].append(revolve([(0.111, -0.040), (0.111, -0.0005)], axis, at, 32))
        parts["orange"].append(revolve([(0.1125, -0.046), (0.1125, -0.036)], axis, at, 32))
    return parts


if __name__ == "__main__":
    links = {"base": base(), "link1": waist(), "link2": spine(), "link3": chest()}
    write_links(OUT, links, "sero-mj Justin mesh, approximate")
