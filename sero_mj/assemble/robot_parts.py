"""What fields of `SerialRobot` are made of: tables, limits, mesh files, billboard lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from .declaration import Array, Declaration, Name, of_shape
from .dh import COLUMNS, Column
from .objects import Object, check_mesh_file

ArrowQuantity = Literal["torques", "torque_error", "joint_accelerations", "singularity"]
BillboardValue = Literal[
    "torques",
    "commanded_torques",
    "torque_error",
    "joint_accelerations",
    "joint_angles",
    "billboard_values",
]


def _is_permutation(columns: list[str]) -> list[str]:
    if sorted(columns) != sorted(COLUMNS):
        raise ValueError(f"found {columns}; expected alpha, a, theta, d in any order")
    return columns


def _differ(names: list[str]) -> list[str]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"'{name}' stands there twice; expected different names")
    return names


def _are_ordered(limits: Array | None) -> Array | None:
    if limits is not None and (limits[:, 0] >= limits[:, 1]).any():
        row = int(np.flatnonzero(limits[:, 0] >= limits[:, 1])[0])
        raise ValueError(f"row {row + 1} is {limits[row].tolist()}; expected lower < upper")
    return limits


def _are_positive(limits: Array | None) -> Array | None:
    if limits is not None and (limits <= 0).any():
        raise ValueError(f"found {limits.tolist()}; expected positive numbers")
    return limits


def _children_differ(children: list[Object]) -> list[Object]:
    names = [child.name for child in children]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two children have the name '{name}'")
    return children


Columns = Annotated[list[Column], AfterValidator(_is_permutation)]
JointNames = Annotated[list[Name], AfterValidator(_differ)]
Ranges = Annotated[Array | None, of_shape(None, 2), AfterValidator(_are_ordered)]
Limits = Annotated[Array | None, of_shape(None), AfterValidator(_are_positive)]
Children = Annotated[list[Object], AfterValidator(_children_differ)]


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
