"""Links of the arms of Universal Robots, for the scripts that write their meshes.

All these arms consist of joints in a few sizes. A joint is a round housing with a lid at its back,
and the next joint leaves from its side. The shoulder, the elbow and the two wrist housings are next
to each other along their axes, and tubes connect them. A `UniversalArm` contains the dimensions of
one arm.

The shapes are this project's own design; no data of the manufacturer's shapes is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from bodies import (
    RING_INSET,
    Parts,
    X,
    Y,
    Z,
    drum,
    fillet,
    merge,
    mix,
    ramp,
    revolve,
    seam_ring,
    tool_flange,
)

SIDES = 48  # facets of housings
GAP = 0.0012  # m, from a housing's rim to the middle of its seam
BEVEL = 0.0015  # m, at a rim; without it, MuJoCo averages the normals of the sharp rim
COLLAR = 0.022  # m, from a housing's flank to the end of the neck that holds a tube
LID = 0.010  # m, height of a lid

Table = dict[str, list[trimesh.Trimesh]]


@dataclass(frozen=True)
class UniversalArm:
    """Dimensions of an arm in meters; dimensions in its DH table have the same names."""

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    flange: float  # d6
    foot: float  # radius of the base
    base: float  # height of the first seam above the floor
    shoulder: float  # radius of the housings of joints 1 and 2
    elbow: float  # radius of the housings of joint 3
    wrist: float  # radius of the housings of joints 4 and 5
    tool: float  # radius of the last link
    upper_tube: float  # radius
    lower_tube: float  # radius
    shoulder_offset: float  # of the middle of the upper arm along axis 2
    elbow_offset: float  # of the middle of the forearm along axis 2

    @property
    def seam(self) -> float:
        """Position of the shoulder and elbow seams along axis 2, midway between the two arms."""
        return 0.5 * (self.shoulder_offset + self.elbow_offset)

    @property
    def half(self) -> float:
        """Half the length of the housings of the upper arm along axis 2."""
        return 0.5 * (self.shoulder_offset - self.elbow_offset)


def housing(
    radius: float, seam: float, back: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0), edge=0.004
) -> trimesh.Trimesh:
    """Returns a round housing from its seam to its back along `axis`, in meters.

    Args:
        radius: radius of the housing.
        seam: middle of the seam at which the next link rotates.
        back: closed end.
        axis: unit vector.
        origin: point at which `seam` and `back` are zero.
        edge: radius of the edge at the back.
    """
    way = 1.0 if back > seam else -1.0
    start = seam + way * GAP
    profile = [
        (radius - BEVEL, start),
        (radius, start + way * BEVEL),
        (radius, back, edge),
        (0.3 * radius, back),
    ]
    return revolve(fillet(profile, 4), axis, origin, SIDES)


def outlet(radius: float, seam: float, axis: np.ndarray) -> trimesh.Trimesh:
    """Returns the side of a housing where the next joint leaves, up to its seam, in meters."""
    inside = radius - 0.0015  # so that it does not touch the flank of the housing
    profile = [
        (inside, 0.0),
        (inside, 0.7 * radius),
        (radius, radius),
        (radius, seam - GAP - BEVEL),
        (radius - BEVEL, seam - GAP),
    ]
    return revolve(profile, axis, sides=SIDES)


def lid(radius: float, face: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0)) -> Table:
    """Returns the blue lid at the back of a housing, and the dark gap below it, in meters."""
    way = np.sign(face)
    rim = radius - 0.0010
    profile = [
        (rim - BEVEL, face + way * 0.0010),
        (rim, face + way * 0.0022),
        (rim, face + way * LID, 0.006),
        (0.55 * radius, face + way * (LID + 0.0012)),
        (0.2 * radius, face + way * (LID + 0.0016)),
    ]
    gap = [(rim - 0.0030, face - way * 0.0010), (rim - 0.0030, face + way * 0.0040)]
    return {
        "blue": [revolve(fillet(profile, 4), axis, origin, SIDES)],
        "dark": [revolve(gap, axis, origin)],
    }


def neck(
    radius: float, tube: float, axis: np.ndarray, origin=(0.0, 0.0, 0.0), width=0.86
) -> trimesh.Trimesh:
    """Returns the part of a housing that narrows toward a tube along `axis`, in meters."""
    along = np.linspace(0.45 * radius, radius + COLLAR - BEVEL, 9)
    end = tube + 0.0035
    r = mix(width * radius, end, ramp(along, 0.55 * radius, radius + 0.7 * COLLAR))
    profile = [*zip(r, along, strict=True), (end - BEVEL, radius + COLLAR)]
    return revolve(profile, axis, origin, SIDES)


def tube(radius: float, start, stop) -> trimesh.Trimesh:
    """Returns a plain tube between two points, in meters."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    length = float(np.linalg.norm(stop - start))
    return revolve([(radius, 0.0), (radius, length)], (stop - start) / length, start, SIDES)


def links(arm: UniversalArm) -> dict[str, Parts]:
    """Returns the parts of every link (meters, modified DH frame) by link and color."""
    return {
        "base": base(arm),
        "link1": shoulder(arm),
        "link2": upper_arm(arm),
        "link3": forearm(arm),
        "link4": wrist_1(arm),
        "link5": wrist_2(arm),
        "link6": wrist_3(arm),
    }


def base(arm: UniversalArm) -> Table:
    """Returns link 0: foot with bolts, round body, and the plug of the cable."""
    r, foot = arm.shoulder, arm.foot
    profile = [
        (foot - 0.001, 0.0),
        (foot, 0.001),
        (foot, 0.014, 0.004),
        (r + 0.004, 0.020, 0.006),
        (r, arm.base - GAP - BEVEL),
        (r - BEVEL, arm.base - GAP),
    ]
    bolt = [(0.0060, 0.010), (0.0060, 0.0195), (0.0050, 0.0205)]
    at = (foot - 0.009) * np.sqrt(0.5)
    bolts = [revolve(bolt, Z, (x, y, 0.0), 8) for x in (-at, at) for y in (-at, at)]
    plug = drum(0.012, 0.012, Y, (0.0, -r - 0.004, 0.5 * arm.base + 0.006), 0.002)
    return {"grey": [revolve(fillet(profile, 3), Z, sides=SIDES)], "steel": bolts, "dark": [plug]}


def shoulder(arm: UniversalArm) -> Table:
    """Returns link 1: upright housing with its lid on top, outlet along axis 2."""
    r, low = arm.shoulder, arm.base - arm.d1
    top = r + 0.002
    return merge(
        lid(r, top, Z),
        {
            "grey": [
                housing(r, low, top, Z),
                outlet(r, arm.seam, Y),
            ],
            "dark": [seam_ring(r - RING_INSET, low)],
        },
    )


def upper_arm(arm: UniversalArm) -> Table:
    """Returns link 2: two housings with lids on the outside, and the tube between them."""
    middle = arm.shoulder_offset
    back = middle + 0.92 * arm.half
    end, at = np.array([arm.a2, 0.0, 0.0]), middle * Z
    seam = arm.seam
    return merge(
        lid(arm.shoulder, back, Z),
        lid(arm.elbow, back, Z, end),
        {
            "grey": [
                housing(arm.shoulder, seam, back, Z),
                housing(arm.elbow, seam, back, Z, end),
                neck(arm.shoulder, arm.upper_tube, X, at),
                neck(arm.elbow, arm.upper_tube, -X, end + at),
            ],
            "steel": [tube(arm.upper_tube, at + 0.5 * arm.shoulder * X, end + at - 0.03 * X)],
            "dark": [seam_ring(arm.shoulder - RING_INSET, seam)],
        },
    )


def forearm(arm: UniversalArm) -> Table:
    """Returns link 3: round ends beside elbow and wrist, and the tube between them."""
    at, end = arm.elbow_offset * Z, np.array([arm.a3, 0.0, 0.0])
    back = arm.elbow_offset - 0.86 * arm.half
    low = arm.elbow_offset - 1.06 * arm.wrist
    return merge(
        {
            "grey": [
                housing(arm.elbow, arm.seam, back, Z, edge=0.55 * arm.elbow),
                neck(arm.elbow, arm.lower_tube, X, at, 0.80),
                neck(arm.wrist, arm.lower_tube, -X, end + at, 0.96),
                housing(arm.wrist, arm.d4 - 0.5 * arm.d5, low, Z, end, 0.55 * arm.wrist),
            ],
            "steel": [tube(arm.lower_tube, at + 0.5 * arm.elbow * X, end + at - 0.03 * X)],
            "dark": [seam_ring(arm.elbow - RING_INSET, arm.seam)],
        },
    )


def wrist_1(arm: UniversalArm) -> Table:
    """Returns link 4: housing about z4 with its lid outside, outlet along y4."""
    r, half = arm.wrist, 0.5 * arm.d5
    back = r + 0.003
    return merge(
        lid(r, back, Z),
        {
            "grey": [housing(r, -half, back, Z), outlet(r, half, Y)],
            "dark": [seam_ring(r - RING_INSET, -half)],
        },
    )


def wrist_2(arm: UniversalArm) -> Table:
    """Returns link 5: housing about z5 with its lid outside, outlet along -y5."""
    r, half = arm.wrist, 0.5 * arm.d5
    back = r + 0.003
    return merge(
        lid(r, back, Z),
        {
            "grey": [housing(r, -half, back, Z), outlet(r, half, -Y)],
            "dark": [seam_ring(r - RING_INSET, -half)],
        },
    )


def wrist_3(arm: UniversalArm) -> Table:
    """Returns link 6: short body with the plug of the tool, and the tool flange."""
    start, r = 0.5 * arm.d5, arm.tool
    top = arm.flange - 0.0065
    body = [
        (arm.wrist - BEVEL, start + GAP),
        (arm.wrist, start + GAP + BEVEL),
        (arm.wrist, start + 0.016, 0.006),
        (r, start + 0.022, 0.004),
        (r, top, 0.003),
        (0.020, top),
    ]
    plug = drum(0.0080, 0.006, Y, (0.0, -r - 0.003, 0.5 * (start + 0.022 + top)), 0.0015)
    parts = tool_flange(arm.flange, (np.arange(4) + 0.5) * np.pi / 2.0, 0.0315)
    return {
        "grey": [revolve(fillet(body, 3), Z, sides=SIDES)],
        "steel": list(parts["steel"]),
        "dark": [*parts["grey"], plug, seam_ring(arm.wrist - RING_INSET, start)],
    }
