"""`JointModel`: motors, links and torque sensors of rigid and elastic joints in MuJoCo.

In a rigid joint, motor and link share one degree of freedom. The sensor measures the motor torque
minus the torques of motor inertia and friction:

    torque = motor_torque - motor_inertia * acceleration - friction

In an elastic joint, motor and link have one angle each. The sensor measures the spring and damper
between them:

    torque = stiffness * (motor_angle - link_angle) + damping * (motor_velocity - link_velocity)

These are the torques of the last step, exact to rounding. Accelerations are velocity differences.
Viscous friction and springs are evaluated as in MuJoCo's integrator (velocities at the end of the
step, angles at its start). Coulomb friction is the result of MuJoCo's solver, also during sticking.
Couplings between joints act on the motor side, so the sensors measure their forces.

With the assumed springs of the LWR, an excitation of 8 Nm and a time step of 1 ms, angles are
within 2e-5 rad and torques within 0.1 Nm of a simulation with a time step of 10 us.

Source: Albu-Schaeffer, Ott, Hirzinger, A Unified Passivity-based Control Framework for Position,
Torque and Impedance Control of Flexible Joint Robots, IJRR 26(1), 2007, eq. 1-3.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ..base.frames import Array, Ints
from ..robots.assemble.mjcf_dynamics import COUPLING, deflection_joint, spring_damping
from ..robots.assemble.world import World
from .physics import Physics

Index = slice | Ints


def as_slice(indices: Ints) -> Index:
    """Returns evenly spaced indices as a slice, and other indices unchanged.

    Indexing by a slice yields a view instead of a copy.
    """
    if not len(indices):
        return slice(0, 0)
    steps = np.unique(np.diff(indices))
    if len(steps) <= 1 and (steps > 0).all():
        return slice(int(indices[0]), int(indices[-1]) + 1, int(steps[0]) if len(steps) else 1)
    return indices


class JointModel:
    """Maps the motors, links and torque sensors of a world's robots to MuJoCo's arrays.

    Link angles and velocities of elastic joints are sums of two MuJoCo joints. Sensor readings are
    linear in the states before and after a step and in the torques of the step, so one matrix
    product computes all of them. The m worlds are the first axis of all arrays.

    Attributes:
        n: number of joints of all robots.
        elastic: whether any joint is elastic.
        forwards: whether `advance` also computes the kinematics and bias torques of the new state.
            If not, the next step computes them, which is faster.
        reads_torques: whether torques are read after each step. Reading the friction takes most of
            the time.
        motor_dofs: indices of the motors in `qvel`, shape (n,).
        motor_positions: indices of the motors in `qpos`, shape (n,).
        motor_angles: motor angles after the last step, shape (m, n), rad.
        motor_velocities: motor velocities after the last step, shape (m, n), rad/s.
        sensor_dofs: indices in `qvel` of the rigid joints, or of the deflections of elastic joints,
            shape (n,).
        motor_torques: motor torques of the next step, shape (m, n), Nm; set before `advance`.
    """

    def __init__(self, world: World, physics: Physics) -> None:
        self._model, self._physics = world.model, physics
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
        self.forwards = self.reads_torques = True
        self.elastic = bool(spring_q)
        self.motor_dofs = as_slice(np.array(motor, np.intp))
        self.sensor_dofs = np.array(sensor, np.intp)
        self.motor_positions = as_slice(np.array(motor_q, np.intp))
        self._motor_q, self._spring_q = np.array(motor_q, np.intp), np.array(spring_q, np.intp)
        self._spring_dofs = self.sensor_dofs[self._elastic_rows]
        self._qpos, self._qvel, self._applied = physics.qpos, physics.qvel, physics.applied
        # If the indices are evenly spaced, these are views, which are always up to date.
        self._copies: list[tuple[Array, Ints, Array]] = []
        self.motor_angles = self._watch(self._qpos, self.motor_positions)
        self.motor_velocities = self._watch(self._qvel, self.motor_dofs)
        self.motor_torques: Array = np.zeros((physics.m, self.n))
        self._dofs_with_friction = np.zeros(0, np.intp)
        self._friction: Array = np.zeros((physics.m, 0))
        self._find_couplings()
        self.refresh()

    def _find_couplings(self) -> None:
        model = self._model
        couplings: list[int] = []
        self._coupled_dofs: list[tuple[int, int, float]] = []  # follower, source, ratio
        for name, part in self._world.robots.items():
            coupled = part.robot.coupled
            for i, source in enumerate(coupled.independent[coupled.source].tolist()):
                if i != source:
                    couplings.append(model.equality(f"{name}/{part.robot.names[i]}{COUPLING}").id)
                    ratio = float(coupled.ratio[i])
                    self._coupled_dofs.append((int(part.dofs[i]), int(part.dofs[source]), ratio))
        ids: list[int] = []
        if couplings:  # equality constraints come first, and all are always active
            data = mujoco.MjData(self._physics.model)
            mujoco.mj_forward(self._physics.model, data)
            ids = data.efc_id[: data.ne].tolist()
        self._coupling_rows = np.array([ids.index(each) for each in couplings], np.intp)
        self._coupling: Array = np.zeros((self._physics.m, len(couplings)))

    def _watch(self, array: Array, index: Index) -> Array:
        watched = array[:, index]
        if not isinstance(index, slice):
            self._copies.append((array, index, watched))
        return watched

    def refresh(self) -> None:
        """Reads inertia, friction and stiffness again after a change of the models."""
        model, physics = self._model, self._physics
        models = [physics.model_of(row) for row in range(physics.m)]
        for name, part in self._world.robots.items():
            if part.robot.elastic_joints:
                damping = spring_damping(self._world.dynamics[name], model.opt.timestep)
                dofs = [
                    self._model.joint(f"{name}/{deflection_joint(j)}") for j in part.robot.names
                ]
                for joint, value in zip(dofs, damping, strict=True):
                    model.dof_damping[joint.dofadr[0]] = value
        self._spring_stiffness = model.jnt_stiffness[model.dof_jntid[self._spring_dofs]]
        friction: Array = np.zeros((physics.m, model.nv))
        friction[:, self._dofs_with_friction] = self._friction
        losses = np.array([each.dof_frictionloss for each in models])
        self._dofs_with_friction = np.flatnonzero((losses > 0).any(axis=0))
        self._arrange(models)
        self._friction[:] = friction[:, self._dofs_with_friction]

    def _arrange(self, models: Sequence[mujoco.MjModel]) -> None:
        """Allocates the sensor terms: [q, dq; torques; q, dq after; couplings; friction]."""
        model, n = self._model, self.n
        kinds = [model.nq, model.nv, n, model.nq, model.nv, len(self._coupled_dofs)]
        sizes = np.array([*kinds, len(self._dofs_with_friction)])
        ends = np.cumsum(sizes)
        self._terms: Array = np.zeros((self._physics.m, ends[-1]))
        self._column = self._terms[..., None]
        q_before, dq_before, motor_torques, q_after, dq_after, coupling, friction = np.split(
            self._terms, ends[:-1], axis=-1
        )
        motor_torques[:] = self.motor_torques
        coupling[:] = self._coupling
        self.motor_torques, self._coupling, self._friction = motor_torques, coupling, friction
        self._inner = self._terms[:, ends[4] :]
        self._after = slice(ends[2], ends[4])
        first = (ends - sizes).tolist()
        found = {id(each): np.zeros((3 * n, ends[-1])) for each in models}
        for each in {id(each): each for each in models}.values():
            self._fill(each, found[id(each)].reshape(3, n, -1), first)
        # Rows with their own friction have their own matrix.
        self._readings_of: Array = np.array([found[id(each)] for each in models])
        if len(found) == 1:
            self._readings_of = self._readings_of[0]
        self._states = q_before, dq_before, q_after, dq_after

    def _fill(self, model: mujoco.MjModel, readings: Array, first: Sequence[int]) -> None:
        """Fills a model's sensor matrix, (3, n, terms), from the first column of each kind."""
        q_before, dq_before, motor_torques, q_after, dq_after, coupling, friction = first
        dofs, springs = self.sensor_dofs, self._elastic_rows
        angles, velocities, torques = readings
        rows = np.arange(self.n)
        rigid = np.setdiff1d(rows, springs)
        angles[rows, q_after + self._motor_q] = 1.0
        angles[springs, q_after + self._spring_q] = 1.0
        velocities[rows, dq_after + np.arange(model.nv)[self.motor_dofs]] = 1.0
        velocities[springs, dq_after + self._spring_dofs] = 1.0
        inertia = model.dof_armature[dofs] / model.opt.timestep
        torques[rigid, motor_torques + rigid] = 1.0
        torques[springs, q_before + self._spring_q] = -self._spring_stiffness
        torques[rows, dq_before + dofs] = inertia
        torques[rows, dq_after + dofs] = -(inertia + model.dof_damping[dofs])
        # A coupling's constraint is q - ratio * q_source - offset = 0; forces act by its gradient.
        slopes = self._couples_at = np.zeros((self.n, len(self._coupled_dofs)))
        for row, (follows, source, ratio) in enumerate(self._coupled_dofs):
            slopes[:, row] = (dofs == follows) - ratio * (dofs == source)
        torques[:, coupling:friction] = slopes
        torques[:, friction:] = self._friction_at = dofs[:, None] == self._dofs_with_friction

    def load_springs(self, data: mujoco.MjData) -> None:
        """Deflects the springs so that they hold the links at rest against the bias torques."""
        deflection = -data.qfrc_bias[self._spring_dofs] / self._spring_stiffness
        motors = self._motor_q[self._elastic_rows]
        angles = data.qpos[motors] + data.qpos[self._spring_q]
        data.qpos[self._spring_q] = deflection
        data.qpos[motors] = angles - deflection

    def advance(self, pushes: Array | None) -> bool:
        """Simulates one step, and returns whether the motion is stable.

        Args:
            pushes: external generalized forces, shape (m, nv), Nm.
        """
        physics = self._physics
        q_before, dq_before, q_after, dq_after = self._states
        q_before[...], dq_before[...] = self._qpos, self._qvel
        self._applied[:, self.motor_dofs] = self.motor_torques
        if pushes is not None:
            self._applied += pushes
        is_stable = physics.step()
        if not is_stable and physics.m == 1:
            return False
        q_after[...], dq_after[...] = self._qpos, self._qvel
        if self.reads_torques:
            physics.read_inner_forces(self._coupling_rows, self._dofs_with_friction, self._inner)
        if self.forwards:
            physics.forward()
        return is_stable

    def external(self, row: int, pushes: Array) -> Array:
        """Returns the external torques on a row's links in the last step, shape (n,), Nm.

        Args:
            pushes: generalized forces of pushes, shape (nv,), Nm or N.
        """
        outer = pushes + self._physics.data_of(row).qfrc_constraint
        inner = self._friction_at @ self._friction[row] + self._couples_at @ self._coupling[row]
        return np.asarray(outer[self.sensor_dofs] - inner)

    def read(self, readings: Array) -> None:
        """Writes true angles, velocities and torques of the links to `readings`, (m, 3n, 1)."""
        self.update_motors()
        # One product per row: a single product for all rows would round differently.
        np.matmul(self._readings_of, self._column, readings)

    def update_motors(self) -> None:
        """Updates `motor_angles` and `motor_velocities` if they are copies."""
        for array, index, copy in self._copies:
            np.take(array, index, axis=1, out=copy)

    def read_at_rest(self, row: int, data: mujoco.MjData) -> Array:
        """Returns the readings of a row at rest, shape (3, n), before the first step."""
        self._terms[row] = 0.0
        self._terms[row, self._after] = np.hstack([data.qpos, data.qvel])
        friction = self._friction[row]
        friction[:] = data.efc_force[data.ne : data.ne + len(friction)]
        self.update_motors()
        readings = self._readings_of if self._readings_of.ndim == 2 else self._readings_of[row]
        found = (readings @ self._column[row]).reshape(3, self.n)
        found[2] = data.qfrc_bias[self.sensor_dofs]
        return np.asarray(found)
