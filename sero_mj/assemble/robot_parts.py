"""What fields of `SerialRobot` are made of: mesh files and billboard lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator

from .declaration import Declaration
from .objects import check_mesh_file

ArrowQuantity = Literal["torques", "torque_error", "joint_accelerations", "singularity"]
BillboardValue = Literal[
    "torques",
    "commanded_torques",
    "torque_error",
    "joint_accelerations",
    "joint_angles",
    "billboard_values",
]


class LinkMesh(Declaration):
    """One mesh file of a link.

    Attributes:
        file: relative to the robot's `directory`.
        color: one of the robot's `colors`.
    """

    file: str
    color: str | None = None

    @field_validator("file")
    @classmethod
    def _is_inside(cls, file: str) -> str:
        return check_mesh_file(file)


class BillboardLine(Declaration):
    """One line of a joint's billboard.

    Attributes:
        value: which of the robot's per-joint inputs it shows; `torque_error` is commanded -
            measured.
        label: put before the number when a billboard has several lines.
        unit: shown behind the number; None for the value's own SI unit.
        decimals: digits after the point; None for what suits the value.
        scale: multiplies the value before it is shown (57.2958 for degrees).
    """

    value: BillboardValue
    label: str = ""
    unit: str | None = None
    decimals: int | None = Field(None, ge=0, le=9)
    scale: float = 1.0


def as_link_meshes(value: Any) -> Any:
    """A link is a file name, a table with `file` and `color`, a list of those, or "" for none."""
    if isinstance(value, str):
        return [{"file": value}] if value else []
    if isinstance(value, Mapping | LinkMesh):
        return [value]
    if isinstance(value, list):
        return [{"file": entry} if isinstance(entry, str) else entry for entry in value]
    return value


def as_billboard_lines(value: Any) -> Any:
    """A line is the name of a value, or a table."""
    if isinstance(value, list):
        return [{"value": line} if isinstance(line, str) else line for line in value]
    return value
