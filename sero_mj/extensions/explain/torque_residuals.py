"""`TorqueResiduals`: the parts of a robot's torques not explained by its motion, on both sides.

The torque sensor of a joint is between its motor and its links, so with link inertia M, motor
inertia B (reflected to the joint) and friction tau_f of motor and gear there are two equations:

    link side:   measured = M(q) ddq + C(q, dq) dq + g(q) + what the model does not know
    motor side:  commanded - measured = B ddtheta + tau_f + what the drive does not do

The residuals of both are linear in possible faults: payload, offset and gain of a sensor, friction,
gain of a drive. All signals pass the same low-pass filter (a Gaussian, without time shift) and are
decimated accordingly: the estimates of a regression stay the same, and the noise of differentiated
angles is removed.

With joint torque control (see `TorqueLoop`) the commanded torque is not that of the motor: then B
is the apparent motor inertia, friction is compensated, and an error of the torque sensor affects
the link side only.

Source: Gautier, Dynamic identification of robots with power model, ICRA 1997 (filtering of torques
and regressors alike); Khalil and Dombre, Modeling, Identification and Control of Robots, 2002,
chapter 12; rigid bodies' torques as linear functions of their ten parameters: Atkeson, An,
Hollerbach, Estimation of inertial parameters of manipulator loads and links, IJRR 5(3), 1986.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array, Bools
from ...robots.assemble.friction_torques import SLOW
from ...robots.assemble.robot_dynamics import GRAVITY, robot_dynamics
from ...robots.declared.robot import SerialRobot
from ...simulate.control.robot_model import RobotModel
from ...simulate.runs.run_log import RunLog, compared_signal
from ...study.align import Pair, at_times

WINDOW = 0.016  # s, standard deviation of the low-pass filter: 10 Hz
_SUPPORT = 4.0  # of these, half width of the filter kernel
_ROW_SPACING = 2.0  # of these, between kept rows
MOST_ROWS = 600  # kept
_MAX_READ = 120_000  # rows of a run; of longer ones every second, third, ... is used
_MIN_ROWS = 12  # kept
_TURNING = 0.999  # mean of the sign of the velocity, below which it reverses
_SATURATED = 0.95  # of a torque limit, above which a drive may be saturated
_NOISE_CORRELATION = -0.35  # correlation of second differences, below which they are noise
_STOP = 0.005  # of a joint's range, within which it is at an end stop
_MIN_SCALE = 1e-3  # Nm or N, of joints without limit and torque
_DIFFERENCE_STEP = 1e-4  # s, step of the numerical derivative of the Jacobian
# Of second differences of angles: their size where an angle jumps, by that of most rows; which rows
# these are; and what is left of one after the next.
_JUMP, _MOST, _RETURNS = 20.0, 0.99, 0.2
_ANGLE_STEP = 1e-4  # rad or m, likewise of torques by angles

# s, tried delays of sensors and drives; effects are interpolated in between.
DELAYS = 0.002 * np.arange(1, 51)
PARAMETERS = ("mass", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


@dataclass(frozen=True, eq=False)
class Torques:
    """Low-pass filtered torques of the joints, (K, n), Nm or N.

    Attributes:
        model: torques at the links according to the model.
        rates: rates of the measured or commanded torque, whichever changes faster, Nm/s.
        requested: torques requested by joint torque control, within the limits of the drives,
            without friction compensation.
        delivered: torques of the drives, from measured torque and the motion of the motors.
        late_model: change of the model's torques by each of `DELAYS`, (D, K, n).
        late_commanded: change of the commanded torques by each of `DELAYS`, (D, K, n).
        payload: torques by mass, first moments and inertia (about the flange, in its axes) of a
            body that is fixed to the flange, (K, n, 10): `PARAMETERS`, SI units.
    """

    measured: Array
    commanded: Array
    model: Array
    rates: Array
    requested: Array
    delivered: Array
    late_model: Array
    late_commanded: Array
    payload: Array


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The low-pass filtered motion of the joints, (K, n), rad or m.

    Attributes:
        velocities: velocities of the joints.
        signs: signs of the velocities, between -1 and 1 where joints reverse.
        accelerations: accelerations of the motors.
        slow: whether joints hardly move.
        links: angles, velocities and accelerations of the links, (3, K, n).
    """

    velocities: Array
    signs: Array
    accelerations: Array
    slow: Bools
    links: Array


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of the measured torques, and intervals without any change.

    Attributes:
        roughness: standard deviation of equivalent white noise in windows, (W, n), Nm.
        times: begin of these windows, (W,), s.
        held: begin (s), end (s) and value of the longest interval with constant measured torque
            of each joint.
    """

    roughness: Array
    times: Array
    held: tuple[tuple[float, float, float], ...]

    def later(self, offset: float) -> SensorNoise:
        """Returns the same, `offset` s later."""
        held = tuple((begin + offset, end + offset, value) for begin, end, value in self.held)
        return SensorNoise(self.roughness, self.times + offset, held)


@dataclass(frozen=True, eq=False)
class TorqueResiduals:
    """Residuals of a robot's torques, and their possible components; NaN where unknown.

    Attributes:
        times: (K,), s, equidistant.
        link: measured minus the model's torques at the links, (K, n), Nm or N; NaN at joints that
            are coupled, of whose torques each may be a share.
        motor: commanded minus measured torque, minus motor inertia and declared friction torques,
            (K, n); also NaN where the joint is slow or reverses.
        lag: commanded minus measured torque, uncorrected, (K, n).
        width: standard deviation of the low-pass filter, s.
        scale: (n,), torque limits, or the largest torque without a limit.
        coulomb: (n,), declared friction, Nm.
        torque_control: whether joint torque control is on.
        no_model: reason why `link` is unknown, such as undeclared masses; empty if it is known.
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
    scale: Array
    coulomb: Array
    torque_control: bool
    no_model: str

    @property
    def has_model(self) -> bool:
        """Whether `link` is valid."""
        return not self.no_model

    @cached_property
    def by_angle(self) -> Array:
        """Change of the model's torque at one joint by the angle of another, (K, n, n).

        In Nm and N by rad and m: what an encoder's offset makes the model err by.
        """
        return _torques_by_angle(self.robot, *self.motion.links)

    @property
    def step(self) -> float:
        """Between two rows, s."""
        return float(self.times[1] - self.times[0])


def torque_residuals(
    log: RunLog,
    name: str,
    *,
    torque_control: bool | None = None,
    times: Array | None = None,
    most_rows: int = MOST_ROWS,
    window: float = WINDOW,
) -> TorqueResiduals:
    """Computes the parts of a robot's torques not explained by its motion.

    Args:
        log: a run.
        name: of the robot in it.
        torque_control: whether joint torque control was on; detected from the smaller residuals
            when None.
        times: (K,), s, of the residuals, on the clock of the run; its own when None.
        most_rows: maximum number kept; longer runs are sampled more coarsely.
        window: standard deviation of the low-pass filter, s.

    Raises:
        UsageError: there is no such robot, or too little or no measured torque.
    """
    robot = _checked(log, name)
    rows, step = _even(log, name)
    # Torques of a row act in the step that leads to it: the state is that of the previous row.
    q, v = rows["q"][1:-1], np.diff(rows["q"], axis=0)[:-1] / step
    a = np.diff(rows["q"], n=2, axis=0) / step**2
    a[_jumps(a)] = np.nan
    at, measured, commanded = rows["t"][2:, 0], rows["measured"][2:], rows["commanded"][2:]
    low_pass = _LowPass(at, step, times, most_rows, window)
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
    model = _link_torques(robot, q, v, a)
    dynamics = robot_dynamics(robot)
    smooth = low_pass(v + a * step)
    speed = np.abs(smooth)
    sign = np.sign(low_pass.fully(v + a * step))
    sign[np.abs(low_pass.fully(v)) < SLOW] = 0.0
    signs = low_pass(sign)
    with np.errstate(invalid="ignore"):
        slow = ~(speed > SLOW)
        turns = slow | ~(np.abs(signs) > _TURNING)
    acceleration = low_pass(a)
    if robot.elastic_joints:  # the motor's, ahead of the link's by the spring's deflection
        acceleration = acceleration + low_pass.second(measured) / dynamics.joint_stiffness
    free = np.where(_at_stops(robot, q), np.nan, measured)
    coupled = {*robot.couplings, *(each.to for each in robot.couplings.values())}
    free[:, [name in coupled for name in robot.names]] = np.nan
    felt = robot.torque_control.motor_inertias
    if felt is None:
        felt = robot.torque_control.inertia_ratio * dynamics.motor_inertias
    lag = commanded - measured
    friction = dynamics.viscous_friction * smooth + dynamics.coulomb_friction * signs
    inertial = dynamics.motor_inertias * acceleration + friction
    plain = low_pass(lag) - inertial
    felt = np.broadcast_to(felt, robot.n)
    # A motor without inertia is given what is commanded.
    ratio = np.divide(dynamics.motor_inertias, felt, out=np.ones(robot.n), where=felt > 0.0)
    # The loop's request to the drive, which saturates.
    asked, most = measured + ratio * lag, _scale(robot, np.full_like(measured, np.inf))
    saturated = np.abs(asked) > _SATURATED * most
    looped = low_pass(np.where(saturated, np.nan, lag)) - felt * acceleration
    for each in (plain, looped):
        each[turns] = np.nan
    scale = _scale(robot, measured)
    if torque_control is None:
        torque_control = _is_smaller(looped / scale, plain / scale)
    rough, windows = _roughness(measured, commanded, step)
    torques = Torques(
        measured=low_pass(measured),
        commanded=low_pass(commanded),
        model=low_pass(model),
        rates=np.fmax(*(np.abs(low_pass.first(each)) for each in (measured, commanded))),
        requested=low_pass(np.clip(asked, -most, most)),
        delivered=low_pass(measured) + inertial,
        late_model=np.stack([low_pass(_later(model, step, each)) for each in DELAYS]),
        late_commanded=np.stack([low_pass(_later(commanded, step, each)) for each in DELAYS]),
        payload=low_pass(_payload_torques(robot, q, v, a)),
    )
    links = np.stack([low_pass(each) for each in (q, v, a)])
    held = tuple(_held(at, each) for each in measured.T)
    return TorqueResiduals(
        robot=robot,
        times=low_pass.times,
        link=low_pass(free) - torques.model,
        motor=looped if torque_control else plain,
        lag=low_pass(lag),
        torques=torques,
        motion=JointMotion(smooth, signs, acceleration, slow, links),
        noise=SensorNoise(rough, at[1] + windows, held),
        width=low_pass.width,
        scale=scale,
        coulomb=dynamics.coulomb_friction,
        torque_control=torque_control,
        no_model=_why_no_model(robot, log, dynamics.estimated),
    )


def pair_with_model(log: RunLog, found: TorqueResiduals) -> Pair:
    """A robot's run, paired with the torques of its model in the same motion.

    The model follows the robot's motion, and its torques result from inverse dynamics: driven by
    the commanded torques it would diverge within a second in any case. Both are low-pass filtered.
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
    """Signals at even times, (T, n) each; NaN where there are gaps."""
    times = log.times
    if len(times) < 4 or log.timestep <= 0.0:
        raise UsageError(f"{log.name} has {len(times)} rows of '{name}'; expected a run")
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
    sampled = {key: at_times(times, values, even) for key, values in signals.items()}
    return {**sampled, "t": even[:, None]}, step


class _LowPass:
    """A Gaussian low-pass filter with its derivatives, evaluated at few times only.

    Args:
        at: (T,), s, times of the rows, `step` apart.
        wanted: (K,), s, evaluation times; at most `most` equidistant ones when None.
        window: its standard deviation, s, one row at least.
    """

    def __init__(
        self, at: Array, step: float, wanted: Array | None, most: int, window: float
    ) -> None:
        self.width = max(window, step)
        reach = int(np.ceil(_SUPPORT * self.width / step))
        every = max(int(_ROW_SPACING * self.width / step), -(-len(at) // most), 1)
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
        # Second derivative: 0 for a constant, 2 for the square of the time.
        second = (z**2 - 1.0) * kernel
        second -= kernel * (second.sum() / kernel.sum())
        self._second = second * 2.0 / (second @ (z * self.width) ** 2)

    def __call__(self, values: Array) -> Array:
        """(T, ...) to (K, ...)."""
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
        """The same at every row, (T, n); the nearest value at both ends."""
        padded = np.pad(values, ((self._reach, self._reach), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(self._kernel), axis=0)
        return np.asarray(windows @ self._kernel)


def _link_torques(robot: SerialRobot, q: Array, v: Array, a: Array) -> Array:
    """M(q) a + C(q, v) v + g(q) of the links alone, (T, n), Nm or N."""
    model = RobotModel.of(robot.model_copy(update={"mount": None, "free_base": False}))
    torques, less = np.zeros((len(q), robot.n)), np.zeros(robot.n)
    for k in np.flatnonzero(np.isfinite(q + v + a).all(axis=1)):
        model.update(q[k], v[k])
        model.write_inverse_dynamics(v[k], a[k], torques[k], less)
        torques[k] -= less
    torques[~np.isfinite(q + v + a).all(axis=1)] = np.nan
    return torques


def _jumps(a: Array) -> Bools:
    """Rows in which an angle jumps and keeps its velocity, as no robot moves, (T, n).

    An encoder slips, or is set anew. The second difference is large there, twice, and the other way
    round: `_JUMP` times that of most rows in which it is not 0, as resolution and noise make it.

    Args:
        a: second differences of the angles, (T, n).
    """
    moving = np.where(a == 0.0, np.nan, np.abs(a))
    usual = [
        np.nanquantile(each, _MOST) if np.isfinite(each).any() else np.inf for each in moving.T
    ]
    large = np.abs(a[:-1]) > _JUMP * np.array(usual)
    back = np.abs(a[:-1] + a[1:]) < _RETURNS * np.abs(a[:-1])
    found = np.zeros(a.shape, bool)
    found[:-1] |= large & back
    found[1:] |= large & back
    return found


def _torques_by_angle(robot: SerialRobot, q: Array, v: Array, a: Array) -> Array:
    """The change of `_link_torques` by each angle, by central differences, (K, n, n)."""
    found = np.empty((len(q), robot.n, robot.n))
    for j, shift in enumerate(_ANGLE_STEP * np.eye(robot.n)):
        more, less = (_link_torques(robot, q + side * shift, v, a) for side in (1.0, -1.0))
        found[:, :, j] = (more - less) / (2.0 * _ANGLE_STEP)
    return found


def _payload_torques(robot: SerialRobot, q: Array, v: Array, a: Array) -> Array:
    """Torques at the links by the ten parameters of a body at the flange, (T, n, 10).

    Of a body with mass m, first moment h = m c and inertia I about the flange's origin, that moves
    with angular velocity w and acceleration u, the origin with acceleration s (gravity included),
    all in the flange's axes: force m s + u x h + w x (w x h), moment h x s + I u + w x (I w).
    """
    table, base, flange = robot.kinematics, robot.base_frame, robot.T_n_flange

    def jacobian(angles: Array) -> Array:
        return table.jacobian(angles, base, flange, robot.flange_link)

    J = jacobian(q)
    change = (jacobian(q + _DIFFERENCE_STEP * v) - jacobian(q - _DIFFERENCE_STEP * v)) / (
        2.0 * _DIFFERENCE_STEP
    )
    velocity = np.einsum("tij,tj->ti", J, v)
    acceleration = np.einsum("tij,tj->ti", J, a) + np.einsum("tij,tj->ti", change, v)
    acceleration[:, 2] += GRAVITY
    R = (table.frames(q, base)[..., robot.flange_link, :, :] @ flange)[:, :3, :3]

    def in_flange(vectors: Array) -> Array:
        return np.asarray(np.einsum("tji,tj->ti", R, vectors))

    moving = acceleration[:, :3], acceleration[:, 3:], velocity[:, 3:]
    s, u, w = (in_flange(each) for each in moving)
    wrench = np.zeros((len(q), 6, 10))
    wrench[:, :3, 0] = s
    wrench[:, :3, 1:4] = _cross(u) + _cross(w) @ _cross(w)
    wrench[:, 3:, 1:4] = -_cross(s)
    wrench[:, 3:, 4:] = _tensor_times(u) + _cross(w) @ _tensor_times(w)
    turned = np.concatenate([np.swapaxes(R, 1, 2) @ J[:, :3], np.swapaxes(R, 1, 2) @ J[:, 3:]], 1)
    return np.asarray(np.swapaxes(turned, 1, 2) @ wrench)


def _cross(x: Array) -> Array:
    """The matrices of x cross, (T, 3, 3)."""
    result = np.zeros((len(x), 3, 3))
    result[:, 0, 1], result[:, 0, 2] = -x[:, 2], x[:, 1]
    result[:, 1, 0], result[:, 1, 2] = x[:, 2], -x[:, 0]
    result[:, 2, 0], result[:, 2, 1] = -x[:, 1], x[:, 0]
    return result


def _tensor_times(x: Array) -> Array:
    """I x as a matrix times (Ixx, Iyy, Izz, Ixy, Ixz, Iyz), (T, 3, 6)."""
    result = np.zeros((len(x), 3, 6))
    for row, columns in enumerate(((0, 3, 4), (3, 1, 5), (4, 5, 2))):
        for axis, column in enumerate(columns):
            result[:, row, column] = x[:, axis]
    return result


def _roughness(measured: Array, commanded: Array, step: float) -> tuple[Array, Array]:
    """Roughness of measured torques not caused by commands; windows of about 0.1 s.

    White noise of standard deviation s has second differences of sqrt(6) s; the median of
    magnitudes is 0.6745 of it, robust to single steps. Neighbours have a correlation of -2/3; far
    from that, it is an oscillation, not noise.
    """
    bends = np.diff(measured, n=2, axis=0)
    asked = np.diff(commanded, n=2, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nansum(bends * asked, axis=0) / np.nansum(asked * asked, axis=0)
    bends = bends - np.nan_to_num(np.where(np.isfinite(share), share, 0.0) * asked)
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
    """The change of values (T, n) by a delay, s."""
    rows = delay / step
    whole = int(rows)
    padded = np.concatenate([np.repeat(values[:1], whole + 1, axis=0), values])
    before, at = padded[: len(values)], padded[1 : len(values) + 1]
    return np.asarray(at + (rows - whole) * (before - at) - values)


def _held(at: Array, measured: Array) -> tuple[float, float, float]:
    """Begin, end and value of the longest interval with constant torque (T,)."""
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
        return f"the masses of {robot.name} are not declared, but estimated"
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
