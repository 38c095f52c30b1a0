"""`CommandedMotion`: a robot's commanded angles from servo commands, speeds or goals.

As in a real robot controller, commands beyond a limit are refused, and commanded angles never move
faster than the velocity limits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array

HOLDS, SERVOS, SPEEDS, MOVES, TORQUES = "holds", "servos", "speeds", "moves", "torques"
# Maximum time in seconds for which joints may move at full speed between two streamed commands.
_MAX_INTERVAL = 0.1
_SMOOTHED = 0.02  # time constant for velocities of streamed angles, which arrive irregularly, s
_STILL = 1e-9  # tolerance for rest, rad and rad/s


class CommandedMotion:
    """Computes the commanded joint angles of a robot step by step.

    Args:
        position_limits: lower and upper limits, shape (n, 2), rad.
        velocity_limits: velocity limits, shape (n,), rad/s.

    Attributes:
        mode: `HOLDS`, `SERVOS` (follows streamed angles), `SPEEDS` (follows speeds), `MOVES` (moves
            to a goal), or `TORQUES` (torques act, and the angles follow the robot).
        angles: commanded angles, shape (n,), rad.
        velocities: velocities of the motion, shape (n,), rad/s, smoothed for streamed angles.
        accelerations: planned accelerations, shape (n,), rad/s^2; zero while following streamed
            angles.
        torques: torques in addition to gravity, shape (n,), Nm.
    """

    def __init__(
        self, names: Sequence[str], position_limits: Array, velocity_limits: Array
    ) -> None:
        n = len(names)
        self.mode = HOLDS
        self.angles, self.velocities, self.accelerations, self.torques = np.zeros((4, n))
        self._names = names
        self._low, self._high = np.asarray(position_limits).T
        self._fastest = np.asarray(velocity_limits)
        self._goal: Array = np.zeros(n)
        self._begin: Array = np.zeros(n)
        self._taken = -np.inf  # time of the last streamed angles, s
        self._ends = False  # whether no more streamed angles will follow
        self._rates: Array = np.zeros(n)  # speeds toward streamed angles, rad/s
        self._speeds: Array = np.zeros(n)
        self._acceleration = 0.0
        self._path = 0.0, 0.0, 0.0  # start, acceleration time and duration of a move, s

    def hold(self, angles: Array | None = None) -> None:
        """Holds the commanded angles, or other `angles`, shape (n,), rad."""
        self.mode, self._ends = HOLDS, False
        if angles is not None:
            self.angles[:] = angles
        self.velocities[:] = self.accelerations[:] = self.torques[:] = 0.0

    def servo(self, angles: Array, time: float, cycle: float) -> str:
        """Follows streamed angles, (n,), rad. Returns the reason for a rejection, or "".

        Args:
            time: simulated time, s.
            cycle: minimum time between two commands, s.
        """
        if wrong := self._beyond(angles):
            return wrong
        is_first = self.mode != SERVOS
        passed = min(max(time - self._taken, cycle), _MAX_INTERVAL)
        before = self.angles if is_first else self._goal
        speeds = np.abs(angles - before) / (_MAX_INTERVAL if is_first else passed)
        if wrong := self._too_fast(speeds):
            return wrong
        if is_first:
            self.hold()
        self.mode, self._taken, self._ends = SERVOS, time, False
        self._goal[:] = angles
        # The motion is spread over the expected time until the next command.
        self._rates[:] = np.minimum(np.abs(angles - self.angles) / passed, self._fastest)
        return ""

    def speed(self, speeds: Array, acceleration: float) -> str:
        """Sets speeds, (n,), rad/s, to be reached with an acceleration, rad/s^2; see `servo`."""
        if wrong := self._too_fast(np.abs(speeds)) or _not_positive("acceleration", acceleration):
            return wrong
        if self.mode != SPEEDS:
            self.hold()
        self.mode, self._acceleration = SPEEDS, acceleration
        self._speeds[:] = speeds
        return ""

    def move(self, angles: Array, speed: float, acceleration: float, time: float) -> str:
        """Moves to angles, shape (n,), rad. The result is that of `servo`.

        Args:
            speed: speed of the joint with the longest path, rad/s.
            acceleration: acceleration of the same joint, rad/s^2.
            time: current time, s.
        """
        way = float(np.abs(angles - self.angles).max())
        if (
            (wrong := self._beyond(angles))
            or (wrong := _not_positive("speed", speed))
            or (wrong := _not_positive("acceleration", acceleration))
            or (wrong := self._too_fast(np.abs(angles - self.angles) / max(way, 1e-9) * speed))
        ):
            return wrong
        self.hold()
        self._begin[:], self._goal[:] = self.angles, angles
        rising = min(speed / acceleration, np.sqrt(way / acceleration))
        self.mode = MOVES
        self._path = time, rising, rising + way / max(acceleration * rising, 1e-9)
        return ""

    def stop(self, deceleration: float) -> None:
        """Stops with a deceleration in rad/s^2, and holds the angles.

        In mode `SERVOS`, the robot first moves to the last streamed angles.
        """
        if self.mode == SERVOS:
            self._ends = True
            return
        if np.abs(self.velocities).max() < _STILL:
            self.hold()
            return
        self.mode = SPEEDS
        self._speeds[:] = 0.0
        self._acceleration = deceleration if deceleration > 0.0 else np.inf

    def act(self, torques: Array) -> None:
        """Applies torques in addition to gravity, shape (n,), Nm."""
        self.hold()
        self.mode = TORQUES
        self.torques[:] = torques

    def step(self, time: float, duration: float) -> None:
        """Continues the motion by a step of a duration, up to a time, both in seconds."""
        if self.mode == SERVOS:
            limit = self._rates * duration
            change = np.clip(self._goal - self.angles, -limit, limit)
            self.angles += change
            share = min(duration / _SMOOTHED, 1.0)
            self.velocities += share * (change / duration - self.velocities)
            if self._ends and np.abs(self._goal - self.angles).max() < _STILL:
                self.hold()
        elif self.mode == SPEEDS:
            max_change = self._acceleration * duration
            change = np.clip(self._speeds - self.velocities, -max_change, max_change)
            before = self.angles.copy()
            self.velocities += change
            self.angles += self.velocities * duration
            np.clip(self.angles, self._low, self._high, self.angles)
            self.velocities[:] = (self.angles - before) / duration
            self.accelerations[:] = change / duration
            if not self._speeds.any() and np.abs(self.velocities).max() < _STILL:
                self.hold()
        elif self.mode == MOVES:
            begin, rising, whole = self._path
            share, speed, acceleration = _trapezoid(time - begin, rising, whole)
            way = self._goal - self._begin
            self.angles[:] = self._begin + way * share
            self.velocities[:], self.accelerations[:] = way * speed, way * acceleration
            if time - begin >= whole:
                self.hold(self._goal)

    def _beyond(self, angles: Array) -> str:
        bad = (angles < self._low) | (angles > self._high)
        if not bad.any():
            return ""
        joint = int(np.argmax(bad))
        expected = f"{self._low[joint]:.4g} to {self._high[joint]:.4g}"
        found = f"{self._names[joint]} is commanded to {angles[joint]:.4g} rad"
        return f"{found}; expected {expected}"

    def _too_fast(self, speeds: Array) -> str:
        if not (speeds > self._fastest * (1.0 + 1e-9)).any():
            return ""
        joint = int(np.argmax(speeds / self._fastest))
        found = f"{self._names[joint]} is commanded at {speeds[joint]:.3g} rad/s"
        return f"{found}; expected up to {self._fastest[joint]:.3g}"


def _not_positive(what: str, value: float) -> str:
    return "" if value > 0.0 else f"{what}: found {value:g}; expected a positive value"


def _trapezoid(t: float, rising: float, whole: float) -> tuple[float, float, float]:
    if t >= whole or rising <= 0.0:
        return 1.0, 0.0, 0.0
    top = 1.0 / (whole - rising)  # the integral of the speed is 1
    slope = top / rising
    if t < rising:
        return slope * t * t / 2.0, slope * t, slope
    if t > whole - rising:
        left = whole - t
        return 1.0 - slope * left * left / 2.0, slope * left, -slope
    return top * (t - rising / 2.0), top, 0.0
