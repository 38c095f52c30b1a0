"""`Plant`: simulated robots, which take motor torques and return sensor readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..base.declaration import numbers
from ..base.errors import Problem, SimulationError, UnknownName
from ..base.frames import Array
from ..robots.assemble.parts import RobotPart
from ..robots.assemble.world import World
from .external_loads import Push, PushRows, attach_payload, detach_payload
from .joint_model import JointModel
from .physics import Physics
from .sensors import SensorRows, Sensors

P = TypeVar("P", bound=Push)

MAX_TORQUE = 1e9  # maximum norm of all motor torques, Nm; the comparison also fails for NaN


class PlantRows:
    """The robots of m worlds (rows) with the same model, which are stepped together.

    Args:
        world: world that was compiled with `dynamic=True`.

    Attributes:
        n: number of joints of all robots in a row.
        measured: sensor readings, shape (m, 3, n); always the same array.
        motor_angles: true motor angles, shape (m, n), rad; always the same array. They differ from
            the link angles in elastic joints.
        motor_velocities: true motor velocities, shape (m, n), rad/s.
        pushes: active pushes of each row.
        has_pushes: whether a push is active, or was active in the last step.
        has_changed: whether the set of active pushes has changed since the last step.
        pushed: generalized forces of pushes in the last step, shape (m, nv), Nm or N.
        failed: errors by row, for rows that could not be stepped.
    """

    def __init__(
        self, world: World, sensors: Sequence[Sensors], *, is_pushed: bool = False
    ) -> None:
        m = len(sensors)
        self.world = world
        model = world.model if m == 1 else world.physics_model()
        self.physics = Physics(model, m, is_pushed=is_pushed)
        self.joints = JointModel(world, self.physics)
        self.n = self.joints.n
        self.motor_angles = self.joints.motor_angles
        self.motor_velocities = self.joints.motor_velocities
        self.sensors = SensorRows(sensors)
        self.measured = self.sensors.measured
        self._actual: Array = np.zeros_like(self.measured)
        self._is_measured = False  # whether `measured` holds the true values
        self._readings = self._actual.reshape(m, -1, 1)
        self._measured_readings = self.measured.reshape(m, -1, 1)
        self.timestep = float(world.model.opt.timestep)
        self.failed: dict[int, SimulationError] = {}
        self.has_pushes = self.has_changed = False
        self.pushed: Array = np.zeros((m, world.model.nv))
        self.pushes: list[list[Push]] = [[] for _ in range(m)]
        self._acting: PushRows | None = None  # pushes of the last step, if there are several rows
        self._each = sensors
        self._scratch = self.physics.data_of(0) if m == 1 else mujoco.MjData(model)

    def row(self, row: int) -> Plant:
        """Returns a new `Plant` for a row. It is not cached, to avoid a reference cycle."""
        return Plant(self.world, self._each[row], rows=self, row=row)

    @property
    def actual(self) -> Array:
        """True link angles, link velocities and joint torques, shape (m, 3, n); rad, rad/s, Nm.

        The torques acted between motors and links in the last step. Do not write to the array.
        """
        if self._is_measured and not self.sensors.is_perfect:  # a sensor fault has just begun
            np.copyto(self._actual, self.measured)
            self._is_measured = False
        return self.measured if self._is_measured else self._actual

    def reset(self, row: int, joint_angles: Array | None = None) -> None:
        """Resets the robots of a row to rest. In a batch, the row's model is reset, too.

        Args:
            joint_angles: joint angles, shape (n,), rad (default: the declared angles).
        """
        physics, data, joints = self.physics, self._scratch, self.joints
        if physics.m > 1 and physics.forget_model(row):
            joints.refresh()
        self.world.reset(data)
        if joint_angles is not None:
            for part in self.world.robots.values():
                data.qpos[part.qpos] = joint_angles[part.joints]
        mujoco.mj_forward(physics.model, data)
        if joints.elastic:
            joints.load_springs(data)
            mujoco.mj_forward(physics.model, data)
        physics.settle(row, data)
        self.actual[row] = joints.read_at_rest(row, data)
        sensors = self._each[row]
        if physics.m > 1:
            sensors.repair()
        sensors.reset(self.actual[row].copy())

    def step(self, motor_torques: Array) -> Array:
        """Simulates one time step. Errors of rows that cannot be stepped are stored in `failed`.

        Args:
            motor_torques: torques before gear friction, at the joint side, shape (m, n), Nm.

        Returns:
            sensor readings `measured`, shape (m, 3, n).
        """
        applied = self.joints.motor_torques
        applied[...] = motor_torques
        if not np.vdot(applied, applied) < MAX_TORQUE**2:
            self._refuse_torques()
        return self.step_with_set_torques()

    def _refuse_torques(self) -> None:
        for row, torques in enumerate(self.joints.motor_torques):
            if not np.vdot(torques, torques) < MAX_TORQUE**2:
                self._fail(row, self.row(row).torque_error())

    def _fail(self, row: int, error: SimulationError) -> None:
        self.failed[row] = error
        self.physics.drop(row)

    def step_with_set_torques(self) -> Array:
        """Simulates one time step with `joints.motor_torques`, without checking the torques."""
        joints, is_single = self.joints, self.physics.m == 1
        if is_single and self.failed:
            return self.measured
        if not joints.advance(self._gather_pushes()):
            for row in self.physics.broken:
                if row not in self.failed:
                    self._fail(row, self.row(row).motion_error())
            if is_single:
                return self.measured
        sensors = self.sensors
        if sensors.is_perfect:
            joints.read(self._measured_readings)
            self._is_measured = True
            return self.measured
        joints.read(self._readings)
        self._is_measured = False
        return sensors.measure(self._actual)

    def _gather_pushes(self) -> Array | None:
        if not self.has_pushes:
            return None
        physics = self.physics
        physics.applied[...] = self.pushed[...] = 0.0
        if physics.m == 1:  # `mj_applyFT` takes 5 us, `PushRows` 25 us
            acting = self.pushes[0]
            self.has_pushes = bool(acting)
            if acting:
                physics.forward()
                for push in acting:
                    push.apply(physics.model, physics.data_of(0), self.pushed[0])
            return self.pushed
        if self.has_changed:
            pushes = [(row, push) for row, each in enumerate(self.pushes) for push in each]
            self._acting = PushRows(physics, pushes) if pushes else None
            self.has_changed = False
        self.has_pushes = self._acting is not None
        if self._acting is not None:
            self._acting.write(self.pushed)
        return self.pushed


class Plant:
    """All robots of a dynamic world, or of one row of `PlantRows`.

    Joints are in the order of `world.robots`. After construction, `data` holds the kinematics, the
    mass matrix and the bias torques (`qfrc_bias`) of its state. If `rows.joints.forwards` is true,
    it also does so after every step.

    Args:
        world: world that was compiled with `dynamic=True`.
        sensors: sensors of all joints (default: perfect sensors).
        timestep: time step, s (default: the time step of the model).

    Attributes:
        measured: sensor readings, shape (3, n); always the same array.
        motor_angles: true motor angles, shape (n,), rad; always the same array.
        motor_velocities: true motor velocities, shape (n,), rad/s.

    Raises:
        ValueError: the world is not dynamic, the timestep is not positive, or the sensors are for
            another number of joints.
    """

    def __init__(
        self,
        world: World,
        sensors: Sensors | None = None,
        timestep: float | None = None,
        *,
        rows: PlantRows | None = None,
        row: int = 0,
    ) -> None:
        if not world.dynamic:
            raise ValueError("the world has no dynamics; expected World(scene, dynamic=True)")
        if timestep is not None:
            if not 0 < timestep < 1:
                raise Problem(
                    "timestep", found=timestep, of="s", expected="more than 0 and less than 1 s"
                ).error()
            world.model.opt.timestep = timestep
        n = sum(part.robot.n for part in world.robots.values())
        self.sensors = Sensors(n) if sensors is None else sensors
        if self.sensors.n != n:
            raise Problem(
                "", "found sensors of", found=self.sensors.n, of="joints", expected=f"{n} joints"
            ).error()
        self.world, self.row, self.n = world, row, n
        self.rows = PlantRows(world, [self.sensors]) if rows is None else rows
        self.joints, self.timestep = self.rows.joints, self.rows.timestep
        self.measured: Array = self.rows.measured[row]
        self.motor_angles: Array = self.rows.motor_angles[row]
        self.motor_velocities: Array = self.rows.motor_velocities[row]
        if rows is None:
            self.rows.reset(0)

    @property
    def actual(self) -> Array:
        """True link angles, link velocities and joint torques, shape (3, n); rad, rad/s, Nm.

        The torques acted between motors and links in the last step. Do not write to the array.
        """
        return np.asarray(self.rows.actual[self.row])

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo model, which payloads and friction changes modify."""
        return self.rows.physics.model_of(self.row)

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo data; in a batch, a copy that is valid until another row's `data` is read."""
        return self.rows.physics.data_of(self.row)

    @property
    def qpos(self) -> Array:
        """MuJoCo's generalized positions, shape (nq,); may be changed in place."""
        return np.asarray(self.rows.physics.qpos[self.row])

    @property
    def pushed(self) -> Array:
        """Generalized forces of pushes in the last step, shape (nv,), Nm or N."""
        return np.asarray(self.rows.pushed[self.row])

    @property
    def time(self) -> float:
        """Simulated time in seconds."""
        return float(self.data.time)

    @property
    def motor_torques(self) -> Array:
        """Torques that acted on the motors in the last step, shape (n,), Nm."""
        applied = self.rows.physics.applied[self.row]
        return np.asarray((applied - self.pushed)[self.joints.motor_dofs])

    def step(self, motor_torques: Array) -> Array:
        """Simulates one time step of a single row.

        Args:
            motor_torques: torques before gear friction, at the joint side, shape (n,), Nm. They are
                not limited.

        Returns:
            sensor readings `measured`, shape (3, n); always the same array.

        Raises:
            SimulationError: a torque is not finite, or the motion has become unstable. `measured`
                and `actual` are unchanged.
        """
        self.rows.step(motor_torques)
        if self.rows.failed:
            raise self.rows.failed.pop(self.row)
        return self.measured

    def reset(self, joint_angles: Any | None = None) -> None:
        """Resets the robots to rest and removes all pushes.

        Outside of a batch, payloads, friction and sensor faults remain. The noise restarts.

        Args:
            joint_angles: joint angles of all robots, shape (n,), rad (default: declared angles).

        Raises:
            ValueError: the joint angles are not n finite numbers.
        """
        angles = None if joint_angles is None else numbers(joint_angles)
        if angles is not None and angles.shape != (self.n,):
            raise Problem("joint_angles", found=angles.size, of="numbers", expected=self.n).error()
        self.rows.pushes[self.row].clear()
        self.rows.physics.applied[self.row] = self.rows.pushed[self.row] = 0.0
        self.rows.reset(self.row, angles)

    def external_torques(self) -> Array:
        """Returns the true external torques on the links in the last step, shape (n,), Nm.

        They result from pushes, contacts and joint stops. A payload is part of its robot.
        """
        return self.joints.external(self.row, self.pushed)

    def push(
        self,
        frame: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        expressed_in: str = "world",
        at: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Push:
        """Applies a force and a torque at a frame until `release` is called.

        Args:
            frame: frame that the force and the torque move with, for example `lwr/flange`.
            force: force vector, shape (3,), N.
            torque: torque vector, shape (3,), Nm.
            expressed_in: frame in whose axes both are expressed.
            at: point of application in `frame`, shape (3,), m (default: the origin).

        Returns:
            the push, whose `force` and `torque` can be changed at any time.

        Raises:
            UnknownName: there is no such frame.
            ValueError: a vector does not have three finite numbers.
        """
        return self.add_push(Push(self.world, frame, force, torque, expressed_in, at))

    def add_push(self, push: P) -> P:
        """Applies a push until `release` is called with it, and returns the push."""
        self.rows.pushes[self.row].append(push)
        self.rows.has_pushes = self.rows.has_changed = True
        return push

    def release(self, push: Push) -> None:
        """Removes a push, if it is active."""
        pushes = self.rows.pushes[self.row]
        if push in pushes:
            pushes.remove(push)
            self.rows.has_changed = True

    def attach_payload(
        self,
        robot: str,
        mass: float,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> None:
        """Attaches a payload to a robot's flange, in place of the previous payload.

        Args:
            mass: mass of the payload, kg.
            center_of_mass: center of mass in the flange frame, shape (3,), m.
            inertia: inertia about the center of mass, in the flange's axes, kg m2: 6 numbers (Ixx,
                Iyy, Izz, Ixy, Ixz, Iyz) or shape (3, 3) (default: the inertia of a steel ball).

        Raises:
            UnknownName: there is no such robot.
            ValueError: a rigid body cannot have this mass and inertia.
        """
        self._part(robot)
        attach_payload(self.rows.physics.own_model(self.row), robot, mass, center_of_mass, inertia)
        self.rows.physics.refresh(self.row)

    def detach_payload(self, robot: str) -> None:
        """Removes a robot's payload. Raises UnknownName if there is no such robot."""
        self._part(robot)
        detach_payload(self.rows.physics.own_model(self.row), robot)
        self.rows.physics.refresh(self.row)

    def set_friction(
        self, robot: str, viscous: ArrayLike | None = None, coulomb: ArrayLike | None = None
    ) -> None:
        """Changes the joint friction of a robot.

        Args:
            viscous: viscous friction, scalar or shape (n,), Nm s/rad (default: unchanged).
            coulomb: Coulomb friction, scalar or shape (n,), Nm (default: unchanged).

        Raises:
            UnknownName: there is no such robot.
            ValueError: a value is negative, or the number of values is neither 1 nor n.
        """
        dofs, model = self._part(robot).dofs, self.rows.physics.own_model(self.row)
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
        """Recomputes derived quantities after changes of `model` or `data`, without a time step."""
        self.joints.refresh()
        self.rows.physics.refresh(self.row)

    def flange(self, robot: str) -> Array:
        """Returns the true flange pose T_world_flange as a new array, shape (4, 4), m."""
        body = np.array([self.flange_body(robot)])
        return np.asarray(self.rows.physics.poses_of([self.row], body)[0])

    def flange_body(self, robot: str) -> int:
        """Returns the body index of a robot's flange."""
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
        """Returns the error for invalid motor torques, and sets the torques to zero."""
        torques = self.joints.motor_torques[self.row]
        joint = int(np.argmax(~(np.abs(torques) < MAX_TORQUE / np.sqrt(self.n))))
        problem = Problem(
            "",
            "found a motor torque of",
            found=float(torques[joint]),
            of="Nm",
            expected="a finite torque below 1e9",
        )
        torques[:] = 0.0
        return SimulationError(float(self.data.time), self._joint_name(joint), problem)

    def motion_error(self) -> SimulationError:
        """Returns the error for an unstable motion, which names the joint."""
        time, accelerations = self.rows.physics.broken[self.row]
        found = accelerations[self.joints.motor_dofs]
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
