"""Lines of billboards: what a number is called, how it is written, and how wide it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..assemble.parts import Owner
from ..assemble.robot_parts import BillboardLine
from ..assemble.scene import Scene

Array = NDArray[np.float64]

NO_DATA = b"no data"
NO_LIMIT = b"none"
# What lines are called where a billboard has several of them.
_LABELS = {
    "torques": "msr",
    "commanded_torques": "cmd",
    "torque_error": "err",
    "joint_accelerations": "acc",
    "joint_angles": "pos",
    "billboard_values": "val",
}
_PLAIN_BELOW = 1e6  # larger values are written with an exponent
# Unit and decimals of a value by itself, for revolute and for prismatic joints.
_UNITS = {
    "torques": (("Nm", 1), ("N", 1)),
    "commanded_torques": (("Nm", 1), ("N", 1)),
    "torque_error": (("Nm", 2), ("N", 2)),
    "joint_accelerations": (("rad/s2", 2), ("m/s2", 2)),
    "joint_angles": (("rad", 3), ("m", 4)),
    "torque_limit": (("Nm", 1), ("N", 1)),
    "torque_share": (("%", 1), ("%", 1)),
}
_OWN_UNIT = (("", 2), ("", 2))  # of `billboard_values` and a robot's own inputs
# What a click on an arrow brings up: the precise numbers (section 2.2), and what they are called.
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}


@dataclass(frozen=True)
class Line:
    """One line of one joint's billboard, ready to be filled."""

    head: str
    form: str
    scientific: str
    scale: float
    decimals: int
    key: str
    widest: str

    def text(self, value: float) -> bytes:
        """The line with its number; `no data` for NaN and infinity."""
        if not math.isfinite(value):
            missing = NO_LIMIT if self.key == "torque_limit" else NO_DATA
            return self.head.encode("ascii") + missing
        # Adding zero turns -0.0, which rounding makes of a small negative, into 0.0.
        value = round(value * self.scale, self.decimals) + 0.0
        form = self.form if abs(value) < _PLAIN_BELOW else self.scientific
        return (self.head + form % value).encode("ascii", "replace")


def declared_lines(part: Owner, scene: Scene) -> list[BillboardLine]:
    """Returns what billboards say: as declared, else what is routed to the robot or double.

    A double says what its robot says, as far as it has values for it.
    """
    declared = part.declared

    def comes(key: str) -> bool:
        if key == "torque_error":  # it follows from the two
            return comes("commanded_torques") and comes("torques")
        return f"{declared.name}.{key}" in scene.routes or getattr(declared, key, None) is not None

    if declared.billboard_lines is not None:
        return declared.billboard_lines
    if part.billboard_lines is not None:
        lines = [line for line in part.billboard_lines if comes(line.value)]
        if lines:
            return lines
    for key in ("billboard_values", "torques"):
        if comes(key):
            return [BillboardLine(value=key)]
    return [BillboardLine(value="joint_angles")]


def billboard_lines(joint: str, declared: list[BillboardLine], prismatic: bool) -> list[Line]:
    """The lines of one joint's billboard."""
    several = len(declared) > 1
    labels = [
        line.label or (_LABELS.get(line.value, line.value) if several else "") for line in declared
    ]
    return [
        _line(joint, k, line.value, label, prismatic, line)
        for k, (line, label) in enumerate(zip(declared, labels, strict=True))
    ]


def detail_lines(joint: str, prismatic: bool) -> list[Line]:
    """The lines with the precise numbers of one joint's arrow."""
    return [
        _line(joint, k, key, label, prismatic) for k, (key, label) in enumerate(_DETAILS.items())
    ]


def _line(
    joint: str,
    k: int,
    key: str,
    label: str,
    prismatic: bool,
    declared: BillboardLine | None = None,
) -> Line:
    """Prepares a line: the joint's name stands on the first one, labels on all."""
    unit, decimals = _UNITS.get(key, _OWN_UNIT)[prismatic]
    scale = 1.0
    if declared is not None:
        unit = unit if declared.unit is None else declared.unit
        decimals = decimals if declared.decimals is None else declared.decimals
        scale = declared.scale
    words = [joint if k == 0 else " " * len(joint), label]
    head = "  ".join(word for word in words if word) + " "
    tail = (f" {unit}" if unit else "").replace("%", "%%")
    form = f"%{decimals + 5 if decimals else 5}.{decimals}f" + tail
    return Line(head, form, "%10.3e" + tail, scale, decimals, key, head + form % -888.8888)
