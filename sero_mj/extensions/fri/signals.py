"""`FriSignals`: what an LWR on FRI measures during an example motion."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.send.motion import InverseDynamics, SineMotion
from ...robots.declared.robot import SerialRobot
from .receiver import ALL_DRIVES

_FRI_LEAD = 0.3  # s; large, so that the commanded position is visible beside the measured one
_FORCE = 40.0  # N; as when somebody leans on the tool
_MOMENT = 4.0  # Nm
_ROOM_TEMPERATURE, _WARM_UP = 28.0, 14.0  # C
_JOINT_IMPEDANCE = 3


class FriSignals:
    """Values of FRI's events at any time, consistent with each other.

    The flange frame is computed from the DH table and the rest by MuJoCo, so that a flange check
    compares two computations. The measured torques are what the motion takes less what the
    external force does; gravity torques hold the robot. FRI gives the wrench and the Jacobian in
    the task frame of the controller's stiffness; here that is the flange's frame.

    Args:
        amplitude: of the motion, 0 stands still, to 1.
    """

    def __init__(self, robot: SerialRobot, amplitude: float = 1.0) -> None:
        self._robot = robot
        self._motion = SineMotion(robot, amplitude)
        self._dynamics = InverseDynamics(robot)
        frames = self._dynamics.world.frames
        self._site = int(frames.site[frames.names.index(f"{robot.name}/flange")])

    def at(self, t: float) -> Mapping[str, Array]:
        """Returns event name to value at time t (s)."""
        model, data = self._dynamics.world.model, self._dynamics.data
        position, velocity, acceleration = self._motion.at(t)
        commanded = self._motion.at(t + _FRI_LEAD)[0]
        gravity = self._dynamics.torques(position, np.zeros(7), np.zeros(7))
        needed = self._dynamics.torques(position, velocity, acceleration)
        jacobian = np.zeros((2, 3, 7))
        mujoco.mj_jacSite(model, data, jacobian[0], jacobian[1], self._site)
        turned = data.site_xmat[self._site].reshape(3, 3).T  # the world's axes in the flange's
        jacobian = (turned @ jacobian).reshape(6, 7)
        mass = np.zeros((7, 7))
        mujoco.mj_fullM(model, data, mass)
        force = _FORCE * np.array([np.cos(0.9 * t), np.sin(0.9 * t), 0.6 * np.sin(0.5 * t)])
        moment = _MOMENT * np.array([np.sin(0.6 * t), np.cos(0.7 * t), np.sin(0.8 * t)])
        external = jacobian.T @ np.concatenate([force, moment])
        return {
            "power": np.array([ALL_DRIVES]),
            "control": np.array([_JOINT_IMPEDANCE]),
            "temperatures": self._temperatures(t),
            "joint_angles": position,
            "flange_frame": self._robot.fwd_kin_base_to_flange(position),
            "commanded_angles": commanded,
            "commanded_frame": self._robot.fwd_kin_base_to_flange(commanded),
            "torques": needed - external,
            "external_torques": external,
            "tcp_force": force,
            "tcp_moment": moment,
            "jacobian": jacobian.ravel(),
            "mass_matrix": mass.ravel(),
            "gravity_torques": gravity,
        }

    def _temperatures(self, t: float) -> Array:
        warmth = 1.0 - 0.6 * float(np.exp(-t / 300.0))
        return np.asarray(_ROOM_TEMPERATURE + _WARM_UP * warmth * np.linspace(1.0, 0.6, 7))
