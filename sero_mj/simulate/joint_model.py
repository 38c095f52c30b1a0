"""What a torque sensor between motor and link reads, for rigid and for elastic joints.

Rigid: motor and link are one degree of freedom. The motor's torque, less what its own inertia and
friction take, goes through the sensor:

    torque = motor_torque - motor_inertia * acceleration - friction

Elastic: motor and link have an angle each, and the sensor reads the spring and damper between:

    torque = stiffness * (motor_angle - link_angle) + damping * (their velocities' difference)

Both are what acted during the last step, to rounding: accelerations are differences of velocity,
viscous friction and spring act as MuJoCo's integrator took them (velocities at the step's end,
angles at its start), and Coulomb friction is what its solver found, also where it holds.

With the LWR's assumed springs, motors that are shaken by 8 Nm, and steps of 1 ms, angles are within
2e-5 rad and torques within 0.1 Nm of those with steps of 10 us.

Source: Albu-Schaeffer, Ott, Hirzinger, A Unified Passivity-based Control Framework for Position,
Torque and Impedance Control of Flexible Joint Robots, IJRR 26(1), 2007, eq. 1-3.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import mj_step, mj_step1, mj_step2
from numpy import add, copyto, multiply, subtract
from numpy.typing import NDArray

from ..assemble.mjcf_dynamics import deflection_joint, spring_damping
from ..assemble.world import World

Array = NDArray[np.float64]
Index = slice | NDArray[np.intp]


def as_slice(indices: NDArray[np.intp]) -> Index:
    """Indices with equal steps as a slice, which numpy reads in place; others as they are."""
    if not len(indices):
        return slice(0, 0)
    steps = np.unique(np.diff(indices))
    if len(steps) <= 1 and (steps > 0).all():
        return slice(int(indices[0]), int(indices[-1]) + 1, int(steps[0]) if len(steps) else 1)
    return indices


class JointModel:
    """Where motors, links and torque sensors of a world's robots are in MuJoCo's arrays.

    Angles of links and their velocities are sums of two joints' where joints are elastic.

    Args:
        world: compiled with `dynamic`.
        data: of it.

    Attributes:
        n: number of joints of all robots together.
        elastic: whether any of them is.
        looks_ahead: whether a step ends with what follows from the state that it leads to
            (kinematics, bias torques); else the next one begins with it, which is faster.
        is_ahead: whether that has been computed.
        motor_dofs: index of every motor in `qvel`, (n,).
        motor_positions: likewise in `qpos`.
        motor_angles: (n,), rad, as `read` or MuJoCo left them.
        motor_velocities: (n,), likewise, rad/s.
        sensor_dofs: index in `qvel` of that which every torque sensor feels, (n,): the link
            together with the motor, or the deflection.
    """

    def __init__(self, world: World, data: mujoco.MjData) -> None:
        self._model, self._data = world.model, data
        self._world = world
        motor: list[int] = []
        sensor: list[int] = []
        motor_q: list[int] = []
        spring_q: list[int] = []
        self._elastic_rows: list[int] = []
        for name, part in world.robots.items():
            motor += part.dofs.tolist()
            motor_q += part.qpos.tolist()
            if not part.robot.elastic_joints:
                sensor += part.dofs.tolist()
                continue
            start = len(sensor)
            self._elastic_rows += range(start, start + part.robot.n)
            for joint in part.robot.names:
                of = self._model.joint(f"{name}/{deflection_joint(joint)}")
                sensor.append(int(of.dofadr[0]))
                spring_q.append(int(of.qposadr[0]))
        self.n = len(motor)
        self.looks_ahead = self.is_ahead = True
        self.elastic = bool(spring_q)
        self.motor_dofs = as_slice(np.array(motor, np.intp))
        self.sensor_dofs = as_slice(np.array(sensor, np.intp))
        self.motor_positions = as_slice(np.array(motor_q, np.intp))
        self._spring_q = as_slice(np.array(spring_q, np.intp))
        self._rows = as_slice(np.array(self._elastic_rows, np.intp))
        self._all_elastic = len(self._elastic_rows) == self.n
        self._spring_dofs = as_slice(np.array(sensor, np.intp)[self._elastic_rows])
        self._qpos, self._qvel = data.qpos, data.qvel
        nv = self._model.nv
        self._torque, self._change, self._before_step = np.zeros((3, nv))
        # Where joints stand in equal steps these are views, which are always up to date.
        self._copies: list[tuple[Array, NDArray[np.intp], Array]] = []
        self.motor_angles = self._watch(self._qpos, self.motor_positions)
        self.motor_velocities = self._watch(self._qvel, self.motor_dofs)
        self._sensed = self._watch(self._torque, self.sensor_dofs)
        self._spring_angles = self._watch(self._qpos, self._spring_q)
        self._spring_speeds = self._watch(self._qvel, self._spring_dofs)
        self._aligned = self._model.nq == nv  # then a joint has one index for both
        self.refresh()

    def _watch(self, array: Array, index: Index) -> Array:
        watched = array[index]
        if not isinstance(index, slice):
            self._copies.append((array, index, watched))
        return watched

    def refresh(self) -> None:
        """Reads inertia, friction and stiffness anew from the model, after they were changed."""
        model = self._model
        for name, part in self._world.robots.items():
            if part.robot.elastic_joints:
                damping = spring_damping(self._world.dynamics[name], model.opt.timestep)
                dofs = [
                    self._model.joint(f"{name}/{deflection_joint(j)}") for j in part.robot.names
                ]
                for joint, value in zip(dofs, damping, strict=True):
                    model.dof_damping[joint.dofadr[0]] = value
        self._before = model.dof_armature / model.opt.timestep
        self._after = self._before + model.dof_damping
        self._stiffness = np.zeros(model.nv)
        if self.elastic:
            joints = model.dof_jntid[self._spring_dofs]
            self._stiffness[self._spring_dofs] = model.jnt_stiffness[joints]
        self._spring_stiffness = self._stiffness[self._spring_dofs]
        rubbing = np.flatnonzero(model.dof_frictionloss > 0)
        self._rubs = len(rubbing)
        self._rubbing = as_slice(rubbing)
        in_place = isinstance(self._rubbing, slice)
        self._rubbed = self._torque[self._rubbing] if in_place else None
        # What every step needs, in one place: looking things up takes a third of our own time.
        self._hot = (
            model, self._data, self._qvel, self._before, self._after, self._before_step,
            self._change, self._torque,
        )  # fmt: skip

    def load_springs(self) -> None:
        """Lets the springs hold the links where they are, at rest; `data` has its bias torques."""
        deflection = -self._data.qfrc_bias[self._spring_dofs] / self._spring_stiffness
        motors = np.arange(len(self._qpos))[self.motor_positions][self._rows]
        angles = self._qpos[motors] + self._qpos[self._spring_q]
        self._qpos[self._spring_q] = deflection
        self._qpos[motors] = angles - deflection

    def hold(self) -> None:
        """Lets the sensors feel what holds the links at rest."""
        np.copyto(self._torque, self._data.qfrc_bias)

    def advance(self, motor_torques: Array, pushes: Array | None) -> None:
        """Lets a step pass and notes what the sensors feel in it.

        Args:
            motor_torques: `qfrc_applied` (nv,), Nm; pushes are added to it.
            pushes: what else acts from outside, (nv,), Nm.
        """
        model, data, qvel, before, after, held, change, torque = self._hot
        multiply(qvel, before, held)
        add(held, motor_torques, held)
        if self.elastic:
            self._pull(held)
        if pushes is not None:
            add(motor_torques, pushes, motor_torques)
        (mj_step2 if self.is_ahead else mj_step)(model, data)
        multiply(qvel, after, change)
        subtract(held, change, torque)
        if self._rubs:
            # Coulomb friction is there until the next `mj_step1`; its rows stand behind those of
            # equality constraints, and before all others.
            forces = data.efc_force
            if len(forces) != self._rubs:
                forces = forces[data.ne : data.ne + self._rubs]
            if self._rubbed is not None:
                add(self._rubbed, forces, self._rubbed)
            else:
                torque[self._rubbing] += forces
        if self.looks_ahead:
            mj_step1(model, data)
        self.is_ahead = self.looks_ahead

    def look(self) -> None:
        """Computes what follows from the state that `data` is in, if that has not been done."""
        if not self.is_ahead:
            mj_step1(self._model, self._data)
            self.is_ahead = True

    def _pull(self, torque: Array) -> None:
        """Adds what the springs do at the start of a step to torques (nv,)."""
        if self._aligned:
            multiply(self._qpos, self._stiffness, self._change)
            subtract(torque, self._change, torque)
        else:
            torque[self._spring_dofs] -= self._spring_stiffness * self._qpos[self._spring_q]

    def external(self, pushes: Array) -> Array:
        """Torques on the links from outside in the last step, (n,), Nm: pushes, contacts, stops.

        Args:
            pushes: what acted by pushes, (nv,).
        """
        friction = self._torque - (self._before_step - self._change)
        outer = pushes + self._data.qfrc_constraint - friction
        return np.asarray(outer[self.sensor_dofs])

    def read(self, angles: Array, velocities: Array, torques: Array) -> None:
        """Writes angles and velocities of the links, and the sensors' torques, each (n,)."""
        for array, index, copy in self._copies:
            np.take(array, index, out=copy)
        if not self.elastic:
            copyto(angles, self.motor_angles)
            copyto(velocities, self.motor_velocities)
        elif self._all_elastic:
            add(self.motor_angles, self._spring_angles, angles)
            add(self.motor_velocities, self._spring_speeds, velocities)
        else:
            copyto(angles, self.motor_angles)
            copyto(velocities, self.motor_velocities)
            angles[self._rows] += self._spring_angles
            velocities[self._rows] += self._spring_speeds
        copyto(torques, self._sensed)
