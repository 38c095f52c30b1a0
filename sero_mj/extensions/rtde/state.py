"""`RtdeState`: the output values of a simulated robot on RTDE."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from mujoco import mju_mat2Quat, mju_quat2Vel

from ...base.frames import Array, inverse
from ...simulate.control.controller import Sensed
from ...simulate.control.observer import MomentumObserver
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.commanded_motion import CommandedMotion
from .variables import CONSTANT, OUTPUTS

JOINTS = 6
_POWER_ON, _PROGRAM_RUNNING = 1, 2  # bits of robot_status_bits
_NORMAL = 1  # safety mode, and bit of safety_status_bits
_RUNNING = 7  # robot mode
_STOPPED, _PLAYING = 1, 2  # runtime states
_BANDWIDTH = 25.0  # bandwidth of the observer of external torques, 1/s
# Minimum singular value of the Jacobian, relative to the largest one, for forces to be reported.
_SINGULAR = 1e-2


class RtdeState:
    """Computes RTDE output values on demand, and caches them for one cycle.

    Poses are those of the flange in the robot base, with rotation vectors in rad. Velocities and
    forces are in base directions. Sensors measure `actual_current_as_torque`. `actual_TCP_force` is
    the external force estimated by a momentum observer.

    Args:
        model: model of the robot, which the controller must update first.
        constants: torque constants, shape (n,), Nm/A. If None, currents are 0.
    """

    def __init__(
        self,
        model: RobotModel,
        motion: CommandedMotion,
        timestep: float,
        constants: Array | None,
    ) -> None:
        self.registers: dict[str, Any] = {}
        self.is_running = False
        self._model, self._motion, self._constants = model, motion, constants
        self._observer = MomentumObserver(model, _BANDWIDTH, timestep)
        self._cache: dict[str, Any] = {}
        self._sensed = Sensed(JOINTS)
        self._commanded: Array = np.zeros(JOINTS)
        self._last: Array = np.zeros(JOINTS)
        self._target_speeds: Array = np.zeros(JOINTS)
        self._speed_slider = 1.0
        self._digital = 0
        self._still: Array = np.zeros(JOINTS)
        self._values: Mapping[str, Callable[[], Any]] = {
            "timestamp": lambda: self._sensed.time,
            "actual_q": lambda: self._sensed.angles,
            "actual_qd": lambda: self._sensed.velocities,
            "actual_current_as_torque": lambda: self._sensed.torques,
            "actual_current": lambda: self._currents(self._sensed.torques),
            "joint_control_output": lambda: self._currents(self._commanded),
            "target_current": lambda: self._currents(self._commanded),
            "target_moment": lambda: self._commanded,
            "target_q": lambda: self._motion.angles,
            "target_qd": lambda: self._target_speeds,
            "target_qdd": lambda: self._motion.accelerations,
            "actual_TCP_pose": self._actual_pose,
            "target_TCP_pose": self._target_pose,
            "actual_TCP_speed": lambda: self._twist(self._sensed.velocities),
            "target_TCP_speed": lambda: self._twist(self._target_speeds),
            "actual_TCP_force": self._wrench,
            "ft_raw_wrench": lambda: self.value("actual_TCP_force"),
            "tcp_force_scalar": lambda: float(np.linalg.norm(self.value("actual_TCP_force")[:3])),
            "robot_mode": lambda: _RUNNING,
            "safety_mode": lambda: _NORMAL,
            "robot_status_bits": lambda: _POWER_ON | _PROGRAM_RUNNING * self.is_running,
            "safety_status_bits": lambda: _NORMAL,
            "runtime_state": lambda: _PLAYING if self.is_running else _STOPPED,
            "target_speed_fraction": lambda: self._speed_slider,
            "actual_digital_output_bits": lambda: self._digital,
        }

    def observe(self, sensed: Sensed, commanded: Array) -> None:
        """Called in each step with the torques commanded in the previous step, shape (n,), Nm."""
        self._observer.update(sensed)
        self._sensed = sensed
        self._commanded[:] = commanded

    def begin_cycle(self, cycle: float) -> None:
        """Clears the cache at the start of a cycle. `cycle` is the time since the last call, s."""
        self._cache.clear()
        np.subtract(self._motion.angles, self._last, self._target_speeds)
        self._target_speeds /= cycle
        self._last[:] = self._motion.angles

    def value(self, name: str) -> Any:
        value = self.registers.get(name)
        if value is None and name in CONSTANT:
            value = CONSTANT[name][1]
        if value is None and (value := self._cache.get(name)) is None:
            compute = self._values.get(name)
            if compute is None:  # a register that was never set
                value = False if OUTPUTS[name] == "BOOL" else 0
            else:
                value = compute()
                if isinstance(value, np.ndarray):
                    value = value.tolist()
                self._cache[name] = value
        return value

    def take(self, inputs: Mapping[str, Any]) -> None:
        self.registers.update({name: inputs[name] for name in inputs if "_register" in name})
        for name, first, bits in (("standard", 0, 8), ("configurable", 8, 8), ("tool", 16, 2)):
            mask = inputs.get(f"{name}_digital_output_mask", 0) & ((1 << bits) - 1)
            state = inputs.get(f"{name}_digital_output", 0)
            self._digital = self._digital & ~(mask << first) | (state & mask) << first
        if inputs.get("speed_slider_mask") and "speed_slider_fraction" in inputs:
            self._speed_slider = float(np.clip(inputs["speed_slider_fraction"], 0.0, 1.0))

    def _currents(self, torques: Array) -> Array:
        return self._still if self._constants is None else torques / self._constants

    def _actual_pose(self) -> Array:
        model = self._model
        T = inverse(model.base()) @ model.flange()
        quat, turn = np.zeros(4), np.zeros(3)
        mju_mat2Quat(quat, T[:3, :3].ravel())
        mju_quat2Vel(turn, quat, 1.0)
        return np.concatenate((T[:3, 3], turn))

    def _target_pose(self) -> Array:
        model, sensed = self._model, self._sensed
        model.update(self._motion.angles, self._still)
        pose = self._actual_pose()
        model.update(sensed.motor_angles, sensed.motor_velocities)
        return pose

    def _jacobian(self) -> Array:
        back = self._model.base()[:3, :3].T
        return np.kron(np.eye(2), back) @ self._model.jacobian()

    def _twist(self, speeds: Array) -> Array:
        return self._jacobian() @ speeds

    def _wrench(self) -> Array:
        # tau = J^T F; near a singularity, the smallest force that explains the torques.
        external = self._observer.external
        found = np.linalg.lstsq(self._jacobian().T, external, rcond=_SINGULAR)[0]
        return np.asarray(found, np.float64)
