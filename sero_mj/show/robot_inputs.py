"""`RobotInputs`: the inputs of one robot or double as attributes, for viewers and overlays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
from numpy.typing import ArrayLike

from ..assemble.world_view import WorldView
from ..decor.quantities import joint_values
from ..errors import UnknownName
from ..frames import Array


class HasInputs(Protocol):
    """A viewer or an overlay."""

    @property
    def world(self) -> WorldView:
        """Its robots and inputs."""

    @property
    def data(self) -> mujoco.MjData:
        """The state of the world."""

    def set(self, target: str, values: Any) -> None:
        """Sets an input by its full name."""


class JointInput:
    """An attribute with one value per joint, (n,), SI units; NaN means no data.

    An overlay also takes a mapping from joint names to numbers and, except for joint angles, a
    vector of its whole model, (nv,).
    """

    def __set_name__(self, owner: type, name: str) -> None:
        """Stores the name of the attribute, which is that of the input."""
        self._key = name

    def __get__(self, robot: RobotInputs, owner: type) -> Array:
        """Returns a copy of the current values."""
        world = robot._of.world
        part = world.owners[robot._name]
        return joint_values(world, robot._of.data)[self._key][part.joints].copy()

    def __set__(self, robot: RobotInputs, values: ArrayLike | Mapping[str, float]) -> None:
        """Sets all values."""
        robot.set(self._key, values)


class RobotInputs:
    """The inputs of one robot or double.

    Additional inputs that a robot declares (`inputs = ["temperatures"]`), frames and toggles are
    set by `set`, or as attributes too.

    Args:
        of: what has the robot.
        name: of the robot or double.

    Attributes:
        joint_angles: (n,), rad or m; those of an overlay's robot are read-only.
        torques: measured, (n,), Nm or N.
        commanded_torques: (n,), Nm or N.
        joint_accelerations: (n,), rad/s2 or m/s2.
        billboard_values: (n,).

    Raises:
        UnknownName: no robot or double of that name; suggests the nearest one.
    """

    __slots__ = ("_name", "_of")

    joint_angles = JointInput()
    torques = JointInput()
    commanded_torques = JointInput()
    joint_accelerations = JointInput()
    billboard_values = JointInput()

    def __init__(self, of: HasInputs, name: str) -> None:
        if name not in of.world.owners:
            raise UnknownName("robot", name, of.world.owners)
        object.__setattr__(self, "_of", of)
        object.__setattr__(self, "_name", name)

    if TYPE_CHECKING:
        _of: HasInputs
        _name: str
    else:

        def __setattr__(self, key: str, values: Any) -> None:
            """Sets an input; so a mistyped attribute is an error that suggests the nearest one."""
            self.set(key, values)

    def set(self, key: str, values: Any) -> None:
        """Sets an input by name.

        Args:
            key: `torques`, `temperatures`, `base_frame`, `show_axes`, ...
            values: of the input's shape, SI units.

        Raises:
            UnknownName: no such input; suggests the nearest one.
            ValueError: the values do not fit the input.
        """
        self._of.set(f"{self._name}.{key}", values)
