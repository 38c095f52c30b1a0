"""`RobotEquations`: the torques of a whole robot as linear equations of its parameters.

With the base parameters b of the links (see `BaseParameters`), and the parameters of the drives:

    link side:   measured = Y(q, dq, ddq) b + o
    drive side:  commanded - measured = B ddtheta + v dq + f sign(dq) + c

Without torque sensors, there is one equation for each joint, which is the sum of both:

    commanded = Y(q, dq, ddq) b + B ddq + v dq + f sign(dq) + o

Further terms are added if they are needed: Stribeck friction s sign(dq) exp(-(dq / v_s)^2),
friction in proportion to the link torque l |torque| sign(dq), and the derivatives with respect to
angle offsets and to the inclination of the base about x and y of the world.

Sources: Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, chapter 12.
Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation
methods for the control of machines with friction, Automatica 30(7), 1994 (Stribeck friction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....base.frames import Array, Bools, rotation_about
from ....robots.assemble.robot_dynamics import robot_dynamics
from ....robots.declared.robot import SerialRobot
from ..base_parameters import BaseParameters, standard_parameters, standard_torques
from ..link_torques import body_torques, link_motion
from ..torque_residuals import TorqueResiduals

DRIVE = ("coulomb_friction", "viscous_friction", "motor_inertia")
STRIBECK_SPEEDS = (0.02, 0.05, 0.1, 0.2)  # rad/s or m/s
_STEP = 1e-4  # rad or m, step of numerical derivatives
_UNITS = {
    "coulomb_friction": ("N", "Nm"), "viscous_friction": ("N s/m", "Nm s/rad"),
    "motor_inertia": ("kg", "kg m2"), "torque_offset": ("N", "Nm"), "drive_offset": ("N", "Nm"),
    "stribeck_friction": ("N", "Nm"), "load_friction": ("", ""),
    "angle_offset": ("m", "rad"), "tilt": ("rad", "rad"),
}  # fmt: skip
_OF_LINKS = {"m": "kg", "h": "kg m", "I": "kg m2"}  # by the first letter of a standard parameter


@dataclass(frozen=True)
class Parameter:
    """A parameter of the equations.

    Attributes:
        kind: `link`, `coulomb_friction`, `viscous_friction`, `motor_inertia`, `torque_offset`,
            `drive_offset`, `stribeck_friction`, `load_friction`, `angle_offset` or `tilt`.
        name: a base parameter such as `A2.hx + 0.31 A3.mass`, or `JOINT.KIND`.
        joint: index of the joint; of `tilt`, 0 for x and 1 for y.
        speed: Stribeck velocity, rad/s or m/s.
    """

    kind: str
    name: str
    unit: str
    joint: int = 0
    speed: float = 0.0

    @classmethod
    def of_joint(cls, robot: SerialRobot, kind: str, joint: int, speed: float = 0.0) -> Parameter:
        unit = _UNITS[kind][robot.types[joint] == "revolute" if kind != "tilt" else 0]
        name = f"base.tilt_{'xy'[joint]}" if kind == "tilt" else f"{robot.names[joint]}.{kind}"
        return cls(kind, name, unit, joint, speed)


@dataclass(frozen=True, eq=False)
class RobotEquations:
    """The equations y = X p of s series at K times.

    The first n series are those of the links, or of joints without a torque sensor. The next n are
    those of the drives, if the run contains commanded and measured torques.

    Attributes:
        parameters: names and units of the p parameters.
        X: columns, shape (K, s, p), zero if unknown.
        y: torques, shape (K, s), Nm or N, zero if unknown.
        known: whether the torque is known and its friction is that of a moving joint, shape (K, s).
        drift: change of the torques in half a sampling interval, shape (K, s).
        scale: torque limits of the series, shape (s,).
    """

    parameters: list[Parameter]
    X: Array
    y: Array
    known: Bools
    drift: Array
    scale: Array

    def with_column(self, parameter: Parameter, column: Array) -> RobotEquations:
        """Returns the equations with another column, shape (K, s)."""
        X = np.concatenate([self.X, np.where(self.known, column, 0.0)[..., None]], axis=2)
        parameters = [*self.parameters, parameter]
        return RobotEquations(parameters, X, self.y, self.known, self.drift, self.scale)


@dataclass(frozen=True, eq=False)
class EquationBuilder:
    """Builds the equations of one run.

    Attributes:
        has_sensors: whether the torques of `found` are measured instead of commanded.
        has_drives: whether the equations contain the parameters of the drives.
        is_separable: whether motor inertias differ from base parameters, shape (n,).
    """

    found: TorqueResiduals
    base: BaseParameters
    has_sensors: bool
    has_drives: bool
    is_separable: Bools

    @property
    def robot(self) -> SerialRobot:
        return self.found.robot

    def plain(self, shift: Array) -> RobotEquations:
        """Returns the equations without optional parameters.

        Args:
            shift: known angle offsets and inclinations about x and y, shape (n + 2,), rad or m.
        """
        found, robot, n = self.found, self.robot, self.robot.n
        K = len(found.times)
        by_links = found.filtered(lambda q, v, a: self._by_base(q, v, a, shift))
        by_links[~np.isfinite(by_links)] = 0.0
        y, known = found.torques.measured, np.isfinite(found.link)
        scale = found.scale
        parameters = [Parameter("link", name, _unit_of_links(name)) for name in self.base.names]
        if self.has_sensors and self.has_drives:
            y, scale = np.concatenate([y, found.lag], axis=1), np.tile(scale, 2)
            known = np.concatenate([known, np.isfinite(found.motor)], axis=1)
            by_links = np.concatenate([by_links, np.zeros_like(by_links)], axis=1)
        elif self.has_drives:
            known = known & np.isfinite(found.motor)
        s = y.shape[1]
        columns = [by_links]
        kinds = [("torque_offset", 0, np.ones((K, n)))]
        if self.has_drives:
            kinds += [(kind, s - n, column) for kind, column in self._drive_columns().items()]
            if self.has_sensors:
                kinds += [("drive_offset", n, np.ones((K, n)))]
        for kind, first, values in kinds:
            for j in range(n):
                column = np.zeros((K, s, 1))
                column[:, first + j, 0] = values[:, j]
                if kind != "motor_inertia" or self.is_separable[j]:
                    columns.append(column)
                    parameters.append(Parameter.of_joint(robot, kind, j))
                else:  # the declared motor inertia is part of the known torques
                    y = y - robot_dynamics(robot).motor_inertias[j] * column[..., 0]
        X = np.nan_to_num(np.concatenate(columns, axis=2))
        X, y = np.where(known[..., None], X, 0.0), np.where(known, y, 0.0)
        rates = np.gradient(y, found.step, axis=0)
        return RobotEquations(parameters, X, y, known, 0.5 * found.sample_time * rates, scale)

    def declared(self, equations: RobotEquations) -> Array:
        """Returns the declared or estimated values of the parameters, shape (p,)."""
        dynamics = robot_dynamics(self.robot)
        values = np.zeros(len(equations.parameters))
        values[: len(self.base)] = self.base.combination @ standard_parameters(self.robot)
        for k, each in enumerate(equations.parameters):
            if each.kind in DRIVE:
                key = "motor_inertias" if each.kind == "motor_inertia" else each.kind
                values[k] = getattr(dynamics, key)[each.joint]
        return values

    def optional(self) -> list[Parameter]:
        """Returns the optional parameters, which only some robots need."""
        robot = self.robot
        found = [Parameter.of_joint(robot, "angle_offset", j) for j in range(robot.n)]
        found += [Parameter.of_joint(robot, "tilt", axis) for axis in range(2)]
        if self.has_drives:
            for j in range(robot.n):
                found.append(Parameter.of_joint(robot, "load_friction", j))
                found += [Parameter.of_joint(robot, "stribeck_friction", j, speed)
                          for speed in STRIBECK_SPEEDS]  # fmt: skip
        return found

    def column(self, parameter: Parameter, links: Array, shift: Array, s: int) -> Array:
        """Returns the column of an optional parameter, shape (K, s).

        Args:
            links: standard parameters of the links, shape (10 n,).
            shift: angle offsets and inclinations, as in `plain`.
        """
        j, n, motion = parameter.joint, self.robot.n, self.found.motion
        column = np.zeros((len(self.found.times), s))
        if parameter.kind == "load_friction":
            column[:, s - n + j] = motion.signs[:, j] * np.abs(self.found.torques.measured[:, j])
        elif parameter.kind == "stribeck_friction":
            speed = motion.velocities[:, j] / parameter.speed
            column[:, s - n + j] = motion.signs[:, j] * np.exp(-(speed**2))
        else:
            step = np.zeros(n + 2)
            step[j + n * (parameter.kind == "tilt")] = _STEP
            q, v, a = motion.links
            more, less = (self._by_links(q, v, a, shift + side * step, links) for side in (1, -1))
            column[:, :n] = (more - less) / (2.0 * _STEP)
        return np.nan_to_num(column)

    def _drive_columns(self) -> dict[str, Array]:
        found, motion = self.found, self.found.motion
        # Mean velocity of the sampling interval, at whose ends the torques may have been sampled.
        velocities = motion.velocities - 0.5 * found.sample_time * motion.accelerations
        return dict(zip(DRIVE, (motion.signs, velocities, motion.accelerations), strict=True))

    def _tilted(self, shift: Array) -> SerialRobot:
        tilt = np.eye(4)
        tilt[:3, :3] = rotation_about(0, shift[-2]) @ rotation_about(1, shift[-1])
        return self.robot.model_copy(update={"base_frame": tilt @ self.robot.base_frame})

    def _by_base(self, q: Array, v: Array, a: Array, shift: Array) -> Array:
        robot, q = self._tilted(shift), q + shift[: self.robot.n]
        motion = link_motion(robot, q, v, a)
        columns = np.empty((len(q), robot.n, len(self.base)))
        for link in np.unique(self.base.indices // 10).tolist():
            own = self.base.indices // 10 == link
            torques = body_torques(robot, q, v, a, link + 1, motion)
            columns[:, :, own] = torques[:, :, self.base.indices[own] % 10]
        return columns

    def _by_links(self, q: Array, v: Array, a: Array, shift: Array, links: Array) -> Array:
        robot, q = self._tilted(shift), q + shift[: self.robot.n]
        motion = link_motion(robot, q, v, a)
        return sum(
            (body_torques(robot, q, v, a, i + 1, motion) @ links[10 * i : 10 * i + 10]
             for i in range(robot.n)),
            np.zeros((len(q), robot.n)),
        )  # fmt: skip


def separable_inertias(robot: SerialRobot, base: BaseParameters) -> Bools:
    """Returns whether the torque of each motor inertia differs from those of all links, (n,)."""
    rng, n = np.random.default_rng(1), robot.n
    low, high = robot.display_ranges.T
    q = rng.uniform(low, high, (60, n))
    v, a = rng.normal(0.0, 2.0, (2, 60, n))
    X = base.columns(standard_torques(robot, q, v, a)).reshape(60 * n, -1)
    motors = (a[:, :, None] * np.eye(n)).reshape(60 * n, n)
    left = motors - X @ np.linalg.lstsq(X, motors, rcond=None)[0]
    return np.asarray(np.linalg.norm(left, axis=0) > 1e-6 * np.linalg.norm(motors, axis=0))


def _unit_of_links(name: str) -> str:
    standard = name.split(maxsplit=1)[0].rpartition(".")[2]
    return _OF_LINKS[standard[0]]
