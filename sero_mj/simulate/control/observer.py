"""`MomentumObserver`: estimates external torques without measured accelerations."""

from __future__ import annotations

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array
from .controller import Sensed
from .robot_model import RobotModel
from .robot_models import RobotModels


class MomentumObserver:
    """Estimates external joint torques r(t), which follow the true torques with a first-order lag.

    With the momentum p = M dq and dp/dt = tau + C^T dq - g + tau_ext, the estimate is

        r = k (p(t) - p(0) - integral of (tau + C^T dq - g + r)),    dr/dt = k (tau_ext - r).

    Each joint follows its own external torque with the time constant 1 / k. Neither accelerations
    nor the inverse of M are needed (De Luca, Albu-Schäffer, Haddadin, Hirzinger 2006, Collision
    Detection and Safe Reaction with the DLR-III Lightweight Manipulator Arm, IROS). C^T dq is
    exact, see `RobotModel.write_momentum`.

    If torques are measured on the link side, p is the momentum of the links alone, because the
    motors and their friction are on the other side of the sensor. If they are motor torques
    (`motor_side`), p includes the motors, and friction is estimated as an external torque.

    A torque acts during the step that ends with the measured state. Terms that depend on the state
    are averaged over the step. r is computed implicitly, so every gain is stable.

    Args:
        model: robot model, which may be shared with a controller that updates it.
        gain: observer gain k, scalar or shape (n,) or (m, n), 1/s.
        timestep: time between two calls, s.
        motor_side: whether the torques are motor torques.

    Attributes:
        external: estimated torques r, shape (n,) or (m, n), Nm or N; updated in place.

    Raises:
        ValueError: a gain is not positive.
    """

    def __init__(
        self,
        model: RobotModel | RobotModels,
        gain: float | Array,
        timestep: float,
        *,
        motor_side: bool = False,
    ) -> None:
        shape = (*model.rows, model.n)
        self.model = model
        gains: Array = np.array(np.broadcast_to(gain, shape), float)
        for name, value in zip(model.joint_names, np.atleast_2d(gains).min(axis=0), strict=True):
            if not value > 0.0:
                raise Problem(
                    "",
                    f"joint {name} has an observer gain of",
                    found=value,
                    expected="a positive gain, 1/s",
                ).error()
        self.external: Array = np.zeros(shape)
        self._timestep, self._gains = timestep, gains
        self._scale: Array = gains / (1.0 + gains * timestep)
        self._motors: Array | None = model.motor_inertia.copy() if motor_side else None
        self._sum, self._momentum, self._own, self._before = np.zeros((4, *shape))
        self._has_begun = False  # whether `_before` contains C^T dq - g of the last step

    def update(self, sensed: Sensed) -> Array:
        """Makes one step and returns `external`."""
        self.model.update(sensed.angles, sensed.velocities)
        return self.update_with(sensed.velocities, sensed.torques)

    def update_with(self, velocities: Array, torques: Array) -> Array:
        """Makes one step after the model was updated to `velocities`, and returns `external`.

        `torques`, shape (n,), Nm or N, acted in the step that led to this state.
        """
        momentum, own = self._momentum, self._own
        self.model.write_momentum(momentum, own)
        if self._motors is not None:
            momentum += self._motors * velocities
        if not self._has_begun:
            self._sum[:], self._has_begun = momentum, True
        else:
            self._sum += ((own + self._before) * 0.5 + torques) * self._timestep
            self.external[:] = (momentum - self._sum) * self._scale
            self._sum += self.external * self._timestep
        self._own, self._before = self._before, own
        return self.external
