"""`kind = "rtde"`: a client of Universal Robots' RTDE holds a simulated robot of six joints."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from ...base.errors import (
    Problem,
    mismatch,
)
from ...simulate.control.robot_model import RobotModel
from . import receiver as rtde
from .robot import RtdeRobot, RtdeSession
from .state import JOINTS


class RtdeClient(RtdeSession):
    """A client of RTDE; the simulated robot listens as a controller of Universal Robots does."""

    logged: ClassVar[tuple[str, ...]] = ("rtde_state", "command_age", "step_lateness")
    title: ClassVar[str] = "client of RTDE"
    order: ClassVar[int] = 77
    protocol_joints: ClassVar[int] = JOINTS

    kind: Literal["rtde"] = "rtde"
    port: int = Field(rtde.PORT, ge=0, le=65535)

    @model_validator(mode="after")
    def _fields_fit_each_other(self) -> Self:
        if self.interface == "ur_rtde" and "first_register" in self.model_fields_set:
            reason = "is for interface = 'position' or 'torque'; leave it out"
            raise Problem("first_register", reason).error()
        constants = self.torque_constants
        if constants is not None and not (constants > 0.0).all():
            worst = float(constants.min())
            raise mismatch(worst, "positive ones, Nm/A", key="torque_constants")
        return self

    def make(self, model: RobotModel, timestep: float) -> RtdeRobot:
        steps = round(self.cycle / timestep)
        if steps < 1 or abs(steps * timestep - self.cycle) > 1e-9:
            expected = f"a multiple of the time step, {timestep:g} s"
            raise mismatch(self.cycle, expected, key="cycle")
        return RtdeRobot(self, model, timestep, steps)
