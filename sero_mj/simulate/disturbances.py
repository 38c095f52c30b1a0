"""Disturbances of a scenario (external forces, payloads) and faults of its robots."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from ..base.declaration import Declaration, Frame, Name, Point, Vector, of_shape
from ..base.errors import Problem
from ..base.frames import Array
from ..robots.declared.dynamics import inertia_problem, tensors_from
from ..robots.declared.robot import SerialRobot
from .plant import Plant
from .sensors import Signal

_SAME_TIME = 1e-9  # tolerance of times, s
Part = Literal["sensors", "drives", "friction"]


class Timed(Declaration):
    """An event with a beginning and an optional end.

    Attributes:
        begin: start time, s.
        end: end time, s (default: no end).
    """

    begin: float = Field(0.0, ge=0)
    end: float | None = None

    @model_validator(mode="after")
    def _ends_later(self) -> Self:
        if self.end is not None and self.end <= self.begin:
            raise Problem(
                "end", found=self.end, expected=f"a time after begin ({self.begin:g} s)"
            ).error()
        return self


class Disturbance(Timed):
    """Base class of all disturbance declarations."""


class Force(Disturbance):
    """An external force and torque at a frame of a robot, which move with the frame.

    Attributes:
        at: frame that force and torque move with, for example `lwr/flange`.
        point: point of application in this frame, shape (3,), m.
        force: force vector, shape (3,), N.
        torque: torque vector, shape (3,), Nm.
        expressed_in: frame in whose axes force and torque are expressed.
        profile: time profile: `step`, `half_sine` (rises and falls until `end`) or `ramp` (rises
            until `end`, and then stays constant).
        samples: piecewise constant force instead of `force`, shape (S, 4): time since `begin` in
            seconds, and force in N. The last sample lasts until `end`. `sero-mj view` saves drag
            forces in this form.
        show: whether an arrow shows the force.
    """

    kind: Literal["force"] = "force"
    at: str
    point: Point = np.zeros(3)
    force: Point = np.zeros(3)
    torque: Point = np.zeros(3)
    expressed_in: str = "world"
    profile: Literal["step", "half_sine", "ramp"] = "step"
    samples: Annotated[Array | None, of_shape(None, 4)] = None
    show: bool = True

    @model_validator(mode="after")
    def _does_something(self) -> Force:
        if self.samples is not None:
            self._check_samples(self.samples)
            return self
        if not {"force", "torque"} & self.model_fields_set:  # zeros are valid, e.g. in a sweep
            raise ValueError("found neither force nor torque; expected a vector for one of them")
        if self.profile != "step" and self.end is None:
            expected = f"the time in seconds at which the {self.profile} ends"
            raise Problem("end", "is required", expected=expected).error()
        return self

    def _check_samples(self, samples: Array) -> None:
        others = [key for key in ("force", "torque", "profile") if key in self.model_fields_set]
        if others:
            raise ValueError(f"samples cannot be combined with {others[0]}")
        if self.end is None:
            expected = "the time in seconds at which the samples end"
            raise Problem("end", "is required", expected=expected).error()
        if not len(samples) or samples[0, 0] != 0.0 or (np.diff(samples[:, 0]) <= 0).any():
            found = samples[:3, 0].tolist()
            expected = "increasing times that start at 0"
            raise Problem("samples", "found times", found=found, expected=expected).error()

    @property
    def acts_by(self) -> list[str]:
        """Names of the nonzero vectors: `force`, `torque`, both or none."""
        if self.samples is not None:
            return ["force"]
        return [key for key in ("force", "torque") if getattr(self, key).any()]

    def at_times(self, times: Array) -> Array:
        """Returns force and torque at T times, shape (T, 2, 3), N and Nm."""
        if self.samples is None:
            return self.share(times)[:, None, None] * np.stack([self.force, self.torque])
        since = np.asarray(times, np.float64) - self.begin + _SAME_TIME
        row = np.searchsorted(self.samples[:, 0], since, side="right") - 1
        found = np.zeros((len(since), 2, 3))
        acts = (row >= 0) & (since < (self.end or 0.0) - self.begin)
        found[acts, 0] = self.samples[row[acts], 1:]
        return found

    def share(self, times: Array) -> Array:
        """Returns the factor (0 to 1) of the force due to `profile` at T times, shape (T,)."""
        times = np.asarray(times, np.float64)
        inside = times >= self.begin
        if self.end is None:
            return inside.astype(np.float64)
        phase = np.clip((times - self.begin) / (self.end - self.begin), 0.0, 1.0)
        if self.profile == "half_sine":
            return np.asarray(np.sin(np.pi * phase) * (inside & (times < self.end)))
        if self.profile == "ramp":
            return phase
        return (inside & (times < self.end)).astype(np.float64)


def _physical(inertia: Array | None) -> Array | None:
    if inertia is not None:
        reason = inertia_problem(tensors_from([inertia])[0])
        if reason is not None:
            raise ValueError(reason)
    return inertia


class Payload(Disturbance):
    """A mass at a robot's flange that is unknown to the controller.

    Attributes:
        robot: robot that picks up the payload.
        mass: mass of the payload, kg.
        center_of_mass: center of mass in the flange frame, shape (3,), m.
        inertia: entries Ixx, Iyy, Izz, Ixy, Ixz, Iyz of the inertia tensor about the center of
            mass, kg m2 (default: the inertia of a steel ball).
        object: object of the scene that moves with the flange.
        grasp: pose of the object at the flange, T_flange_object (default: the pose at `begin`).
    """

    kind: Literal["payload"] = "payload"
    robot: Name
    mass: float = Field(gt=0, le=1e4)
    center_of_mass: Point = np.zeros(3)
    inertia: Annotated[Vector | None, AfterValidator(_physical)] = None
    object: Name | None = None
    grasp: Frame | None = None


DISTURBANCES: Mapping[str, type[Disturbance]] = {"force": Force, "payload": Payload}


class Fault(Timed, ABC):
    """A fault during a period of time.

    Attributes:
        robot: robot with the fault; optional if the scene has only one robot.
        joints: names of the faulty joints (default: all joints).
        part: component with the fault. When a fault ends, other faults of the component continue.
    """

    part: ClassVar[Part] = "sensors"

    robot: Name | None = None
    joints: list[str] = Field(default_factory=list)

    def check(self, robots: Mapping[str, SerialRobot]) -> None:
        """Raises DeclarationError if the robot is missing or unknown, or a joint is unknown."""
        name = self._owner(robots)
        if name is None:
            expected = f"one of {', '.join(robots)}"
            raise Problem("robot", "is required", expected=expected).error()
        if name not in robots:
            raise Problem("robot", "no robot", found=name, available=robots).error()
        names = robots[name].names
        for joint in self.joints:
            if joint not in names:
                raise Problem(
                    "joints", f"{name} has no joint", found=joint, available=names
                ).error()

    def _owner(self, robots: Mapping[str, SerialRobot]) -> str | None:
        return self.robot or (next(iter(robots)) if len(robots) == 1 else None)

    def rows(self, robots: Mapping[str, SerialRobot]) -> list[int]:
        """Returns the indices of the faulty joints among the joints of all robots."""
        chosen = self._owner(robots)
        joints = [(name, joint) for name, robot in robots.items() for joint in robot.names]
        return [
            row
            for row, (name, joint) in enumerate(joints)
            if name == chosen and (not self.joints or joint in self.joints)
        ]

    @abstractmethod
    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        """Starts the fault.

        Args:
            rows: indices of the faulty joints in the plant.
            gains: factor of each commanded torque, shape (n,); drive faults change it in place.
        """


class SensorFault(Fault):
    """A sensor with errors.

    Attributes:
        signal: affected signal: `angles`, `velocities` or `torques`.
        bias: constant error, rad, rad/s or Nm.
        gain: factor of the true value.
        noise: standard deviation of the noise, rad, rad/s or Nm.
        resolution: quantization step, rad, rad/s or Nm.
        delay_ms: delay of the readings, ms.
    """

    kind: Literal["sensor"] = "sensor"
    signal: Signal = "torques"
    bias: float | None = None
    gain: float | None = None
    noise: float | None = Field(None, ge=0)
    resolution: float | None = Field(None, ge=0)
    delay_ms: float | None = Field(None, ge=0, le=1e4)

    @model_validator(mode="after")
    def _breaks_something(self) -> SensorFault:
        keys = ("bias", "gain", "noise", "resolution", "delay_ms")
        if all(getattr(self, key) is None for key in keys):
            raise ValueError(f"has no effect; expected one of {', '.join(keys)}")
        return self

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        declared = {key: getattr(self, key) for key in ("bias", "gain", "noise", "resolution")}
        changed = {key: value for key, value in declared.items() if value is not None}
        if changed:
            plant.sensors.change(self.signal, rows, **changed)
        if self.delay_ms is not None:
            steps = round(self.delay_ms / 1e3 / plant.timestep)
            plant.sensors.delay(self.signal, steps, list(rows))


class EncoderOffset(Fault):
    """An encoder with a constant offset.

    Attributes:
        offset: offset of the reading, rad or m.
        offset_deg: offset of the reading in degrees.
    """

    kind: Literal["encoder_offset"] = "encoder_offset"
    offset: float = 0.0
    offset_deg: float = 0.0

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        offset = self.offset + float(np.deg2rad(self.offset_deg))
        plant.sensors.change("angles", rows, bias=offset)


class DeadSensor(Fault):
    """A sensor that reads zero.

    Attributes:
        signal: affected signal: `angles`, `velocities` or `torques`.
    """

    kind: Literal["dead_sensor"] = "dead_sensor"
    signal: Signal = "torques"

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        for row in rows:
            plant.sensors.kill(self.signal, row)


class FrozenSensor(Fault):
    """A sensor that holds its last reading.

    Attributes:
        signal: affected signal: `angles`, `velocities` or `torques`.
    """

    kind: Literal["frozen_sensor"] = "frozen_sensor"
    signal: Signal = "torques"

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        for row in rows:
            plant.sensors.freeze(self.signal, row)


class ControllerFault(Fault):
    """Drives with a wrong gain.

    Attributes:
        gain: factor of the commanded torques: -1 for a wrong sign, 0 for a drive that is off.
    """

    part: ClassVar[Part] = "drives"

    kind: Literal["controller"] = "controller"
    gain: float = -1.0

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        gains[list(rows)] = self.gain


class FrictionFault(Fault):
    """Changed friction, for example of a dry bearing or a brake that does not open.

    Attributes:
        viscous: factor of the viscous friction.
        coulomb: factor of the Coulomb friction.
        added_coulomb: added Coulomb friction, Nm.
    """

    part: ClassVar[Part] = "friction"

    kind: Literal["friction"] = "friction"
    viscous: float = Field(1.0, ge=0)
    coulomb: float = Field(1.0, ge=0)
    added_coulomb: float = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _changes_something(self) -> FrictionFault:
        if (self.viscous, self.coulomb, self.added_coulomb) == (1.0, 1.0, 0.0):
            raise ValueError("has no effect; expected viscous, coulomb or added_coulomb")
        return self

    def apply(self, plant: Plant, rows: Sequence[int], gains: Array) -> None:
        first = 0
        for name, part in plant.world.robots.items():
            mine = [row - first for row in rows if first <= row < first + part.robot.n]
            first += part.robot.n
            if mine:
                viscous = plant.model.dof_damping[part.dofs].copy()
                coulomb = plant.model.dof_frictionloss[part.dofs].copy()
                viscous[mine] *= self.viscous
                coulomb[mine] = coulomb[mine] * self.coulomb + self.added_coulomb
                plant.set_friction(name, viscous, coulomb)


FAULTS: Mapping[str, type[Fault]] = {
    "sensor": SensorFault,
    "encoder_offset": EncoderOffset,
    "dead_sensor": DeadSensor,
    "frozen_sensor": FrozenSensor,
    "controller": ControllerFault,
    "friction": FrictionFault,
}
