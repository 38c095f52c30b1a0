"""Lines of billboards: label, unit, number format and width."""

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
# Labels of lines on billboards with several lines.
_LABELS = {
    "torques": "msr",
    "commanded_torques": "cmd",
    "torque_error": "err",
    "joint_accelerations": "acc",
    "joint_angles": "pos",
    "billboard_values": "val",
}
_PLAIN_BELOW = 1e6  # above it values are written with an exponent
# Default unit and decimals of a value, for revolute and for prismatic joints.
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
# Values and labels that a click on an arrow shows (section 2.2).
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}


@dataclass(frozen=True)
class Line:
    """The format of one line of a joint's billboard."""

    head: str
    form: str
    scientific: str
    scale: float
    decimals: int
    key: str
    widest: str

    def text(self, value: float) -> bytes:
        """Returns the line with its number; `no data` for NaN and infinity."""
        if not math.isfinite(value):
            missing = NO_LIMIT if self.key == "torque_limit" else NO_DATA
            return self.head.encode("ascii") + missing
        # Adding zero converts -0.0, the result of rounding a small negative value, to 0.0.
        value = round(value * self.scale, self.decimals) + 0.0
        form = self.form if abs(value) < _PLAIN_BELOW else self.scientific
        return (self.head + form % value).encode("ascii", "replace")


def declared_lines(part: Owner, scene: Scene) -> list[BillboardLine]:
    """Returns the lines of billboards: as declared, else the inputs routed to the robot or double.

    A double has the lines of its robot, as far as it has values for them.
    """
    declared = part.declared

    def comes(key: str) -> bool:
        if key == "torque_error":  # computed from the two
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
    """Returns the line formats of one joint's billboard.

    Args:
        joint: its name.
        declared: the declared lines.
        prismatic: whether the joint is prismatic, for units.
    """
    several = len(declared) > 1
    labels = [
        line.label or (_LABELS.get(line.value, line.value) if several else "") for line in declared
    ]
    return [
        _line(joint, k, line.value, label, prismatic, line)
        for k, (line, label) in enumerate(zip(declared, labels, strict=True))
    ]


def detail_lines(joint: str, prismatic: bool) -> list[Line]:
    """Returns the line formats of the precise values of one joint's arrow."""
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
    """Returns the format of line k: the joint's name is on the first, labels are on all."""
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
