"""Designs motions that excite the parameters of a robot for identification.

Each independent joint follows a finite Fourier series, which is periodic and has exact derivatives
(Swevers et al.). Its coefficients are such that the joint starts and ends each period at rest and
without acceleration. The coefficients maximize the information about all parameters and minimize
the condition number. The torques of the joints are linear in the parameters:

    torques = Y(q, dq, ddq) p + B ddq + v dq + f sign(dq) + c

with the base parameters p of the links, the motor inertias B, viscous and Coulomb friction v and f,
and the offsets c. Rows are divided by the torque limits, as torque noise is proportional to them.
The cost of linearly independent columns X with b columns, which are normalized to X_1, is

    log cond(X_1) - log det(X^T X) / b

Sources: Swevers, Ganseman, Tükel, De Schutter, Van Brussel, Optimal robot excitation and
identification, IEEE Transactions on Robotics and Automation 13(5), 1997; Gautier, Khalil, Exciting
trajectories for the identification of base inertial parameters of robots, IJRR 11(4), 1992.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...robots.assemble.friction_torques import SLOW, friction_of
from ...robots.assemble.robot_dynamics import robot_dynamics
from ...robots.declared.mounts import base_frames, carrier, unmounted
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ...simulate.control.target_motions import Chirp, Motion
from .base_parameters import BaseParameters, standard_parameters, standard_torques
from .clearance import Clearance
from .motion_limits import MotionLimits

try:
    from scipy.linalg import null_space, qr
    from scipy.optimize import minimize
except ImportError as error:
    raise UsageError(
        f"the design of a motion requires SciPy ({error}): pip install 'sero-mj[identify]'"
    ) from error

_ROWS, _ROWS_PER_HARMONIC = 48, 8  # minimum number of rows per period, and per harmonic
_POSES_PER_ROW = 4  # distances change faster than torques
_DRAWS, _STARTS, _EVALUATIONS = 200, 3, 50  # random motions, of which the best ones are improved
_DRAWN_SHARES = 0.3, 0.9  # shares of the bounds that random motions reach
_SHARPNESS = 24  # exponent of the smooth maximum
_STEP = 1e-5  # step of numerical derivatives
_RANK = 1e-6  # relative length of the independent part of columns that depend on others
_TORQUE_PENALTY, _DISTANCE_PENALTY = 10.0, 0.1
_MAX_ROWS = 3000  # rows whose torques are computed together
_SAMPLES = 200  # random states
_CHECK = 0.005  # s, time between rows at which limits are checked
_REDUCTION, _MIN_FACTOR = 0.97, 0.05

Progress = Callable[[int, int], None]
Samples = tuple[Array, Array, Array]  # positions, velocities, accelerations


class FourierSeries:
    """Periodic functions whose value, velocity and acceleration are zero at the start.

    Attributes:
        period: s.
        harmonics: number of harmonics, two or more.
        count: number of independent functions.
    """

    def __init__(self, period: float, harmonics: int) -> None:
        self.period, self.harmonics, self.count = period, harmonics, 2 * harmonics - 2
        rows = np.concatenate([self._waves(np.zeros(1), order) for order in range(3)])
        self._combinations = null_space(rows / np.abs(rows).max(axis=1, keepdims=True))

    def _waves(self, times: Array, order: int) -> Array:
        rates = 2.0 * np.pi / self.period * np.arange(self.harmonics + 1)
        phase = times[:, None] * rates + 0.5 * np.pi * order  # a derivative shifts the phase
        sines, cosines = rates**order * np.sin(phase), rates**order * np.cos(phase)
        return np.concatenate([sines[:, 1:], cosines], axis=1)

    def at(self, times: Array) -> Samples:
        """Returns the functions and their derivatives of first and second order, (T, count)."""
        q, v, a = (self._waves(times, order) @ self._combinations for order in range(3))
        return q, v, a


class Regressor:
    """The torques of a robot as a linear function of all parameters."""

    def __init__(self, robot: SerialRobot, limits: MotionLimits, rng: np.random.Generator) -> None:
        self.robot, self._coupling = robot, limits.coupling
        self._base, self._standard = BaseParameters.of(robot), standard_parameters(robot)
        self._motor_inertia = robot_dynamics(robot).motor_inertias
        low, high = limits.positions.T
        size = _SAMPLES, len(low)
        v, a = rng.uniform(-1.0, 1.0, (2, *size)) * limits.velocities
        X, torques = self.at(rng.uniform(low, high, size), v, 2.0 * np.pi * a)
        typical = np.sqrt(np.mean((torques @ self._coupling) ** 2, axis=0)) + 1e-9
        self._weights = 1.0 / np.where(np.isfinite(limits.torques), limits.torques, typical)
        # A QR decomposition with pivoting finds columns that span all others.
        X = (X * self._weights[:, None]).reshape(-1, X.shape[2])
        lengths = np.linalg.norm(X, axis=0)
        nonzero = np.flatnonzero(lengths > 1e-12 * lengths.max())
        _, R, order = qr(X[:, nonzero] / lengths[nonzero], mode="economic", pivoting=True)
        independent = np.abs(np.diag(R)) > _RANK * np.abs(R[0, 0])
        self._kept = np.sort(nonzero[order[: int(independent.sum())]])

    def all_joints(self, q: Array, v: Array, a: Array) -> Samples:
        """Converts the motion of the independent joints (T, k) to that of all joints (T, n)."""
        coupled = self.robot.coupled
        return coupled.positions(q), coupled.rates(v), coupled.rates(a)

    def at(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Returns the columns (T, k, p) and the torques at all joints (T, n).

        The torques are those that the declared robot requires. The motion is that of the
        independent joints, shape (T, k).
        """
        motion = self.all_joints(q, v, a)
        standard = standard_torques(self.robot, *motion)
        torques = standard @ self._standard + self._motor_inertia * motion[2]
        links = np.einsum("tnb,nk->tkb", self._base.columns(standard), self._coupling)
        diagonals = [each[..., None] * np.eye(q.shape[1])
                     for each in (a, v, np.tanh(v / SLOW), np.ones_like(v))]  # fmt: skip
        columns = np.concatenate([links, *diagonals], axis=2)
        return columns, torques + friction_of(self.robot, motion[1])

    def information(self, columns: Array, count: int = 1) -> Array:
        """Returns matrices X^T X (count, b, b) of motions whose rows follow each other."""
        X = columns[:, :, self._kept] * self._weights[:, None]
        X = X.reshape(count, -1, len(self._kept))
        return np.swapaxes(X, 1, 2) @ X


def condition_number(information: Array) -> Array:
    """Returns condition numbers of columns normalized to length 1, from X^T X (..., b, b)."""
    lengths = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    values = np.linalg.eigvalsh(information / (lengths[..., None] * lengths[..., None, :]))
    return np.asarray(np.sqrt(values[..., -1] / np.maximum(values[..., 0], 1e-15)))


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion of a robot that excites its parameters.

    Attributes:
        start: positions of the k independent joints at start and end, shape (k,), rad or m.
        coefficients: factors of the functions of `series`, shape (count, k).
    """

    regressor: Regressor
    limits: MotionLimits
    clearance: Clearance
    series: FourierSeries
    start: Array
    coefficients: Array

    def independent(self, times: Array) -> Samples:
        """Returns the motion of the independent joints at times (T,) in s, shape (T, k) each."""
        q, v, a = (each @ self.coefficients for each in self.series.at(times))
        return self.start + q, v, a

    def motion(self, times: Array) -> Motion:
        """Returns the motion of all joints at times (T,) in s; it repeats after each period."""
        return Motion(times, *self.regressor.all_joints(*self.independent(times)))

    def torques(self, times: Array) -> Array:
        """Returns the torques that the declared robot requires, shape (T, n), Nm or N."""
        return self.regressor.at(*self.independent(times))[1]

    def used(self, times: Array) -> dict[str, Array]:
        """Returns how much of its bounds the motion uses; see `MotionLimits.used`."""
        q, v, _ = self.independent(times)
        return self.limits.used(q, v, self.torques(times))

    def exceeded(self) -> str:
        """Returns the quantity that exceeds its bounds, or ""."""
        times = np.arange(0.0, self.series.period, _CHECK)
        for kind, shares in self.used(times).items():
            if (shares > 1.0 + 1e-9).any():
                return kind
        return "distance" if self.clearance.shortfalls(self.motion(times).angles).any() else ""

    def condition(self) -> tuple[float, int]:
        """Returns the condition number of the normalized columns, and the number of columns."""
        return self._condition(*self.independent(np.arange(0.0, self.series.period, _CHECK)))

    def chirp_condition(self) -> float:
        """Returns the condition number of a chirp with this duration, range and bandwidth."""
        period = self.series.period
        low, high = 1.0 / period, self.series.harmonics / period
        room = np.abs(self.limits.positions - self.start[:, None]).min(axis=1)
        swing = np.minimum(room, self.limits.velocities / (2.0 * np.pi * high))
        motion = Chirp(
            amplitude=self.limits.coupling @ swing, start_frequency=low, end_frequency=high,
            duration=period, ramp=0.1 * period,
        ).motion(
            np.arange(0.0, period, _CHECK), self.regressor.robot, self.motion(np.zeros(1)).angles[0]
        )  # fmt: skip
        free = self.regressor.robot.coupled.independent
        parts = motion.angles, motion.velocities, motion.accelerations
        q, v, a = (each[:, free] for each in parts)
        return self._condition(q, v, a)[0]

    def _condition(self, q: Array, v: Array, a: Array) -> tuple[float, int]:
        information = self.regressor.information(self.regressor.at(q, v, a)[0])
        return float(condition_number(information)[0]), information.shape[1]


def design_excitation(
    scene: Scene,
    name: str,
    *,
    period: float = 10.0,
    harmonics: int = 5,
    share: float = 0.8,
    clearance: float = 0.02,
    start: Array | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Excitation:
    """Designs a motion of one robot in a scene that excites its parameters.

    Args:
        scene: scene whose floor, objects and other robots the robot must not touch.
        name: name of the robot.
        period: duration of the motion, s.
        harmonics: number of harmonics of each joint.
        share: share of the ranges, velocity limits and torque limits that the motion may use.
        clearance: minimum distance between parts of the robot, and to its surroundings, m.
        start: joint values at start and end, shape (k,) or (n,), rad or m (default: the declared
            values, or the nearest ones within the bounds).
        seed: seed of the random motions from which the search starts.
        progress: called with the completed and the total number of steps.

    Raises:
        UsageError: the base of the robot moves freely, the robot collides at the start, the start
            is out of bounds, or no motion is possible there.
    """
    robot = scene.robots[name]
    if robot.free_base:
        reason = f"the base of '{name}' moves freely, so joint torques do not determine its motion"
        raise UsageError(f"{reason}; expected a robot with a fixed base")
    robot = unmounted(robot, base_frames(scene.robots)[name])
    limits, coupled = MotionLimits.of(robot, share), robot.coupled
    if carried := [each for each in scene.robots if carrier(scene.robots[each]) == name]:
        limits.notes.append(f"torques do not include the loads {', '.join(carried)}")
    begin = _start(robot, limits, start)
    rng = np.random.default_rng(seed)
    low, high = limits.positions.T
    poses = coupled.positions(rng.uniform(low, high, (_SAMPLES, coupled.k)))
    space = Clearance(scene, name, clearance, coupled.positions(begin), poses)
    series = FourierSeries(period, harmonics)
    rest = np.zeros((series.count, coupled.k))
    found = Excitation(Regressor(robot, limits, rng), limits, space, series, begin, rest)
    coefficients, factor = _Search(found).best(rng, progress), 1.0
    while factor > _MIN_FACTOR:
        found = replace(found, coefficients=factor * coefficients)
        if not (exceeded := found.exceeded()):
            return found
        factor *= _REDUCTION
    reason = f"even a small motion of '{name}' about its start exceeds the bounds: {exceeded}"
    raise UsageError(f"{reason}. Choose another pose with --start, or change --share.")


def _start(robot: SerialRobot, limits: MotionLimits, start: Array | None) -> Array:
    (low, high), free = limits.positions.T, robot.coupled.independent
    if start is None:
        return np.clip(robot.home[free], low, high)
    if len(start) not in (robot.n, len(free)):
        expected = f"{len(free)}, one per independent joint"
        raise UsageError(Problem("--start", found=len(start), of="values", expected=expected))
    begin = start[free] if len(start) == robot.n else start
    for k in np.flatnonzero((begin < low) | (begin > high)).tolist():
        expected = f"{low[k]:.4g} to {high[k]:.4g}, {limits.share:g} of the range"
        key = f"--start, {limits.names[k]}"
        raise UsageError(Problem(key, found=float(begin[k]), expected=expected))
    return np.asarray(begin, np.float64)


class _Search:
    # Optimizes unbounded numbers x (count, k), which a smooth function maps to coefficients within
    # the bounds of positions and velocities. Torques and distances out of bounds add to the cost.

    def __init__(self, rest: Excitation) -> None:
        self._rest = rest
        series, limits, start = rest.series, rest.limits, rest.start
        rows = max(_ROWS, _ROWS_PER_HARMONIC * series.harmonics)
        self._samples = series.at((np.arange(rows) + 0.5) * series.period / rows)
        many = _POSES_PER_ROW * rows
        self._poses = series.at(np.arange(many) * series.period / many)[0]
        low, high = limits.positions.T
        self._room = np.maximum([start - low, high - start], 1e-9 * (high - low))
        reach = limits.velocities * series.period / (2.0 * np.pi)
        self._scale = np.minimum(self._room.max(axis=0), reach)

    def best(self, rng: np.random.Generator, progress: Progress | None) -> Array:
        """Returns the coefficients with the lowest cost, shape (count, k)."""
        x = rng.normal(size=(_DRAWS, *self._rest.coefficients.shape))
        x *= rng.uniform(*_DRAWN_SHARES, (_DRAWS, 1, x.shape[2])) / self._shares(x * self._scale)
        found, done, total = [], 0, _STARTS * _EVALUATIONS

        def cost_and_gradient(flat: Array) -> tuple[float, Array]:
            nonlocal done
            done = min(done + 1, total)
            if progress is not None:
                progress(done, total)
            shifts = np.concatenate([np.zeros((1, flat.size)), _STEP * np.eye(flat.size)])
            costs = self._costs((flat + shifts).reshape(-1, *x.shape[1:]))
            return float(costs[0]), (costs[1:] - costs[0]) / _STEP

        for k in np.argsort(self._costs(x))[:_STARTS]:
            limit = {"maxfun": _EVALUATIONS}
            result = minimize(
                cost_and_gradient, x[k].ravel(), jac=True, method="L-BFGS-B", options=limit
            )
            found.append((float(result.fun), result.x.reshape(1, *x.shape[1:])))
        return np.asarray(self._coefficients(min(found, key=lambda each: each[0])[1])[0])

    def _shares(self, coefficients: Array) -> Array:
        # Smooth maximum of the shares of the bounds that are used, (B, 1, k).
        q, v = self._samples[0] @ coefficients, self._samples[1] @ coefficients
        below, above = self._room
        used = [np.maximum(-q, 0.0) / below, np.maximum(q, 0.0) / above]
        shares = np.concatenate([*used, np.abs(v) / self._rest.limits.velocities], axis=1)
        largest = shares.max(axis=1, keepdims=True)
        powers = ((shares / largest) ** _SHARPNESS).sum(axis=1, keepdims=True)
        return np.asarray(largest * powers ** (1.0 / _SHARPNESS))

    def _coefficients(self, x: Array) -> Array:
        x = x * self._scale
        # x / (1 + shares^p)^(1/p), without overflow for large shares.
        excess = np.logaddexp(0.0, _SHARPNESS * np.log(self._shares(x)))
        return np.asarray(x * np.exp(-excess / _SHARPNESS))

    def _costs(self, x: Array) -> Array:
        # Costs (B,) of numbers x (B, count, k), in parts that fit into memory.
        parts = -(-len(x) * len(self._poses) // (_POSES_PER_ROW * _MAX_ROWS))
        return np.concatenate([self._costs_of(part) for part in np.array_split(x, parts)])

    def _costs_of(self, x: Array) -> Array:
        rest, coefficients, (B, _, k) = self._rest, self._coefficients(x), x.shape
        q, v, a = ((each @ coefficients).reshape(-1, k) for each in self._samples)
        columns, torques = rest.regressor.at(rest.start + q, v, a)
        information = rest.regressor.information(columns, B)
        determinants = np.linalg.slogdet(information)[1] / information.shape[1]
        used = rest.limits.used(rest.start + q, v, torques)["torque"].reshape(B, -1)
        poses = (rest.start + self._poses @ coefficients).reshape(-1, k)
        near = rest.clearance.shortfalls(rest.regressor.robot.coupled.positions(poses))
        penalty = _TORQUE_PENALTY * (np.maximum(used - 1.0, 0.0) ** 2).sum(axis=1)
        penalty += _DISTANCE_PENALTY * near.reshape(B, -1).sum(axis=1)
        return np.asarray(np.log(condition_number(information)) - determinants + penalty)
