"""`RobotInputs`: attributes that set the inputs of one robot or double of a viewer or overlay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import UnknownName
from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import joint_values


class HasInputs(Protocol):
    """Interface of viewers and overlays, whose inputs a program sets."""

    @property
    def world(self) -> WorldView: ...

    @property
    def data(self) -> mujoco.MjData: ...

    def set(self, target: str, values: Any) -> None: ...


class JointInput:
    """Attribute of `RobotInputs` with one value per joint in SI units, shape (n,); NaN for no data.

    An overlay also accepts a mapping from joint names to numbers. Except for joint angles, it also
    accepts a vector for the whole model, shape (nv,).
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._key = name

    def __get__(self, robot: RobotInputs, owner: type) -> Array:
        world = robot._of.world
        values = joint_values(world, robot._of.data)[self._key]
        members = world.scene.members(robot._name) or [robot._name]
        return np.concatenate([values[world.owners[name].joints] for name in members])

    def __set__(self, robot: RobotInputs, values: ArrayLike | Mapping[str, float]) -> None:
        robot.set(self._key, values)


class RobotInputs:
    """The inputs of a robot, a double or a group as attributes, which a program can set.

    The values of a group are those of its robots, one robot after the other. Additional inputs that
    a robot declares (`inputs = ["temperatures"]`), frames and toggles can also be set with `set` or
    as attributes.

    Attributes:
        joint_angles: joint angles, shape (n,), rad or m; read-only for robots of an overlay.
        torques: measured torques, shape (n,), Nm or N.
        commanded_torques: commanded torques, shape (n,), Nm or N.
        joint_accelerations: joint accelerations, shape (n,), rad/s2 or m/s2.
        billboard_values: values that the billboards of the joints show, shape (n,).

    Raises:
        UnknownName: there is no such robot, double or group. The message suggests a similar name.
    """

    __slots__ = ("_name", "_of")

    joint_angles = JointInput()
    torques = JointInput()
    commanded_torques = JointInput()
    joint_accelerations = JointInput()
    billboard_values = JointInput()

    def __init__(self, of: HasInputs, name: str) -> None:
        scene = of.world.scene
        known = [*of.world.owners, *scene.groups, *scene.double_groups]
        if name not in known:
            raise UnknownName("robot", name, known)
        object.__setattr__(self, "_of", of)
        object.__setattr__(self, "_name", name)

    if TYPE_CHECKING:
        _of: HasInputs
        _name: str
    else:

        def __setattr__(self, key: str, values: Any) -> None:
            self.set(key, values)

    def set(self, key: str, values: Any) -> None:
        """Sets an input by name, such as `torques`.

        Raises:
            UnknownName: there is no such input. The message suggests a similar name.
            ValueError: the values do not have the shape or range of the input.
        """
        self._of.set(f"{self._name}.{key}", values)
