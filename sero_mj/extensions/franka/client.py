"""`kind = "franka"`: a client of libfranka holds a simulated robot, which answers as its FCI."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from ...base.errors import (
    mismatch,
)
from ...simulate.control.controller import PerJoint, Ratio, within
from ...simulate.control.joint_control import MAX_STIFFNESS
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.program_controller import Reachable
from .motion import CYCLE, JOINTS
from .receiver import NEWEST, OLDEST, PORT
from .robot import FrankaRobot


class FrankaClient(Reachable):
    """A client of Franka's FCI; the simulated robot is an FR3 or a Panda, or another of 7 joints.

    Attributes:
        host: address that the robot has; those of the machine itself are 127.0.0.1 to
            127.255.255.254, so that each of several robots can have one.
        port: its port; libfranka's clients know 1337 alone. 0 with `{port}` in `command`: a free
            one.
        command: starts the program, as for `udp`; a run goes on after one that ends with status 0.
        clock: `real_time`: a state each millisecond; `lockstep`: time waits for each command of a
            motion, and between motions for the next one.
        patience: s to wait in lockstep for a command, and between two motions.
        first_patience: s to wait for the first client, and for the first command of a motion.
        version: of the robot's server, which libfranka has to fit: 5 for 0.9, 6 for 0.10 to 0.13,
            7 for 0.13.6, 8 for 0.14, 9 for 0.15 to 0.17, 10 from 0.18 on and for pylibfranka.
        stiffness: Nm/rad per joint, of the robot's own control, until the client sets another one.
            Default: that of libfranka's examples.
        damping: ratio per joint, likewise.
    """

    logged: ClassVar[tuple[str, ...]] = (
        "franka_state",
        "command_success_rate",
        "command_age",
        "step_lateness",
    )
    title: ClassVar[str] = "client of libfranka"
    order: ClassVar[int] = 80
    protocol_joints: ClassVar[int] = JOINTS

    kind: Literal["franka"] = "franka"
    port: int = Field(PORT, ge=0, le=65535)
    version: int = Field(NEWEST, ge=OLDEST, le=NEWEST)
    stiffness: Annotated[PerJoint, within(0.0, MAX_STIFFNESS, "Nm/rad")] = np.array(
        [3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0]
    )
    damping: Ratio = np.array([1.0])

    def make(self, model: RobotModel, timestep: float) -> FrankaRobot:
        steps = round(CYCLE / timestep)
        if steps < 1 or abs(steps * timestep - CYCLE) > 1e-9:
            reason = "FCI has cycles of 1 ms; the time step is"
            expected = "1 ms divided by a whole number"
            raise mismatch(1e3 * timestep, expected, reason, key="kind", of="ms")
        gains = [self.per_joint(key, JOINTS) for key in ("stiffness", "damping")]
        return FrankaRobot(self, model, timestep, steps, self.version, *gains)
