"""A plug-in: a PD controller for joints, with a slider for its bandwidth.

Its pyproject.toml has:

    [project.entry-points."sero_mj.controllers"]
    pd = "pd_controller:PD"
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from sero_mj import SerialRobot
from sero_mj.simulate.control.controller import (
    ControllerDeclaration,
    Sensed,
    Slider,
    Target,
    range_text,
)
from sero_mj.simulate.control.robot_model import RobotModel


class PD(ControllerDeclaration):
    """Computed torque: every joint follows its target as a critically damped oscillator.

    Attributes:
        bandwidth: bandwidth of the oscillator, rad/s.
    """

    title: ClassVar[str] = "computed torque"

    kind: Literal["pd"] = "pd"
    bandwidth: float = Field(15.0, gt=0, le=100)

    def make(self, model: RobotModel, timestep: float) -> ComputedTorque:
        """Returns the controller of one robot."""
        return ComputedTorque(model, self.bandwidth)

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        """Returns a slider for the bandwidth, which acts while the robot moves."""

        def fields(value: float) -> dict[str, Any]:
            return {"bandwidth": max(value, 1.0)}

        words = range_text("bandwidth", "rad/s")
        return [Slider("bandwidth", self.bandwidth, 60.0, "%.0f rad/s", fields, words)]


class ComputedTorque:
    """tau = M(q) (ddq_d + 2 w (dq_d - dq) + w^2 (q_d - q)) + g(q)."""

    def __init__(self, model: RobotModel, bandwidth: float) -> None:
        self._model, self._bandwidth = model, bandwidth

    def torques(self, sensed: Sensed, target: Target, out: np.ndarray) -> None:
        """Writes the torques of one step to `out`."""
        model, w = self._model, self._bandwidth
        model.update(sensed.motor_angles, sensed.motor_velocities)
        velocity_errors = target.velocities - sensed.motor_velocities
        accelerations = target.accelerations + 2 * w * velocity_errors
        accelerations += w**2 * (target.angles - sensed.motor_angles)
        out[:] = model.mass() @ accelerations + model.gravity()
