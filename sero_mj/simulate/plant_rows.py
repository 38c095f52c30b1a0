"""`PlantRows`: simulated robots in one world or in many equal ones, in rows; `PlantRow`: one."""

from __future__ import annotations

from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..base.declaration import numbers
from ..base.errors import Problem, SimulationError, UnknownName
from ..base.frames import Array, RowIndex
from ..robots.assemble.parts import RobotPart
from ..robots.assemble.world import World
from .external_loads import Push, PushRows, attach_payload, detach_payload
from .joint_model import JointModel
from .rows import ManyRows, OneRow
from .sensors import Sensors

P = TypeVar("P", bound=Push)

MAX_TORQUE = 1e9  # Nm, norm of all motor torques; a comparison with it refuses NaN as well


class PlantRows:
    """Takes motor torques and gives what sensors read, row by row; `Plant` for one world.

    Args:
        world: compiled with `dynamic=True`.
        rows: one world as it is, or many, whose arrays have the rows as their first axis.
        sensors: what the robots have, of as many rows.

    Attributes:
        world: as given.
        rows: likewise.
        n: number of joints of all robots of a row together.
        joints: motors, links and torque sensors in MuJoCo.
        measured: (3, n), what the sensors read.
        motor_angles: (n,), true, rad: before the spring of an elastic joint. Always the same
            array, to read only; so is the next.
        motor_velocities: (n,), likewise, rad/s.
        sensors: as given.
        timestep: of a step, s.
        pushes: that act, of every row.
        has_pushes: whether any acts, or did in the last step.
        pushed: (nv,), torques of pushes in the last step, Nm or N.
        failed: what was wrong with rows of many, which take no part since.

    Raises:
        ValueError: the sensors are not those of n joints.
    """

    def __init__(self, world: World, rows: OneRow | ManyRows, sensors: Sensors | None) -> None:
        self.world, self.rows = world, rows
        self.joints = JointModel(world, rows)
        self.n = self.joints.n
        self.motor_angles = self.joints.motor_angles
        self.motor_velocities = self.joints.motor_velocities
        self.sensors = Sensors(self.n) if sensors is None else sensors
        if self.sensors.n != self.n:
            raise Problem(
                "", "found sensors of", found=self.sensors.n, of="joints", expected=self.n
            ).error()
        self.measured = self.sensors.measured
        self._actual: Array = np.zeros_like(self.measured)
        self._is_measured = False  # whether `measured` has the true values
        column = (*rows.shape, -1, 1)
        self._readings = self._actual.reshape(column)
        self._measured_readings = self.measured.reshape(column)
        self.timestep = float(world.model.opt.timestep)
        self.failed: dict[RowIndex, SimulationError] = {}
        self.has_pushes = False
        self.pushed: Array = np.zeros((*rows.shape, world.model.nv))
        self.pushes: dict[RowIndex, list[Push]] = {row: [] for row in rows.indices}
        self._acting: PushRows | None = None  # of many rows, those of the last step
        self._changed = False  # whether others act in the next one

    def row(self, row: RowIndex) -> PlantRow:
        """The robots of a row by themselves."""
        return PlantRow(self, row)

    @property
    def actual(self) -> Array:
        """(3, n), true angles and velocities of the links and torques between motors and links.

        The latter during the last step; rad, rad/s, Nm. Not to be written into.
        """
        if self._is_measured and not self.sensors.is_perfect:  # since a moment ago
            np.copyto(self._actual, self.measured)
            self._is_measured = False
        return self.measured if self._is_measured else self._actual

    def step(self, motor_torques: Array) -> Array:
        """Simulates one timestep.

        Args:
            motor_torques: (n,), before gear friction and as seen at the joint, Nm; none is cut
                off here.

        Returns:
            `measured`, (3, n): the same array every time.

        Raises:
            SimulationError: a torque is no number, or the motion of the only row has become
                unstable; names the joint and the time. `measured` and `actual` are those before.
        """
        applied = self.joints.motor_torques
        applied[...] = motor_torques
        if not np.vdot(applied, applied) < MAX_TORQUE**2:
            self._refuse_torques()
        return self.step_given()

    def _refuse_torques(self) -> None:
        """Raises the error of a single row; of many rows, drops those concerned."""
        for row in self.rows.indices:
            torques = self.joints.motor_torques[row]
            if not np.vdot(torques, torques) < MAX_TORQUE**2:
                self._fail(row, self.row(row).torque_error())

    def _fail(self, row: RowIndex, error: SimulationError) -> None:
        if isinstance(self.rows, OneRow):
            raise error
        self.failed[row] = error
        self.rows.drop(row)

    def step_given(self) -> Array:
        """Simulates one timestep with `joints.motor_torques`, unchecked.

        Returns:
            `measured`, (3, n): the same array every time.

        Raises:
            SimulationError: the motion of the only row has become unstable.
        """
        joints = self.joints
        if not joints.advance(self._gather_pushes()):
            for row in self.rows.indices:
                if self.rows.is_broken(row):
                    self._fail(row, self.row(row).motion_error())
        sensors = self.sensors
        if sensors.is_perfect:
            joints.read(self._measured_readings)
            self._is_measured = True
            return self.measured
        joints.read(self._readings)
        self._is_measured = False
        return sensors.measure(self._actual)

    def place(self, row: int, plant: PlantRows) -> None:
        """Sets one of many rows to the state of a single plant at rest, with a seed of noise."""
        assert isinstance(self.rows, ManyRows) and isinstance(plant.rows, OneRow)
        if self.rows.place(row, plant.world.model, plant.rows.data):
            self.joints.refresh()
        self.joints.update_motors()
        self.actual[row] = plant.actual
        self.sensors.reset_row(row, plant.actual, plant.sensors.seed)

    def _gather_pushes(self) -> Array | None:
        """Joint torques of all pushes, (nv,), Nm; None without pushes."""
        if not self.has_pushes:
            return None
        rows = self.rows
        rows.applied[...] = self.pushed[...] = 0.0
        if isinstance(rows, ManyRows):
            if self._changed:
                pushes = [(row, push) for row in rows.indices for push in self.pushes[row]]
                self._acting = PushRows(rows, pushes) if pushes else None
                self._changed = False
            self.has_pushes = self._acting is not None
            if self._acting is not None:
                self._acting.write(self.pushed)
            return self.pushed
        (acting,) = self.pushes.values()
        self.has_pushes = bool(acting)
        if acting:
            rows.look_ahead()
            for push in acting:
                push.apply(rows.model, rows.data, self.pushed)
        return self.pushed


class PlantRow:
    """The robots of one row of a plant: what they measure, what acts on them, what they carry.

    Args:
        plant: all rows.
        row: which one of them.

    Attributes:
        world: with the robots' names.
        rows: all rows, in MuJoCo.
        index: its place in arrays of all rows.
        n: number of joints of all robots together.
        timestep: of a step, s.
        sensors: of all rows.
        measured: (3, n), what the sensors read.
        motor_angles: (n,), true, rad: before the spring of an elastic joint. Always the same
            array, to read only; so is the next.
        motor_velocities: (n,), likewise, rad/s.
    """

    def __init__(self, plant: PlantRows, row: RowIndex) -> None:
        self.world, self.rows, self.index = plant.world, plant.rows, row
        self.n, self.timestep, self.sensors = plant.n, plant.timestep, plant.sensors
        self.measured = plant.measured[row]
        self.motor_angles, self.motor_velocities = (
            plant.motor_angles[row],
            plant.motor_velocities[row],
        )
        self._plant = plant

    @property
    def actual(self) -> Array:
        """See `PlantRows`; (3, n)."""
        return self._plant.actual[self.index]

    @property
    def model(self) -> mujoco.MjModel:
        """Its `MjModel`; payloads and frictions change it."""
        return self.rows.model_of(self.index)

    @property
    def data(self) -> mujoco.MjData:
        """Its `MjData`; with many rows a copy, until that of the next row is asked for."""
        return self.rows.data_of(self.index)

    @property
    def qpos(self) -> Array:
        """MuJoCo's coordinates, (nq,), in place."""
        return self.rows.qpos[self.index]

    def push(
        self,
        frame: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        expressed_in: str = "world",
        at: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Push:
        """Applies a force and a torque at a frame until `release`.

        Args:
            frame: at whose origin they act, e.g. `lwr/flange`.
            force: (3,), N.
            torque: (3,), Nm.
            expressed_in: name of the frame in whose axes both are given.
            at: (3,), where in the frame they act, m.

        Returns:
            the push; change its `force` and `torque` at any time.

        Raises:
            UnknownName: no such frame.
            ValueError: not three finite numbers.
        """
        return self.add_push(Push(self.world, frame, force, torque, expressed_in, at))

    def add_push(self, push: P) -> P:
        """Lets a push act until `release`, see `push`."""
        self._plant.pushes[self.index].append(push)
        self._plant.has_pushes = self._plant._changed = True
        return push

    def release(self, push: Push) -> None:
        """Ends a push; nothing happens if it has ended."""
        pushes = self._plant.pushes[self.index]
        if push in pushes:
            pushes.remove(push)
            self._plant._changed = True

    def attach_payload(
        self,
        robot: str,
        mass: float,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> None:
        """Fixes a payload to a robot's flange, in place of the one that it may have.

        Args:
            robot: its name.
            mass: kg.
            center_of_mass: (3,), in the flange's frame, m.
            inertia: about it, in the flange's axes, kg m2: 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz,
                Iyz) or (3, 3); that of a ball of steel when None.

        Raises:
            UnknownName: no such robot.
            ValueError: no rigid body has this mass and inertia.
        """
        self._part(robot)
        attach_payload(self.rows.own_model(self.index), robot, mass, center_of_mass, inertia)
        self.rows.refresh(self.index)

    def detach_payload(self, robot: str) -> None:
        """Takes a robot's payload away.

        Raises:
            UnknownName: no such robot.
        """
        self._part(robot)
        detach_payload(self.rows.own_model(self.index), robot)
        self.rows.refresh(self.index)

    def set_friction(
        self, robot: str, viscous: ArrayLike | None = None, coulomb: ArrayLike | None = None
    ) -> None:
        """Changes a robot's friction from now on.

        Args:
            robot: its name.
            viscous: one number or (n,), Nm s/rad; as it is when None.
            coulomb: likewise, Nm.

        Raises:
            UnknownName: no such robot.
            ValueError: a friction below zero, or neither one nor n.
        """
        dofs, model = self._part(robot).dofs, self.rows.own_model(self.index)
        for name, value, target in (
            ("viscous", viscous, model.dof_damping),
            ("coulomb", coulomb, model.dof_frictionloss),
        ):
            if value is not None:
                friction = np.atleast_1d(numbers(value))
                if friction.shape not in ((1,), dofs.shape):
                    raise Problem(
                        name, found=friction.size, of="numbers", expected=f"1 or {len(dofs)}"
                    ).error()
                if (friction < 0).any():
                    raise Problem(name, found=friction.tolist(), expected="0 or more").error()
                target[dofs] = friction
        self.refresh()

    def refresh(self) -> None:
        """Recomputes what depends on `model` and `data` after they were changed; no time passes."""
        self._plant.joints.refresh()
        self.rows.refresh(self.index)

    def flange(self, robot: str) -> Array:
        """T_world_flange now, (4, 4), m: the true one, in an array of its own."""
        body = np.array([self.flange_body(robot)])
        return np.asarray(self.rows.poses_of([self.index], body)[0])

    def flange_body(self, robot: str) -> int:
        """The body of a robot's flange in the model."""
        return self._part(robot).flange_body

    def _part(self, robot: str) -> RobotPart:
        if robot not in self.world.robots:
            raise UnknownName("robot", robot, self.world.robots)
        return self.world.robots[robot]

    def _joint_name(self, row: int) -> str:
        names = [
            f"{name}/{j}" for name, part in self.world.robots.items() for j in part.robot.names
        ]
        return names[row]

    def torque_error(self) -> SimulationError:
        """The error of invalid motor torques, which are set to zero."""
        torques = self._plant.joints.motor_torques[self.index]
        joint = int(np.argmax(~(np.abs(torques) < MAX_TORQUE / np.sqrt(self.n))))
        problem = Problem(
            "",
            "found a motor torque of",
            found=float(torques[joint]),
            of="Nm",
            expected="a finite one, below 1e9",
        )
        torques[:] = 0.0
        return SimulationError(float(self.data.time), self._joint_name(joint), problem)

    def motion_error(self) -> SimulationError:
        """The error of an unstable motion, with its joint."""
        time, accelerations = self.rows.broken_at(self.index)
        found = accelerations[self._plant.joints.motor_dofs]
        broken = ~(np.abs(found) < mujoco.mjMAXVAL)
        parts = self.world.robots.values()
        revolute = np.concatenate([part.kinematics.revolute for part in parts])
        joint = int(np.argmax(broken) if broken.any() else np.argmax(np.abs(found)))
        unit = "rad/s2" if revolute[joint] else "m/s2"
        problem = Problem(
            "",
            "the motion is unstable: found an acceleration of",
            found=float(found[joint]),
            of=unit,
            expected=f"lower gains, or a timestep below {self.timestep:g} s",
        )
        return SimulationError(time, self._joint_name(joint), problem)
