"""Controller kind `fri`, with which a client of KUKA's FRI commands a simulated robot."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from ...base.errors import Problem, mismatch
from ...simulate.control.robot_model import RobotModel
from . import iiwa as fri_iiwa
from . import receiver as fri
from .iiwa_fri import IiwaFri
from .lwr_fri import LwrFri
from .robot import JOINTS, FriRobot, FriSession

# Required control mode, by quantity that a client commands in addition to joint positions.
_REQUIRED_CONTROL = {"wrench": "cartesian_impedance", "torque": "joint_impedance"}


class FriClient(FriSession):
    """An FRI client. The simulated robot is an LWR, an iiwa or another robot with 7 joints."""

    logged: ClassVar[tuple[str, ...]] = ("fri_state", "fri_quality", "step_lateness")
    title: ClassVar[str] = "FRI client"
    order: ClassVar[int] = 75
    protocol_joints: ClassVar[int] = JOINTS

    kind: Literal["fri"] = "fri"
    port: int = Field(fri.PORT, ge=0, le=65535)

    @model_validator(mode="before")
    @classmethod
    def _port_follows_version(cls, fields: dict[str, Any]) -> dict[str, Any]:
        if fields.get("version", "1") != "1" and "port" not in fields:
            return {**fields, "port": fri_iiwa.PORT}
        return fields

    @model_validator(mode="after")
    def _fields_fit_each_other(self) -> Self:
        low, high = fri.CYCLES  # this range also applies to an iiwa
        if self.cycle and not low <= self.cycle <= high:
            raise mismatch(self.cycle, f"{low} to {high} s", key="cycle")
        required = _REQUIRED_CONTROL.get(self.command_mode)
        if self.version == "1" and required:
            expected = "position, because FRI 1.0 commands select quantities by flags"
            raise mismatch(self.command_mode, expected, key="command_mode")
        if required and required != self.control:
            expected = f"{required} with command_mode = '{self.command_mode}'"
            raise mismatch(self.control, expected, key="control")
        return self

    def make(self, model: RobotModel, timestep: float) -> FriRobot:
        if model.n != JOINTS:
            reason = f"FRI requires {JOINTS} joints, but {model.name} has {model.n}"
            raise Problem("kind", reason).error()
        cycle = self.cycle or timestep
        steps = self.steps_per_cycle(cycle, timestep)
        if cycle < fri.CYCLES[0] - 1e-9:
            expected = f"{fri.CYCLES[0]} s or more, because the time step is {timestep:g} s"
            raise mismatch(self.cycle, expected, key="cycle")
        if self.version == "1":
            return LwrFri(self, model, timestep, steps)
        if abs(cycle - round(cycle, 3)) > 1e-9:
            raise mismatch(cycle, "whole milliseconds", key="cycle")
        return IiwaFri(self, model, timestep, steps)
