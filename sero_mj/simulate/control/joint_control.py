"""Joint-space controllers (gravity compensation, torque, impedance, position) and their damping.

They control one robot, or all robots of a `RobotModels`, whose rows are the first axis of all
arrays then.
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

MAX_STIFFNESS = 5000.0  # Nm/rad, of the joint impedance controller of the KUKA LWR
_PER_LIMIT, _SWINGS = 5.0, 13.0  # 1/rad and 1/s, see `JointImpedance.for_robot`
# Ends of sliders: Nm s/rad, of ratios, and of a stiffness at first.
_MOST_DAMPING, _MOST_RATIO, _MOST_OF_FIRST = 50.0, 2.0, 6.0


class GravityCompensation(ControllerDeclaration):
    """Compensates gravity: the robot can be moved by hand.

    Attributes:
        damping: Nm s/rad or N s/m per joint, against motion.
    """

    needs_target: ClassVar[bool] = False
    title: ClassVar[str] = "gravity compensation"
    short: ClassVar[str] = "gravity"
    order: ClassVar[int] = 10

    kind: Literal["gravity_compensation"] = "gravity_compensation"
    damping: Annotated[PerJoint, within(0.0, 1e4, "Nm s/rad")] = np.zeros(1)

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        """Damping of all joints."""
        damping = float(self.damping[0])
        return [
            Slider("damping", damping, _MOST_DAMPING, "%.1f Nm s/rad",
                   lambda value: {"damping": np.array([value])}, range_text("damping", "Nm s/rad"))
        ]  # fmt: skip

    def make(self, model: RobotModel | RobotModels, timestep: float) -> GravityCompensator:
        return GravityCompensator(model, damping=self.per_joint("damping", model.n))


class Torque(ControllerDeclaration):
    """Constant torques on top of gravity compensation.

    Attributes:
        torques: Nm per joint, all the time; what a target brings comes on top.
        compensate_gravity: whether gravity is added.
    """

    needs_target: ClassVar[bool] = False
    order: ClassVar[int] = 50

    kind: Literal["torque"] = "torque"
    torques: PerJoint = np.zeros(1)
    compensate_gravity: bool = True

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """None: it has nothing to play with."""
        return None

    def make(self, model: RobotModel | RobotModels, timestep: float) -> GravityCompensator:
        own = self.per_joint("torques", model.n)
        return GravityCompensator(
            model, torques=own, feed_forward=True, compensate_gravity=self.compensate_gravity
        )


class JointImpedance(ControllerDeclaration):
    """Every joint is a spring and a damper about the target's angles.

    Attributes:
        at_links: whether the stiffness is what one feels at the links of elastic joints, behind a
            torque loop; else it is that of their motors.
        stiffness: Nm/rad per joint, 0 to 5000 as on the KUKA LWR.
        damping: ratio per joint; 0.7 overshoots by 4.6 %, 1 not at all.
        feed_forward: whether the torques that the target's motion takes are added.
        damping_every: s between two designs of the damping matrix.
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
        """Springs that reach a joint's torque limit 0.2 rad (m) off.

        Where there is no limit, the joint alone would swing at 13 rad/s.
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
        """Half as stiff."""
        return self.changed({"stiffness": self.stiffness / 2})

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        """Stiffness of all joints together and one by one, and the damping ratio."""
        of_first = np.broadcast_to(first.stiffness, robot.n)
        stiffness = np.broadcast_to(self.stiffness, robot.n)
        words = range_text("stiffness", "Nm/rad")
        share = 100.0 * float(np.median(stiffness / np.maximum(of_first, 1e-9)))

        def of_joint(joint: int) -> Callable[[float], dict[str, Any]]:
            def fields(value: float) -> dict[str, Any]:
                wanted = stiffness.copy()
                wanted[joint] = value
                return {"stiffness": wanted}

            return fields

        found = [
            Slider("stiffness", share, 100.0 * _MOST_OF_FIRST, "%.0f %%",
                   lambda value: {"stiffness": of_first * value / 100.0}, words,
                   "of all joints, of what it was at first"),
            damping_slider(float(self.damping[0]), lambda value: np.array([value])),
        ]  # fmt: skip
        for joint, name in enumerate(robot.names):
            unit = "Nm/rad" if robot.types[joint] == "revolute" else "N/m"
            most = _MOST_OF_FIRST * float(of_first[joint])
            found.append(
                Slider(name, float(stiffness[joint]), most, f"%.0f {unit}", of_joint(joint), words,
                       group="stiffness of the joints")
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
    """Follows the target's angles as a stiff impedance, with the torques that its motion takes.

    Behind a torque loop, elastic joints are under full state feedback: with the loop's B, Bt and T
    (`torque_loop`), gains are B / Bt K of the motors' positions, B / Bt D of their velocities,
    B / Bt - 1 of the joint torques and B / Bt T of the torques' derivatives. The links are where
    the motors are but for the deflection by what the motion takes, which is allowed for.

    Attributes:
        stiffness: Nm/rad per joint.
        damping: ratio per joint.
        feed_forward: as for `JointImpedance`.
        damping_every: as for `JointImpedance`.
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
        """None: who plays with a robot wants to feel it give way."""
        return None


def damping_slider(ratio: float, value_of: Callable[[float], Any]) -> Slider:
    """The slider of a field `damping`, a ratio."""
    return Slider(
        "damping",
        ratio,
        _MOST_RATIO,
        "%.2f",
        lambda value: {"damping": value_of(value)},
        range_text("damping"),
        "ratio: 0.7 overshoots by 4.6 %, 1 not at all",
    )


class GravityCompensator(Controller):
    """tau = g(q) - d dq + tau_0, or g(q) + tau_0 + tau_target.

    Args:
        damping: d, (n,) or (m, n), Nm s/rad; None for none.
        torques: tau_0, (n,) or (m, n), Nm, added all the time; None for none.
        feed_forward: whether the target's torques are added.
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
    """tau = K (q_d - q) + D (dq_d - dq) + g(q) + tau_target.

    With feed-forward also M(q) ddq_d + C(q, dq) dq_d, which makes the error of a moving target die
    out as that of a resting one does (PD+; Paden and Panja 1988, Globally asymptotically stable
    'PD+' controller for robot manipulators, Int. J. Control 47). To a resting target the robot
    moves as springs and dampers on its own inertia would make it: the energy
    1/2 dq M dq + 1/2 e K e falls by dq D dq (Hogan 1985; Albu-Schäffer, Ott, Hirzinger 2007, A
    Unified Passivity-based Control Framework, IJRR 26). D is designed from M(q), motors' inertia
    included, every `damping_every`, and held: any positive semidefinite D takes energy.

    Where joints are elastic, q and dq are the motors', and the links hang below their targets by
    what gravity bends; behind a torque loop q is where the links come to rest
    (`StaticDeflection`), so that K is what one feels at the links.

    Args:
        stiffness: the diagonal of K, (n,) or (m, n), Nm/rad.
        damping: ratio, (n,) or (m, n).
        timestep: s between two calls.
        feed_forward: whether the torques of the target's motion are added.
        damping_every: s.
        at_links: whether K is meant at the links of elastic joints, or at their motors.
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
        # Steps until now, and those in which the damping of every row is designed anew.
        self._k = self._next = 0
        self._due = np.zeros(model.rows, np.intp)
        shape = (*model.rows, model.n)
        self.damping: Array = np.zeros((*shape, model.n))
        self._error: Array = np.zeros(shape)
        self._own, self._less = np.zeros((2, *shape))
        self._times = np.matvec if model.rows else np.dot  # which takes half as long

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
        """See `Controller`.

        Raises:
            DeclarationError: K is too close to the stiffness of the joints themselves.
        """
        most = SOFTEST * joint_stiffness
        own = np.max(np.atleast_2d(self._spring), axis=0)
        if self._at_links and (own > most).any():
            problems = [
                Problem(
                    "stiffness",
                    f"joint {self.model.joint_names[i]}: found",
                    found=own[i],
                    of="Nm/rad",
                    expected=f"at most {most[i]:g}, {100 * SOFTEST:g} % of the elastic joint's",
                )
                for i in np.flatnonzero(own > most).tolist()
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
            most = 0.99 * share * gain
            others = f" and {99 * share:.2g} % of the others" if model.n > 1 else ""
            up_to = f"up to {most:.3g}{others}"
            name = model.joint_names[joint]
            raise too_stiff(name, f" at {gain:g} Nm/rad", self._timestep, up_to)


def in_rows(each: Sequence[Array], robots: int) -> Array:
    """Numbers per joint of the robots of the first row, the second, and so on, as (m, n)."""
    rows = range(0, len(each), robots)
    return np.array([np.concatenate(each[row : row + robots]) for row in rows])


def diagonal(values: Array) -> Array:
    """Diagonal matrices, (..., n, n)."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))


def design_damping(mass: Array, stiffness: Array, ratio: float | Array) -> Array:
    """Damping matrix that gives every mode of mass and stiffness a damping ratio.

    Double diagonalisation: M = Q Q^T and K = Q W^2 Q^T with diagonal W, then D = 2 Q Z W Q^T. Modes
    then move as mass-spring-dampers of their own: with one ratio z a step overshoots by
    exp(-pi z / sqrt(1 - z^2)), 4.6 % at 0.7. A direction without stiffness has no damping.

    Modes belong to no single joint. Ratios that differ are put in as sqrt(z_i z_j) before the
    entries of the matrix for ratio one: it stays positive semidefinite, and equal ratios give the
    exact result.

    Args:
        mass: (..., n, n), symmetric, positive definite.
        stiffness: (..., n, n), symmetric, positive semidefinite.
        ratio: damping ratio, 1 for critical damping; a number, (n,) or (..., n).

    Returns:
        (..., n, n), symmetric, positive semidefinite: it can only take energy, also when it is
        kept while the mass matrix changes.

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
    """The joint that moves most in an unstable mode of a sampled controller, or None.

    The torques -K q - D dq are held for a step, and velocities are stepped before angles (MuJoCo's
    semi-implicit Euler): the robot is stable where no eigenvalue of that map is beyond one. For one
    mass this is w^2 t^2 + 4 z w t < 4 with w^2 = K / M and D = 2 z w M.

    Args:
        mass: (n, n), kg m2 (kg).
        stiffness: (n, n), Nm/rad (N/m).
        damping: (n, n), Nm s/rad (N s/m).
        timestep: s between two torques.
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
    """The largest share from 0 to 1 of something for which a condition holds, within 0.03 %."""
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def too_stiff(joint: str, gain: str, timestep: float, expected: str = "less") -> DeclarationError:
    """The error for gains that are unstable at a time step.

    Args:
        gain: for the message: ` at 500 Nm/rad`, say.
        timestep: s between two torques.
    """
    return Problem(
        "stiffness",
        f"joint {joint} is unstable{gain} with a time step of",
        found=1000.0 * timestep,
        of="ms",
        expected=f"{expected}, or a shorter step",
    ).error()
