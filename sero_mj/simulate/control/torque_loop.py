"""`TorqueLoop`: the joint torque control between a controller and its motors.

A motor with inertia B (as seen at the joint), friction tau_f of motor and gear, and joint torque
tau, measured between motor and link, moves as

    B ddtheta + tau = tau_m - tau_f.

The loop converts the commanded torque u of the controller into the motor torque

    tau_m = (B / Bt) (u - T dtau/dt) + (1 - B / Bt) tau + tau_f^.

The motor then moves as if its inertia were Bt < B. T damps the spring of an elastic joint, and
tau_f^, the friction estimated by an observer, compensates friction:

    Bt ddtheta + tau + T dtau/dt = u - (Bt / B) (tau_f - tau_f^)
    d tau_f^ / dt = L (tau_f - tau_f^)

The observer is B ddtheta^ + tau = tau_m - tau_f^ with tau_f^ = -L B (dtheta - dtheta^). It needs no
accelerations: tau_f^ is tau_f after a first-order low pass of bandwidth L. The measured torque also
passes a low pass, and T compensates its lag. For rigid joints T = 0, and the low pass filters the
error tau - u. The torque limits of the drives apply last. The observer uses the limited torques.

For the controller, the robot has the inertia M + diag(Bt) with link inertia M, and gains are
designed for it. A stiff joint impedance (`JointPosition`) behind the loop is position control with
full state feedback: motor position, torque, and their derivatives.

Source: Albu-Schäffer, Ott, Hirzinger, A Unified Passivity-based Control Framework for Position,
Torque and Impedance Control of Flexible Joint Robots, IJRR 26(1), 2007; Le Tien, Albu-Schäffer,
De Luca, Hirzinger, Friction observer and compensation for control of robots with joint torque
measurement, IROS 2008.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import DeclarationError, Problem
from ...base.frames import Array, Bools
from ...robots.assemble.robot_dynamics import RobotDynamics
from ...robots.declared.dynamics import TorqueControl
from ...robots.declared.robot import SerialRobot
from .robot_model import RobotModel
from .robot_models import RobotModels

# Minimum growth rate of unstable modes, 1/s. Slower growth is not caused by the time step, but by
# rounding, which splits the double eigenvalue of joints without stiffness.
_SLOW = 0.5
_MAX_DENSE = 16  # maximum number of joints for which one dense product is faster than one per joint


@dataclass(frozen=True, eq=False)
class LoopGains:
    """Parameters of a torque loop, shape (n,) each. The module docstring defines the symbols.

    Attributes:
        motor_inertias: motor inertias B at the joints, kg m2 (kg).
        shaped_inertias: apparent motor inertias Bt, which the controller assumes, kg m2 (kg).
        bandwidth: bandwidth of the low-pass filter of the torque, 1/s.
        damping_time: gain T of the torque's derivative, s; 0 for rigid joints.
        friction_bandwidth: bandwidth L of the friction observer, 1/s; 0 for no compensation.
        stiffness: stiffness of elastic joints, Nm/rad (N/m); infinite for rigid joints.
        damping: damping in parallel with the stiffness, Nm s/rad (N s/m).
    """

    motor_inertias: Array
    shaped_inertias: Array
    bandwidth: Array
    damping_time: Array
    friction_bandwidth: Array
    stiffness: Array
    damping: Array

    @classmethod
    def of(cls, control: TorqueControl, dynamics: RobotDynamics, elastic: bool) -> LoopGains:
        """Returns the declared gains, with defaults for those that are not declared.

        Raises DeclarationError if a motor has no inertia, or if a shaped inertia exceeds its own.
        """
        motors, shaped = dynamics.motor_inertias, control.motor_inertias
        problems = [
            Problem(
                "dynamics.motor_inertias",
                f"joint {i + 1}: found 0; expected more than 0, because run.torque_control is true",
            )
            for i in np.flatnonzero(motors <= 0).tolist()
        ]
        if shaped is None:
            shaped = motors * control.inertia_ratio
        problems += [
            Problem(
                "torque_control.motor_inertias",
                f"joint {i + 1}: found",
                found=shaped[i],
                expected=f"at most {motors[i]:g}, the inertia of the motor",
            )
            for i in np.flatnonzero(shaped > motors * (1 + 1e-9)).tolist()
        ]
        if problems:
            raise DeclarationError(problems)
        one = np.ones(len(motors))
        stiffness = dynamics.joint_stiffness if elastic else np.inf * one
        return cls(
            motors,
            shaped,
            control.bandwidth * one,
            2.0 * control.damping * np.sqrt(shaped / stiffness),
            control.friction_bandwidth * one,
            stiffness,
            dynamics.joint_damping if elastic else 0.0 * one,
        )

    @classmethod
    def joined(cls, robots: list[LoopGains]) -> LoopGains:
        """Returns the gains of several robots in one object, joint after joint."""
        keys = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(each, key) for each in robots]) for key in keys))

    def shaped(self, robot: SerialRobot) -> SerialRobot:
        """Returns the robot with the shaped motor inertias, for its controller."""
        dynamics = robot.dynamics.model_copy(update={"motor_inertias": self.shaped_inertias})
        return robot.model_copy(update={"dynamics": dynamics})

    def lighter(self, share: float) -> LoopGains:
        """Returns gains with inertia ratios (B / Bt)^share: 1 for share 0, current for share 1."""
        ratio = (self.motor_inertias / self.shaped_inertias) ** share
        shaped = self.motor_inertias / ratio
        time = self.damping_time * np.sqrt(shaped / self.shaped_inertias)
        return replace(self, shaped_inertias=shaped, damping_time=time)


class TorqueLoop:
    """Joint torque control of all joints in m rows of a plant, called in every step.

    Args:
        limits: torque limits of the drives, shape (n,), Nm or N; infinite for no limit.

    Attributes:
        friction: estimated friction of motors and gears, shape (m, n), Nm or N.
        motor_torques: motor torques of the last step, shape (m, n), Nm or N.
        sensed: input of `step`, shape (m, 2, n): motor velocities, rad/s or m/s, and the joint
            torques measured in the step that led to these velocities, Nm or N.
    """

    def __init__(self, gains: LoopGains, timestep: float, limits: Array, m: int = 1) -> None:
        n = len(gains.motor_inertias)
        self.gains, self.timestep = gains, timestep
        self._high, self._low = np.array(limits), -np.array(limits)
        # [motor torques, friction, friction and momentum, filtered torques; u; dtheta, tau]
        terms: Array = np.zeros((m, 7, n))
        coefficients = loop_coefficients(gains, timestep)
        self._own, self._next = terms[:, :4], np.zeros((m, 4, n))
        if n <= _MAX_DENSE:
            matrix = _dense(coefficients).T.copy()
            self._product = terms.reshape(m, -1), matrix, self._next.reshape(m, -1)
        else:
            inputs, outputs = (each.swapaxes(1, 2)[:, :, None] for each in (terms, self._next))
            self._product = inputs, coefficients.transpose(2, 1, 0).copy(), outputs
        self.sensed: Array = terms[:, 5:]
        self.motor_torques, self.friction, self._momentum, self._filtered, self._commanded = (
            terms[:, k] for k in range(5)
        )

    def reset(self, torques: Array, velocities: Array, which: Bools | slice = slice(None)) -> None:
        """Resets some rows as if their drives had been holding the robot at rest.

        Args:
            torques: measured joint torques, shape (k, n), Nm or N.
            velocities: velocities of the motors, shape (k, n), rad/s or m/s.
        """
        self.motor_torques[which] = torques
        self._filtered[which] = np.where(np.isfinite(self.gains.stiffness), torques, 0.0)
        self.friction[which] = 0.0
        self._momentum[which] = _momentum_per_velocity(self.gains, self.timestep) * velocities

    def command(self, torques: Array) -> None:
        """Sets the commanded torques u, shape (m, n), Nm or N, until the next call."""
        self._commanded[...] = torques

    def step(self, out: Array) -> None:
        """Writes the motor torques for `sensed` to `out`, shape (m, n), Nm or N."""
        np.matmul(*self._product)
        self._own[...] = self._next
        motors = self.motor_torques
        np.minimum(np.maximum(motors, self._low, out=motors), self._high, out=motors)
        out[...] = motors


class StaticDeflection:
    """Computes the resting angles of the links of elastic joints, without external torques.

    These angles q^ satisfy K (theta - q^) = l(q^), where l are the torques that the controller
    commands at rest (gravity and springs). A controller that uses q^ as joint angles compensates
    gravity exactly at rest, and its stiffness acts at the links instead of in series with the
    joints. q^ depends on motor angles only, so a passive controller remains passive
    (Albu-Schäffer, Ott, Hirzinger 2007). Each step makes one fixed-point iteration, which is a
    contraction if the joints are stiffer than springs and gravity.

    Args:
        stiffness: joint stiffness K, shape (n,), Nm/rad (N/m).
        at_rest: array of the torques l, shape (n,), Nm or N, which is read in every step (default:
            gravity torques).
        angles: initial angles of the links, shape (n,) or (m, n), rad or m.
    """

    def __init__(
        self,
        stiffness: Array,
        at_rest: Array | None,
        model: RobotModel | RobotModels,
        angles: Array,
    ) -> None:
        self._compliance = 1.0 / stiffness
        self._angles: Array = np.array(angles, float)
        self._model, self._at_rest = model, at_rest
        self._still: Array = np.zeros_like(self._angles)
        if at_rest is not None:
            at_rest[...] = self._gravity()

    def begin(self, which: Bools, angles: Array, motor_angles: Array) -> None:
        """Resets the rows in a mask to link angles, (n,), for motor angles of all rows, (m, n)."""
        others = self._angles[~which].copy()
        self._angles[which] = angles
        self.link_angles(motor_angles)
        self._angles[~which] = others

    def _gravity(self) -> Array:
        self._model.update(self._angles, self._still)
        return self._model.gravity()

    def link_angles(self, motor_angles: Array) -> Array:
        """Returns the resting link angles q^ for motor angles theta, always in the same array."""
        torques = self._gravity() if self._at_rest is None else self._at_rest
        np.multiply(torques, self._compliance, out=self._angles)
        return np.subtract(motor_angles, self._angles, out=self._angles)


def _momentum_per_velocity(gains: LoopGains, timestep: float) -> Array:
    share = -np.expm1(-gains.friction_bandwidth * timestep)
    return np.asarray(share * gains.motor_inertias / timestep)


def loop_coefficients(gains: LoopGains, timestep: float) -> Array:
    """Returns the coefficients of a loop's linear step without torque limits, shape (4, 7, n).

    For each joint they map [motor torques, friction, friction + its momentum term, filtered
    torques] of the last step and [commanded torques, motor velocities, measured torques] to the
    first four of this step. With the momentum term, b dtheta with b = (1 - exp(-L t)) B / t, the
    observer does not need the velocities of the last step. Exponentials make both low passes exact
    for inputs that are constant during a step.
    """
    n = len(gains.motor_inertias)
    find = -np.expm1(-gains.friction_bandwidth * timestep)
    read = -np.expm1(-gains.bandwidth * timestep)
    momentum = _momentum_per_velocity(gains, timestep)
    ratio = gains.motor_inertias / gains.shaped_inertias
    # The torque that is fed back lags by the filter and by one step.
    delay = np.where(np.isfinite(gains.stiffness), 1.0 / gains.bandwidth + timestep, 0.0)
    lead = (ratio * gains.damping_time + (ratio - 1.0) * delay) / timestep
    one, none = np.ones(n), np.zeros(n)
    observed = [find, -find, one, none, none, none, -find]
    friction = [find, -find, one, none, none, -momentum, -find]
    # With rigid joints a step of the command would jump by the ratio of the inertias until the
    # torque is fed back. Therefore the error is filtered there, instead of the torque.
    rigid = np.where(np.isfinite(gains.stiffness), 0.0, 1.0)
    filtered = [none, none, none, 1.0 - read, -read * rigid, none, read]
    # (1 - ratio) f+ - lead (f+ - f), where f+ is the filtered torque after this step
    before = (1.0 - ratio) * (1.0 - read) + lead * read
    now = (1.0 - ratio) * read - lead * read
    command = np.where(rigid, 1.0 - now, ratio)
    motors = [*friction[:3], before, command, friction[5], friction[6] + now]
    return np.array([motors, friction, observed, filtered])


def _dense(coefficients: Array) -> Array:
    """Returns the coefficients (4, 7, n) of all joints as one matrix (4 n, 7 n)."""
    n = coefficients.shape[2]
    dense: Array = np.zeros((4, n, 7, n))
    joints = np.arange(n)
    dense[:, joints, :, joints] = coefficients.transpose(2, 0, 1)
    return dense.reshape(4 * n, 7 * n)


def unstable_loop(
    gains: LoopGains,
    mass: Array,
    timestep: float,
    stiffness: Array | None = None,
    damping: Array | None = None,
    steps: int = 1,
) -> int | None:
    """Returns the joint that moves most in an unstable mode of the closed loop, or None.

    The robot is linearized about a pose and steps as with MuJoCo's semi-implicit Euler integrator:
    springs are evaluated at the start of a step, their damping at its end. The torques of the
    controller are held for `steps` steps.

    Args:
        mass: mass matrix of the links without the motors, shape (n, n).
        timestep: time step of the loop and of the physics, s.
        stiffness: stiffness of the controller with respect to the motor angles, shape (n, n).
        damping: damping of the controller with respect to the motor velocities, shape (n, n).
    """
    n = len(mass)
    loop = _dense(loop_coefficients(gains, timestep))
    elastic = bool(np.isfinite(gains.stiffness).all())
    motors = np.diag(gains.motor_inertias)
    # State: [m, r, w, f; u; dtheta, tau; theta; deflection, its velocity]
    size = 10 * n
    at = [slice(k * n, (k + 1) * n) for k in range(10)]
    m, u, velocity, torque, angle, bend, bending = at[0], *at[4:]
    act = np.eye(size)
    act[: 4 * n, : 7 * n], act[: 4 * n, 7 * n :] = loop, 0.0
    move = np.eye(size)
    if elastic:
        both = np.block([[mass + motors, mass], [mass, mass]])
        soft = both + timestep * np.kron(np.diag([0.0, 1.0]), np.diag(gains.damping))
        after: Array = np.zeros((2 * n, size))
        after[:, velocity], after[:, bending] = both[:, :n], both[:, n:]
        after[:n, m] += timestep * np.eye(n)
        after[n:, bend] -= timestep * np.diag(gains.stiffness)
        after = np.linalg.solve(soft, after)
        move[velocity], move[bending] = after[:n], after[n:]
        move[torque] = -gains.damping[:, None] * after[n:]
        move[torque, bend] -= np.diag(gains.stiffness)
        move[bend] += timestep * after[n:]
        move[angle] += timestep * after[:n]
    else:
        acceleration = np.linalg.inv(mass + motors)
        move[velocity, m] = timestep * acceleration
        move[torque, torque] = 0.0
        move[torque, m] = np.eye(n) - motors @ acceleration
        move[angle] += timestep * move[velocity]
        move[bend], move[bending] = 0.0, 0.0
    whole = np.linalg.matrix_power(move @ act, steps)
    control = np.eye(size)
    control[u, u] = 0.0
    if stiffness is not None and damping is not None:
        control[u, angle], control[u, velocity] = -stiffness, -damping
    else:  # nothing depends on the angles, which would add a double eigenvalue of one
        rest = np.delete(np.arange(size), angle)
        whole, control = whole[np.ix_(rest, rest)], control[np.ix_(rest, rest)]
    values, vectors = np.linalg.eig(whole @ control)  # indices of `velocity` are the same
    worst = int(np.argmax(np.abs(values)))
    if np.abs(values[worst]) <= 1.0 + _SLOW * timestep * steps:
        return None
    return int(np.argmax(np.abs(vectors[velocity, worst])))
