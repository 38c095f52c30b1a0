"""`Clock`: determines the displayed time, which is real time or controlled by the user."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ...data.drive.place import follow
from .binned_history import SPAN

SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
_STEP = 1.0 / 60.0  # size of a single step if the sources have no time step, s
_SIMULATION_CHUNK = 0.05  # simulated time per call, s
# The real time in seconds that a frame spends on simulation is limited, so that the window stays
# responsive. If the rest of a frame takes longer, simulation may take as long as the rest. This
# halves the frame rate at worst.
_MAX_WAIT = 0.03
_SAMPLE_INTERVAL = 0.004  # s; at real-time speed, this shows spikes of 5 ms
_MAX_SAMPLES = 20  # maximum number of samples per frame
_JUMP_THRESHOLD = 0.5  # maximum advance of the time that is not a jump, s
_PAST_SAMPLES = 120  # number of samples that refill the plots after a jump
_SMOOTHING = 0.1  # weight of the last frame in `real_speed`
_MAX_FRAME = 0.5  # maximum time of a frame, s; frames after a suspend are longer

HISTORY_SPAN = 60.0  # duration of live data that can be replayed, s
_STATE_RATE = 30.0  # number of stored states per second
_MAX_STATE_BYTES = 64e6  # maximum size of all stored states, which limits the rate of large worlds
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class Tick(NamedTuple):
    """An event on the timeline.

    Attributes:
        time: time of the event in seconds.
        text: description of the event.
        is_mark: True for a mark set by the user, False for a fault.
    """

    time: float
    text: str
    is_mark: bool


class Clock:
    """Determines the time that a mirror shows in each frame.

    Live sources run in real time. The display can be paused, and the last minute can be replayed
    while packets are still received.

    Attributes:
        is_live: whether a source follows real time.
        is_past: whether a past state of live sources is shown.
        is_playing: whether there are sources. If there are none, the user sets all inputs.
        speed: selected ratio of displayed time to real time.
        time: displayed time in seconds.
        begin: start of the timeline in seconds.
        end: end of the timeline in seconds. For live sources and simulations without an end, this
            is the newest time. None if a recording has no known end.
        step_size: size of a single step in seconds.
        on_state: function that is called for each new state of the mirror, for example to plot it.
            While it is set, recordings and simulations advance in fine steps even at a low frame
            rate. At first and after a jump in time, it is called for earlier times to fill plots.
        real_speed: actual ratio of displayed time to real time in the last frames. A simulation
            may be slower than `speed`.
    """

    def __init__(self, mirror: LiveWorld) -> None:
        self._mirror = mirror
        self.is_live = mirror.is_live
        self.is_playing = bool(mirror.sources)
        self.is_paused = False
        self.speed = 1.0
        self.real_speed = 1.0
        self.on_state: Callable[[], None] | None = None
        self.time = self.begin = 0.0
        self.is_past = self._resumes_past = False
        has_history = self.is_live and mirror.has_states
        self._history = LiveHistory(mirror) if has_history else None
        sources = mirror.sources.values()
        ends = [source.end for source in sources if source.end is not None]
        is_endless = self.is_live or len(ends) < len(sources)
        self.end = None if is_endless else max(ends, default=None)
        # The timeline of a simulation without an end moves.
        self._growing = [] if self.is_live else [s for s in sources if s.newest is not None]
        self._move_timeline()
        steps = [source.step for source in sources if source.step is not None]
        self.step_size = min(steps, default=_STEP)
        self._shown: float | None = None  # time that the mirror shows
        self._is_reported = True  # whether `on_state` was called for this time
        self._simulated = 0.0  # time up to which the simulation has run
        self._simulates = bool(steps)
        self._passed = self._simulating = (
            0.0  # real time of the last frame and of its simulation, s
        )

    @property
    def is_at_end(self) -> bool:
        return self._has_end and self.end is not None and self.time >= self.end

    @property
    def _has_end(self) -> bool:
        return not (self.is_live or self._growing)

    def _move_timeline(self) -> None:
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
        return not self.is_live or self._history is not None

    def advance(self, passed: float) -> bool:
        """Advances by a real time in seconds. Returns whether the displayed state has changed."""
        if self.is_live:
            return self._follow(passed)
        if self.is_paused or self.is_at_end:
            self.real_speed = self.speed
            return self._show()
        before = self.time
        self._passed = min(passed, _MAX_FRAME)
        self.time += self.speed * self._passed
        if self._has_end and self.end is not None and self.time >= self.end:
            # The end limits this frame, so `real_speed` must not decrease.
            self.time, before = self.end, self.end - self.speed * passed
        changed = self._show()
        self._move_timeline()
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
            history.store()  # This is the displayed state, which must remain available.
        self._mirror.advance()
        if self.on_state is not None:
            self.on_state()
        history.add()
        self.begin, self.end = history.begin, history.end
        if self.is_past and not self.is_paused:
            self.time += self.speed * min(passed, _MAX_FRAME)
            self.is_past = self.time < self.end
        elif self.is_paused and not self.is_past:
            self.is_past = True
        if not self.is_past:
            self.time, self.speed = self.end, 1.0
            return True
        self.time = max(self.time, self.begin)
        history.show(self.time)
        return True

    def go_live(self) -> str:
        if not self.is_live:
            if self.end is None:
                return "this timeline has no end"
            self.seek(self.end)
            if self._has_end:
                return "at the end"
            self.is_paused = False
            return "continues from the newest state"
        self.is_past = self.is_paused = self._resumes_past = False
        if self._history is not None:
            self._history.put_back()
        return "live"

    def replay_past(self) -> None:
        """Fills plots at the next frame: calls `on_state` for earlier times, as after a jump."""
        self._is_reported = False

    def _show(self) -> bool:
        jumps = not self._is_reported and self.on_state is not None
        if self.time == self._shown and self._mirror.sources and not jumps:
            return False
        goal = self.time
        if self._simulates and goal > self._simulated:
            goal = self._simulate(goal)
        for time in self._times(goal, jumps=jumps):
            self._mirror.advance(time)
            if self.on_state is not None:
                self.on_state()
        self._shown, self._is_reported = goal, self.on_state is not None
        return True

    def _times(self, goal: float, *, jumps: bool) -> list[float]:
        if self.on_state is None:
            return [goal]
        passed = goal - (goal if self._shown is None else self._shown)
        if jumps or passed < 0 or passed > _JUMP_THRESHOLD:  # The plots must be refilled.
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
        if self.is_live and not self.is_paused and not self._resumes_past:
            return self.go_live()
        return "paused" if self.is_paused else "continues"

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
            return "the speed of live sources cannot be changed"
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
        self.speed = self.real_speed = SPEEDS[min(max(nearest + times, 0), len(SPEEDS) - 1)]
        return f"speed {self.speed:g}"

    def reset(self) -> str:
        if self.is_live:
            is_paused = self.is_paused
            self.go_live()
            self._mirror.reset()
            # Even a paused view must not show the declared pose instead of the robot's pose.
            self._follow(0.0)
            self.is_paused = is_paused
            return "reset to the declared pose; the latest packets are applied"
        self.seek(0.0)
        return "back to the start"

    def seek(self, time: float) -> None:
        """Jumps to a time in seconds, which is limited to the timeline.

        For live sources, seeking to the newest time shows live data. If live sources have no
        history, seeking has no effect.
        """
        if self.is_live and (self._history is None or self.end is None):
            return
        end = float("inf") if self.end is None else self.end
        self.time = min(max(time, self.begin), end)
        if self.is_live:
            self.is_past = self._resumes_past = self.time < end
            if not self.is_past:
                self.go_live()

    def go_to_start(self) -> None:
        """Returns to the start after the sources have restarted."""
        self.time = self._simulated = 0.0
        self._shown, self.is_paused = None, False
        self._move_timeline()


def time_text(time: float) -> str:
    """Formats a time in seconds as `3.42 s`, or as `12:03.4` from one minute."""
    if time < 60:
        return f"{time:.2f} s"
    minutes, seconds = divmod(time, 60)
    if minutes < 60:
        return f"{minutes:.0f}:{seconds:04.1f}"
    hours, minutes = divmod(minutes, 60)
    return f"{hours:.0f}:{minutes:02.0f}:{seconds:02.0f}"


class LiveHistory:
    """Stores the newest state of a live mirror, and about 30 states per second of the last minute.

    If the mirror shows a past state, call `put_back` before the mirror advances.
    """

    def __init__(self, mirror: LiveWorld, span: float = HISTORY_SPAN) -> None:
        self._model, self._data = mirror.world.model, mirror.data
        self._span = span
        size = mujoco.mj_stateSize(self._model, _STATE)
        count = int(min(span * _STATE_RATE, _MAX_STATE_BYTES / (8 * size)))
        self._step = span / count
        self._times: Array = np.full(count, np.nan)
        self._states: Array = np.empty((count, size))
        self._newest: Array = np.empty(size)
        self._row = -1  # row of the newest stored state
        self.end = 0.0

    @property
    def begin(self) -> float:
        known = self._times[self._times >= self.end - self._span]
        return float(known.min()) if len(known) else self.end

    def add(self) -> None:
        time = float(self._data.time)
        if time < self.end:
            self._times[:] = np.nan
            self._row = -1
        self.end = time
        mujoco.mj_getState(self._model, self._data, self._newest, _STATE)
        if self._row < 0 or time >= self._times[self._row] + self._step:
            self.store()

    def store(self) -> None:
        """Stores the newest state, even if the previous one is recent."""
        self._row = (self._row + 1) % len(self._times)
        self._times[self._row], self._states[self._row] = self.end, self._newest

    def put_back(self) -> None:
        mujoco.mj_setState(self._model, self._data, self._newest, _STATE)

    def show(self, time: float) -> None:
        """Restores the last state up to a time in seconds, or the oldest state."""
        count = len(self._times)
        order = (self._row + 1 + np.arange(count)) % count  # oldest state first
        order = order[np.isfinite(self._times[order])]
        if not len(order):
            return
        place = int(np.searchsorted(self._times[order], time + 1e-9, "right")) - 1
        row = order[max(place, 0)]
        mujoco.mj_setState(self._model, self._data, self._states[row], _STATE)
        follow(self._model, self._data)
