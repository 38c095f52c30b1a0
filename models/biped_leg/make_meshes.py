"""Writes the link meshes of a leg of the DLR Biped to `meshes/`.

An original design of drums and shells like those of the LWR, whose joints the robot has. Each part
is in the modified Denavit-Hartenberg frame of its link, in meters. In the zero pose, the leg is
straight: x of links 3 to 7 is down, z of links 3, 4, 5 and 7 is to the left, and z of link 6 is
forward.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, drum, link_cap, loft, merge, revolve, write_links

OUT = Path(__file__).resolve().parent / "meshes"

THIGH = SHANK = 0.40  # m
ANKLE = 0.09  # height of the ankle above the floor, m
TOE = 0.10  # distance from the ankle forward to the toe joint, m
TOE_HEIGHT = 0.02  # height of the toe joint above the floor, m
DOWN = (Y, Z, X)  # u backwards, v left, w down, in the frames of links 3 to 5


def fork(radius: float, half: float, at: float, axis, origin=(0.0, 0.0, 0.0)):
    """Returns the two cheeks of a fork about `axis`, with caps, in meters."""
    shift = [axis * (side * at) for side in (-1, 1)]
    cheeks = [drum(radius, half, axis, origin + s, 0.3 * half) for s in shift]
    caps = [link_cap(0.62 * radius, at + half, side * axis, origin) for side in (-1, 1)]
    return merge({"white": cheeks}, *caps)


def base():
    """Returns the flange under the pelvis."""
    plate = [(0.062, 0.125), (0.062, 0.112), (0.056, 0.104), (0.056, 0.098)]
    return {"grey": [revolve(plate[::-1], sides=28)]}


def hip_yaw():
    """Returns link 1: a rotating column, and the fork of the roll joint in front and behind."""
    column = [(0.058, 0.050, 0.056, 2.4), (0.078, 0.058, 0.058, 2.1), (0.097, 0.057, 0.057, 2.0)]
    bridge = [(0.030, 0.036, 0.080, 3.0), (0.066, 0.046, 0.070, 3.0)]
    own = {"white": [loft(column, edges=(0.006, 0.006)), loft(bridge, edges=(0.01, 0.01))]}
    return merge(own, fork(0.040, 0.012, 0.070, Y))


def hip_roll():
    """Returns link 2: the cross of roll and pitch."""
    # x2 is up, y2 to the right, z2 forward.
    cross = [(-0.055, 0.030, 0.052, 3.0), (0.055, 0.030, 0.052, 3.0)]
    own = {"grey": [loft(cross, (X, Y, Z), edges=(0.008, 0.008)), drum(0.036, 0.057, Z)]}
    return merge(own, fork(0.046, 0.013, 0.066, Y))


def thigh():
    """Returns link 3: the thigh, and the fork of the knee."""
    shell = [
        (0.000, 0.046, 0.044, 2.6, 0.000),
        (0.060, 0.060, 0.056, 2.6, -0.006),
        (0.150, 0.066, 0.060, 2.5, -0.012),
        (0.260, 0.056, 0.054, 2.5, -0.010),
        (0.335, 0.046, 0.060, 2.8, -0.004),
        (0.385, 0.036, 0.060, 3.0, 0.000),
    ]
    shield = [(0.09, 0.006, 0.034, 3.2, -0.068), (0.17, 0.006, 0.040, 3.2, -0.0765),
              (0.27, 0.006, 0.032, 3.2, -0.064)]  # fmt: skip
    own = {
        "white": [loft(shell, DOWN, edges=(0.03, 0.02), sides=28)],
        "grey": [drum(0.050, 0.050, Z, edge=0.006)],
        "blue": [loft(shield, DOWN, edges=(0.005, 0.005))],
    }
    return merge(own, fork(0.048, 0.012, 0.062, Z, (THIGH, 0.0, 0.0)))


def shank():
    """Returns link 4: the shank, and the fork of the ankle."""
    shell = [
        (0.000, 0.040, 0.040, 2.6, 0.000),
        (0.060, 0.050, 0.046, 2.6, 0.004),
        (0.140, 0.056, 0.050, 2.5, 0.010),
        (0.250, 0.044, 0.042, 2.5, 0.006),
        (0.335, 0.034, 0.044, 2.8, 0.000),
        (0.385, 0.028, 0.046, 3.0, 0.000),
    ]
    own = {
        "white": [loft(shell, DOWN, edges=(0.025, 0.015), sides=28)],
        "grey": [drum(0.045, 0.047, Z, edge=0.006)],
    }
    return merge(own, fork(0.034, 0.010, 0.050, Z, (SHANK, 0.0, 0.0)))


def ankle():
    """Returns link 5: the cross of the ankle's axes."""
    return {"grey": [drum(0.030, 0.037, Z, edge=0.004), drum(0.024, 0.050, Y, edge=0.004)]}


def foot():
    """Returns link 6: the foot up to the toe joint, with a dark sole; z is forward."""
    back = -TOE  # position of the ankle relative to the toe joint
    top = [
        (back - 0.072, 0.016, 0.036, 2.8, ANKLE - 0.030),
        (back - 0.040, 0.022, 0.044, 3.0, ANKLE - 0.034),
        (back + 0.040, 0.026, 0.048, 3.0, ANKLE - 0.036),
        (-0.030, 0.018, 0.050, 3.2, ANKLE - 0.028),
        (-0.006, 0.012, 0.050, 3.4, ANKLE - 0.022),
    ]
    sole = [
        (back - 0.076, 0.006, 0.040, 3.0, ANKLE - 0.006),
        (-0.080, 0.006, 0.050, 3.2, ANKLE - 0.006),
        (-0.004, 0.006, 0.052, 3.4, ANKLE - 0.006),
    ]
    forward = (X, Y, Z)
    cheeks = [
        loft(
            [(back - 0.062, 0.034, 0.022, 2.6, 0.030), (back - 0.050, 0.034, 0.022, 2.6, 0.030)],
            forward, edges=(0.004, 0.004), steps=1,
        ),
        loft(
            [(back + 0.050, 0.034, 0.022, 2.6, 0.030), (back + 0.062, 0.034, 0.022, 2.6, 0.030)],
            forward, edges=(0.004, 0.004), steps=1,
        ),
    ]  # fmt: skip
    caps = [link_cap(0.014, 0.062, side * Z, (0.0, 0.0, back)) for side in (-1, 1)]
    own = {
        "white": [loft(top, forward, edges=(0.012, 0.006), sides=28), *cheeks],
        "grey": [loft(sole, forward, edges=(0.004, 0.003), sides=28)],
    }
    return merge(own, *caps)


def toe():
    """Returns link 7: the toe; y is backward."""
    forward = (X, Z, -Y)
    top = [
        (0.002, 0.011, 0.050, 3.4, -0.003),
        (0.030, 0.011, 0.048, 3.2, -0.001),
        (0.058, 0.008, 0.036, 2.6, 0.004),
    ]
    sole = [
        (0.000, 0.006, 0.051, 3.4, TOE_HEIGHT - 0.006),
        (0.040, 0.006, 0.048, 3.0, TOE_HEIGHT - 0.006),
        (0.062, 0.005, 0.034, 2.6, TOE_HEIGHT - 0.005),
    ]
    return {
        "white": [loft(top, forward, edges=(0.003, 0.008), sides=28)],
        "grey": [loft(sole, forward, edges=(0.003, 0.005), sides=28), drum(0.011, 0.051, Z)],
    }


if __name__ == "__main__":
    links = {
        "base": base(),
        "link1": hip_yaw(),
        "link2": hip_roll(),
        "link3": thigh(),
        "link4": shank(),
        "link5": ankle(),
        "link6": foot(),
        "link7": toe(),
    }
    write_links(OUT, links, "sero-mj biped mesh, approximate")
