"""What controllers share: the method that computes torques, and declarations with gains."""

from __future__ import annotations

from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator

from ..declaration import Declaration, numbers
from ..errors import DeclarationError, Problem
from .robot_model import RobotModel
from .state import Sensed, Target

Array = NDArray[np.float64]


def _one_or_more(value: Any) -> Any:
    if value is None:
        return None
    array = numbers(value)
    if array.ndim > 1 or array.size == 0:
        raise ValueError(
            f"found {array.ndim} levels of lists; expected one number or one per joint"
        )
    return np.atleast_1d(array)


def within(low: float, high: float, unit: str = "", note: str = "") -> AfterValidator:
    """Returns a validator for arrays of numbers.

    Args:
        low: the least that is allowed.
        high: the greatest.
        unit: for the message.
        note: at its end.
    """
    unit = unit and f" {unit}"

    def validate(array: Array) -> Array:
        bad = (array < low) | (array > high)
        if bad.any():
            message = f"found {array[bad][0]:g}; expected {low:g} to {high:g}{unit}"
            raise ValueError(f"{message}{note}")
        return array

    return AfterValidator(validate)


PerJoint = Annotated[Array, BeforeValidator(_one_or_more)]
MaybePerJoint = Annotated[Array | None, BeforeValidator(_one_or_more)]
Ratio = Annotated[PerJoint, within(0.0, 2.0, "(a ratio; 1 is critical damping)")]
DEFAULT_RATIO: Array = np.array([0.7])


class Controller(Protocol):
    """Computes torques: one of the shipped controllers, or any object with this method.

    ```python
    class Wave:
        def torques(self, sensed, target, out):
            out[:] = 5.0 * np.sin(sensed.time)
    ```
    """

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the motor torques of this step.

        Args:
            sensed: what the sensors say; not to be changed.
            target: what is asked for; not to be changed.
            out: (n,), Nm or N, to be written; holds the last step's.
        """


class ControllerDeclaration(Declaration):
    """Base of the declarations of controllers; numbers per joint may be one for all.

    Attributes:
        torque_limits: (n,), Nm or N, where they are below those of the robot.
        torque_rate_limits: (n,), Nm/s or N/s; None for none.
    """

    torque_limits: MaybePerJoint = None
    torque_rate_limits: MaybePerJoint = None

    def make(self, model: RobotModel, timestep: float) -> Controller:
        """The controller, without torque limits.

        Args:
            model: what it knows of its robot; it has it for itself.
            timestep: s between two calls.

        Raises:
            DeclarationError: gains that do not fit the robot's joints.
        """
        raise NotImplementedError

    def per_joint(self, key: str, n: int) -> Array:
        """A field as (n,) numbers.

        Raises:
            DeclarationError: it has neither one nor n.
        """
        value = np.asarray(getattr(self, key))
        if len(value) not in (1, n):
            message = f"found {len(value)} entries; expected {n}, one per joint, or one for all"
            raise DeclarationError([Problem(key, message)])
        return np.array(np.broadcast_to(value, n))
