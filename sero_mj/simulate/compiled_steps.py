"""`CompiledSteps`: many steps of a simulation in one call of machine code, see `run.jit`.

What a step costs in Python is mostly the way between calls. Here controllers, limits, drives,
physics, sensors and log of many steps are one function, which numba compiles. The laws are those
that run in Python; what surrounds them says the same as `Simulation`, `Drives` and `JointModel`
say for one step, and a test compares both.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from mujoco import mj_fwdKinematics, mj_step, mj_step2

from ..control import cartesian_control, jit, joint_control, robot_model
from ..control.cartesian_control import CartesianWork, cartesian_torques, write_spring_wrench
from ..control.jit import address_of, compiled, folder_of, read, table_of
from ..control.joint_control import GravityWork, JointWork, gravity_torques, joint_torques
from ..control.robot_model import ModelArrays, write_inverse_dynamics
from ..frames import Array, Ints, Matrix, Vector
from . import joint_model, plant
from .constraint_arrays import ConstraintArrays
from .controlled_robot import ControlledRobot
from .drives import Drives
from .joint_model import ACCELERATION, POSITION, VELOCITY, JointArrays
from .plant import MAX_TORQUE, Plant
from .sensors import SensorArrays

# By the type of what a law works with.
LAWS: dict[type, Callable[..., None]] = {
    GravityWork: gravity_torques,
    JointWork: joint_torques,
    CartesianWork: cartesian_torques,
}
_GRAVITY, _JOINT = range(2)  # in that order
DONE, NOTEWORTHY, UNSTABLE, REFUSED = range(4)  # why steps have come to an end


class RobotArrays(NamedTuple):
    """A robot and its plan. In its table follow its model, what is sensed, the target, and work.

    Attributes:
        law: its number among `LAWS`.
        is_elastic: whether its motors have encoders of their own, without errors.
        joint: which of the plant's joints is its first.
        rows: (steps or 1, ...), of the plan.
        planned: of the target what is in a row.
        asked: (n,), what the controller asks for.
        commanded: (n,), within the limits.
        limits: (n,).
    """

    law: int
    is_elastic: bool
    joint: int
    rows: Matrix
    planned: Vector
    asked: Vector
    commanded: Vector
    limits: Vector


class SensedArrays(NamedTuple):
    """Of `Sensed` what laws look at."""

    motor_state: Vector
    motor_angles: Vector
    motor_velocities: Vector


class TargetArrays(NamedTuple):
    """Of `Target` what laws look at."""

    has_torques: bool
    state: Vector
    velocities: Vector
    accelerations: Vector
    pose: Matrix
    position: Vector
    rotation: Matrix
    twist: Vector
    posture: Vector
    wrench: Vector
    torques: Vector


class DriveArrays(NamedTuple):
    """What is between controllers and motors, see `Drives`.

    Attributes:
        substeps: of the physics in one of the controllers.
        limits: (N,), of the motors; infinite where `Drives` do not take part.
        late: (delay + 1, N), torques that do not act yet.
        place: (1,), in `late`, of the next.
        has_loop: whether joint torque is controlled.
        matrix: of the loop, see `TorqueLoop`.
        terms: likewise.
        is_elastic: whether the loop gets the motors' velocities, instead of the links'.
    """

    substeps: int
    limits: Array
    late: Array
    place: Ints
    has_loop: bool
    matrix: Array
    terms: Array
    is_elastic: bool


class LogArrays(NamedTuple):
    """The log, (steps + 1, signals, N), and what it is written from.

    Attributes:
        measured: angles, velocities, torques.
        actual: likewise.
        driven: torques that are commanded and asked for.
        readings: (3N,), as `actual`.
        drive: (2, N), as `driven`.
        slow: square of the speed of all joints together at which none runs away.
    """

    measured: Array
    actual: Array
    driven: Array
    readings: Array
    drive: Array
    slow: float


_MODEL = len(RobotArrays._fields)
_SENSED = _MODEL + len(ModelArrays._fields)
_TARGET = _SENSED + len(SensedArrays._fields)
_WORK = _TARGET + len(TargetArrays._fields)


def command(table: Ints, joints: JointArrays, measured: Array, row: int) -> bool:
    """Computes the torques of one robot in a step; returns whether all are finite."""
    robot, model = read(RobotArrays, table), read(ModelArrays, table[_MODEL:])
    sensed: Any = read(SensedArrays, table[_SENSED:])
    target: Any = read(TargetArrays, table[_TARGET:])
    asked, work = robot.asked, table[_WORK:]
    for i in range(len(asked)):
        motor = robot.joint + i
        if robot.is_elastic:
            sensed.motor_angles[i] = joints.positions[joints.motor_positions[motor]]
            sensed.motor_velocities[i] = joints.velocities[joints.motor_dofs[motor]]
        else:
            sensed.motor_angles[i] = measured[0, motor]
            sensed.motor_velocities[i] = measured[1, motor]
    if len(robot.rows) > 1:
        robot.planned[:] = robot.rows[row]
    # What of the pose is not without gaps has copies.
    target.position[:] = target.pose[:3, 3]
    target.rotation[:] = target.pose[:3, :3]
    model.angles[:] = sensed.motor_angles
    mj_fwdKinematics(model.model, model.data)
    if robot.law == _GRAVITY:
        gravity_torques(model, read(GravityWork, work), sensed, target, asked)
    elif robot.law == _JOINT:
        joint_torques(model, read(JointWork, work), sensed, target, asked)
    else:
        cartesian_torques(model, read(CartesianWork, work), sensed, target, asked)
    is_finite = True
    for i in range(len(asked)):
        is_finite &= np.isfinite(asked[i])
        robot.commanded[i] = min(max(asked[i], -robot.limits[i]), robot.limits[i])
    return is_finite


def move(joints: JointArrays, constraints: ConstraintArrays, is_ahead: bool) -> bool:
    """Makes a step of the physics, see `JointModel.advance`; returns whether it is stable."""
    joints.positions_before[:] = joints.positions
    joints.velocities_before[:] = joints.velocities
    for i in range(len(joints.given)):
        joints.applied[joints.motor_dofs[i]] = joints.given[i]
    if is_ahead:
        mj_step2(joints.model, joints.data)
    else:
        mj_step(joints.model, joints.data)
    warned = joints.warned
    if warned[ACCELERATION] or warned[VELOCITY] or warned[POSITION]:
        return False
    joints.positions_after[:] = joints.positions
    joints.velocities_after[:] = joints.velocities
    first = (constraints.force_pointer[0] - constraints.arena_address) // 8
    for i in range(len(joints.coupling)):
        joints.coupling[i] = constraints.arena[first + joints.coupling_rows[i]]
    first += constraints.counts[1]  # behind equality constraints
    for i in range(len(joints.friction)):
        joints.friction[i] = constraints.arena[first + i]
    return True


def drive(
    drives: DriveArrays,
    joints: JointArrays,
    constraints: ConstraintArrays,
    sensors: SensorArrays,
    readings: Array,
    commanded: Array,
    is_ahead: bool,
) -> int:
    """Moves the plant by one step of the controllers, see `Drives.step`; returns how it ended."""
    n, given, limits, late = len(joints.given), joints.given, drives.limits, drives.late
    for i in range(n):
        if not abs(commanded[i]) < MAX_TORQUE / n:
            return REFUSED
    for substep in range(drives.substeps):
        if drives.has_loop:
            control_torque(drives, joints, sensors.measured, commanded)
        else:
            for i in range(n):
                given[i] = min(max(commanded[i], -limits[i]), limits[i])
        if len(late) > 1:
            late[drives.place[0] % len(late)] = given
            drives.place[0] += 1
            given[:] = late[drives.place[0] % len(late)]
        if not move(joints, constraints, is_ahead and substep == 0):
            return UNSTABLE
        np.dot(joints.readings_of, joints.terms, readings)
        measure(sensors, readings)
    return DONE


def measure(sensors: SensorArrays, readings: Array) -> None:
    """Reads plain sensors, see `Sensors.measure`."""
    n, k = len(sensors.speeds), sensors.state[0] % len(sensors.offsets)
    for signal in range(3):
        for i in range(n):
            value = readings[signal * n + i]
            if not sensors.is_perfect:
                if signal == 1 and sensors.is_differentiated[i]:
                    value = differentiated(sensors, i)
                value = value * sensors.gain[signal, i] + sensors.offsets[k, signal, i]
                grid = sensors.resolution[signal, i]
                if grid > 0.0:
                    value = np.rint(value / grid) * grid
            sensors.measured[signal, i] = value
    if not sensors.is_perfect:
        sensors.state[0] += 1
        if sensors.differentiates:
            sensors.angles[:] = sensors.measured[0]
            sensors.state[1] = 1


def differentiated(sensors: SensorArrays, i: int) -> float:
    """The velocity of a joint by the angles that are read, through its filter."""
    if sensors.state[1]:
        change = (sensors.measured[0, i] - sensors.angles[i]) / sensors.timestep
        sensors.speeds[i] += sensors.new_share[i] * (change - sensors.speeds[i])
    return float(sensors.speeds[i])


def control_torque(
    drives: DriveArrays, joints: JointArrays, measured: Array, commanded: Array
) -> None:
    """Makes a step of the torque loop, see `TorqueLoop.step`."""
    n, terms = len(joints.given), drives.terms
    terms[4 * n : 5 * n] = commanded
    terms[5 * n : 6 * n] = measured[1]
    terms[6 * n :] = measured[2]
    if drives.is_elastic:
        for i in range(n):
            terms[5 * n + i] = joints.velocities[joints.motor_dofs[i]]
    terms[: 4 * n] = drives.matrix.dot(terms)
    for i in range(n):
        terms[i] = min(max(terms[i], -drives.limits[i]), drives.limits[i])
        joints.given[i] = terms[i]


def run_steps(
    first: int,
    stop: int,
    is_ahead: bool,
    stops_at_contacts: bool,
    gains: Array,
    robots: Ints,
    joints: JointArrays,
    constraints: ConstraintArrays,
    sensors: SensorArrays,
    drives: DriveArrays,
    log: LogArrays,
) -> tuple[int, int]:
    """Makes the steps that lead to rows of the log.

    Args:
        first: row.
        stop: the one behind the last.
        is_ahead: whether what follows from the state has been computed.
        stops_at_contacts: whether it ends where something touches something.
        gains: (N,), by which commanded torques are multiplied.
        robots: (robots, values, 3), tables of those that are controlled.
        joints: of all of them.
        constraints: on them.
        sensors: in them.
        drives: of their motors.
        log: that is written.

    Returns:
        the last row that has been written, and why it is the last: all are `DONE`; something in it
        is `NOTEWORTHY`, a contact or a high speed; the step after it is `UNSTABLE`; or that has
        been `REFUSED` for its torques, and nothing has moved.
    """
    n, drive_torques, readings = len(joints.given), log.drive, log.readings
    for k in range(first, stop):
        for robot in range(len(robots)):
            if not command(robots[robot], joints, sensors.measured, k - 1):
                return k - 1, REFUSED
        commanded = drive_torques[0] * gains
        goes_on = is_ahead and k == first
        end = drive(drives, joints, constraints, sensors, readings, commanded, goes_on)
        if end != DONE:
            return k - 1, end
        speed = 0.0
        for i in range(n):
            motor = joints.velocities[joints.motor_dofs[i]]
            speed += max(readings[n + i] ** 2, motor**2)
            for signal in range(3):
                log.measured[k, signal, i] = sensors.measured[signal, i]
                log.actual[k, signal, i] = readings[signal * n + i]
            for signal in range(2):
                log.driven[k, signal, i] = drive_torques[signal, i]
        if not speed <= log.slow or (stops_at_contacts and constraints.counts[0] > 0):
            return k, NOTEWORTHY
    return stop - 1, DONE


# What `run_steps` calls, innermost first.
_CALLS = (
    write_inverse_dynamics,
    write_spring_wrench,
    gravity_torques,
    joint_torques,
    cartesian_torques,
    command,
    move,
    differentiated,
    measure,
    control_torque,
    drive,
)


@cache
def _compiled() -> Any:
    """`run_steps` as machine code.

    numba keeps it by its name, and until this file changes; so the name has the sum of the others
    that it is made of.
    """
    modules = jit, robot_model, joint_control, cartesian_control, joint_model, plant
    sources = hashlib.sha256("".join(map(inspect.getsource, modules)).encode()).hexdigest()
    steps = FunctionType(run_steps.__code__, run_steps.__globals__)
    steps.__qualname__ = f"run_steps_{sources[:12]}"
    return compiled(steps, *_CALLS)


class CompiledSteps:
    """The steps of a simulation as machine code.

    Args:
        plant: that is simulated.
        drives: of its motors; None where commanded torques are those of the motors.
        robots: with their controllers.
        log: what is written.
        stops_at_contacts: whether steps end where something touches something.
    """

    NOTEWORTHY, UNSTABLE, REFUSED = NOTEWORTHY, UNSTABLE, REFUSED

    def __init__(
        self,
        plant: Plant,
        drives: Drives | None,
        robots: list[ControlledRobot],
        log: LogArrays,
        *,
        stops_at_contacts: bool,
    ) -> None:
        self._plant, self._robots, self._log = plant, robots, log
        self._stops_at_contacts = stops_at_contacts
        self._run = _compiled()
        self._joints: JointArrays | None = None  # as they were last, with addresses next to them
        self._constraints = ConstraintArrays.of(plant.data)
        self._model, self._data = address_of(plant.model), address_of(plant.data)
        self._drives = _drive_arrays(plant, drives)
        # Tables do not keep alive what they are of.
        self._groups = [_groups_of(robot) for robot in robots]
        tables = [table_of(*groups) for groups in self._groups]
        self._tables = np.zeros((len(tables), max(map(len, tables)), 3), np.int64)
        for all_values, table in zip(self._tables, tables, strict=True):
            all_values[: len(table)] = table

    @staticmethod
    def obstacles(robots: list[ControlledRobot]) -> list[str]:
        """Why controllers have to run in Python; nothing where they need not."""
        found = []
        for robot in robots:
            _, limited, hanging = robot.in_use
            if type(getattr(limited.controller, "work", None)) not in LAWS:
                found.append(f"the controller of {robot.robot.name} is not one of sero-mj's")
            elif limited.has_rate_limits:
                found.append(f"controllers.{robot.robot.name}.torque_rate_limits")
            elif hanging is not None:
                found.append(f"elastic joints of {robot.robot.name} behind a torque loop")
        return found

    def run(self, first: int, stop: int, gains: Array) -> tuple[int, int]:
        """Makes steps, see `run_steps`.

        Args:
            first: row of the log.
            stop: the one behind the last; it ends before it where a controller has to be designed,
                or noise to be drawn. It makes none where noise is drawn within a step.
            gains: (N,), by which commanded torques are multiplied.
        """
        for robot in self._robots:
            stop = min(stop, first + robot.prepare(first - 1))
        stop = min(stop, first + self._plant.sensors.prepare() // self._drives.substeps)
        sensors = self._plant.sensors.arrays
        last, end = self._call(first, stop, gains, sensors)
        self._plant.sensors.take_compiled_readings(sensors.state)
        for robot in self._robots:
            robot.law_controller.pass_steps(last + 1 - first)
        if last >= first:
            self._plant.take_compiled_steps()
        return last, end

    def load(self) -> None:
        """Compiles steps or loads them from files, where that has not been done; makes none."""
        self._call(1, 1, np.ones(self._plant.n), self._plant.sensors.arrays)

    @property
    def folder(self) -> Path | None:
        """Where they are kept for the next time; None where no folder can be written to."""
        return folder_of(self._run)

    def _call(self, first: int, stop: int, gains: Array, sensors: SensorArrays) -> tuple[int, int]:
        joints = self._plant.joints
        if self._joints is not joints.arrays:
            self._joints = joints.arrays
            self._addressed = self._joints._replace(model=self._model, data=self._data)
        last, end = self._run(
            first,
            stop,
            joints.is_ahead,
            self._stops_at_contacts,
            gains,
            self._tables,
            self._addressed,
            self._constraints,
            sensors,
            self._drives,
            self._log,
        )
        return last, end


def _groups_of(robot: ControlledRobot) -> list[tuple[Any, ...]]:
    """All that is in a robot's table."""
    limited, controller, target = robot.controller, robot.law_controller, robot.target
    planned, rows = robot.plan
    own = RobotArrays(
        law=list(LAWS).index(type(controller.work)),
        is_elastic=robot.robot.elastic_joints,
        joint=robot.joints.start,
        rows=np.ascontiguousarray(rows),
        planned=planned,
        asked=limited.asked,
        commanded=robot.commanded,
        limits=limited.limits,
    )
    sensed = SensedArrays(*(getattr(robot.sensed, key) for key in SensedArrays._fields))
    values = {key: getattr(target, key) for key in TargetArrays._fields}
    values |= {key: np.array(values[key]) for key in ("position", "rotation")}
    return [own, controller.model.arrays, sensed, TargetArrays(**values), controller.work]


def _drive_arrays(plant: Plant, drives: Drives | None) -> DriveArrays:
    n, is_elastic = plant.n, plant.joints.elastic
    matrix, terms = np.zeros((0, 0)), np.zeros(0)
    if drives is None:
        late, place = np.zeros((1, n)), np.zeros(1, np.intp)
        return DriveArrays(1, np.full(n, np.inf), late, place, False, matrix, terms, is_elastic)
    has_loop = drives.loop is not None
    if drives.loop is not None:
        matrix, terms = drives.loop.matrix, drives.loop.terms
    late, place = drives.late, drives.place
    limits, substeps = drives.limits, drives.substeps
    return DriveArrays(substeps, limits, late, place, has_loop, matrix, terms, is_elastic)
