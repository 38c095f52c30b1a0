"""`TorqueResiduals`: the parts of a robot's torques that the motion does not explain.

The torque sensor of a joint is between its motor and its links. With the link inertia M, the motor
inertia B (reflected to the joint) and the friction tau_f of motor and gear, the equations are:

    link side:   measured = M(q) ddq + C(q, dq) dq + g(q) + link residual
    motor side:  commanded - measured = B ddtheta + tau_f + motor residual

Both residuals are linear in possible faults: payload, offset and gain of a sensor, friction, gain
of a drive. All signals pass the same low-pass filter (a Gaussian without time shift) and are
decimated. This does not change the estimates of a regression, and removes the noise of
differentiated angles.

With joint torque control (see `TorqueLoop`), the commanded torque is not the motor torque. Then, B
is the apparent motor inertia, friction is compensated, and an error of the torque sensor affects
only the link side.

Sources: Gautier, Dynamic identification of robots with power model, ICRA 1997 (filtering of torques
and regressors). Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, chapter
12.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array, Bools
from ...robots.assemble.friction_torques import SLOW
from ...robots.assemble.robot_dynamics import RobotDynamics, robot_dynamics
from ...robots.declared.robot import SerialRobot
from ...simulate.runs.run_log import RunLog, compared_signal
from ...study.align import Pair, at_times
from .link_torques import (
    body_torques,
    link_torques,
    mass_matrices,
    torques_by_angle,
    torques_by_gravity,
)

WINDOW = 0.016  # s, standard deviation of the low-pass filter: 10 Hz
_SUPPORT = 4.0  # half width of the filter kernel in standard deviations
_ROW_SPACING = 2.0  # spacing of the residuals in standard deviations
MAX_ROWS = 600  # maximum number of rows of the residuals
_MAX_READ = 120_000  # rows of a run; longer runs are decimated
_GAP = 0.02  # s; accelerations within longer linear interpolations are wrong
_MIN_ROWS = 12  # minimum number of rows of the residuals
_REVERSING = 0.999  # mean sign of the velocity below which the joint reverses
_SATURATED = 0.95  # share of the torque limit above which a drive may be saturated
_NOISE_CORRELATION = -0.35  # correlation of second differences below which they are noise
_STOP = 0.005  # distance to an end stop as a share of the joint's range
_MIN_SCALE = 1e-3  # Nm or N, scale of joints without torque limit and torque
# An angle jumps if a second difference exceeds this multiple of this quantile, and the sum with the
# next one is below this share.
_JUMP, _QUANTILE, _RETURN_SHARE = 20.0, 0.99, 0.2

# Delays of sensors and drives in s; effects of other delays are interpolated.
DELAYS = 0.002 * np.arange(1, 51)
OF_MOTORS = ("motor_inertias", "viscous_friction", "coulomb_friction")  # keys of `[dynamics]`
_FIT_MARGIN = 1.2  # ratio of residuals above which undeclared friction is significant
_FIT_ROUNDS, _HUBER = 20, 2.0  # of a robust fit; standard deviations with full weight


@dataclass(frozen=True, eq=False)
class Torques:
    """Low-pass filtered torques of the joints, shape (K, n), Nm or N.

    Attributes:
        model: link torques of the model.
        rates: the larger of the rates of change of measured and commanded torques, Nm/s.
        curvature: second derivatives of the measured torques, Nm/s2.
        requested: torques requested by joint torque control within the limits of the drives,
            without friction compensation.
        delivered: torques of the drives, from measured torques and the motion of the motors.
        late_model: link torques of the model with each of the D `DELAYS`, minus those without a
            delay, shape (D, K, n).
        late_commanded: the same for the commanded torques.
        payload: torques per unit of the `PARAMETERS` of a body at the flange (mass, first moments
            and inertia about the flange frame), shape (K, n, 10).
    """

    measured: Array
    commanded: Array
    model: Array
    rates: Array
    curvature: Array
    requested: Array
    delivered: Array
    late_model: Array
    late_commanded: Array
    payload: Array


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The low-pass filtered motion of the joints, shape (K, n), rad or m.

    Attributes:
        signs: signs of the velocities, between -1 and 1 while a joint reverses.
        accelerations: accelerations of the motors.
        slow: whether a joint hardly moves.
        links: angles, velocities and accelerations of the links, shape (3, K, n).
    """

    velocities: Array
    signs: Array
    accelerations: Array
    slow: Bools
    links: Array


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of the measured torques, and intervals of constant torque.

    Attributes:
        roughness: standard deviation of equivalent white noise in windows, shape (W, n), Nm.
        times: start times of the windows, shape (W,), s.
        held: start time (s), end time (s) and torque of each joint's longest interval with constant
            measured torque.
    """

    roughness: Array
    times: Array
    held: tuple[tuple[float, float, float], ...]

    def later(self, offset: float) -> SensorNoise:
        """Returns a copy with `offset` seconds added to all times."""
        held = tuple((begin + offset, end + offset, value) for begin, end, value in self.held)
        return SensorNoise(self.roughness, self.times + offset, held)


@dataclass(frozen=True, eq=False)
class TorqueResiduals:
    """Residuals of a robot's torques and possible components of the residuals; NaN if unknown.

    Attributes:
        times: equidistant times, shape (K,), s.
        link: measured minus model torques, shape (K, n), Nm or N; NaN for coupled joints, whose
            torques cannot be separated.
        motor: commanded minus measured torques, minus the torques of motor inertia and declared
            friction, shape (K, n), Nm or N; NaN while a joint is slow or reverses.
        lag: commanded minus measured torques, shape (K, n).
        width: standard deviation of the low-pass filter, s.
        sample_time: time between two rows of the run, s.
        scale: torque limits, or the largest torques of joints without a limit, shape (n,).
        coulomb: declared Coulomb friction, shape (n,), Nm.
        torque_control: whether joint torque control is active.
        no_model: reason why `link` is invalid, such as undeclared masses; empty if it is valid.
        filtered: low-pass filters the torques (T, ...) that a function returns for the joint
            values, velocities and accelerations (T, n) of all rows; returns shape (K, ...).
        undeclared: keys of `[dynamics]` that are not declared. The friction and motor inertia of
            `motor` are then fitted to this run, so that only their changes are visible.
        left_out: mapping from reasons to the rows without residuals of link and motor for this
            reason, shape (2, K, n).
    """

    robot: SerialRobot
    times: Array
    link: Array
    motor: Array
    lag: Array
    torques: Torques
    motion: JointMotion
    noise: SensorNoise
    width: float
    sample_time: float
    scale: Array
    coulomb: Array
    torque_control: bool
    no_model: str
    filtered: Callable[[Callable[[Array, Array, Array], Array]], Array]
    undeclared: tuple[str, ...] = ()
    left_out: Mapping[str, Bools] = field(default_factory=dict)

    @property
    def has_model(self) -> bool:
        return not self.no_model

    @cached_property
    def dynamics(self) -> RobotDynamics:
        """The dynamics of the robot."""
        return robot_dynamics(self.robot)

    @cached_property
    def by_angle(self) -> Array:
        """Derivatives of the model torques with respect to the joint values, shape (K, n, n)."""
        return torques_by_angle(self.robot, *self.motion.links)

    @cached_property
    def by_acceleration(self) -> Array:
        """Mass matrices of the links at the filtered angles, shape (K, n, n)."""
        return mass_matrices(self.robot, self.motion.links[0])

    @cached_property
    def by_gravity(self) -> Array:
        """Derivatives of the model torques with respect to gravity, shape (K, n, 3), kg m."""
        return torques_by_gravity(self.robot, self.motion.links[0])

    @property
    def step(self) -> float:
        """Time between two rows of the residuals, s."""
        return float(self.times[1] - self.times[0])


def torque_residuals(
    log: RunLog,
    name: str,
    *,
    torque_control: bool | None = None,
    times: Array | None = None,
    max_rows: int = MAX_ROWS,
    window: float = WINDOW,
) -> TorqueResiduals:
    """Computes the parts of a robot's torques that the motion does not explain.

    Args:
        log: the run.
        name: name of the robot.
        torque_control: whether joint torque control was active; None selects the value with
            smaller residuals.
        times: times of the residuals on the clock of the run, shape (K,), s; None for equidistant
            times.
        max_rows: maximum number of equidistant times.
        window: standard deviation of the low-pass filter, s.

    Raises:
        UsageError: there is no such robot, no measured torque, or too little data.
    """
    robot = _checked(log, name)
    rows, step = _even(log, name)
    # The torques of a row act in the step before it, so the state is that of the previous row.
    q, v = rows["q"][1:-1], np.diff(rows["q"], axis=0)[:-1] / step
    a = np.diff(rows["q"], n=2, axis=0) / step**2
    jumps = _jumps(a)
    a[jumps] = np.nan
    at, measured, commanded = rows["t"][2:, 0], rows["measured"][2:], rows["commanded"][2:]
    low_pass = _LowPass(at, step, times, max_rows, window)
    if len(low_pass.times) < _MIN_ROWS:
        least = _MIN_ROWS * low_pass.step + 2 * _SUPPORT * low_pass.width
        problem = Problem(
            log.name,
            "has",
            found=round(float(log.times[-1] - log.times[0]), 3),
            of=f"s of '{name}'",
            expected=f"at least {least:.2g} s",
        )
        raise UsageError(problem)
    model = link_torques(robot, q, v, a)
    dynamics = robot_dynamics(robot)
    smooth = low_pass(v + a * step)
    speed = np.abs(smooth)
    sign = np.sign(low_pass.fully(v + a * step))
    sign[np.abs(low_pass.fully(v)) < SLOW] = 0.0
    signs = low_pass(sign)
    with np.errstate(invalid="ignore"):
        slow = speed <= SLOW  # not where the velocity is unknown
        reverses = ~(speed > SLOW) | ~(np.abs(signs) > _REVERSING)
    acceleration = low_pass(a)
    if robot.elastic_joints:  # the motor differs from the link by the deflection of the spring
        acceleration = acceleration + low_pass.second(measured) / dynamics.joint_stiffness
    apparent = _apparent_inertias(robot, dynamics)
    lag = commanded - measured
    friction = dynamics.viscous_friction * smooth + dynamics.coulomb_friction * signs
    inertial = dynamics.motor_inertias * acceleration + friction
    plain = low_pass(lag) - inertial
    # A motor without inertia exerts the commanded torque.
    ratio = np.divide(dynamics.motor_inertias, apparent, out=np.ones(robot.n), where=apparent > 0.0)
    # Torques that the torque loop requests from the drives, which saturate.
    requested, limit = measured + ratio * lag, _scale(robot, np.full_like(measured, np.inf))
    saturated = np.abs(requested) > _SATURATED * limit
    looped = low_pass(np.where(saturated, np.nan, lag)) - apparent * acceleration
    for each in (plain, looped):
        each[reverses] = np.nan
    undeclared = tuple(key for key in OF_MOTORS if key in dynamics.estimated)
    motion = JointMotion(
        smooth, signs, acceleration, slow, np.stack([low_pass(each) for each in (q, v, a)])
    )
    plain = _without_fit(plain, effects_of_motors(motion, undeclared, torque_control=False))
    looped = _without_fit(looped, effects_of_motors(motion, undeclared, torque_control=True))
    scale = _scale(robot, measured)
    if torque_control is None:
        # The fit of more parameters is always closer.
        margin = _FIT_MARGIN if undeclared else 1.0
        torque_control = _is_smaller(looped / scale, margin * plain / scale)
    rough, windows = _roughness(measured, commanded, step)
    torques = Torques(
        measured=low_pass(measured),
        commanded=low_pass(commanded),
        model=low_pass(model),
        rates=np.fmax(*(np.abs(low_pass.first(each)) for each in (measured, commanded))),
        curvature=low_pass.second(measured),
        requested=low_pass(np.clip(requested, -limit, limit)),
        delivered=low_pass(measured) + inertial,
        late_model=np.stack([low_pass(_later(model, step, each)) for each in DELAYS]),
        late_commanded=np.stack([low_pass(_later(commanded, step, each)) for each in DELAYS]),
        payload=low_pass(body_torques(robot, q, v, a)),
    )
    held = tuple(_held(at, each) for each in measured.T)
    return TorqueResiduals(
        robot=robot,
        times=low_pass.times,
        link=low_pass(_only_of_links(robot, q, measured)) - torques.model,
        motor=looped if torque_control else plain,
        lag=low_pass(lag),
        torques=torques,
        motion=motion,
        noise=SensorNoise(rough, at[1] + windows, held),
        width=low_pass.width,
        sample_time=step,
        scale=scale,
        coulomb=dynamics.coulomb_friction,
        torque_control=torque_control,
        no_model=_why_no_model(robot, log, dynamics.estimated),
        filtered=lambda torques: low_pass(torques(q, v, a)),
        undeclared=undeclared,
        left_out=_left_out(
            low_pass,
            missing=np.stack(
                [_any_joint(~np.isfinite(q)) | ~np.isfinite(measured), ~np.isfinite(q + lag)]
            ),
            jumps=np.stack([_any_joint(jumps), jumps]),
            stops=_at_stops(robot, q),
            coupled=is_coupled(robot),
            saturated=saturated & torque_control,
            slow=slow,
            reverses=reverses,
        ),
    )


def effects_of_motors(
    motion: JointMotion, keys: Sequence[str], *, torque_control: bool
) -> list[Array]:
    """Returns the motor torques per unit of some of `OF_MOTORS`, shape (K, n) each.

    Joint torque control compensates friction, so that only the inertia has an effect.
    """
    effects = dict(
        zip(OF_MOTORS, (motion.accelerations, motion.velocities, motion.signs), strict=True)
    )
    return [effects[key] for key in keys if key == OF_MOTORS[0] or not torque_control]


def pair_with_model(log: RunLog, found: TorqueResiduals) -> Pair:
    """Pairs a robot's run with the torques of its model in the same motion, low-pass filtered.

    The torques of the model result from inverse dynamics of the measured motion. A model driven by
    the commanded torques would diverge within a second.
    """
    name = found.robot.name
    angles = at_times(log.times, log.of(name, "joint_angles"), found.times)
    a, b = {"joint_angles": angles, "torques": found.torques.measured}, {"joint_angles": angles}
    b["torques"] = found.torques.measured - found.link
    if log.has(name, "commanded_torques"):
        a["commanded_torques"] = found.torques.commanded
        b["commanded_torques"] = b["torques"] + found.lag - found.motor
    return Pair(found.robot, found.times, a, b, 0.0, None, (log.name, "its model"))


def _checked(log: RunLog, name: str) -> SerialRobot:
    if name not in log.robots:
        raise UsageError(f"no robot '{name}' in {log.name}; it has {', '.join(log.robots)}")
    robot = log.robots[name]
    if not log.has(name, "torques"):
        found = f"has no measured torques of '{name}'"
        raise UsageError(Problem(log.name, found, expected="`torques`"))
    return robot


def _even(log: RunLog, name: str) -> tuple[dict[str, Array], float]:
    # Signals at equidistant times, (T, n) each, with NaN in gaps.
    times = log.times
    distinct = len(np.unique(times))
    if distinct < 4 or log.timestep <= 0.0:
        found = f"{log.name} has {distinct} different times of '{name}'"
        raise UsageError(f"{found}; expected 4 or more")
    n = log.robots[name].n
    signals = {"q": log.of(name, "joint_angles"), "measured": log.of(name, "torques")}
    missing = np.full((len(times), n), np.nan)
    has = log.has(name, "commanded_torques")
    signals["commanded"] = compared_signal(log, name, "commanded_torques") if has else missing
    signals["t"] = times[:, None]
    thin = -(-round((times[-1] - times[0]) / log.timestep) // _MAX_READ)
    step = log.timestep * max(thin, 1)
    even = times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-6) + 1)
    if len(even) == len(times) and np.allclose(even, times, rtol=0.0, atol=1e-3 * step):
        return signals, step
    sampled = {key: at_times(times, values, even, _GAP) for key, values in signals.items()}
    return {**sampled, "t": even[:, None]}, step


def _apparent_inertias(robot: SerialRobot, dynamics: RobotDynamics) -> Array:
    # Motor inertias with joint torque control, (n,).
    apparent = robot.torque_control.motor_inertias
    if apparent is None:
        apparent = robot.torque_control.inertia_ratio * dynamics.motor_inertias
    return np.broadcast_to(apparent, robot.n)


def is_coupled(robot: SerialRobot) -> Bools:
    """Returns whether each joint shares its drive with another one, shape (n,)."""
    coupled = {*robot.couplings, *(each.to for each in robot.couplings.values())}
    return np.array([name in coupled for name in robot.names])


def _only_of_links(robot: SerialRobot, q: Array, measured: Array) -> Array:
    # Measured torques; NaN at end stops, and for coupled joints, which share a drive.
    free = np.where(_at_stops(robot, q), np.nan, measured)
    free[:, is_coupled(robot)] = np.nan
    return free


def _any_joint(rows: Bools) -> Bools:
    # Whether any joint is concerned, as link torques depend on all joints, (T, n).
    return np.broadcast_to(rows.any(axis=1, keepdims=True), rows.shape)


def _left_out(
    low_pass: _LowPass,
    *,
    missing: Bools,
    jumps: Bools,
    stops: Bools,
    coupled: Bools,
    saturated: Bools,
    slow: Bools,
    reverses: Bools,
) -> dict[str, Bools]:
    # Reasons why residuals of link and motor are unknown, with masks (2, K, n). All but the last
    # two arguments are masks of the rows before the filter.
    def near(rows: Bools) -> Bools:
        return np.isnan(low_pass(np.where(rows, np.nan, 0.0)))

    no = np.zeros_like(slow)
    return {
        "gap or missing value": np.stack([near(each) for each in missing]),
        "jump of an angle": np.stack([near(each) for each in jumps]),
        "coupled joint": np.stack([no | coupled, no]),
        "end stop": np.stack([near(stops), no]),
        "saturated": np.stack([no, near(saturated)]),
        "at rest": np.stack([no, slow]),
        "reversing": np.stack([no, reverses]),
    }


def _without_fit(residuals: Array, columns: Sequence[Array]) -> Array:
    # Residuals (K, n) without the best multiples of columns (K, n), joint by joint. The fit is
    # robust (Huber 1964), because a fault may act during a part of the run.
    result = residuals.copy()
    for joint in range(residuals.shape[1] if columns else 0):
        X = np.stack([each[:, joint] for each in columns], axis=-1)
        rows = np.isfinite(residuals[:, joint]) & np.isfinite(X).all(axis=1)
        if rows.sum() <= _MIN_ROWS:
            continue
        X, y = X[rows], residuals[rows, joint]
        lengths = np.maximum(np.linalg.norm(X, axis=0), 1e-12)
        weights = np.ones(len(y))
        for _ in range(_FIT_ROUNDS):
            root = np.sqrt(weights)[:, None]
            phi = np.linalg.lstsq(root * X / lengths, root[:, 0] * y, rcond=1e-6)[0]
            left = np.abs(y - X / lengths @ phi)
            spread = max(float(np.median(left)) / 0.6745, 1e-12)
            weights = np.minimum(1.0, _HUBER * spread / np.maximum(left, 1e-12))
        result[rows, joint] = y - X / lengths @ phi
    return result


class _LowPass:
    # A Gaussian low-pass filter with derivatives, for rows at the times `at` (T,). It is evaluated
    # at the times `wanted` (K,), or at `max_rows` equidistant times at most.
    def __init__(
        self, at: Array, step: float, wanted: Array | None, max_rows: int, window: float
    ) -> None:
        self.width = max(window, step)
        reach = int(np.ceil(_SUPPORT * self.width / step))
        every = max(int(_ROW_SPACING * self.width / step), -(-len(at) // max_rows), 1)
        self.step = every * step
        rows = np.arange(reach, len(at) - reach, every)
        if wanted is not None:
            rows = np.rint((wanted - at[0]) / step).astype(int)
        inside = (rows >= reach) & (rows < len(at) - reach)
        self.times = at[rows] if wanted is None else wanted
        self._rows, self._inside, self._reach = rows, inside, reach
        z = np.arange(-reach, reach + 1) * step / self.width
        kernel = np.exp(-0.5 * z**2)
        self._kernel = kernel / kernel.sum()
        first = z * kernel
        self._first = first / (first @ (z * self.width))
        # Second derivative, normalized to 0 for a constant and 2 for the square of the time.
        second = (z**2 - 1.0) * kernel
        second -= kernel * (second.sum() / kernel.sum())
        self._second = second * 2.0 / (second @ (z * self.width) ** 2)

    def __call__(self, values: Array) -> Array:
        return self._at_rows(values, self._kernel)

    def first(self, values: Array) -> Array:
        return self._at_rows(values, self._first)

    def second(self, values: Array) -> Array:
        return self._at_rows(values, self._second)

    def _at_rows(self, values: Array, kernel: Array) -> Array:
        flat = values.reshape(len(values), -1)
        result = np.full((len(self._rows), flat.shape[1]), np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(flat, len(kernel), axis=0)
        result[self._inside] = windows[self._rows[self._inside] - self._reach] @ kernel
        return result.reshape(len(self._rows), *values.shape[1:])

    def fully(self, values: Array) -> Array:
        # The filter at every row, (T, n), with the nearest value beyond both ends.
        padded = np.pad(values, ((self._reach, self._reach), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(self._kernel), axis=0)
        return np.asarray(windows @ self._kernel)


def _jumps(a: Array) -> Bools:
    # Rows with jumps in the second differences `a` (T, n) of angles, as when an encoder slips or is
    # reset: two large values of opposite sign, because the velocity stays the same.
    moving = np.where(a == 0.0, np.nan, np.abs(a))
    usual = [
        np.nanquantile(each, _QUANTILE) if np.isfinite(each).any() else np.inf for each in moving.T
    ]
    large = np.abs(a[:-1]) > _JUMP * np.array(usual)
    back = np.abs(a[:-1] + a[1:]) < _RETURN_SHARE * np.abs(a[:-1])
    found = np.zeros(a.shape, bool)
    found[:-1] |= large & back
    found[1:] |= large & back
    return found


def _roughness(measured: Array, commanded: Array, step: float) -> tuple[Array, Array]:
    # Roughness of measured torques that commands do not cause, in windows of about 0.1 s. White
    # noise with the standard deviation s has second differences of sqrt(6) s. The median of their
    # magnitudes is 0.6745 times that, and robust to single steps. Successive values have a
    # correlation of -2/3; otherwise, it is an oscillation, not noise.
    bends = np.diff(measured, n=2, axis=0)
    caused = np.diff(commanded, n=2, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nansum(bends * caused, axis=0) / np.nansum(caused * caused, axis=0)
    bends = bends - np.nan_to_num(np.where(np.isfinite(share), share, 0.0) * caused)
    size = max(round(0.1 / step), 12)
    count = max(len(bends) // size, 1)
    stretches = bends[: count * size].reshape(count, -1, bends.shape[1])
    rough = np.median(np.abs(stretches), axis=1) / 0.6745 / np.sqrt(6.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = (stretches[:, 1:] * stretches[:, :-1]).sum(axis=1) / (stretches**2).sum(axis=1)
    rough = np.where(alike < _NOISE_CORRELATION, rough, 0.0)
    begins = np.asarray(np.arange(count) * (size * step), np.float64)
    return np.asarray(rough, np.float64), begins


def _later(values: Array, step: float, delay: float) -> Array:
    # The change of values (T, n) by a delay in s.
    rows = delay / step
    whole = int(rows)
    padded = np.concatenate([np.repeat(values[:1], whole + 1, axis=0), values])
    before, at = padded[: len(values)], padded[1 : len(values) + 1]
    return np.asarray(at + (rows - whole) * (before - at) - values)


def _held(at: Array, measured: Array) -> tuple[float, float, float]:
    changes = np.flatnonzero(np.concatenate([[True], np.diff(measured) != 0.0, [True]]))
    longest = int(np.argmax(np.diff(changes)))
    begin, end = changes[longest], changes[longest + 1] - 1
    return float(at[begin]), float(at[end]), float(measured[begin])


def _scale(robot: SerialRobot, measured: Array) -> Array:
    limits = np.full(robot.n, np.inf) if robot.torque_limits is None else robot.torque_limits
    largest = np.maximum(np.nanmax(np.abs(measured), axis=0, initial=0.0), _MIN_SCALE)
    return np.where(np.isfinite(limits), limits, largest)


def _why_no_model(robot: SerialRobot, log: RunLog, estimated: Sequence[str]) -> str:
    if "masses" in estimated:
        return f"the masses of {robot.name} are estimated, not declared"
    if robot.mount is not None or robot.free_base:
        return f"the base of {robot.name} moves"
    carried = [
        name
        for name, each in log.robots.items()
        if (each.mount or "").partition("/")[0] == robot.name
    ]
    return f"{robot.name} carries {', '.join(carried)}" if carried else ""


def _at_stops(robot: SerialRobot, angles: Array) -> Bools:
    low, high = robot.plausible_limits.T
    near = _STOP * np.ptp(robot.display_ranges, axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray((angles < low + near) | (angles > high - near))


def _is_smaller(a: Array, b: Array) -> bool:
    known = np.isfinite(a) & np.isfinite(b)
    joints = known.sum(axis=0) > _MIN_ROWS
    if not joints.any():
        return False
    mine, others, apart = (
        np.nanmedian(np.where(known, np.abs(each), np.nan)[:, joints], axis=0)
        for each in (a, b, a - b)
    )
    return bool(apart[mine < others].sum() > apart[mine >= others].sum())
