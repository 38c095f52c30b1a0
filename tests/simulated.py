"""Robots with masses for tests of controllers, and a plain control loop.

The LWR's masses are here until its robot file has them (then `lwr_model` is `RobotModel.of`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.control.controller import Sensed
from sero_mj.simulate.control.robot_model import RobotModel

Array = NDArray[np.float64]

# Links 1 to 7 of the LWR, rounded: mass (kg), center (m) in the joint frame, inertia (kg m2).
MASSES = (2.49, 2.49, 2.49, 2.49, 1.73, 1.62, 0.118)
CENTRES = (
    (0, 0.025, -0.08),
    (0, 0.075, 0.033),
    (0, -0.025, -0.08),
    (0, -0.075, 0.033),
    (0, 0.02, -0.11),
    (0, 0.003, 0.005),
    (0, 0, 0.06),
)
INERTIAS = (0.016, 0.015, 0.016, 0.015, 0.009, 0.003, 0.0001)
MOTORS = (3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394)  # kg m2, KDL after Jubien 2014
START = np.deg2rad([10.0, 40.0, -20.0, -80.0, 30.0, 50.0, 15.0])


@cache
def lwr_robot() -> SerialRobot:
    return SerialRobot.from_model("lwr")


def lwr_mujoco(timestep: float = 1e-3) -> tuple[mujoco.MjModel, list[int], int]:
    """Returns a model of an LWR with masses, its joint ids, and the id of the flange body."""
    world = World(Scene(robots=[lwr_robot()], floor=False))
    part, model = world.robots["lwr"], world.model
    model.body_mass[:] = 0.0
    model.body_inertia[:] = 0.0
    for body, mass, centre, inertia in zip(part.bodies[1:], MASSES, CENTRES, INERTIAS, strict=True):
        model.body_mass[body] = mass
        model.body_ipos[body], model.body_iquat[body] = centre, (1, 0, 0, 0)
        model.body_inertia[body] = inertia, inertia, 0.6 * inertia
    model.dof_armature[part.dofs] = MOTORS
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.jnt_limited[:] = 0
    model.opt.timestep = timestep
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, [int(model.dof_jntid[dof]) for dof in part.dofs], part.flange_body


def lwr_model() -> RobotModel:
    model, joints, flange = lwr_mujoco()
    return RobotModel(model, joints, body=flange, name="lwr")


class Loop:
    """A control loop of one robot, which is moved by torques."""

    def __init__(self, timestep: float = 1e-3, angles: Array = START) -> None:
        self.model, joints, self.flange = lwr_mujoco(timestep)
        self.robot = RobotModel(self.model, joints, body=self.flange, name="lwr")
        self.n = self.robot.n
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = angles
        self.sensed = Sensed(self.n)
        self.torques = np.zeros(self.n)
        self.sense()

    def sense(self) -> None:
        self.sensed.time = self.data.time
        self.sensed.angles[:] = self.data.qpos
        self.sensed.velocities[:] = self.data.qvel

    def run(
        self, seconds: float, act: Callable[[Sensed, Array], object], push: Array | None = None
    ) -> Array:
        """Returns the angles after every step, shape (steps, n).

        `act` writes torques into its second argument.
        """
        steps = round(seconds / self.model.opt.timestep)
        log = np.empty((steps, self.n))
        for row in log:
            self.sense()
            act(self.sensed, self.torques)
            self.data.qfrc_applied[:] = self.torques
            if push is not None:
                self.data.qfrc_applied[:] += push
            mujoco.mj_step(self.model, self.data)
            row[:] = self.data.qpos
        self.sense()
        return log
