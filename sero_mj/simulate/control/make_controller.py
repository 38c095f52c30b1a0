"""Makes controllers with limited torques from declarations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from ...base.declaration import by_kind
from ...base.errors import DeclarationError, Problem, SeroError, SimulationError, about_fault, shown
from ...base.frames import Array, Bools
from ...base.plugins import CONTROLLERS, load_all
from ...base.trust import require
from .controller import Controller, ControllerDeclaration, Sensed, Target, as_controller
from .joint_control import in_rows
from .robot_model import RobotModel
from .robot_models import RobotModels


class LimitedController:
    """A controller with torque limits and torque rate limits.

    The torques of the first step are not rate-limited.

    Args:
        limits: torque limits, shape (n,), Nm or N.
        timestep: time between two calls, s.
        rates: maximum rates of the torques, shape (n,), Nm/s or N/s (default: no limits).

    Attributes:
        requested: torques of the last step before the limits, shape (n,); updated in place.

    Raises:
        DeclarationError: a limit is not positive, or the number of limits is not n.
    """

    def __init__(
        self,
        controller: Controller,
        limits: Array,
        timestep: float,
        rates: Array | None = None,
        *,
        robot: str = "robot",
        joint_names: Sequence[str],
    ) -> None:
        problems = _limit_problems("torque_limits", limits, "Nm", joint_names)
        if rates is not None:
            problems += _limit_problems("torque_rate_limits", rates, "Nm/s", joint_names)
        if problems:
            raise DeclarationError(problems)
        self.controller, self._kind = as_controller(controller), type(controller)
        self._places = [f"{robot}/{name}" for name in joint_names]
        self._limit(np.array(limits, float), None if rates is None else rates * timestep)

    def _limit(self, limits: Array, step: Array | None) -> None:
        self.requested: Array = np.zeros(limits.shape)
        self._commanded: Array = self.requested
        self.limits, self._low, self._step = limits, -limits, step
        self._last: Array | None = None

    @classmethod
    def joined(
        cls, each: Sequence[LimitedController], robots: int, model: RobotModels
    ) -> LimitedController:
        """Joins new controllers with the same `Controller.group`; see `Controller.joined`."""
        kind = type(each[0].controller)
        controller = kind.joined([one.controller for one in each], robots, model)
        made = cls(controller, np.ones(model.n), 1.0, joint_names=model.joint_names)
        made._places = model.joint_names
        step = None
        if any(one._step is not None for one in each):
            free = [np.full_like(one.limits, np.inf) for one in each]
            step = in_rows(
                [each if one._step is None else one._step
                 for one, each in zip(each, free, strict=True)],
                robots,
            )  # fmt: skip
        made._limit(in_rows([one.limits for one in each], robots), step)
        return made

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the limited torques to `out`, shape (n,).

        Raises:
            SimulationError: the controller raised an error, or a requested torque is NaN or
                infinite. For joined controllers, call `is_finite` for each row instead.
        """
        requested = self.requested
        try:
            returned = self.controller.torques(sensed, target, requested)
        except np.linalg.LinAlgError:  # raised by numpy for a matrix with NaN
            is_finite = np.isfinite(sensed.values).all(axis=(-2, -1))
            requested[~is_finite if requested.ndim > 1 and not is_finite.all() else ...] = math.nan
            returned = None
        except SeroError:
            raise
        except Exception as error:  # third-party controllers can raise any error
            what = f"{self._kind.__name__}.torques: {about_fault(error, self._kind)}"
            raise SimulationError(sensed.time, self._robot, what) from error
        if returned is not None:
            reason = "torques() returned a value; expected None, and torques written to `out`"
            raise SimulationError(sensed.time, self._robot, reason)
        if requested.ndim == 1 and not self.is_finite():
            raise self.not_finite(sensed)
        np.minimum(np.maximum(requested, self._low, out=out), self.limits, out=out)
        if self._step is not None:
            if self._last is None:
                self._last = out.copy()
            np.maximum(out, self._last - self._step, out=out)
            np.minimum(out, self._last + self._step, out=out)
            self._last[...] = out
        self._commanded = out

    @property
    def _robot(self) -> str:
        return self._places[0].partition("/")[0]

    @property
    def saturated(self) -> Bools:
        """Whether the torque of each joint was limited in the last step, shape (n,)."""
        return np.not_equal(self._commanded, self.requested)

    def check(self, angles: Array) -> None:
        self.controller.check(angles)

    def is_finite(self, row: int = 0) -> bool:
        """Returns whether the requested torques of a row have a finite sum of squares."""
        requested = self.requested if self.requested.ndim == 1 else self.requested[row]
        return bool(requested.dot(requested) < math.inf)  # detects NaN and inf in any joint

    def not_finite(self, sensed: Sensed, row: int = 0) -> SimulationError:
        """Returns the error for a row with NaN or infinite sensor readings or requested torques."""
        requested = np.atleast_2d(self.requested)[row]
        measured = sensed.values.reshape(-1, 3, len(requested))[row]
        for values, what in zip(measured, ("angle", "velocity", "torque"), strict=True):
            if not np.isfinite(values).all():
                joint = int(np.argmax(~np.isfinite(values)))
                reason, found, unit = f"the controller received a {what} of", values[joint], ""
                break
        else:
            bad = ~np.isfinite(requested)
            joint = int(np.argmax(bad if bad.any() else np.abs(requested)))
            reason, found, unit = "the controller requested", requested[joint], "Nm"
        expected = "a finite number"
        problem = Problem("", reason, found=float(found), of=unit, expected=expected)
        return SimulationError(sensed.time, self._places[joint], problem)


def _limit_problems(key: str, limits: Array, unit: str, names: Sequence[str]) -> list[Problem]:
    values = np.asarray(limits, float)
    if values.shape != (len(names),):
        return [
            Problem(key, found=values.size, of="entries", expected=f"{len(names)}, one per joint")
        ]
    return [
        Problem(key, f"joint {name} has", found=value, expected=f"a positive number of {unit}")
        for name, value in zip(names, values, strict=True)
        if not value > 0
    ]


@cache
def controller_kinds() -> dict[str, type[ControllerDeclaration]]:
    """Returns all installed kinds of controllers by name, in their order."""
    kinds = load_all(CONTROLLERS, ControllerDeclaration)
    return dict(sorted(kinds.items(), key=lambda each: (each[1].order, each[0])))


def controller_from(table: Any) -> ControllerDeclaration:
    """Returns the declaration of a controller for a table with `kind` and its fields.

    A declaration is returned unchanged. Raises DeclarationError for an unknown kind or wrong
    fields.
    """
    return by_kind(table, controller_kinds(), ControllerDeclaration)  # type: ignore[type-abstract]


def make_controller(
    controller: ControllerDeclaration | Any,
    model: RobotModel,
    timestep: float,
    torque_limits: Array | None = None,
) -> LimitedController:
    """Returns a controller whose torques are limited to the torque limits of its robot.

    Args:
        controller: declaration, or any object with the method `torques` of `Controller`.
        model: robot model that only this controller uses.
        timestep: time between two calls, s.
        torque_limits: torque limits of the robot, shape (n,), Nm or N (default: no limits).

    Raises:
        DeclarationError: gains or limits do not fit the robot.
        NotTrusted: the controller would run code, and its file is not trusted.
    """
    n = model.n
    limits: Array = np.full(n, np.inf) if torque_limits is None else np.array(torque_limits, float)
    rates = None
    found, own = f"found {shown(controller)}", None
    if isinstance(controller, ControllerDeclaration):
        own = controller
        require(own.origin, own.actions())
        controller = own.make(model, timestep)
        found = f"{type(own).__name__}.make returned {shown(controller)}"
    if isinstance(controller, type):
        message = f"found {shown(controller)}; expected an instance: {controller.__name__}()"
        raise Problem("", message).error()
    if not callable(getattr(controller, "torques", None)):
        message = f"{found}; expected an object with a method torques(sensed, target, out)"
        raise Problem("", message).error()
    if own is not None:
        if own.torque_limits is not None:
            limits = _lower(own.per_joint("torque_limits", n), limits, model.joint_names)
        if own.torque_rate_limits is not None:
            rates = own.per_joint("torque_rate_limits", n)
    return LimitedController(
        controller, limits, timestep, rates, robot=model.name, joint_names=model.joint_names
    )


def _lower(own: Array, robots: Array, names: list[str]) -> Array:
    expected = "up to {:g}, the limit of the robot"
    problems = [
        Problem("torque_limits", f"joint {name} has", found=a, expected=expected.format(b))
        for name, a, b in zip(names, own, robots, strict=True)
        if a > b
    ]
    if problems:
        raise DeclarationError(problems)
    return own
