"""The momentum observer: torques from outside, without measuring accelerations."""

from __future__ import annotations

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array
from .controller import Sensed
from .robot_model import RobotModel


class MomentumObserver:
    """External joint torques r(t) of one robot, a first-order low pass of the true ones.

    With the momentum p = M dq and dp/dt = tau + C^T dq - g + tau_ext,

        r = k (p(t) - p(0) - integral of (tau + C^T dq - g + r)),    dr/dt = k (tau_ext - r):

    each joint follows its own external torque with time constant 1 / k. Neither accelerations nor
    the inverse of M are needed (De Luca, Albu-Schäffer, Haddadin, Hirzinger 2006, Collision
    Detection and Safe Reaction with the DLR-III Lightweight Manipulator Arm, IROS). C^T dq is
    exact, see `RobotModel.transposed_coriolis`.

    With torques measured on the link side, p is the momentum of the links alone: the motors with
    their friction are on the other side of the sensor. With motor torques, `motor_side=True`
    counts the motors' inertia, and their friction is taken for torques from outside.

    A torque is taken to have acted during the step that ends with the angles it is given with, as
    in a loop that sets a torque, steps, and senses; what depends on the state is averaged over the
    step. r is solved for at the end of the step, so every gain is stable.

    Args:
        model: for itself, or shared with a controller that updates it.
        gain: k, 1/s, one number or (n,); its inverse is the time constant.
        timestep: s between two calls.
        motor_side: whether torques are those of the motors.

    Attributes:
        external: (n,), Nm or N, the estimate r; the same array at every step.

    Raises:
        ValueError: a gain that is not positive.
    """

    def __init__(
        self,
        model: RobotModel,
        gain: float | Array,
        timestep: float,
        *,
        motor_side: bool = False,
    ) -> None:
        n = model.n
        self.model = model
        gains: Array = np.array(np.broadcast_to(gain, n), float)
        for name, value in zip(model.joint_names, gains, strict=True):
            if not value > 0.0:
                raise Problem(
                    "",
                    f"joint {name} has an observer gain of",
                    found=value,
                    expected="a positive one, 1/s",
                ).error()
        self.external: Array = np.zeros(n)
        self._timestep = timestep
        self._scale: Array = gains / (1.0 + gains * timestep)
        self._motors: Array | None = model.motor_inertia.copy() if motor_side else None
        self._sum: Array = np.zeros(n)
        self._before: Array | None = None  # C^T dq - g of the last step

    def update(self, sensed: Sensed) -> Array:
        """Takes one step and returns `external`.

        Args:
            sensed: angles, velocities, and the torques that led there.
        """
        self.model.update(sensed.angles, sensed.velocities)
        return self.update_with(sensed.velocities, sensed.torques)

    def update_with(self, velocities: Array, torques: Array) -> Array:
        """The same with the model already updated, as a controller may have done it.

        Args:
            velocities: (n,), those that the model was updated with.
            torques: (n,), Nm or N, of the step that led there.
        """
        model = self.model
        momentum = model.link_momentum()
        if self._motors is not None:
            momentum = momentum + self._motors * velocities
        own: Array = model.transposed_coriolis() - model.gravity()
        if self._before is None:
            self._sum[:] = momentum
        else:
            self._sum += ((own + self._before) * 0.5 + torques) * self._timestep
            self.external[:] = (momentum - self._sum) * self._scale
            self._sum += self.external * self._timestep
        self._before = own
        return self.external
