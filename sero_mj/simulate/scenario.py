"""`Scenario`: a scene to simulate, with controllers, targets, disturbances and faults."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from copy import copy
from functools import cache, partial
from math import ceil
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from ..base.declaration import Declaration, by_kind, of_shape
from ..base.errors import DeclarationError, Problem, collect
from ..base.frames import Array
from ..base.trust import FileOrigin, Request
from ..robots.assemble.robot_dynamics import EARTH
from ..robots.declared.degrees import look_like_degrees
from ..robots.declared.scene import Scene
from ..robots.declared.surroundings import Object
from .control.controller import Controller, ControllerDeclaration, as_controller, within
from .control.joint_control import GravityCompensation
from .control.make_controller import controller_from
from .control.plan import target_motion_from
from .control.target_motions import TargetMotion
from .disturbances import (
    DISTURBANCES,
    FAULTS,
    ControllerFault,
    Disturbance,
    Fault,
    Force,
    Payload,
)  # fmt: skip
from .expect import Expect
from .runs.monitor import Monitor
from .sensors import SIGNALS, SensorErrors, Sensors

log = logging.getLogger(__name__)

TORQUE_RATE = 3000.0  # rate of joint torque control on the LWR, Hz
OBSERVER_GAIN = 50.0  # default gain of the momentum observer, 1/s
_MAX_DURATION = 1e5  # maximum duration of a run, s


class RobotSensors(Declaration):
    """The sensor errors of a robot.

    Attributes:
        angles: errors of the encoders.
        velocities: errors of the velocity sensors, or of the differentiated velocities.
        torques: errors of the torque sensors.
        velocity_filter: bandwidth of the low-pass filter for velocities that are differentiated
            from encoder readings, 1/s. If None, velocities are the true velocities with the errors
            in `velocities`.
    """

    angles: SensorErrors = Field(default_factory=SensorErrors)
    velocities: SensorErrors = Field(default_factory=SensorErrors)
    torques: SensorErrors = Field(default_factory=SensorErrors)
    velocity_filter: float | None = Field(None, gt=0, le=1e5)


class Run(Declaration):
    """Settings of a simulation run.

    Attributes:
        duration: duration of the run, s.
        timestep: time step of the controllers and of the log, s.
        physics_timestep: time step of physics, sensors and joint torque control, s. `timestep` must
            be a multiple of it. The default is `timestep`, or with torque control a fraction of
            `timestep` that gives at least 3 kHz.
        torque_control: whether joint torque control acts between controllers and motors (see
            `TorqueControl`). Without it, commanded torques act directly on the motors.
        drive_delay: delay until a motor torque acts, s; a multiple of the physics time step.
        gravity: gravity vector in the world, shape (3,), m/s2; zeros for robots in orbit. It is
            known to the controllers.
        seed: seed of all random numbers.
        elastic: whether the joints of all robots are elastic (default: the setting of each robot).
        show_targets: whether transparent doubles show the commanded poses.
        show_paths: whether a series of transparent doubles shows each commanded path.
        observer_gain: gain of the momentum observer, 1/s.
        runaway_speed: velocity of a joint or its motor at which the run ends with an error, as a
            multiple of the velocity limit (default limit: 20 rad/s or 5 m/s); 0 disables the check.
    """

    duration: float = Field(5.0, gt=0, le=_MAX_DURATION)
    timestep: float = Field(0.001, ge=1e-5, le=0.05)
    physics_timestep: float | None = Field(None, ge=1e-5, le=0.05)
    torque_control: bool = False
    drive_delay: float = Field(0.0, ge=0, le=0.1)
    gravity: Annotated[Array, of_shape(3), within(-100.0, 100.0, "m/s2")] = EARTH
    seed: int = Field(0, ge=0, lt=2**32)
    elastic: bool | None = None
    show_targets: bool = True
    show_paths: bool = False
    observer_gain: float = Field(OBSERVER_GAIN, gt=0, le=1e4)
    runaway_speed: float = Field(3.0, ge=0, le=1e6)

    @model_validator(mode="before")
    @classmethod
    def _without_jit(cls, table: dict[str, Any]) -> dict[str, Any]:
        if "jit" in table:
            _warn_of_jit()
        return {key: value for key, value in table.items() if key != "jit"}

    @model_validator(mode="after")
    def _rates_fit(self) -> Run:
        problems: list[Problem] = []
        if self.physics_timestep is not None:
            ratio = self.timestep / self.physics_timestep
            if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-3 * ratio:
                fit = self.timestep / max(round(ratio), 1)
                expected = f"run.timestep ({self.timestep:g} s) / N, for example {fit:.6g} s"
                problems.append(
                    Problem(
                        "physics_timestep", found=self.physics_timestep, of="s", expected=expected
                    )
                )
        step = self.timestep / self.substeps
        ratio = self.drive_delay / step
        if not problems and abs(ratio - round(ratio)) > 1e-3 * max(ratio, 1.0):
            expected = (
                f"a multiple of the physics time step ({step:.6g} s), for example "
                f"{round(ratio) * step:.6g} s"
            )
            problems.append(
                Problem("drive_delay", found=self.drive_delay, of="s", expected=expected)
            )
        if self.observer_gain > max(OBSERVER_GAIN, (1 + 1e-9) / self.timestep):
            expected = f"at most {1 / self.timestep:g}, 1 / run.timestep"
            problems.append(
                Problem("observer_gain", found=self.observer_gain, of="1/s", expected=expected)
            )
        if problems:
            raise DeclarationError(problems)
        return self

    @property
    def steps(self) -> int:
        return max(round(self.duration / self.timestep), 1)

    @property
    def substeps(self) -> int:
        """Number of physics steps in one step of the controllers."""
        if self.physics_timestep is not None:
            return max(round(self.timestep / self.physics_timestep), 1)
        return max(ceil(self.timestep * TORQUE_RATE - 1e-6), 1) if self.torque_control else 1


@cache
def _warn_of_jit() -> None:
    log.warning("run.jit no longer has any effect; remove it")


class Scenario:
    """A scene with controllers, targets, disturbances, faults and expectations.

    Args:
        scene: scene with robots, objects and the view.
        controllers: mapping from robot names to controller declarations, their tables, or objects
            with the method `torques` of `Controller`. Robots without a controller compensate
            gravity. An entry for a group applies to all robots of the group that have no entry of
            their own, also in `targets` and `sensors`.
        targets: mapping from robot names to target motions of the joints or of the flange.
        sensors: mapping from robot names to sensor errors.
        disturbances: mapping from names to disturbances.
        faults: mapping from names to faults.
        expect: mapping from names to pass criteria.
        monitor: thresholds of the fault detector.
        name: name in titles.
        description: one line for `sero-mj list`.
        **run: fields of `Run`: `duration`, `timestep`, `seed`, ...

    Attributes:
        run: the settings of the run.
        file: file that the scenario was read from.
        settings: overrides by dotted key that were applied when the file was read.
        tables: the file of the scenario, and the scenarios that it extends.

    Raises:
        DeclarationError: the scenario is invalid. The error contains all problems.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        controllers: Mapping[str, Any] | None = None,
        targets: Mapping[str, Any] | None = None,
        sensors: Mapping[str, Any] | None = None,
        disturbances: Mapping[str, Any] | None = None,
        faults: Mapping[str, Any] | None = None,
        expect: Mapping[str, Any] | None = None,
        monitor: Mapping[str, Any] | Monitor | None = None,
        name: str = "scenario",
        description: str = "",
        **run: Any,
    ) -> None:
        self.problems: list[Problem] = []
        self.scene, self.name, self.description = scene, name, description
        self.file: Path | None = scene.file
        self.settings: Mapping[str, Any] = {}
        self.tables: tuple[Path, ...] = ()
        # If [run] is invalid, events after the default duration must not be reported.
        self.run = Run(duration=_MAX_DURATION)
        with collect(self.problems, "run"):
            self.run = Run(**run)
        self.controllers: dict[str, ControllerDeclaration | Controller] = self._each(
            "controllers", controllers
        )
        self.targets: dict[str, TargetMotion] = self._each("targets", targets)
        self.sensors: dict[str, RobotSensors] = self._each("sensors", sensors)
        for section in (self.controllers, self.targets, self.sensors):
            _share_out(section, scene)
        self.disturbances: dict[str, Disturbance] = self._each("disturbances", disturbances)
        self.faults: dict[str, Fault] = self._each("faults", faults)
        named = (set(each) for each in (disturbances, faults) if isinstance(each, Mapping))
        self.broken = set[str]().union(*named) - {*self.disturbances, *self.faults}
        self.expect: dict[str, Expect] = self._each("expect", expect)
        self.monitor = Monitor()
        with collect(self.problems, "monitor"):
            self.monitor = _built(Monitor, monitor or {})
        self._check_names()
        if self.problems:
            raise DeclarationError(scene.located(self.problems))

    def _each(self, section: str, tables: Mapping[str, Any] | None) -> dict[str, Any]:
        if tables is not None and not isinstance(tables, Mapping):
            self.problems.append(Problem(section, found=tables, expected="a table of named tables"))
            return {}
        found = {}
        for name, table in (tables or {}).items():
            with collect(self.problems, f"{section}.{name}"):
                found[name] = build_entry(section, table)
        return found

    def _check_names(self) -> None:
        robots = self.scene.robots
        if not robots:
            self.problems.append(Problem("robots", "found none; expected at least one"))
        for section in ("controllers", "targets", "sensors"):
            for name in getattr(self, section):
                if name not in robots:
                    self.problems.append(
                        Problem(
                            f"{section}.{name}",
                            "no robot",
                            found=name,
                            available=[*robots, *self.scene.groups],
                        )
                    )
        for name, controller in self.controllers.items():
            joints = getattr(controller, "protocol_joints", None)
            if name in robots and joints is not None and robots[name].n != joints:
                kind = getattr(controller, "kind", "")
                message = f"'{kind}' is for {joints} joints, but {name} has {robots[name].n}"
                self.problems.append(Problem(f"controllers.{name}.kind", message))
        for name, disturbance in self.disturbances.items():
            self._check_disturbance(f"disturbances.{name}", disturbance)
        for section in ("disturbances", "faults"):
            for name, each in getattr(self, section).items():
                if each.begin >= self.run.duration:
                    end = f"before the end of the run at {self.run.duration:g} s"
                    message = f"found {each.begin:g} s; expected a time {end}"
                    self.problems.append(Problem(f"{section}.{name}.begin", message))
        self._check_starts()
        for name, fault in self.faults.items():
            with collect(self.problems, f"faults.{name}"):
                fault.check(robots)
        for name, expect in self.expect.items():
            with collect(self.problems, f"expect.{name}"):
                expect.check(self)

    def _check_starts(self) -> None:
        for name, robot in self.scene.robots.items():
            if robot.position_limits is None:
                continue
            low, high = robot.position_limits.T
            in_degrees = look_like_degrees(robot, robot.home)
            for joint in np.flatnonzero((robot.home < low) | (robot.home > high)):
                turns = robot.types[joint] == "revolute"
                factor, unit = (np.rad2deg(1.0), "deg") if turns else (1.0, "m")
                numbers = factor * np.array([robot.home[joint], low[joint], high[joint]])
                found = f"joint {robot.names[joint]} starts at {numbers[0]:.4g} {unit}"
                message = f"{found}; expected {numbers[1]:.4g} to {numbers[2]:.4g} {unit}"
                message += "; are the angles in degrees?" if in_degrees[joint] else ""
                self.problems.append(Problem(f"robots.{name}.joint_angles", message))

    def _check_disturbance(self, place: str, disturbance: Disturbance) -> None:
        known: list[tuple[str, str, list[str]]] = []
        if isinstance(disturbance, Force):
            frames = [*self.scene.named_frames(), "world"]
            known = [("at", "frame", frames[:-1]), ("expressed_in", "frame", frames)]
        elif isinstance(disturbance, Payload):
            objects = [each.name for each in self.scene.objects]
            known = [("robot", "robot", [*self.scene.robots]), ("object", "object", objects)]
        for key, what, names in known:
            value = getattr(disturbance, key)
            known_as = self.scene.frame_name(value) if what == "frame" and value else value
            if value is not None and known_as not in names:
                self.problems.append(
                    Problem(f"{place}.{key}", f"no {what}", found=value, available=names)
                )

    @property
    def duration(self) -> float:
        return self.run.duration

    @property
    def obstacles(self) -> list[Object]:
        """Objects that robots can collide with, which are all objects that no robot carries."""
        payloads = [each for each in self.disturbances.values() if isinstance(each, Payload)]
        carried = {payload.object for payload in payloads}
        return [each for each in self.scene.objects if each.name not in carried]

    @property
    def has_surroundings(self) -> bool:
        """Whether robots can have contacts with objects, a floor or each other."""
        return bool(self.obstacles or self.scene.floor) or len(self.scene.robots) > 1

    @property
    def amplifies(self) -> bool:
        """Whether a fault increases commanded torques beyond the controllers' limits."""
        faults = self.faults.values()
        return any(isinstance(each, ControllerFault) and abs(each.gain) > 1 for each in faults)

    def request(self) -> Request | None:
        """Returns the programs and libraries that a simulation would run, or None without any."""
        actions = [
            action
            for name, declared in self.controllers.items()
            if isinstance(declared, ControllerDeclaration)
            for action in declared.actions(f"controllers.{name}")
        ]
        file = self.file or Path(self.name)
        return Request(file, tuple(actions), self.tables) if actions else None

    def set_origin(self, origin: FileOrigin) -> None:
        """Sets the file that the controllers were read from, and whether it is trusted."""
        for declared in self.controllers.values():
            if isinstance(declared, ControllerDeclaration):
                declared.set_origin(origin)

    @property
    def withheld(self) -> Request | None:
        """Programs and libraries that the scenario has no permission to run, or None."""
        origins = [getattr(declared, "origin", None) for declared in self.controllers.values()]
        is_trusted = all(origin is None or origin.is_trusted for origin in origins)
        return None if is_trusted else self.request()

    def without_programs(self) -> Scenario:
        """Returns a copy in which robots with external controllers compensate gravity."""
        copied = copy(self)
        copied.controllers = {
            name: declared
            for name, declared in self.controllers.items()
            if not (isinstance(declared, ControllerDeclaration) and declared.actions())
        }
        return copied

    def has_target(self, robot: str) -> bool:
        """Returns whether a robot has a target, either a declared one or its initial pose."""
        if self._is_wrong(f"controllers.{robot}", f"targets.{robot}"):
            return True  # its declaration is invalid, which is reported already
        return robot in self.targets or as_controller(self.controller_of(robot)).needs_target

    def is_in_real_time(self, robot: str) -> bool:
        """Returns whether a robot's controller runs in real time."""
        controller = as_controller(self.controller_of(robot))
        return bool(controller.is_in_real_time) or self._is_wrong(f"controllers.{robot}")

    def _is_wrong(self, *sections: str) -> bool:
        keys = [f"{problem.key}." for problem in self.problems]
        return any(key.startswith(f"{each}.") for key in keys for each in sections)

    def controller_of(self, robot: str) -> Any:
        """Returns the controller of a robot (default: gravity compensation)."""
        return self.controllers.get(robot, GravityCompensation())

    def make_sensors(self, seed: int) -> Sensors:
        """Returns one object with the sensors of all robots.

        Raises:
            DeclarationError: a sensor error has the wrong number of values, or delays differ.
        """
        merged: dict[str, SensorErrors] = {}
        for signal in SIGNALS:
            parts: dict[str, list[Array]] = {
                key: [] for key in ("noise", "bias", "resolution", "gain")
            }
            delays = {}
            for name, robot in self.scene.robots.items():
                declared = self.sensors.get(name) or RobotSensors()
                place = f"sensors.{name}.{signal}"
                errors: SensorErrors = getattr(declared, signal)
                for key, values in parts.items():
                    value = np.asarray(getattr(errors, key))
                    if value.shape not in ((), (1,), (robot.n,)):
                        self.problems.append(
                            Problem(
                                f"{place}.{key}",
                                found=value.size,
                                of="numbers",
                                expected=f"1 or {robot.n}",
                            )
                        )
                        value = np.zeros(())
                    values.append(np.broadcast_to(value, robot.n))
                delays[name] = errors.delay
            if len(set(delays.values())) > 1:
                found = ", ".join(f"{name} {delay}" for name, delay in delays.items())
                message = f"the robots have different delays of {signal} ({found} steps); "
                message += "expected the same for all"
                self.problems.append(Problem("sensors", message))
            joined = {key: np.concatenate(values) for key, values in parts.items()}
            # Sensors are read in every physics step, but delays count steps of the controllers.
            delay = max(delays.values()) * self.run.substeps
            merged[signal] = SensorErrors(**joined, delay=delay)
        if self.problems:
            raise DeclarationError(self.scene.located(self.problems))
        filters = [
            np.full(robot.n, (self.sensors.get(name) or RobotSensors()).velocity_filter or 0.0)
            for name, robot in self.scene.robots.items()
        ]
        return Sensors(
            sum(map(len, filters)),
            seed=seed,
            **merged,
            velocity_filter=np.concatenate(filters),
            timestep=self.run.timestep / self.run.substeps,
        )


def _share_out(section: dict[str, Any], scene: Scene) -> None:
    """Replaces group entries with entries for their robots. Inner groups take precedence."""
    around, members = scene.membership.around, scene.membership.members
    own = {name: section.pop(name) for name in [*section] if name in members}
    robots = dict.fromkeys(robot for name in own for robot in members[name])
    for robot in robots:
        first = next(group for group in around[robot] if group in own)  # inner groups come first
        section.setdefault(robot, own[first])


def build_entry(section: str, table: Any) -> Any:
    """Builds the object that a table declares; objects are returned unchanged.

    Args:
        section: `controllers`, `targets`, `sensors`, `disturbances`, `faults` or `expect`.

    Raises:
        DeclarationError: the table is invalid.
    """
    return _BUILDERS[section](table)


def _built(kind: Any, table: Any) -> Any:
    if isinstance(table, kind):
        return table
    if not isinstance(table, Mapping):
        raise Problem(found=table, expected="a table").error()
    return kind(**table)


def _controller(table: Any) -> ControllerDeclaration | Controller:
    if isinstance(table, Mapping) or not callable(getattr(table, "torques", None)):
        return controller_from(table)
    controller: Controller = table
    return controller


_BUILDERS: Mapping[str, Callable[[Any], Any]] = {
    "controllers": _controller,
    "targets": target_motion_from,
    "sensors": partial(_built, RobotSensors),
    "disturbances": partial(by_kind, kinds=DISTURBANCES, base=Disturbance),
    "faults": partial(by_kind, kinds=FAULTS, base=Fault),  # type: ignore[type-abstract]
    "expect": partial(_built, Expect),
}
