"""`Plant`: the simulated robots, which take motor torques and give what their sensors read."""

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

MAX_TORQUE = 1e9  # Nm, norm of all motor torques; a comparison with it refuses NaN as well


class PlantRows:
    """The robots of m equal worlds, which are stepped together; `Plant` is one row of them.

    Args:
        world: compiled with `dynamic=True`.

    Attributes:
        n: number of joints of all robots of a row together.
        joints: motors, links and torque sensors in MuJoCo.
        measured: (m, 3, n), what the sensors read; always the same array.
        motor_angles: (m, n), true, rad: before the spring of an elastic joint; always the same
            array.
        motor_velocities: (m, n), the same for velocities, rad/s.
        timestep: of a step, s.
        pushes: that act, of every row.
        has_pushes: whether any acts, or did in the last step.
        has_changed: whether others act in the next step.
        pushed: (m, nv), torques of pushes in the last step, Nm or N.
        failed: errors of rows that could not take the last step.
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
        self._is_measured = False  # whether `measured` has the true values
        self._readings = self._actual.reshape(m, -1, 1)
        self._measured_readings = self.measured.reshape(m, -1, 1)
        self.timestep = float(world.model.opt.timestep)
        self.failed: dict[int, SimulationError] = {}
        self.has_pushes = self.has_changed = False
        self.pushed: Array = np.zeros((m, world.model.nv))
        self.pushes: list[list[Push]] = [[] for _ in range(m)]
        self._acting: PushRows | None = None  # of several rows, those of the last step
        self._each = sensors
        self._scratch = self.physics.data_of(0) if m == 1 else mujoco.MjData(model)

    def row(self, row: int) -> Plant:
        """The robots of a row; a new object, for one that is kept here would be freed late."""
        return Plant(self.world, self._each[row], rows=self, row=row)

    @property
    def actual(self) -> Array:
        """(m, 3, n), true angles and velocities of the links and torques between motors and links.

        The latter during the last step; rad, rad/s, Nm. Not to be written into.
        """
        if self._is_measured and not self.sensors.is_perfect:  # since a moment ago
            np.copyto(self._actual, self.measured)
            self._is_measured = False
        return self.measured if self._is_measured else self._actual

    def reset(self, row: int, joint_angles: Array | None = None) -> None:
        """Puts the robots of a row at rest; frictions of a row of several are as declared again.

        Args:
            joint_angles: (n,), rad; the declared ones when None.
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
        """Simulates one timestep; rows that cannot take it are in `failed` then.

        Args:
            motor_torques: (m, n), before gear friction and as seen at the joint, Nm.

        Returns:
            `measured`, (m, 3, n).
        """
        applied = self.joints.motor_torques
        applied[...] = motor_torques
        if not np.vdot(applied, applied) < MAX_TORQUE**2:
            self._refuse_torques()
        return self.step_given()

    def _refuse_torques(self) -> None:
        for row, torques in enumerate(self.joints.motor_torques):
            if not np.vdot(torques, torques) < MAX_TORQUE**2:
                self._fail(row, self.row(row).torque_error())

    def _fail(self, row: int, error: SimulationError) -> None:
        self.failed[row] = error
        self.physics.drop(row)

    def step_given(self) -> Array:
        """Simulates one timestep with `joints.motor_torques`, unchecked; see `step`."""
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
        """Joint torques of all pushes, (m, nv), Nm; None without pushes."""
        if not self.has_pushes:
            return None
        physics = self.physics
        physics.applied[...] = self.pushed[...] = 0.0
        if physics.m == 1:  # `mj_applyFT` takes 5 us, `PushRows` 25 us
            acting = self.pushes[0]
            self.has_pushes = bool(acting)
            if acting:
                physics.look_ahead()
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
    """All robots of a dynamic world, joint after joint in the order of `world.robots`.

    After construction and, if `rows.joints.looks_ahead`, after every step `data` holds the
    kinematics, the mass matrix and the bias torques (`qfrc_bias`) of the state that it is in, so a
    controller need not compute them.

    Args:
        world: compiled with `dynamic=True`.
        sensors: of the robots; perfect ones when None.
        timestep: s; the model's when None.
        rows: the rows that this one belongs to, if it is stepped with others.
        row: its index among them.

    Attributes:
        measured: (3, n), what the sensors read; always the same array.
        motor_angles: (n,), true, rad: before the spring of an elastic joint; always the same array.
        motor_velocities: (n,), the same for velocities, rad/s.

    Raises:
        ValueError: the world is not dynamic, the timestep not positive, or the sensors are not
            those of n joints.
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
            raise ValueError("found a world to look at; expected World(scene, dynamic=True)")
        if timestep is not None:
            if not 0 < timestep < 1:
                raise Problem(
                    "timestep", found=timestep, of="s", expected="more than 0, below 1"
                ).error()
            world.model.opt.timestep = timestep
        n = sum(part.robot.n for part in world.robots.values())
        self.sensors = Sensors(n) if sensors is None else sensors
        if self.sensors.n != n:
            raise Problem(
                "", "found sensors of", found=self.sensors.n, of="joints", expected=n
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
        """(3, n), true angles and velocities of the links and torques between motors and links.

        The latter during the last step; rad, rad/s, Nm. Not to be written into.
        """
        return np.asarray(self.rows.actual[self.row])

    @property
    def model(self) -> mujoco.MjModel:
        """Its `MjModel`; payloads and frictions change it."""
        return self.rows.physics.model_of(self.row)

    @property
    def data(self) -> mujoco.MjData:
        """Its `MjData`; of several rows a copy, until that of the next row is asked for."""
        return self.rows.physics.data_of(self.row)

    @property
    def qpos(self) -> Array:
        """MuJoCo's coordinates, (nq,), in place."""
        return np.asarray(self.rows.physics.qpos[self.row])

    @property
    def pushed(self) -> Array:
        """Joint torques of pushes in the last step, (nv,), Nm or N."""
        return np.asarray(self.rows.pushed[self.row])

    @property
    def time(self) -> float:
        """Since the start, s."""
        return float(self.data.time)

    @property
    def motor_torques(self) -> Array:
        """What acted on the motors in the last step, (n,), Nm."""
        applied = self.rows.physics.applied[self.row]
        return np.asarray((applied - self.pushed)[self.joints.motor_dofs])

    def step(self, motor_torques: Array) -> Array:
        """Simulates one timestep of robots that are the only row.

        Args:
            motor_torques: (n,), before gear friction and as seen at the joint, Nm; none is cut
                off here.

        Returns:
            `measured`, (3, n): the same array every time.

        Raises:
            SimulationError: a torque is not a number, or the motion has become unstable; names the
                joint and the time. `measured` and `actual` are those before.
        """
        self.rows.step(motor_torques)
        if self.rows.failed:
            raise self.rows.failed.pop(self.row)
        return self.measured

    def reset(self, joint_angles: Any | None = None) -> None:
        """Puts the robots where they are declared to be, at rest, and ends pushes.

        Payloads, frictions and faults of sensors stay; the noise begins anew.

        Args:
            joint_angles: (n,), of all robots, rad; the declared ones when None.

        Raises:
            ValueError: not n finite numbers.
        """
        angles = None if joint_angles is None else numbers(joint_angles)
        if angles is not None and angles.shape != (self.n,):
            raise Problem("joint_angles", found=angles.size, of="numbers", expected=self.n).error()
        self.rows.pushes[self.row].clear()
        self.rows.physics.applied[self.row] = self.rows.pushed[self.row] = 0.0
        self.rows.reset(self.row, angles)

    def external_torques(self) -> Array:
        """What acted on the links from outside in the last step, (n,), Nm, true.

        Of pushes, contacts and stops; a payload is a part of its robot.
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
        self.rows.pushes[self.row].append(push)
        self.rows.has_pushes = self.rows.has_changed = True
        return push

    def release(self, push: Push) -> None:
        """Ends a push; nothing happens if it has ended."""
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
        """Fixes a payload to a robot's flange, in place of the one that it may have.

        Args:
            mass: kg.
            center_of_mass: (3,), in the flange's frame, m.
            inertia: about it, in the flange's axes, kg m2: 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz,
                Iyz) or (3, 3); that of a ball of steel when None.

        Raises:
            UnknownName: no such robot.
            ValueError: no rigid body has this mass and inertia.
        """
        self._part(robot)
        attach_payload(self.rows.physics.own_model(self.row), robot, mass, center_of_mass, inertia)
        self.rows.physics.refresh(self.row)

    def detach_payload(self, robot: str) -> None:
        """Takes a robot's payload away.

        Raises:
            UnknownName: no such robot.
        """
        self._part(robot)
        detach_payload(self.rows.physics.own_model(self.row), robot)
        self.rows.physics.refresh(self.row)

    def set_friction(
        self, robot: str, viscous: ArrayLike | None = None, coulomb: ArrayLike | None = None
    ) -> None:
        """Changes a robot's friction from now on.

        Args:
            viscous: one number or (n,), Nm s/rad; as it is when None.
            coulomb: likewise, Nm.

        Raises:
            UnknownName: no such robot.
            ValueError: a friction below zero, or neither one nor n.
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
        """Recomputes what depends on `model` and `data` after they were changed; no time passes."""
        self.joints.refresh()
        self.rows.physics.refresh(self.row)

    def flange(self, robot: str) -> Array:
        """T_world_flange now, (4, 4), m: the true one, in an array of its own."""
        body = np.array([self.flange_body(robot)])
        return np.asarray(self.rows.physics.poses_of([self.row], body)[0])

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
        torques = self.joints.motor_torques[self.row]
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
