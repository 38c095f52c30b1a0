"""`TorqueLoop`: the joint torque control between a controller and its motors.

With link inertia M, motor inertia B (as seen at the joint), friction tau_f of motor and gear, and
the torque tau that the sensor between motor and link reads,

    B ddtheta + tau = tau_m - tau_f,

the loop turns what the controller commands, u, into motor torques

    tau_m = (B / Bt) (u - T dtau/dt) + (1 - B / Bt) tau + tau_f^

so that the motor feels as if its inertia were Bt < B, the spring of an elastic joint is damped by
T, and friction is made up for by what an observer finds of it:

    Bt ddtheta + tau + T dtau/dt = u - (Bt / B) (tau_f - tau_f^)
    d tau_f^ / dt = L (tau_f - tau_f^)

The observer is B ddtheta^ + tau = tau_m - tau_f^ with tau_f^ = -L B (dtheta - dtheta^): it takes
no accelerations, and tau_f^ is tau_f through a first-order low pass of bandwidth L. The torque is
read through one as well, whose lag is allowed for in T; where joints are rigid, T = 0, and the
error tau - u goes through it. Drives saturate last, and the observer knows what they gave.

To the controller the robot has the inertia M + diag(Bt), so its gains are designed with that; with
it, a stiff joint impedance (`JointPosition`) is position control with full state feedback: of motor
position, torque, and their derivatives.

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

# 1/s; what grows more slowly is no matter of the time step. Rounding splits the double eigenvalue
# of what nothing holds.
_SLOW = 0.5


@dataclass(frozen=True, eq=False)
class LoopGains:
    """What a torque loop does to every joint, (n,) each.

    Attributes:
        motor_inertias: B, kg m2 (kg).
        shaped_inertias: Bt, likewise; what its controller takes for the motors'.
        bandwidth: of the torque's low pass, 1/s.
        damping_time: T, s; 0 for rigid joints.
        friction_bandwidth: L, 1/s; 0 for no compensation.
        stiffness: of the elastic joints, Nm/rad (N/m); infinite for rigid ones.
        damping: in parallel with it, Nm s/rad (N s/m).
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
        """The gains that are declared, with defaults for those that are not.

        Args:
            control: the robot's `[torque_control]`.
            elastic: whether its joints are.

        Raises:
            DeclarationError: a motor is to feel heavier than it is, or has no inertia.
        """
        motors, shaped = dynamics.motor_inertias, control.motor_inertias
        problems = [
            Problem(
                "dynamics.motor_inertias",
                f"joint {i + 1}: found 0; expected more than 0 where run.torque_control is true",
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
                expected=f"at most {motors[i]:g}, the motor's",
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
        """Those of several robots, joint after joint."""
        keys = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(each, key) for each in robots]) for key in keys))

    def felt(self, robot: SerialRobot) -> SerialRobot:
        """The robot as its controller knows it: with the motors that the loop lets it feel."""
        dynamics = robot.dynamics.model_copy(update={"motor_inertias": self.shaped_inertias})
        return robot.model_copy(update={"dynamics": dynamics})

    def lighter(self, share: float) -> LoopGains:
        """Those that shape the motors' inertia by a share of what these do, from 0 (not at all)."""
        ratio = (self.motor_inertias / self.shaped_inertias) ** share
        shaped = self.motor_inertias / ratio
        time = self.damping_time * np.sqrt(shaped / self.shaped_inertias)
        return replace(self, shaped_inertias=shaped, damping_time=time)


class TorqueLoop:
    """Joint torque control of all joints of m rows of a plant, at the rate of its steps.

    Args:
        timestep: s between two steps.
        limits: (n,), torques that the drives can give, Nm or N; infinite where there is no limit.

    Attributes:
        friction: (m, n), Nm or N, what the observer finds of motors' and gears' friction.
        motor_torques: (m, n), Nm or N, what the drives gave last.
        sensed: (m, 2, n), velocities of the motors, rad/s or m/s, then what the torque sensors read
            of the step that led there, Nm or N; to be written before `step`.
    """

    def __init__(self, gains: LoopGains, timestep: float, limits: Array, m: int = 1) -> None:
        n = len(gains.motor_inertias)
        self.gains, self.timestep = gains, timestep
        self._high, self._low = np.array(limits), -np.array(limits)
        # By joint: a product of small matrices takes a third of `einsum`.
        self._coefficients = loop_coefficients(gains, timestep).transpose(2, 0, 1).copy()
        # [motor torques, friction, friction and momentum, filtered torques; u; dtheta, tau]
        terms: Array = np.zeros((m, n, 7))
        self._column, self._next = terms[..., None], np.zeros((m, n, 4, 1))
        self._own: Array = self._column[:, :, :4]
        self.sensed: Array = terms[..., 5:].swapaxes(1, 2)
        self.motor_torques, self.friction, self._momentum, self._filtered, self._commanded = (
            terms[..., k] for k in range(5)
        )

    def reset(self, torques: Array, velocities: Array, which: Bools | slice = slice(None)) -> None:
        """Begins anew, with drives that have held the robot until now.

        Args:
            torques: (k, n), that the sensors read, Nm or N.
            velocities: (k, n), of the motors, rad/s or m/s.
        """
        self.motor_torques[which] = torques
        self._filtered[which] = np.where(np.isfinite(self.gains.stiffness), torques, 0.0)
        self.friction[which] = 0.0
        self._momentum[which] = _momentum_per_velocity(self.gains, self.timestep) * velocities

    def command(self, torques: Array) -> None:
        """Takes what the controllers ask for until the next call, (m, n), Nm or N."""
        self._commanded[...] = torques

    def step(self, out: Array) -> None:
        """Takes one step from what is in `sensed`.

        Args:
            out: (m, n), to be written: torques of the motors in the next step, Nm or N.
        """
        np.matmul(self._coefficients, self._column, self._next)
        self._own[...] = self._next
        motors = self.motor_torques
        np.minimum(np.maximum(motors, self._low, out=motors), self._high, out=motors)
        out[...] = motors


class StaticDeflection:
    """Where the links of elastic joints come to rest, with nothing from outside but what holds.

    With q^ such that K (theta - q^) = l(q^), where l are the torques that the controller commands
    at rest (gravity and springs), a controller that takes q^ for its angles compensates gravity
    exactly at rest, and its springs are felt at the links, not in series with the joints. q^ is a
    function of the motors' angles alone, so it leaves a passive controller passive
    (Albu-Schäffer, Ott, Hirzinger 2007). The fixed point is a contraction where joints are stiffer
    than springs and gravity, and goes on from the last step's.

    Args:
        stiffness: K, (n,), Nm/rad (N/m).
        at_rest: l, (n,), Nm or N, to be read at every step; None for gravity.
        angles: (n,), rad or m, of the links at first; (m, n) of as many rows as the model has.
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
        """Begins anew with some of many rows, (m,).

        Args:
            angles: (n,), rad or m, of their links at first.
            motor_angles: (m, n), of all rows.
        """
        others = self._angles[~which].copy()
        self._angles[which] = angles
        self.link_angles(motor_angles)
        self._angles[~which] = others

    def _gravity(self) -> Array:
        self._model.update(self._angles, self._still)
        return self._model.gravity()

    def link_angles(self, motor_angles: Array) -> Array:
        """q^, (n,), rad or m; the same array every time.

        Args:
            motor_angles: theta, (n,), rad or m.
        """
        torques = self._gravity() if self._at_rest is None else self._at_rest
        np.multiply(torques, self._compliance, out=self._angles)
        return np.subtract(motor_angles, self._angles, out=self._angles)


def _momentum_per_velocity(gains: LoopGains, timestep: float) -> Array:
    share = -np.expm1(-gains.friction_bandwidth * timestep)
    return np.asarray(share * gains.motor_inertias / timestep)


def loop_coefficients(gains: LoopGains, timestep: float) -> Array:
    """The linear step of a loop, before drives saturate.

    Args:
        timestep: s.

    Returns:
        (4, 7, n), coefficients per joint: to [motor torques, friction, friction + its momentum
        term, filtered torques] from the same a step before and [commanded torques, motor
        velocities, measured torques]. The momentum term, b dtheta with
        b = (1 - exp(-L t)) B / t, lets the observer do without the
        velocities of the step before; exponentials make both low passes exact for what is constant
        during a step.
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
    kept = [find, -find, one, none, none, none, -find]  # find * tau_m - ... of what is remembered
    friction = [find, -find, one, none, none, -momentum, -find]
    # Through rigid joints a step of the command would jump by the ratio of the inertias until the
    # torque is fed back: there the error is filtered, not the torque.
    rigid = np.where(np.isfinite(gains.stiffness), 0.0, 1.0)
    filtered = [none, none, none, 1.0 - read, -read * rigid, none, read]
    # (1 - ratio) f+ - lead (f+ - f), where f+ is what is filtered after this step
    before = (1.0 - ratio) * (1.0 - read) + lead * read
    now = (1.0 - ratio) * read - lead * read
    ahead = np.where(rigid, 1.0 - now, ratio)
    motors = [friction[0], friction[1], friction[2], before, ahead, friction[5], friction[6] + now]
    return np.array([motors, friction, kept, filtered])


def unstable_loop(
    gains: LoopGains,
    mass: Array,
    timestep: float,
    stiffness: Array | None = None,
    damping: Array | None = None,
    steps: int = 1,
) -> int | None:
    """The joint that moves most in an unstable mode of robot, torque loop and controller, or None.

    The robot is linear about a pose and moves as MuJoCo's semi-implicit Euler moves it (springs
    taken at the start of a step, their damping at its end); the controller's torques are held.

    Args:
        mass: (n, n), of the links, without the motors.
        timestep: s of the loop and of the physics.
        stiffness: (n, n), of the controller: what its torques fall by with the motors' angles.
        damping: (n, n), likewise with their velocities.
    """
    n = len(mass)
    loop: Array = np.zeros((4, n, 7, n))
    joints = np.arange(n)
    loop[:, joints, :, joints] = loop_coefficients(gains, timestep).transpose(2, 0, 1)
    elastic = bool(np.isfinite(gains.stiffness).all())
    motors = np.diag(gains.motor_inertias)
    # State: [m, r, w, f; u; dtheta, tau; theta; deflection, its velocity]
    size = 10 * n
    at = [slice(k * n, (k + 1) * n) for k in range(10)]
    m, u, velocity, torque, angle, bend, bending = at[0], *at[4:]
    act = np.eye(size)
    act[: 4 * n, : 7 * n], act[: 4 * n, 7 * n :] = loop.reshape(4 * n, 7 * n), 0.0
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
    else:  # nothing depends on the angles, which drift: a double eigenvalue of one
        kept = np.delete(np.arange(size), angle)
        whole, control = whole[np.ix_(kept, kept)], control[np.ix_(kept, kept)]
    values, vectors = np.linalg.eig(whole @ control)  # `velocity` stands before what was left out
    worst = int(np.argmax(np.abs(values)))
    if np.abs(values[worst]) <= 1.0 + _SLOW * timestep * steps:
        return None
    return int(np.argmax(np.abs(vectors[velocity, worst])))
