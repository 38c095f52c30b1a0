"""From a declaration to a controller whose torques are limited."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from ...base.declaration import by_kind
from ...base.errors import DeclarationError, Problem, SeroError, SimulationError, about_fault, shown
from ...base.frames import Array, Bools, RowIndex
from ...base.plugins import CONTROLLERS, load_all
from ...base.trust import require
from .controller import Controller, ControllerDeclaration, Sensed, Target
from .model_rows import ModelRows
from .robot_model import RobotModel


class LimitedController:
    """A controller behind torque limits and torque rate limits.

    The first torques are not rate-limited: they are the reference for the next step.

    Args:
        controller: whose torques to limit.
        limits: (n,), Nm or N.
        timestep: s between two calls.
        rates: (n,), Nm/s or N/s; None for no limit.
        robot: its name, for messages.
        joint_names: of every joint, for messages.
        rows: () for one robot; (m,) for m of them, which are then the first axis of all.

    Attributes:
        controller: what is limited.
        requested: (n,), what the controller asked for in the last step; always the same array.
        limits: (n,), as given.

    Raises:
        DeclarationError: a limit is not positive, or there is not one for every joint.
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
        rows: tuple[int, ...] = (),
    ) -> None:
        shape = (*rows, len(joint_names))
        problems = _limit_problems("torque_limits", limits, "Nm", joint_names)
        if rates is not None:
            problems += _limit_problems("torque_rate_limits", rates, "Nm/s", joint_names)
        if problems:
            raise DeclarationError(problems)
        self.controller = controller
        self.requested: Array = np.zeros(shape)
        self._given: Array = self.requested
        self._robot, self._names = robot, list(joint_names)
        self.limits: Array = np.array(limits, float)
        self._low: Array = -self.limits
        self._step: Array | None = None if rates is None else np.multiply(rates, timestep)
        self._last: Array | None = None
        self._from: Array = np.zeros(shape)
        self._to: Array = np.zeros(shape)

    @classmethod
    def joined(
        cls, each: Sequence[LimitedController], model: ModelRows
    ) -> LimitedController | None:
        """One for all rows that is the same as these, which have made no step.

        None where controllers do not have the same kind, or this kind has none for many rows.

        Args:
            each: of the rows.
            model: of all of them.
        """
        first, kinds = each[0], {type(one.controller) for one in each}
        join = getattr(first.controller, "joined", None)
        controller = (
            join([one.controller for one in each], model) if len(kinds) == 1 and join else None
        )
        if controller is None:
            return None
        made = cls(
            controller,
            first.limits,
            1.0,
            robot=first._robot,
            joint_names=first._names,
            rows=model.rows,
        )
        made.limits = np.array([one.limits for one in each])
        made._low = -made.limits
        if any(one._step is not None for one in each):
            free = np.full(model.n, np.inf)
            made._step = np.array([free if one._step is None else one._step for one in each])
        return made

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques within the limits, (n,).

        Raises:
            SimulationError: a torque of the only robot is NaN or infinite.
        """
        requested = self.requested
        try:
            returned = self.controller.torques(sensed, target, requested)  # type: ignore[func-returns-value]
        except np.linalg.LinAlgError:  # what numpy makes of NaN in a matrix
            if requested.ndim > 1:
                raise
            requested[:] = math.nan
            returned = None
        except SeroError:
            raise
        except Exception as error:  # whatever somebody's own controller raises
            kind = type(self.controller)
            what = f"{kind.__name__}.torques: {about_fault(error, kind)}"
            raise SimulationError(sensed.time, self._robot, what) from error
        if returned is not None:
            reason = "torques() has returned something; expected it to write into `out`"
            raise SimulationError(sensed.time, self._robot, reason)
        if requested.ndim == 1 and not self.is_finite():
            raise self.not_finite(sensed)
        np.minimum(np.maximum(requested, self._low, out=out), self.limits, out=out)
        if self._step is not None:
            if self._last is None:
                self._last = out.copy()
            np.subtract(self._last, self._step, self._from)
            np.add(self._last, self._step, self._to)
            np.minimum(np.maximum(out, self._from, out=out), self._to, out=out)
            self._last[...] = out
        self._given = out

    @property
    def saturated(self) -> Bools:
        """Which joints got something else than they asked for in the last step, (n,)."""
        return np.not_equal(self._given, self.requested)

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long, where the controller can tell.

        Args:
            angles: (n,), rad or m, where the robot starts.

        Raises:
            DeclarationError: names the joint that would shake most.
        """
        check = getattr(self.controller, "check", None)
        if check is not None:
            check(angles)

    def is_finite(self, row: RowIndex = ...) -> bool:
        """Whether the torques that are asked for in a row are numbers, and not too large to be."""
        requested = self.requested[row]  # a single product detects NaN and inf in any joint
        return bool(requested.dot(requested) < math.inf)

    def not_finite(self, sensed: Sensed, row: RowIndex = ...) -> SimulationError:
        """Names the joint whose sensor is to blame, else the one whose torque is, of a row."""
        requested = self.requested[row]
        for values, what in zip(sensed.values[row], ("angle", "velocity", "torque"), strict=True):
            if not np.isfinite(values).all():
                joint = int(np.argmax(~np.isfinite(values)))
                reason, found, unit = f"the controller gets a measured {what} of", values[joint], ""
                break
        else:
            bad = ~np.isfinite(requested)
            joint = int(np.argmax(bad if bad.any() else np.abs(requested)))
            reason, found, unit = "the controller asks for", requested[joint], "Nm"
        place = f"{self._robot}/{self._names[joint]}"
        expected = "a finite number"
        problem = Problem("", reason, found=float(found), of=unit, expected=expected)
        return SimulationError(sensed.time, place, problem)


def _limit_problems(key: str, limits: Array, unit: str, names: Sequence[str]) -> list[Problem]:
    """What is wrong with limits, joint by joint."""
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
    """All installed kinds of controllers by name."""
    kinds = load_all(CONTROLLERS, ControllerDeclaration)
    return dict(sorted(kinds.items(), key=lambda each: (each[1].order, each[0])))


def controller_from(table: Any) -> ControllerDeclaration:
    """Builds the declaration of a controller from a table of a file.

    Args:
        table: `kind` and its fields; a declaration comes back as it is.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return by_kind(table, controller_kinds(), ControllerDeclaration)  # type: ignore[type-abstract]


def make_controller(
    controller: ControllerDeclaration | Controller,
    model: RobotModel | ModelRows,
    timestep: float,
    torque_limits: Array | None = None,
) -> LimitedController:
    """Makes a controller and limits its torques as its robot asks.

    Args:
        controller: a declaration, or any object with the method `torques` of `Controller`.
        model: what the controller knows of its robot; for it alone. Of many equal robots for
            controllers with a form for them.
        timestep: s between two calls.
        torque_limits: the robot's, (n,), Nm or N; None where it has none.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
        NotTrusted: it would run something, and its file may not.
    """
    n = model.n
    limits: Array = np.full(n, np.inf) if torque_limits is None else np.array(torque_limits, float)
    rates = None
    found, own = f"found {shown(controller)}", None
    if isinstance(controller, ControllerDeclaration):
        own = controller
        require(own.origin, own.actions())
        controller = own.make(model, timestep)  # type: ignore[arg-type]  # some take rows
        found = f"{type(own).__name__}.make returned {shown(controller)}"
    if isinstance(controller, type):
        message = f"found {shown(controller)}; expected an object: {controller.__name__}()"
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
        controller,
        limits,
        timestep,
        rates,
        robot=model.name,
        joint_names=model.joint_names,
        rows=model.rows,
    )


def _lower(own: Array, robots: Array, names: list[str]) -> Array:
    """A controller's limits, which may not be above those of its robot."""
    problems = [
        Problem("torque_limits", f"joint {name} has", found=a, expected=f"up to {b:g}, the robot's")
        for name, a, b in zip(names, own, robots, strict=True)
        if a > b
    ]
    if problems:
        raise DeclarationError(problems)
    return own
