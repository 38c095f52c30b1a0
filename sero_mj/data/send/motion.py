"""Example motions of robots, and the signals that are measured during a motion.

Motions are smooth and within the limits of the robot. Signals include the required torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world import World
from ...robots.declared.mounts import carriers
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene

LEAD = 0.5  # time in s by which the commanded position leads the measured position
_AMPLITUDE = 0.4  # amplitude as a share of half the range of the joint
_AMPLITUDE_ABOUT_POSE = 0.2  # the same share for motions about a declared pose
_BEND = 0.2  # share of half the range, so that the arm is bent in the center pose
_MAX_SWING = 1.1  # rad
_REDUCTION, _REDUCTIONS = 0.75, 10  # factor of amplitudes after a collision, and its maximum uses
_SAMPLE_TIMES = 0.618034 * np.arange(500)  # times that sample all phases of the motion, s
_PERIODS = np.array([7.0, 9.0, 6.0, 8.0, 5.0, 4.0, 3.5])  # s; repeated for more joints


class SineMotion:
    """A motion in which every joint oscillates with its own period, below the velocity limits.

    The center is the declared `joint_angles`, or a bent pose. `amplitude` is from 0 to 1.
    """

    def __init__(self, robot: SerialRobot, amplitude: float = 1.0) -> None:
        low, high = robot.display_ranges.T
        half = (high - low) / 2
        sign = np.where(np.arange(robot.n) % 2 == 0, 1.0, -1.0)
        share = _AMPLITUDE if robot.joint_angles is None else _AMPLITUDE_ABOUT_POSE
        swing = np.minimum(share * half, _MAX_SWING)
        self._center = (low + high) / 2 + sign * _BEND * half
        if robot.joint_angles is not None:
            self._center = np.clip(robot.joint_angles, low + swing, high - swing)
        swing *= min(max(amplitude, 0.0), 1.0)
        self._omega = 2 * np.pi / np.resize(_PERIODS, robot.n)
        self._phase = 0.7 * np.arange(robot.n)
        if robot.velocity_limits is not None:
            swing = np.minimum(swing, 0.8 * robot.velocity_limits / self._omega)
        self._swing = swing
        self._coupled = robot.coupled if robot.couplings else None

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Returns joint positions, velocities and accelerations, shape (n,), at time `t` (s)."""
        angle = self._omega * t + self._phase
        sin, cos = np.sin(angle), np.cos(angle)
        position = self._center + self._swing * sin
        velocity = self._swing * self._omega * cos
        acceleration = -self._swing * self._omega**2 * sin
        if self._coupled is not None:
            free, rates = self._coupled.independent, self._coupled.rates
            position = self._coupled.positions(position[free])
            velocity, acceleration = rates(velocity[free]), rates(acceleration[free])
        return position, velocity, acceleration


class InverseDynamics:
    """MuJoCo's inverse dynamics of one or more robots.

    Without declared masses, the torques are an estimate for links with the density of water.
    """

    def __init__(self, *robots: SerialRobot) -> None:
        self.world = World(Scene(robots=list(robots), floor=False))
        self.data = self.world.make_data()
        parts = self.world.robots.values()
        self._qpos = np.concatenate([part.qpos for part in parts])
        self._dofs = np.concatenate([part.dofs for part in parts])
        self.world.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)

    def torques(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Returns the joint torques of all robots, in order, for a motion, shape (n,)."""
        data, dofs = self.data, self._dofs
        data.qpos[self._qpos], data.qvel[dofs], data.qacc[dofs] = position, velocity, acceleration
        mujoco.mj_inverse(self.world.model, data)
        return np.asarray(data.qfrc_inverse[dofs])


def clear_amplitudes(robots: Sequence[SerialRobot], amplitude: float) -> dict[str, float]:
    """Returns the motion amplitude of each robot that avoids collisions between robots.

    Amplitudes of robots that collide in sampled poses, and of robots that carry them, are reduced.
    Collisions in the declared pose are ignored.
    """
    by_name = {robot.name: robot for robot in robots}
    amplitudes = dict.fromkeys(by_name, amplitude)
    if len(robots) < 2:
        return amplitudes
    world = World(Scene(robots=list(robots), floor=False), dynamic=True)
    model, data = world.model, world.make_data()
    owners = [name.partition("/")[0] for name in (model.body(i).name for i in range(model.nbody))]

    def meeting(t: float | None) -> set[tuple[str, str]]:
        for name, part in world.robots.items():
            angles = part.robot.home if t is None else motions[name].at(t)[0]
            data.qpos[part.qpos] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0]]
        return {(owners[a], owners[b]) for a, b in bodies.tolist() if {a, b} <= moving}

    moving = {i for i in range(model.nbody) if owners[i] in by_name}
    motions = {name: SineMotion(robot, amplitude) for name, robot in by_name.items()}
    always = meeting(None)
    for _ in range(_REDUCTIONS):
        met = {pair for t in _SAMPLE_TIMES for pair in meeting(float(t))} - always
        if not met:
            break
        reduced: set[str] = set()
        for one, other in met:
            below, above = set(carriers(by_name, one)), set(carriers(by_name, other))
            # Carriers of only one of the colliding robots are reduced, if there are any.
            reduced |= (below ^ above) - {one, other} or {one, other}
        for name in reduced:
            amplitudes[name] *= _REDUCTION
            motions[name] = SineMotion(by_name[name], amplitudes[name])
    return amplitudes


class CommonMotion:
    """A motion of several robots without collisions; `amplitude` is from 0 to 1."""

    def __init__(self, robots: Sequence[SerialRobot], amplitude: float) -> None:
        amplitudes = clear_amplitudes(robots, amplitude)
        self._motions = [SineMotion(robot, amplitudes[robot.name]) for robot in robots]
        self._dynamics = InverseDynamics(*robots)
        ends = np.cumsum([0, *(robot.n for robot in robots)]).tolist()
        self._rows = {r.name: slice(*ends[i : i + 2]) for i, r in enumerate(robots)}
        self._last: tuple[float, Array] | None = None

    def of(self, robot: str, t: float, lead: float) -> Array:
        """Returns position, velocity, acceleration, torque and target position, shape (5, n).

        Args:
            lead: time by which the target leads the position, s.
        """
        if self._last is None or self._last[0] != t:  # once for all robots of a packet
            states = np.concatenate([motion.at(t) for motion in self._motions], axis=1)
            targets = np.concatenate([motion.at(t + lead)[0] for motion in self._motions])
            self._last = t, np.vstack([states, self._dynamics.torques(*states), targets])
        return self._last[1][:, self._rows[robot]]


class RobotSignals:
    """The measured signals of one robot during a motion."""

    def __init__(self, robot: SerialRobot, motion: CommonMotion) -> None:
        self._robot, self._motion = robot, motion

    def signals(self, t: float) -> Mapping[str, Array]:
        """Returns the values of inputs such as `joint_angles` and `torques` at time `t` (s)."""
        position, velocity, acceleration, torques, target = self._motion.of(
            self._robot.name, t, LEAD
        )
        return {
            "joint_angles": position,
            "commanded_angles": target,
            "torques": torques,
            "commanded_torques": torques,  # the controller has no torque error
            "joint_velocities": velocity,
            "joint_accelerations": acceleration,
            "billboard_values": velocity,
            "flange_check": self._robot.fwd_kin_base_to_flange(position),
            # For inputs that the robot declares, such as temperatures.
            "further": 30.0 + 5.0 * np.sin(0.2 * t + np.arange(self._robot.n)),
        }
