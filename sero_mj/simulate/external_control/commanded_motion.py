"""`CommandedMotion`: the angles that a robot is commanded to by single angles, speeds or goals.

As on a robot's own controller, a command is refused where it is beyond a limit, and the commanded
angles never move faster than the joints may.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array

HOLDS, SERVOS, SPEEDS, MOVES, TORQUES = "holds", "servos", "speeds", "moves", "torques"
# s: single angles may be as far from the last ones as a joint comes in the time between them, and
# no farther than it comes in this time.
_LEAP = 0.1
_SMOOTHED = 0.02  # s, time constant of velocities of single angles, which come irregularly
_STILL = 1e-9  # rad/s


class CommandedMotion:
    """Where the robot is commanded to, step by step.

    Args:
        position_limits: (n, 2), rad.
        velocity_limits: (n,), rad/s.

    Attributes:
        mode: what it does: `HOLDS`, follows single angles (`SERVOS`) or speeds (`SPEEDS`), `MOVES`
            to a goal, or lets `TORQUES` act, by which it is carried along.
        angles: (n,), rad, commanded.
        velocities: (n,), rad/s, of these; of single angles smoothed.
        accelerations: (n,), rad/s^2, of motion that it has planned itself; zero while it servos.
        torques: (n,), Nm, that act on top of gravity's.
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
        self._taken = -np.inf  # s, when the last single angles were
        self._ends = False  # whether none are to come
        self._rates: Array = np.zeros(n)  # rad/s, by which they are gone to
        self._speeds: Array = np.zeros(n)
        self._acceleration = 0.0
        self._path = 0.0, 0.0, 0.0  # of a move: begin, s; time of acceleration, s; duration, s

    def hold(self, angles: Array | None = None) -> None:
        """Holds the robot where it is commanded to, or at angles, (n,), rad."""
        self.mode, self._ends = HOLDS, False
        if angles is not None:
            self.angles[:] = angles
        self.velocities[:] = self.accelerations[:] = self.torques[:] = 0.0

    def servo(self, angles: Array, time: float, cycle: float) -> str:
        """Takes single angles, (n,), rad; returns why not, or nothing.

        Args:
            time: s.
            cycle: s between two of them, at least.
        """
        if wrong := self._beyond(angles):
            return wrong
        is_first = self.mode != SERVOS
        passed = min(max(time - self._taken, cycle), _LEAP)
        before = self.angles if is_first else self._goal
        speeds = np.abs(angles - before) / (_LEAP if is_first else passed)
        if wrong := self._too_fast(speeds):
            return wrong
        if is_first:
            self.hold()
        self.mode, self._taken, self._ends = SERVOS, time, False
        self._goal[:] = angles
        # The way is spread over the time until the next ones.
        self._rates[:] = np.minimum(np.abs(angles - self.angles) / passed, self._fastest)
        return ""

    def speed(self, speeds: Array, acceleration: float) -> str:
        """Takes speeds, (n,), rad/s, to be reached by an acceleration, rad/s^2; likewise."""
        if wrong := self._too_fast(np.abs(speeds)) or _not_positive("acceleration", acceleration):
            return wrong
        if self.mode != SPEEDS:
            self.hold()
        self.mode, self._acceleration = SPEEDS, acceleration
        self._speeds[:] = speeds
        return ""

    def move(self, angles: Array, speed: float, acceleration: float, time: float) -> str:
        """Moves to angles, (n,), rad, the joint with the longest way by a speed, rad/s; likewise.

        The speed rises and falls by an acceleration, rad/s^2; `time` is that of now, s.
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
        """Comes to rest by a deceleration, rad/s^2, and holds; of single angles, at the last."""
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
        """Lets torques act, (n,), Nm."""
        self.hold()
        self.mode = TORQUES
        self.torques[:] = torques

    def step(self, time: float, duration: float) -> None:
        """Goes on to a time, s, by a step of a duration, s."""
        if self.mode == SERVOS:
            most = self._rates * duration
            change = np.clip(self._goal - self.angles, -most, most)
            self.angles += change
            share = min(duration / _SMOOTHED, 1.0)
            self.velocities += share * (change / duration - self.velocities)
            if self._ends and np.abs(self._goal - self.angles).max() < _STILL:
                self.hold()
        elif self.mode == SPEEDS:
            most_change = self._acceleration * duration
            change = np.clip(self._speeds - self.velocities, -most_change, most_change)
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
    return "" if value > 0.0 else f"{what}: found {value:g}; expected a positive one"


def _trapezoid(t: float, rising: float, whole: float) -> tuple[float, float, float]:
    if t >= whole or rising <= 0.0:
        return 1.0, 0.0, 0.0
    top = 1.0 / (whole - rising)  # the area below the speed is 1
    slope = top / rising
    if t < rising:
        return slope * t * t / 2.0, slope * t, slope
    if t > whole - rising:
        left = whole - t
        return 1.0 - slope * left * left / 2.0, slope * left, -slope
    return top * (t - rising / 2.0), top, 0.0
