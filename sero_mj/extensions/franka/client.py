"""The controller kind `franka`: a libfranka client controls a simulated robot over FCI."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from ...base.errors import Problem, mismatch
from ...simulate.control.controller import PerJoint, Ratio, within
from ...simulate.control.joint_control import MAX_STIFFNESS
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.program_controller import Reachable
from .motion import CYCLE, JOINTS
from .receiver import NEWEST, OLDEST, PORT
from .robot import FrankaRobot


class FrankaClient(Reachable):
    """A libfranka client that controls a simulated FR3, Panda, or other robot with 7 joints.

    Attributes:
        host: address of the robot. Several robots can use different addresses of this machine,
            127.0.0.1 to 127.255.255.254.
        port: port of the robot (libfranka clients always use 1337). If the port is 0, a free port
            is selected and replaces `{port}` in `command`.
        command: command that starts the program, as for `udp`. If the program exits with status 0,
            the run continues.
        clock: `real_time` to send a state every millisecond, or `lockstep` to stop the simulation
            until each command of a motion arrives, and between motions until the next motion.
        patience: in lockstep, maximum time in s to wait for a command of a motion, and between
            motions for the next motion.
        first_patience: time in s to wait for the first client, and for the first command of a
            motion.
        version: server version of the robot, which must match libfranka: 5 for libfranka 0.9, 6 for
            0.10 to 0.13, 7 for 0.13.6, 8 for 0.14, 9 for 0.15 to 0.17, 10 from 0.18 on and for
            pylibfranka.
        stiffness: stiffness of the internal joint impedance control, Nm/rad per joint, until the
            client changes it (default: the stiffness in the examples of libfranka).
        damping: damping ratio of the internal joint impedance control per joint.
    """

    logged: ClassVar[tuple[str, ...]] = (
        "franka_state",
        "command_success_rate",
        "command_age",
        "step_lateness",
    )
    title: ClassVar[str] = "libfranka client"
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
        if model.n != JOINTS:
            reason = f"FCI requires {JOINTS} joints, but {model.name} has {model.n}"
            raise Problem("kind", reason).error()
        steps = round(CYCLE / timestep)
        if steps < 1 or abs(steps * timestep - CYCLE) > 1e-9:
            reason = "FCI cycles last 1 ms, but the time step is"
            expected = "1 ms divided by an integer"
            raise mismatch(1e3 * timestep, expected, reason, key="kind", of="ms")
        gains = [self.per_joint(key, JOINTS) for key in ("stiffness", "damping")]
        return FrankaRobot(self, model, timestep, steps, self.version, *gains)
