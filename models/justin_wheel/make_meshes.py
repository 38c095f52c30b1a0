"""Writes the link meshes of one leg of Justin's platform to `meshes/`: a leg, a fork, a wheel.

An original design. Each part is in the modified Denavit-Hartenberg frame of its link, in meters.
The frame of the base is on the floor under the steering axis, with x outward. The frame of link 1
is in the center of the wheel, with z up. z of link 2 is the wheel axis.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, cap, drum, loft, merge, revolve, write_links

OUT = Path(__file__).resolve().parent / "meshes"

RADIUS = 0.10  # radius of the wheel, m
KNEE = 0.285  # height of the outer end of the leg, m


def base():
    """Returns the leg: an arm from the platform to the housing of the steering axis."""
    arm = [
        (-0.02, 0.040, 0.046, 3.0, 0.0, 0.0),
        (0.10, 0.046, 0.050, 3.0, 0.012, 0.0),
        (0.24, 0.052, 0.058, 3.0, 0.0, 0.0),
    ]
    inwards = (Z, Y, -X)  # u up, v sideways, w toward the platform
    hood = [
        (0.215, 0.058, 0.058, 2.0),
        (0.270, 0.062, 0.062, 2.0),
        (0.320, 0.054, 0.054, 2.0),
        (0.345, 0.030, 0.030, 2.0),
    ]
    return {
        "white": [loft(arm, inwards, (0.0, 0.0, KNEE)), loft(hood, edges=(0.006, 0.02))],
        "grey": [revolve([(0.050, 0.205), (0.050, 0.222)], sides=28)],
        "orange": [revolve([(0.0595, 0.220), (0.0595, 0.228)], sides=28)],
    }


def fork():
    """Returns link 1: the fork that holds the wheel and rotates about the steering axis."""
    crown = [(0.098, 0.050, 0.040, 2.6), (0.118, 0.048, 0.046, 2.2)]
    cheek = [(-0.03, 0.026, 0.007, 3.0), (0.04, 0.032, 0.008, 3.0), (0.112, 0.040, 0.009, 3.0)]
    sides = [loft(cheek, origin=(0.0, s * 0.042, 0.0), edges=(0.006, 0.004)) for s in (-1, 1)]
    return {"white": sides, "grey": [loft(crown)]}


def wheel():
    """Returns link 2: tyre, rim and hub caps."""
    tread = [(RADIUS - 0.012, -0.026), (RADIUS - 0.003, -0.022), (RADIUS, -0.010)]
    tyre = [(0.068, -0.026), *tread, *((r, -z) for r, z in tread[::-1]), (0.068, 0.026)]
    rim = [(0.070, -0.0265), (0.070, 0.0265)]
    holes = []
    for angle in np.arange(5) * 2 * np.pi / 5:  # makes rolling visible
        at = (0.046 * np.cos(angle), 0.046 * np.sin(angle), 0.0)
        holes.append(drum(0.012, 0.0275, Z, at, 0.001))
    hubs = merge(cap(0.020, 0.0265, Z), cap(0.020, 0.0265, -Z))
    own = {"black": [revolve(tyre, sides=36), *holes], "steel": [revolve(rim, sides=28)]}
    return merge(own, hubs)


if __name__ == "__main__":
    links = {"base": base(), "link1": fork(), "link2": wheel()}
    write_links(OUT, links, "sero-mj Justin mesh, approximate")
