"""Writes the link meshes of Justin's head to `meshes/`.

An original design: a rounded shell with a dark visor and two cameras, on a neck with a pan and a
tilt joint. Each part is in the modified Denavit-Hartenberg frame of its link, in meters: z of the
base and of link 1 is up; x of link 2 is forward, y is down and z is to the left.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, drum, link_cap, loft, merge, revolve, write_links

OUT = Path(__file__).resolve().parent / "meshes"

UPRIGHT = (X, Z, -Y)  # in the frame of link 2: u forward, v left, w up
EYES = 0.105  # height of the cameras above the tilt axis, m
EYE = 0.036  # distance from the middle to a camera, m


def base():
    """Returns the foot of the neck."""
    return {"grey": [revolve([(0.050, 0.0), (0.050, 0.006), (0.044, 0.012), (0.040, 0.020)])]}


def neck():
    """Returns link 1: the neck, and the fork of the tilt joint."""
    column = [(-0.045, 0.036, 0.036, 2.0), (-0.020, 0.034, 0.034, 2.2), (0.0, 0.026, 0.030, 2.4)]
    cheeks = [drum(0.028, 0.009, Y, (0.0, side * 0.034, 0.0)) for side in (-1, 1)]
    return {"grey": [loft(column, edges=(0.002, 0.006)), *cheeks]}


def head():
    """Returns link 2: shell, visor, cameras, ear caps."""
    # Outlines: position along w, half depth, half width, exponent, forward offset.
    shell = [
        (-0.020, 0.050, 0.052, 2.3, 0.004),
        (0.020, 0.078, 0.070, 2.5, 0.012),
        (0.075, 0.098, 0.086, 2.6, 0.016),
        (0.130, 0.102, 0.090, 2.6, 0.014),
        (0.175, 0.090, 0.080, 2.5, 0.008),
        (0.205, 0.062, 0.055, 2.3, 0.002),
    ]
    visor = [(0.062, 0.040, 0.070, 3.2, 0.082), (0.105, 0.040, 0.078, 3.2, 0.0845),
             (0.148, 0.036, 0.068, 3.2, 0.084)]  # fmt: skip
    crest = [(0.150, 0.070, 0.020, 3.0, 0.000), (0.212, 0.046, 0.016, 3.0, 0.000)]
    eyes, lenses, rings = [], [], []
    for side in (-1.0, 1.0):
        at = (0.120, -EYES, side * EYE)
        eyes.append(revolve([(0.0235, -0.010), (0.0235, 0.012), (0.0205, 0.014)], X, at))
        rings.append(revolve([(0.0185, 0.010), (0.0185, 0.0150), (0.0165, 0.0155)], X, at))
        lens = [(0.0150, 0.012), (0.0145, 0.0165), (0.0100, 0.0185), (0.0, 0.0195)]
        lenses.append(revolve(lens, X, at))
    ears = [link_cap(0.024, 0.087, side * Z, (0.012, -0.085, 0.0)) for side in (-1, 1)]
    own = {
        "white": [loft(shell, UPRIGHT, edges=(0.02, 0.03), steps=4, sides=36)],
        "grey": [loft(visor, UPRIGHT, edges=(0.016, 0.016), steps=4, sides=32)],
        "steel": eyes,
        "blue": [loft(crest, UPRIGHT, edges=(0.01, 0.012)), *rings],
        "black": lenses,
    }
    return merge(own, *ears)


if __name__ == "__main__":
    links = {"base": base(), "link1": neck(), "link2": head()}
    write_links(OUT, links, "sero-mj Justin mesh, approximate")
