"""Joint-space controllers: gravity compensation, torque, impedance and position.

They control one robot, or all robots of a `RobotModels`, whose rows are then the first axis of all
arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from ...base.errors import DeclarationError, Problem
from ...base.frames import Array, Bools
from ...robots.declared.robot import SerialRobot
from .controller import (
    DEFAULT_RATIO,
    SOFTEST,
    Controller,
    ControllerDeclaration,
    PerJoint,
    Ratio,
    Sensed,
    Slider,
    Target,
    range_text,
    within,
)  # fmt: skip
from .robot_model import RobotModel
from .robot_models import RobotModels

MAX_STIFFNESS = 5000.0  # maximum stiffness of the KUKA LWR's joint impedance controller, Nm/rad
_PER_LIMIT, _SWINGS = 5.0, 13.0  # 1/rad and 1/s, see `JointImpedance.for_robot`
# Maxima of sliders for the damping (Nm s/rad), damping ratio and factor of the initial stiffness.
_SLIDER_DAMPING, _SLIDER_RATIO, _SLIDER_STIFFNESS = 50.0, 2.0, 6.0


class GravityCompensation(ControllerDeclaration):
    """Compensates gravity, so that the robot can be moved by hand.

    Attributes:
        damping: viscous damping, Nm s/rad or N s/m per joint.
    """

    needs_target: ClassVar[bool] = False
    title: ClassVar[str] = "gravity compensation"
    short: ClassVar[str] = "gravity"
    order: ClassVar[int] = 10

    kind: Literal["gravity_compensation"] = "gravity_compensation"
    damping: Annotated[PerJoint, within(0.0, 1e4, "Nm s/rad")] = np.zeros(1)

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        damping = float(self.damping[0])
        return [
            Slider("damping", damping, _SLIDER_DAMPING, "%.1f Nm s/rad",
                   lambda value: {"damping": np.array([value])}, range_text("damping", "Nm s/rad"))
        ]  # fmt: skip

    def make(self, model: RobotModel | RobotModels, timestep: float) -> GravityCompensator:
        return GravityCompensator(model, damping=self.per_joint("damping", model.n))


class Torque(ControllerDeclaration):
    """Commands constant torques in addition to gravity compensation.

    Attributes:
        torques: constant torques, Nm per joint. The torques of the target are added.
        compensate_gravity: whether gravity torques are added.
    """

    needs_target: ClassVar[bool] = False
    order: ClassVar[int] = 50

    kind: Literal["torque"] = "torque"
    torques: PerJoint = np.zeros(1)
    compensate_gravity: bool = True

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """Returns None, because there is nothing to adjust in live control."""
        return None

    def make(self, model: RobotModel | RobotModels, timestep: float) -> GravityCompensator:
        own = self.per_joint("torques", model.n)
        return GravityCompensator(
            model, torques=own, feed_forward=True, compensate_gravity=self.compensate_gravity
        )


class JointImpedance(ControllerDeclaration):
    """Makes every joint a spring and a damper about its target angle.

    Attributes:
        at_links: whether the stiffness acts at the links instead of the motors. It applies to
            elastic joints with joint torque control.
        stiffness: joint stiffness, 0 to 5000 Nm/rad per joint as on the KUKA LWR.
        damping: damping ratio per joint. 0.7 overshoots by 4.6 %, and 1 does not overshoot.
        feed_forward: whether the torques for the motion of the target are added.
        damping_every: time between two designs of the damping matrix, s.
    """

    at_links: ClassVar[bool] = True
    title: ClassVar[str] = "joint impedance"
    short: ClassVar[str] = "joint"
    order: ClassVar[int] = 20

    kind: Literal["joint_impedance"] = "joint_impedance"
    stiffness: Annotated[
        PerJoint,
        within(0.0, MAX_STIFFNESS, "Nm/rad", "; kind = 'joint_position' can be stiffer"),
    ]
    damping: Ratio = DEFAULT_RATIO
    feed_forward: bool = False
    damping_every: float = Field(0.1, gt=0, le=1)

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """Chooses a stiffness that reaches the torque limit at an error of 0.2 rad (m).

        Without a torque limit, the stiffness makes a single joint oscillate at 13 rad/s.
        """
        bounds = robot.torque_bounds
        by_inertia = _SWINGS**2 * np.diagonal(model.mass())
        stiffness = np.where(
            np.isfinite(bounds), np.minimum(_PER_LIMIT * bounds, MAX_STIFFNESS), by_inertia
        )
        digits = 10.0 ** np.floor(np.log10(np.maximum(stiffness, 1e-6)) - 1)
        rounded = np.minimum(np.round(stiffness / digits) * digits, MAX_STIFFNESS)
        return cls(stiffness=rounded, damping=DEFAULT_RATIO)

    def softer(self) -> Self | None:
        return self.changed({"stiffness": self.stiffness / 2})

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        of_first = np.broadcast_to(first.stiffness, robot.n)
        stiffness = np.broadcast_to(self.stiffness, robot.n)
        describe = range_text("stiffness", "Nm/rad")
        share = 100.0 * float(np.median(stiffness / np.maximum(of_first, 1e-9)))

        def of_joint(joint: int) -> Callable[[float], dict[str, Any]]:
            def fields(value: float) -> dict[str, Any]:
                changed = stiffness.copy()
                changed[joint] = value
                return {"stiffness": changed}

            return fields

        found = [
            Slider("stiffness", share, 100.0 * _SLIDER_STIFFNESS, "%.0f %%",
                   lambda value: {"stiffness": of_first * value / 100.0}, describe,
                   "of all joints, in percent of the initial stiffness"),
            damping_slider(float(self.damping[0]), lambda value: np.array([value])),
        ]  # fmt: skip
        for joint, name in enumerate(robot.names):
            unit = "Nm/rad" if robot.types[joint] == "revolute" else "N/m"
            maximum = _SLIDER_STIFFNESS * float(of_first[joint])
            found.append(
                Slider(name, float(stiffness[joint]), maximum, f"%.0f {unit}", of_joint(joint),
                       describe, group="stiffness of the joints")
            )  # fmt: skip
        return found

    def make(self, model: RobotModel | RobotModels, timestep: float) -> JointImpedanceController:
        return JointImpedanceController(
            model,
            self.per_joint("stiffness", model.n),
            self.per_joint("damping", model.n),
            timestep,
            feed_forward=self.feed_forward,
            damping_every=self.damping_every,
            at_links=self.at_links,
        )


class JointPosition(JointImpedance):
    """Follows target angles as a stiff joint impedance with feed-forward torques.

    Behind a torque loop, elastic joints have full state feedback. With B, Bt and T of the loop
    (`torque_loop`), the gains are B / Bt K for motor positions, B / Bt D for motor velocities,
    B / Bt - 1 for joint torques and B / Bt T for their derivatives. The targets of the motors
    include the deflection caused by the torques of the motion.

    Attributes:
        stiffness: joint stiffness, Nm/rad per joint.
        damping: damping ratio per joint.
        feed_forward: whether the torques for the motion of the target are added.
        damping_every: time between two designs of the damping matrix, s.
    """

    at_links: ClassVar[bool] = False
    title: ClassVar[str] = "joint position"
    short: ClassVar[str] = ""
    order: ClassVar[int] = 40

    kind: Literal["joint_position"] = "joint_position"  # type: ignore[assignment]
    stiffness: Annotated[PerJoint, within(1.0, 1e6, "Nm/rad")] = np.array([10000.0])
    damping: Ratio = np.ones(1)
    feed_forward: bool = True

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """Returns None, because a robot in live control should yield to forces."""
        return None


def damping_slider(ratio: float, value_of: Callable[[float], Any]) -> Slider:
    """Returns a slider for the field `damping` that contains a damping ratio."""
    return Slider(
        "damping",
        ratio,
        _SLIDER_RATIO,
        "%.2f",
        lambda value: {"damping": value_of(value)},
        range_text("damping"),
        "ratio: 0.7 overshoots by 4.6 %, 1 does not overshoot",
    )


class GravityCompensator(Controller):
    """Control law tau = g(q) - d dq + tau_0, or g(q) + tau_0 + tau_target.

    Args:
        damping: viscous damping d, shape (n,) or (m, n), Nm s/rad (default: 0).
        torques: constant torques tau_0, shape (n,) or (m, n), Nm (default: 0).
        feed_forward: whether the torques of the target are added.
        compensate_gravity: whether g(q) is added.
    """

    spans_robots = True

    def __init__(
        self,
        model: RobotModel | RobotModels,
        *,
        damping: Array | None = None,
        torques: Array | None = None,
        feed_forward: bool = False,
        compensate_gravity: bool = True,
    ) -> None:
        self.model = model
        self._compensates, self._feeds_forward = compensate_gravity, feed_forward
        self._damping: Array = np.zeros(model.n) if damping is None else damping
        self._own: Array = np.zeros(model.n) if torques is None else torques
        self._resists, self._has_own = bool(self._damping.any()), bool(self._own.any())
        self._rest: Array | None = None

    @property
    def group(self) -> tuple[object, ...]:
        return type(self), self._compensates, self._feeds_forward

    @classmethod
    def joined(cls, each: Sequence[Self], robots: int, model: RobotModels) -> Self:
        first = each[0]
        return cls(
            model,
            damping=in_rows([one._damping for one in each], robots),
            torques=in_rows([one._own for one in each], robots),
            feed_forward=first._feeds_forward,
            compensate_gravity=first._compensates,
        )

    def hold_links(self, joint_stiffness: Array) -> Array:
        self._rest = np.zeros((*self.model.rows, self.model.n))
        return self._rest

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        if self._compensates:
            self.model.update(sensed.motor_angles, sensed.motor_velocities)
            self.model.gravity(out)
        else:
            out[:] = 0.0
        if self._has_own:
            out += self._own
        if self._feeds_forward:
            out += target.torques
        if self._rest is not None:
            self._rest[...] = out
        if self._resists:
            out -= self._damping * sensed.motor_velocities


class JointImpedanceController(Controller):
    """Control law tau = K (q_d - q) + D (dq_d - dq) + g(q) + tau_target.

    With feed-forward, M(q) ddq_d + C(q, dq) dq_d is added, and the error converges as with a
    resting target (PD+; Paden and Panja 1988, Globally asymptotically stable 'PD+' controller for
    robot manipulators, Int. J. Control 47). With a resting target, the robot moves as if springs
    and dampers acted on its own inertia. The energy 1/2 dq M dq + 1/2 e K e decreases by dq D dq
    (Hogan 1985; Albu-Schäffer, Ott, Hirzinger 2007, A Unified Passivity-based Control Framework,
    IJRR 26). D is designed from M(q) with the motor inertias at intervals of `damping_every`.
    Between two designs it is constant. Any positive semidefinite D dissipates energy.

    If joints are elastic, q and dq are motor angles and velocities, and gravity deflects the links
    from their targets. Behind a torque loop, q are the resting angles of the links
    (`StaticDeflection`), so that K acts at the links.

    Args:
        stiffness: diagonal of K, shape (n,) or (m, n), Nm/rad.
        damping: damping ratio, shape (n,) or (m, n).
        timestep: time between two calls, s.
        damping_every: time between two designs of D, s.
        at_links: whether K acts at the links of elastic joints instead of the motors.
    """

    spans_robots = True

    def __init__(
        self,
        model: RobotModel | RobotModels,
        stiffness: Array,
        damping: Array,
        timestep: float,
        *,
        feed_forward: bool = False,
        damping_every: float = 0.04,
        at_links: bool = True,
    ) -> None:
        self.model, self._spring, self._ratio = model, stiffness, damping
        self.stiffness = diagonal(stiffness)
        self._timestep, self._at_links, self._feeds_forward = timestep, at_links, feed_forward
        self._rest: Array | None = None
        self._every = max(round(damping_every / timestep), 1)
        # Number of completed steps, and the next steps in which the damping is designed again.
        self._k = self._next = 0
        self._due = np.zeros(model.rows, np.intp)
        shape = (*model.rows, model.n)
        self.damping: Array = np.zeros((*shape, model.n))
        self._error: Array = np.zeros(shape)
        self._own, self._less = np.zeros((2, *shape))
        self._times = np.matvec if model.rows else np.dot  # `np.dot` takes half the time

    @property
    def group(self) -> tuple[object, ...]:
        kinds = type(self), self._every, self._at_links, self._feeds_forward
        return *kinds, self._rest is None

    @classmethod
    def joined(cls, each: Sequence[Self], robots: int, model: RobotModels) -> Self:
        first = each[0]
        return cls(
            model,
            in_rows([one._spring for one in each], robots),
            in_rows([one._ratio for one in each], robots),
            first._timestep,
            feed_forward=first._feeds_forward,
            damping_every=first._every * first._timestep,
            at_links=first._at_links,
        )

    def begin(self, which: Bools) -> None:
        self._due[which] = self._next = self._k

    def hold_links(self, joint_stiffness: Array) -> Array:
        """Raises DeclarationError if K is too close to the stiffness of the joints."""
        maximum = SOFTEST * joint_stiffness
        own = np.max(np.atleast_2d(self._spring), axis=0)
        if self._at_links and (own > maximum).any():
            problems = [
                Problem(
                    "stiffness",
                    f"joint {self.model.joint_names[i]}: found",
                    found=own[i],
                    of="Nm/rad",
                    expected=f"at most {maximum[i]:g}, which is {100 * SOFTEST:g} % of the "
                    "stiffness of the elastic joint",
                )
                for i in np.flatnonzero(own > maximum).tolist()
            ]
            raise DeclarationError(problems)
        self._rest = np.zeros((*self.model.rows, self.model.n))
        return self._rest

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        model, own = self.model, self._own
        model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._k == self._next:
            self._design()
        self._k += 1
        np.subtract(target.angles, sensed.motor_angles, self._error)
        self._error *= self._spring
        self._times(self.damping, target.velocities - sensed.motor_velocities, out)
        out += self._error
        if self._feeds_forward:
            model.write_inverse_dynamics(target.velocities, target.accelerations, own, self._less)
            out += model.motor_inertia * target.accelerations
            own -= self._less
        else:
            model.gravity(own)
        out += own
        if target.has_torques:
            out += target.torques
        if self._rest is not None:
            np.add(own, self._error if self._at_links else 0.0, self._rest)

    def _design(self) -> None:
        model = self.model
        mass = model.mass()
        due = self._due <= self._k
        shape = (*model.rows, model.n)
        stiffness = np.broadcast_to(self._spring, shape)[due]
        ratio = np.broadcast_to(self._ratio, shape)[due]
        for joints in [slice(None)] if isinstance(model, RobotModel) else model.robots:
            self.damping[due, joints, joints] = design_damping(
                mass[due][..., joints, joints], diagonal(stiffness[..., joints]), ratio[..., joints]
            )
        self._due[due] = self._k + self._every
        self._next = int(self._due.min())

    def check(self, angles: Array) -> None:
        model = self.model
        model.update(angles, np.zeros(model.n))
        mass, stiffness = model.mass(), self.stiffness
        damping = design_damping(mass, stiffness, self._ratio)
        joint = unstable_joint(mass, stiffness, damping, self._timestep)
        if joint is not None:

            def holds(share: float) -> bool:
                damping = design_damping(mass, share * stiffness, self._ratio)
                return unstable_joint(mass, share * stiffness, damping, self._timestep) is None

            gain = float(stiffness[joint, joint])
            share = largest_share(holds)
            others = f" and {99 * share:.2g} % of the other stiffnesses" if model.n > 1 else ""
            up_to = f"up to {0.99 * share * gain:.3g}{others}"
            name = model.joint_names[joint]
            raise too_stiff(name, f" at {gain:g} Nm/rad", self._timestep, up_to)


def in_rows(each: Sequence[Array], robots: int) -> Array:
    """Joins arrays per joint, which are listed row by row and robot by robot, to shape (m, n)."""
    rows = range(0, len(each), robots)
    return np.array([np.concatenate(each[row : row + robots]) for row in rows])


def diagonal(values: Array) -> Array:
    """Returns diagonal matrices with diagonals `values`, shape (..., n, n)."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))


def design_damping(mass: Array, stiffness: Array, ratio: float | Array) -> Array:
    """Returns the damping matrix that gives every mode of mass and stiffness a damping ratio.

    Double diagonalization yields M = Q Q^T and K = Q W^2 Q^T with diagonal W, and D = 2 Q Z W Q^T.
    Each mode then moves as an independent mass-spring-damper. With ratio z, a step overshoots by
    exp(-pi z / sqrt(1 - z^2)), or 4.6 % at 0.7. A direction without stiffness has no damping.

    A mode does not belong to one joint. Therefore different ratios scale the entries of the matrix
    for ratio one by sqrt(z_i z_j). The matrix remains positive semidefinite, so it can only
    dissipate energy, and the result for equal ratios is exact.

    Args:
        mass: mass matrices, shape (..., n, n), symmetric and positive definite.
        stiffness: stiffness matrices, shape (..., n, n), symmetric and positive semidefinite.
        ratio: damping ratio (1 for critical damping), scalar or shape (n,) or (..., n).

    Source: Albu-Schäffer, Ott, Frese, Hirzinger 2003, Cartesian Impedance Control of Redundant
    Robots: Recent Results with the DLR-Light-Weight-Arms, ICRA (double diagonalization design).
    """
    lower = np.linalg.cholesky(mass)
    unlower = np.linalg.inv(lower)
    squares, vectors = np.linalg.eigh(unlower @ stiffness @ unlower.mT)
    modes = lower @ vectors
    scale = 2.0 * np.sqrt(np.maximum(squares, 0.0))
    matrix = (modes * scale[..., None, :]) @ modes.mT
    root = np.sqrt(np.broadcast_to(ratio, mass.shape[:-1]))
    return np.asarray(matrix * root[..., None, :] * root[..., None])


def unstable_joint(mass: Array, stiffness: Array, damping: Array, timestep: float) -> int | None:
    """Returns the joint that moves most in an unstable mode of a sampled controller, or None.

    The torques -K q - D dq are held for one time step, and velocities are integrated before angles
    (MuJoCo's semi-implicit Euler). The robot is stable if no eigenvalue of this map has a magnitude
    above one. For one mass this means w^2 t^2 + 4 z w t < 4 with w^2 = K / M and D = 2 z w M.
    """
    n = len(mass)
    pull = timestep * np.linalg.solve(mass, np.hstack([stiffness, damping]))
    step: Array = np.eye(2 * n)
    step[n:] -= pull
    step[:n] += timestep * step[n:]
    values, vectors = np.linalg.eig(step)
    worst = int(np.argmax(np.abs(values)))
    if np.abs(values[worst]) <= 1.0 + 1e-7:
        return None
    return int(np.argmax(np.abs(vectors[n:, worst])))


def largest_share(holds: Callable[[float], bool]) -> float:
    """Returns the largest share from 0 to 1 for which `holds` is true, with an error of 0.03 %."""
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def too_stiff(
    joint: str, gain: str, timestep: float, expected: str = "a lower stiffness"
) -> DeclarationError:
    """Returns the error for unstable gains. `gain` is a text such as ` at 500 Nm/rad`."""
    return Problem(
        "stiffness",
        f"joint {joint} is unstable{gain} with a time step of",
        found=1000.0 * timestep,
        of="ms",
        expected=f"{expected}, or a shorter time step",
    ).error()
