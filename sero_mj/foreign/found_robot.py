"""A robot that was found in a model: what decor knows of a `SerialRobot`, without a DH table."""

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

# What may be said of a robot that was found; all else is as the model has it.
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
_FULL_WIDTH_G = 5.0  # accelerations are at full width at this many times free fall


def _positive(value: Any) -> Any:
    """One positive number, or one for each joint; inf for a joint without a limit."""
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
    """What decor needs to know of a robot in somebody else's model.

    It has no table: where its joints are is what the model says. `dh` only says which of them
    turn. Its numbers may differ from joint to joint where a `SerialRobot` has one for all.

    Attributes:
        joint_names: as the model has them, of any characters.
        torque_limits: (n,), inf where nothing is known.
        arrow_radius: (n,) or one for all, m.
    """

    joint_names: Annotated[list[str], AfterValidator(list)] = []
    torque_limits: PerJoint | None = None
    arrow_radius: PerJoint = np.array(0.1)  # type: ignore[assignment]

    @field_validator("dh_params")
    @classmethod
    def _joint_count(cls, rows: Array, info: ValidationInfo) -> Array:
        return rows  # as many as the model has

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
        """At which torque an arrow without limit is as wide as its radius (n,), Nm or N."""
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
        """Length of the axes of what each joint moves (n,), m: a finger's are smaller."""
        return np.full(self.n, self.axes_size) if self._axes is None else self._axes


@dataclass(frozen=True, eq=False)
class FoundPart(RobotPart):
    """Where a found robot is in the model.

    Attributes:
        tree: its bodies and joints.
        size: its reach, m.
        tool: name of the frame at the end of its chain, without the robot's.
        labels: what its links are called, (n + 1).
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
        """Which of its joints lead to where it first branches; none where that is at once."""
        return self.tree.chain

    @property
    def reach(self) -> float:
        """The sum of the distances along its chain, m."""
        return self.size


def found_robot(
    tree: Tree, revolute: Any, limits: Array, sizes: Sizes, said: Mapping[str, Any]
) -> SerialRobot:
    """Makes the declaration of a robot from what the model says, and the user over it.

    Args:
        tree: the robot.
        revolute: which of its joints turn, (n,).
        limits: of their torques, (n,), inf where there is none.
        sizes: of its decor.
        said: fields of `FIELDS`.

    Raises:
        DeclarationError: other fields, or values that do not fit.
    """
    problems = [
        Problem(key, f"unknown key{did_you_mean(key, FIELDS)}") for key in said if key not in FIELDS
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
        **said,
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
            torques=np.zeros(n),  # comes from the model, which billboards must know
            **fields,
        )
        if "arrow_width_scale" not in said:
            robot._loads = sizes.load
        if "axes_size" not in said:
            robot._axes = sizes.axes
    except DeclarationError as error:
        raise DeclarationError([p.inside(f"robots.{tree.name}") for p in error.problems]) from None
    return robot
