"""`FrankaState`: the state that a simulated Franka arm sends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...base.frames import Array, inverse
from ...simulate.control.controller import Sensed
from ...simulate.control.robot_model import RobotModel
from .receiver import state_fields, state_size

_FRAMES = ("F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE")
_SINGULAR = 1e-8  # minimum det(J J^T) for which external forces are computed (our choice)


class FrankaState:
    """The state of a simulated Franka arm as a packet, whose values are written in place.

    Attributes:
        packet: bytes of the packet. Its matrices are column-major.
        views: mapping from field names (`receiver.FIELDS`) to views of their values in `packet`.
    """

    def __init__(self, version: int, model: RobotModel, cycle: float) -> None:
        self.packet = bytearray(state_size(version))
        self.views: dict[str, Any] = {
            name: np.frombuffer(self.packet, f"<{kind[-1]}", int(kind[:-1]), at)
            for name, (at, kind) in state_fields(version).items()
        }
        self._model, self._cycle = model, cycle
        self._before: Array = np.zeros(model.n)  # torques of the previous cycle, Nm
        self._frames: dict[str, Array] = {}
        for name in _FRAMES:
            self.set_frame(name, np.eye(4))

    def __setitem__(self, field: str, values: Array | Sequence[float] | float) -> None:
        view = self.views.get(field)
        if view is not None:
            view[:] = values

    def __getitem__(self, field: str) -> Any:
        return self.views[field]

    def set_frame(self, name: str, pose: Array) -> None:
        """Sets the pose of an end effector or stiffness frame (`F_T_EE`), shape (4, 4), m."""
        self._frames[name] = pose
        self[name] = pose.T.ravel()

    def measure(self, sensed: Sensed, external: Array) -> None:
        """Writes the measured values of the robot, and the values that are computed from them.

        `external` are the torques that the environment exerts on the robot, shape (7,), Nm.
        """
        self._model.update(sensed.angles, sensed.velocities)
        self["q"], self["dq"], self["tau_J"] = sensed.angles, sensed.velocities, sensed.torques
        self["theta"], self["dtheta"] = sensed.motor_angles, sensed.motor_velocities
        self["dtau_J"] = (sensed.torques - self._before) / self._cycle
        self._before[:] = sensed.torques
        elbow = float(sensed.angles[2]), 1.0 if sensed.angles[3] >= 0.0 else -1.0
        for name in ("elbow", "elbow_d", "elbow_c"):
            self[name] = elbow
        self.place(external)

    def place(self, external: Array) -> None:
        """Writes the pose of the end effector, and the force that causes the external torques.

        Franka robots report the torques that they exert, with the opposite sign of `external`.
        """
        model = self._model
        self["tau_ext_hat_filtered"] = -external
        T_base_world = inverse(model.base())
        T_base_flange = T_base_world @ model.flange()
        T_base_ee = T_base_flange @ self._frames["F_T_EE"]
        for name in ("O_T_EE", "O_T_EE_d", "O_T_EE_c"):
            self[name] = T_base_ee.T.ravel()
        # Clients read gravity from this field, which libfranka documents as {0, 0, -9.81}.
        self["O_ddP_O"] = T_base_world[:3, :3] @ model.skeleton.opt.gravity
        T_base_k = T_base_ee @ self._frames["EE_T_K"]
        jacobian, to_base = model.jacobian(), T_base_world[:3, :3]
        linear, angular = to_base @ jacobian[:3], to_base @ jacobian[3:]
        linear += _cross(angular, T_base_k[:3, 3] - T_base_flange[:3, 3])  # v_K = v_F + w x r
        full = np.vstack([linear, angular])
        square = full @ full.T
        wrench: Array = np.zeros(6)
        if np.linalg.det(square) > _SINGULAR:
            wrench[:] = np.linalg.solve(square, full @ -external)
        turn = T_base_k[:3, :3].T
        self["O_F_ext_hat_K"] = wrench
        self["K_F_ext_hat_K"] = np.concatenate([turn @ wrench[:3], turn @ wrench[3:]])


def _cross(columns: Array, vector: Array) -> Array:
    x, y, z = vector
    a, b, c = columns
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
