"""The controllers by their names in files, and how one gets to work on a robot."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DeclarationError, Problem
from ..kinds import by_kind
from .cartesian_control import CartesianImpedance
from .gains import ControllerDeclaration
from .joint_control import GravityCompensation, JointImpedance, JointPosition, Torque
from .robot_model import RobotModel
from .torque_limits import Controller, LimitedController

Array = NDArray[np.float64]

CONTROLLERS: dict[str, type[ControllerDeclaration]] = {
    "gravity_compensation": GravityCompensation,
    "joint_position": JointPosition,
    "joint_impedance": JointImpedance,
    "cartesian_impedance": CartesianImpedance,
    "torque": Torque,
}


def controller_from(table: Any) -> ControllerDeclaration:
    """Builds the declaration of a controller from a table of a file.

    Args:
        table: `kind` and its fields; a declaration comes back as it is.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return by_kind(table, CONTROLLERS, ControllerDeclaration)


def make_controller(
    controller: ControllerDeclaration | Controller,
    model: RobotModel,
    timestep: float,
    torque_limits: Array | None = None,
) -> LimitedController:
    """Puts a controller to work behind the torque limits of its robot.

    Args:
        controller: a declaration, or any object with the method `torques` of `Controller`.
        model: what the controller knows of its robot; for it alone.
        timestep: s between two calls.
        torque_limits: the robot's, (n,), Nm or N; None where it has none.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
    """
    n = model.n
    limits: Array = np.full(n, np.inf) if torque_limits is None else np.array(torque_limits, float)
    rates = None
    if isinstance(controller, ControllerDeclaration):
        own = controller
        controller = own.make(model, timestep)
        if own.torque_limits is not None:
            limits = _lower(own.per_joint("torque_limits", n), limits, model.joint_names)
        if own.torque_rate_limits is not None:
            rates = own.per_joint("torque_rate_limits", n)
    elif isinstance(controller, type):
        message = (
            f"found the class {controller.__name__}; expected an object: {controller.__name__}()"
        )
        raise DeclarationError([Problem("", message)])
    elif not callable(getattr(controller, "torques", None)):
        message = f"found {controller!r}; expected a method torques(sensed, target, out)"
        raise DeclarationError([Problem("", message)])
    return LimitedController(
        controller, limits, timestep, rates, robot=model.name, joint_names=model.joint_names
    )


def _lower(own: Array, robots: Array, names: list[str]) -> Array:
    """A controller's limits, which may not be above those of its robot."""
    problems = [
        Problem("torque_limits", f"joint {name} has {a:g}; expected up to {b:g}, the robot's")
        for name, a, b in zip(names, own, robots, strict=True)
        if a > b
    ]
    if problems:
        raise DeclarationError(problems)
    return own
