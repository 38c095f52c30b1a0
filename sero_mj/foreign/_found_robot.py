"""A robot found in an external model: a `SerialRobot` without a DH table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, PrivateAttr, ValidationInfo, field_validator

from ..assemble.parts import Ints, RobotPart
from ..assemble.robot import SerialRobot
from ..declaration import Array, numbers
from ..errors import DeclarationError, Problem, did_you_mean
from .model_sizes import GRAVITY, Sizes
from .model_trees import Tree

# Fields that a user can set for a found robot; the others come from the model.
FIELDS = (
    "torque_limits",
    "acceleration_limits",
    "show_arrows",
    "arrow_quantity",
    "arrow_radius",
    "arrow_width_scale",
    "arrow_dead_band",
    "offsets_to_center_of_joints",
    "show_axes",
    "axes_size",
    "axes_transparency",
    "show_billboards",
    "billboard_scale",
    "billboard_lines",
    "inputs",
    "enable_touch_sensor",
)
_FULL_WIDTH_G = 5.0  # multiple of free fall at which arrows of accelerations have full width


def _positive(value: Any) -> Any:
    """Converts one positive number, or one for each joint; inf for a joint without a limit."""
    if value is None:
        return None
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.ndim > 1:
        raise ValueError(f"found {value!r}; expected a number, or one for each joint")
    finite = numbers(np.where(np.isposinf(array), 0.0, array))
    array = np.where(np.isposinf(array), np.inf, finite)
    if (array <= 0).any():
        raise ValueError(f"found {array.tolist()}; expected positive numbers")
    return array


PerJoint = Annotated[Array, BeforeValidator(_positive)]


class FoundRobot(SerialRobot):
    """The declaration of a robot found in an external model.

    It has no DH table: the model has the joint poses, and `dh` only tells revolute from
    prismatic joints. Some fields have one value per joint where a `SerialRobot` has one for all.

    Attributes:
        joint_names: as in the model, of any characters.
        torque_limits: (n,), Nm or N, inf where unknown.
        arrow_radius: (n,) or one for all, m.
    """

    joint_names: Annotated[list[str], AfterValidator(list)] = []
    torque_limits: PerJoint | None = None
    arrow_radius: PerJoint = np.array(0.1)  # type: ignore[assignment]

    @field_validator("dh_params")
    @classmethod
    def _joint_count(cls, rows: Array, info: ValidationInfo) -> Array:
        return rows  # any number of joints

    @field_validator("arrow_radius")
    @classmethod
    def _one_or_all(cls, value: Array, info: ValidationInfo) -> Array:
        rows = info.data.get("dh_params")
        if rows is not None and value.ndim and len(value) != len(rows):
            raise ValueError(f"found {len(value)} entries; expected {len(rows)}, one per joint")
        return value

    _loads: Array | None = PrivateAttr(None)
    _axes: Array | None = PrivateAttr(None)

    @property
    def arrow_loads(self) -> Array:
        """Effort at which an arrow without limit is as wide as its radius (n,), Nm or N."""
        return super().arrow_loads if self._loads is None else self._loads

    @property
    def arrow_radii(self) -> Array:
        """Radius of every joint's arrow (n,), m."""
        return np.broadcast_to(self.arrow_radius, self.n).astype(np.float64)

    @property
    def axes_length(self) -> float:
        """Length of the axes, m."""
        return self.axes_size

    @property
    def axes_lengths(self) -> Array:
        """Length of the axes of the body that each joint moves (n,), m; smaller for fingers."""
        return np.full(self.n, self.axes_size) if self._axes is None else self._axes


@dataclass(frozen=True, eq=False)
class FoundPart(RobotPart):
    """Indices of a found robot in the model.

    Attributes:
        tree: its bodies and joints.
        size: its reach, m.
        tool: name of the frame at the end of its chain, without the robot's name.
        labels: names of its base and links, n + 1.
    """

    tree: Tree
    size: float
    tool: str
    labels: list[str]

    @property
    def flange_name(self) -> str:
        """Name of the frame at the end of its chain."""
        return f"{self.robot.name}/{self.tool}"

    @property
    def link_names(self) -> list[str]:
        """Names of its base and links, n + 1: those of the model's bodies."""
        return [f"{self.robot.name}/{label}" for label in self.labels]

    @property
    def chain(self) -> Ints:
        """Indices of its joints up to the first branch of its tree; empty if the root branches."""
        return self.tree.chain

    @property
    def reach(self) -> float:
        """Sum of the distances between joints along its chain, m."""
        return self.size


def found_robot(
    tree: Tree, revolute: Any, limits: Array, sizes: Sizes, overrides: Mapping[str, Any]
) -> SerialRobot:
    """Builds the declaration of a robot from the model, with the user's fields as overrides.

    Args:
        tree: the robot.
        revolute: True for revolute joints, (n,) bool.
        limits: torque limits, (n,), Nm or N, inf for none.
        sizes: of its decor.
        overrides: the user's fields, of `FIELDS`.

    Raises:
        DeclarationError: other fields, or values that do not fit.
    """
    problems = [
        Problem(key, f"unknown key{did_you_mean(key, FIELDS)}")
        for key in overrides
        if key not in FIELDS
    ]
    if problems:
        raise DeclarationError([problem.inside(f"robots.{tree.name}") for problem in problems])
    fields: dict[str, Any] = {
        "show_arrows": True,
        "billboard_lines": ["joint_angles", "torques"],
        "torque_limits": limits,
        "acceleration_limits": _FULL_WIDTH_G * GRAVITY / np.where(revolute, sizes.link, 1.0),
        "arrow_radius": sizes.arrow_radius,
        "axes_size": float(np.median(sizes.axes)),
        **overrides,
    }
    n = len(tree.joints)
    if np.ndim(fields["torque_limits"]) == 0 and fields["torque_limits"] is not None:
        fields["torque_limits"] = [fields["torque_limits"]] * n
    try:
        robot = FoundRobot(
            name=tree.name,
            dh_convention="craig",
            dh_params=np.zeros((n, 4)),
            joint_types=["revolute" if turns else "prismatic" for turns in revolute],
            joint_names=tree.joint_names,
            torques=np.zeros(n),  # provided by the model; billboards have to show it
            **fields,
        )
        if "arrow_width_scale" not in overrides:
            robot._loads = sizes.load
        if "axes_size" not in overrides:
            robot._axes = sizes.axes
    except DeclarationError as error:
        raise DeclarationError([p.inside(f"robots.{tree.name}") for p in error.problems]) from None
    return robot
