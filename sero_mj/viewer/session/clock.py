"""The displayed time of a live viewer: real time for live sources, else set by the user."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...data.drive.mirror import LiveWorld
from .binned_history import SPAN
from .live_history import LiveHistory

SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
_STEP = 1.0 / 60.0  # s, for recordings without a time step
_SIMULATION_CHUNK = 0.05  # s simulated in one call
# s of real time until a frame is shown, so that the window stays responsive; if the rest of a frame
# takes longer, that time, which halves the frame rate at worst.
_MAX_WAIT = 0.03
_SAMPLE_INTERVAL = 0.004  # s between samples, so that no spike of 5 ms is missed in real time
_MAX_SAMPLES = 20  # per frame
_JUMP_THRESHOLD = 0.5  # s; a larger advance is a jump
_PAST_SAMPLES = 120  # with which the plots are refilled after a jump
_SMOOTHING = 0.1  # weight of a frame in the displayed speed
_MAX_FRAME = 0.5  # s; longer frames (after a laptop's sleep) are shortened to this


class Tick(NamedTuple):
    """Something that happened at a time of the time line.

    Attributes:
        time: s.
        text: what.
        is_mark: whether the user has marked it; else it is a fault that was found.
    """

    time: float
    text: str
    is_mark: bool


class Clock:
    """Determines the time that a mirror shows, frame by frame.

    Live sources run in real time. They can be paused, and the last minute can be replayed while
    they continue; packets received meanwhile are kept.

    Attributes:
        is_live: whether a source follows the real time.
        is_past: whether it is live, and shows the past.
        is_playing: whether there is a source with a speed; else the user sets all inputs.
        speed: displayed s per real s.
        begin: of the time line, s.
        end: of the time line, s; None if a source has no end. For live sources and endless
            simulations the newest time.
        step_size: of a single step, s.
        on_moment: called whenever the mirror has advanced; if set, recordings and simulations
            advance in equally fine steps at a low frame rate, so that a plot misses little. If it
            is set later, it is first called for past times, as after a jump.
        real_speed: achieved in the last frames; a simulation may be slower than `speed`.
    """

    def __init__(self, mirror: LiveWorld) -> None:
        self._mirror = mirror
        self.is_live = mirror.is_live
        self.is_playing = bool(mirror.sources)
        self.is_paused = False
        self.speed = 1.0
        self.real_speed = 1.0
        self.on_moment: Callable[[], None] | None = None
        self.time = self.begin = 0.0
        self.is_past = self._goes_on_from_there = False
        has_history = self.is_live and mirror.has_states
        self._history = LiveHistory(mirror) if has_history else None
        sources = mirror.sources.values()
        ends = [source.end for source in sources if source.end is not None]
        is_endless = self.is_live or len(ends) < len(sources)
        self.end = None if is_endless else max(ends, default=None)
        # The time line of an endless simulation moves.
        self._growing = [] if self.is_live else [s for s in sources if s.newest is not None]
        self._move_line()
        steps = [source.step for source in sources if source.step is not None]
        self.step_size = min(steps, default=_STEP)
        self._shown: float | None = None  # the time of the mirror
        self._is_heard = True  # whether `on_moment` was called for it
        self._simulated = 0.0  # as far as it is simulated
        self._simulates = bool(steps)
        self._passed = self._simulating = 0.0  # s for the last frame, and for simulating in it

    @property
    def is_at_end(self) -> bool:
        return self._has_end and self.end is not None and self.time >= self.end

    @property
    def _has_end(self) -> bool:
        return not (self.is_live or self._growing)

    def _move_line(self) -> None:
        if self._growing:
            self.begin = max(source.begin for source in self._growing)
            self.end = max(source.newest or 0.0 for source in self._growing)

    def _stop_at_failure(self) -> None:
        failed = [s.now() for s in self._mirror.sources.values() if s.error and not s.is_live]
        if failed:
            self._growing = []
            self.end = max(failed)
            self.time = min(self.time, self.end)

    @property
    def can_go_back(self) -> bool:
        """Whether the past can be shown."""
        return not self.is_live or self._history is not None

    def advance(self, passed: float) -> bool:
        """Advances by a real time, s, and updates the mirror."""
        if self.is_live:
            return self._follow(passed)
        if self.is_paused or self.is_at_end:
            self.real_speed = self.speed
            return self._show()
        before = self.time
        self._passed = min(passed, _MAX_FRAME)
        self.time += self.speed * self._passed
        if self._has_end and self.end is not None and self.time >= self.end:
            self.time, before = self.end, self.end - self.speed * passed  # not due to its speed
        changed = self._show()
        self._move_line()
        self._stop_at_failure()
        passed = max(passed, 1e-6)
        self.real_speed += _SMOOTHING * ((self.time - before) / passed - self.real_speed)
        return changed

    def _follow(self, passed: float) -> bool:
        history = self._history
        if history is None:
            if not self.is_paused:
                self._mirror.advance()
            return not self.is_paused
        if self.is_past:
            history.put_back()
        elif self.is_paused and self.end:
            history.keep()  # the last displayed state, while paused
        self._mirror.advance()
        if self.on_moment is not None:
            self.on_moment()
        history.add()
        self.begin, self.end = history.begin, history.end
        if self.is_past and not self.is_paused:
            self.time += self.speed * min(passed, _MAX_FRAME)
            self.is_past = self.time < self.end
        elif self.is_paused and not self.is_past:
            self.is_past = True  # at the last displayed time
        if not self.is_past:
            self.time, self.speed = self.end, 1.0
            return True
        self.time = max(self.time, self.begin)
        history.show(self.time)
        return True

    def go_live(self) -> str:
        if not self.is_live:
            if self.end is None:
                return "no end"
            self.seek(self.end)
            if self._has_end:
                return "at the end"
            self.is_paused = False
            return "goes on from now"
        self.is_past = self.is_paused = self._goes_on_from_there = False
        if self._history is not None:
            self._history.put_back()
        return "live"

    def look_back(self) -> None:
        """Calls `on_moment` for past times as after a jump, if they can be shown again."""
        self._is_heard = False

    def _show(self) -> bool:
        jumps = not self._is_heard and self.on_moment is not None
        if self.time == self._shown and self._mirror.sources and not jumps:
            return False
        goal = self.time
        if self._simulates and goal > self._simulated:
            goal = self._simulate(goal)
        for moment in self._moments(goal, jumps=jumps):
            self._mirror.advance(moment)
            if self.on_moment is not None:
                self.on_moment()
        self._shown, self._is_heard = goal, self.on_moment is not None
        return True

    def _moments(self, goal: float, *, jumps: bool) -> list[float]:
        if self.on_moment is None:
            return [goal]
        passed = goal - (goal if self._shown is None else self._shown)
        if jumps or passed < 0 or passed > _JUMP_THRESHOLD:  # plots show the time before it
            begin = max(goal - SPAN, 0.0)
            return np.linspace(begin, goal, _PAST_SAMPLES).tolist() if goal else [goal]
        if not passed:
            return [goal]
        count = min(max(round(passed / _SAMPLE_INTERVAL), 1), _MAX_SAMPLES)
        return [goal - passed * k / count for k in range(count - 1, -1, -1)]

    def _simulate(self, goal: float) -> float:
        begin = clock.monotonic()
        max_wait = max(_MAX_WAIT, self._passed - self._simulating)
        while self._simulated < goal and clock.monotonic() - begin < max_wait:
            self._simulated = min(self._simulated + _SIMULATION_CHUNK, goal)
            for source in self._mirror.sources.values():
                source.advance_to(self._simulated)
        self._simulating = clock.monotonic() - begin
        if not self.is_paused:
            self.time = self._simulated
        return self._simulated

    def pause(self) -> str:
        if self.is_at_end:
            self.seek(0.0)
            self.is_paused = False
            return "from the start"
        self.is_paused = not self.is_paused
        if self.is_live and not self.is_paused and not self._goes_on_from_there:
            return self.go_live()
        return "paused" if self.is_paused else "goes on"

    def step(self, count: int = 1) -> str:
        self.is_paused = True
        if self.is_live and self._history is None:
            self._mirror.advance()
            return "paused; shows the latest packet"
        if self.is_live:
            wanted = self.time + count * self.step_size
            if count > 0 and wanted >= (self.end or 0.0):
                self.go_live()
                self._follow(0.0)
                self.is_paused = True
                return "paused; shows the latest packet"
            self.seek(wanted)
            return f"{time_text((self.end or 0.0) - self.time)} ago"
        self.seek(self.time + count * self.step_size)
        return f"at {self.time:.3f} s"

    def faster(self, times: int) -> str:
        if self.is_live and not self.is_past:
            return "live: the speed is the robot's"
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
        self.speed = self.real_speed = SPEEDS[min(max(nearest + times, 0), len(SPEEDS) - 1)]
        return f"speed {self.speed:g}"

    def reset(self) -> str:
        if self.is_live:
            is_paused = self.is_paused
            self.go_live()
            self._mirror.reset()
            # Immediately, even if paused: the declared pose is not from the robot.
            self._follow(0.0)
            self.is_paused = is_paused
            return "reset to the declared pose, then the latest packets"
        self.seek(0.0)
        return "back to the start"

    def seek(self, time: float) -> None:
        """Continues from a time, s, within the time line.

        The newest time of live sources is live, not past; no effect without history.
        """
        if self.is_live and (self._history is None or self.end is None):
            return
        end = float("inf") if self.end is None else self.end
        self.time = min(max(time, self.begin), end)
        if self.is_live:
            self.is_past = self._goes_on_from_there = self.time < end
            if not self.is_past:
                self.go_live()

    def go_to_start(self) -> None:
        """Continues at the start after a restart."""
        self.time = self._simulated = 0.0
        self._shown, self.is_paused = None, False
        self._move_line()


def time_text(time: float) -> str:
    """A time as text: `3.42 s`, or `12:03.4` from a minute on."""
    if time < 60:
        return f"{time:.2f} s"
    minutes, seconds = divmod(time, 60)
    if minutes < 60:
        return f"{minutes:.0f}:{seconds:04.1f}"
    hours, minutes = divmod(minutes, 60)
    return f"{hours:.0f}:{minutes:02.0f}:{seconds:02.0f}"
