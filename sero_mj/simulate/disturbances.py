"""Disturbances of a scenario: external forces and payloads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from ..assemble.dynamics import inertia_problem, tensors_from
from ..declaration import Declaration, Frame, Name, Point, Vector, by_kind


class Timed(Declaration):
    """An event that begins and may end.

    Attributes:
        begin: s.
        end: s; None for never.
    """

    begin: float = Field(0.0, ge=0)
    end: float | None = None

    @model_validator(mode="after")
    def _ends_later(self) -> Self:
        if self.end is not None and self.end <= self.begin:
            raise ValueError(f"end: found {self.end:g}; expected more than begin, {self.begin:g} s")
        return self


Array = NDArray[np.float64]


class Disturbance(Timed):
    """Base of the declarations of disturbances."""


class Force(Disturbance):
    """An external force and torque at a frame of a robot, which move with it.

    Attributes:
        at: the frame at whose origin they act, `lwr/flange` say.
        force: (3,), N.
        torque: (3,), Nm.
        expressed_in: the frame in whose axes both are given.
        profile: `step`; `half_sine`, a push that grows and fades until `end`; `ramp`, which
            grows until `end` and then stays.
        show: whether an arrow shows it.
    """

    kind: Literal["force"] = "force"
    at: str
    force: Point = np.zeros(3)
    torque: Point = np.zeros(3)
    expressed_in: str = "world"
    profile: Literal["step", "half_sine", "ramp"] = "step"
    show: bool = True

    @model_validator(mode="after")
    def _does_something(self) -> Force:
        if not (self.force.any() or self.torque.any()):
            raise ValueError("found neither force nor torque; expected three numbers of one")
        if self.profile != "step" and self.end is None:
            raise ValueError(f"end: is required; expected the time (s) at which the {self.profile}"
                             " is over")  # fmt: skip
        return self

    def share(self, times: Array) -> Array:
        """How much of the force acts at these times, (T,), 0 to 1."""
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
    """A mass that is fixed to a flange, and that the controller does not know of.

    Attributes:
        robot: which one picks it up.
        mass: kg.
        center_of_mass: (3,), in the flange's frame, m.
        inertia: about it, Ixx, Iyy, Izz, Ixy, Ixz, Iyz, kg m2; that of a ball of steel if None.
        object: an object of the scene that goes with the flange meanwhile.
        grasp: T_flange_object; where the object is at `begin` when None.
    """

    kind: Literal["payload"] = "payload"
    robot: Name
    mass: float = Field(gt=0, le=1e4)
    center_of_mass: Point = np.zeros(3)
    inertia: Annotated[Vector | None, AfterValidator(_physical)] = None
    object: Name | None = None
    grasp: Frame | None = None


DISTURBANCES: Mapping[str, type[Disturbance]] = {"force": Force, "payload": Payload}


def disturbance_from(table: Any) -> Disturbance:
    """Builds a disturbance from a table with `kind`.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return by_kind(table, DISTURBANCES, Disturbance)
