"""Controllers of many equal robots at once: the laws of `joint_control` for (m, n) arrays.

MuJoCo computes the dynamics of all robots in one call, numpy the rest in a few.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod

import mujoco
import numpy as np
from mujoco.batch import Batch

from ..control.joint_control import JointImpedance, design_damping
from ..control.robot_model import RobotModel
from ..frames import Array, Bools, Ints

_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_UNUSED = int(
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    | mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_SPRING
    | mujoco.mjtDisableBit.mjDSBL_DAMPER
    | mujoco.mjtDisableBit.mjDSBL_ISLAND
)


class ManyTargets:
    """What m robots of n joints are to do; `Target` for one.

    Attributes:
        state: (m, 2n), angles, then velocities, so that one operation takes both.
        angles: (m, n), rad or m; a view.
        velocities: (m, n), per second; a view.
        torques: (m, n), Nm or N.
    """

    def __init__(self, m: int, n: int) -> None:
        self.state: Array = np.zeros((m, 2 * n))
        self.angles: Array = self.state[:, :n]
        self.velocities: Array = self.state[:, n:]
        self.torques: Array = np.zeros((m, n))


class ManyModels:
    """What the controllers of m equal robots know of them; `RobotModel` for one.

    Args:
        model: of one of them.
        m: how many.

    Attributes:
        m: as given.
        n: number of joints of a robot.
        gravity: (m, n), Nm or N, at the angles of the last `update`; the same array every time.
    """

    def __init__(self, model: RobotModel, m: int) -> None:
        self.m, self.n = m, model.n
        skeleton = copy.copy(model.skeleton)
        # Nothing of it is asked but gravity and masses.
        skeleton.opt.disableflags |= _UNUSED
        self._batch = Batch(skeleton, m, 1)
        self._qpos: Array = self._batch.bind("qpos")
        # At rest what acts is gravity alone.
        self.gravity: Array = self._batch.bind("qfrc_bias")
        self._sparse: Array = self._batch.bind("M")
        # Where the elements of a mass matrix are among those that MuJoCo keeps; the last for none.
        data, places = mujoco.MjData(skeleton), np.zeros((self.n, self.n))
        data.M[:] = 1.0 + np.arange(len(data.M))
        mujoco.mj_fullM(skeleton, data, places)
        self._places: Ints = places.astype(np.intp) - 1

    def update(self, angles: Array) -> None:
        """Moves all models to angles, (m, n), rad or m."""
        np.copyto(self._qpos, angles)
        self._batch.forward(stage=_VELOCITY)

    def masses(self, which: Bools) -> Array:
        """M(q) of k of the robots, (k, n, n), kg m2 (kg), with the motors' on the diagonal."""
        kept = self._sparse[which]
        return np.asarray(np.hstack([kept, np.zeros((len(kept), 1))])[:, self._places])


class Law(ABC):
    """Torques of m robots."""

    @abstractmethod
    def begin(self, which: Bools) -> None:
        """Begins an episode of some of them, (m,): nothing that was remembered gets into it."""

    @abstractmethod
    def torques(self, states: Array, targets: ManyTargets, out: Array) -> None:
        """Writes the torques of this step, without limits.

        Args:
            states: (m, 2n), angles, then velocities of the motors.
            targets: of all.
            out: (m, n), Nm or N, to be written.
        """


class ManyTorques(Law):
    """tau = g(q) + tau_target; `GravityCompensator` for one."""

    def __init__(self, models: ManyModels) -> None:
        self._models = models

    def begin(self, which: Bools) -> None:
        """Nothing is remembered."""

    def torques(self, states: Array, targets: ManyTargets, out: Array) -> None:
        """Writes the torques of this step, (m, n)."""
        models = self._models
        models.update(states[:, : models.n])
        np.add(models.gravity, targets.torques, out)


class ManyImpedances(Law):
    """tau = K (q_d - q) + D (dq_d - dq) + g(q); `JointImpedanceController` for one.

    Args:
        models: of the robots.
        declared: gains, the same for all; without feed-forward.
        timestep: s between two calls.
    """

    def __init__(self, models: ManyModels, declared: JointImpedance, timestep: float) -> None:
        m, n = models.m, models.n
        self._models = models
        self._stiffness = declared.per_joint("stiffness", n)
        self._ratio = declared.per_joint("damping", n)
        self._every = max(round(declared.damping_every / timestep), 1)
        self._k = 0
        self._due = np.zeros(m, np.intp)  # steps in which the damping of a robot is designed anew
        self._next = 0  # the first of these
        self._damping: Array = np.zeros((m, n, n))
        self._errors: Array = np.zeros((m, 2 * n))
        self._damped: Array = np.zeros((m, n, 1))

    def begin(self, which: Bools) -> None:
        """Begins an episode of some of them."""
        self._due[which] = self._next = self._k

    def torques(self, states: Array, targets: ManyTargets, out: Array) -> None:
        """Writes the torques of this step, (m, n)."""
        models, n, errors = self._models, self._models.n, self._errors
        models.update(states[:, :n])
        if self._k == self._next:
            self._design()
        self._k += 1
        np.subtract(targets.state, states, errors)
        np.multiply(self._stiffness, errors[:, :n], out)
        np.matmul(self._damping, errors[:, n:, None], self._damped)
        np.add(out, self._damped[:, :, 0], out)
        np.add(out, models.gravity, out)

    def _design(self) -> None:
        """Designs the damping of those robots whose time it is."""
        due = self._due <= self._k
        masses = self._models.masses(due)
        self._damping[due] = design_damping(masses, np.diag(self._stiffness), self._ratio)
        self._due[due] = self._k + self._every
        self._next = int(self._due.min())
