"""The momentum observer: torques from outside, without measuring accelerations."""

from __future__ import annotations

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array
from .controller import Sensed
from .robot_model import RobotModel
from .robot_models import RobotModels


class MomentumObserver:
    """External joint torques r(t) of one robot, a first-order low pass of the true ones.

    With the momentum p = M dq and dp/dt = tau + C^T dq - g + tau_ext,

        r = k (p(t) - p(0) - integral of (tau + C^T dq - g + r)),    dr/dt = k (tau_ext - r):

    each joint follows its own external torque with time constant 1 / k. Neither accelerations nor
    the inverse of M are needed (De Luca, Albu-Schäffer, Haddadin, Hirzinger 2006, Collision
    Detection and Safe Reaction with the DLR-III Lightweight Manipulator Arm, IROS). C^T dq is
    exact, see `RobotModel.write_momentum`.

    With torques measured on the link side, p is the momentum of the links alone: the motors with
    their friction are on the other side of the sensor. With motor torques, `motor_side=True`
    counts the motors' inertia, and their friction is taken for torques from outside.

    A torque is taken to have acted during the step that ends with the angles it is given with, as
    in a loop that sets a torque, steps, and senses; what depends on the state is averaged over the
    step. r is solved for at the end of the step, so every gain is stable.

    Args:
        model: for itself, or shared with a controller that updates it; of many equal robots, which
            are then the first axis of all.
        gain: k, 1/s, one number or (n,), or (m, n); its inverse is the time constant.
        timestep: s between two calls.
        motor_side: whether torques are those of the motors.

    Attributes:
        external: (n,), Nm or N, the estimate r; the same array at every step.

    Raises:
        ValueError: a gain that is not positive.
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
                    expected="a positive one, 1/s",
                ).error()
        self.external: Array = np.zeros(shape)
        self._timestep, self._gains = timestep, gains
        self._scale: Array = gains / (1.0 + gains * timestep)
        self._motors: Array | None = model.motor_inertia.copy() if motor_side else None
        self._sum, self._momentum, self._own, self._before = np.zeros((4, *shape))
        self._has_begun = False  # whether `_before` has C^T dq - g of the last step

    def update(self, sensed: Sensed) -> Array:
        """Takes one step and returns `external`."""
        self.model.update(sensed.angles, sensed.velocities)
        return self.update_with(sensed.velocities, sensed.torques)

    def update_with(self, velocities: Array, torques: Array) -> Array:
        """The same with the model already updated, as a controller may have done it.

        Args:
            velocities: (n,), those that the model was updated with.
            torques: (n,), Nm or N, of the step that led there.
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
