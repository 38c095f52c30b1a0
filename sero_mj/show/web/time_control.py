"""Connects Studio's simulation controls and history to the clock of a mirror."""

from __future__ import annotations

import time

from mujoco.studio import messages, plugin, sim, sim_history

from ..clock import Clock

_RUNS = sim.PauseState.UNPAUSED
_PAUSED = sim.PauseState.NORMAL_PAUSED


class TimeControl(plugin.SimPlugin):
    """Replaces Studio's `StepControl`: time and state are those of the mirror.

    Args:
        clock: of the mirror.

    Attributes:
        is_held: whether time is stopped because no browser has connected yet.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last = time.monotonic()
        self._is_scrubbed = False
        self.is_held = False

    def snapshot(self) -> messages.StepControlSnapshot:
        """Returns the state of Studio's controls."""
        control = sim.StepControl()
        control.set_pause_state(_PAUSED if self._clock.is_paused else _RUNS)
        control.set_speed(100.0 * self._clock.speed)
        return messages.StepControlSnapshot.from_step_control(control)

    @messages.handler
    def on_step_control(self, event: messages.StepControlSnapshot) -> bool:
        """Applies pause and speed that were set on the page."""
        wanted = event.pause_state != _RUNS
        if wanted != self._clock.is_paused:
            self._clock.pause()
        if not self._clock.is_live:
            self._clock.speed = self._clock.real_speed = max(event.speed / 100.0, 1e-3)
        return True

    @messages.handler
    def on_single_step(self, event: messages.SingleStepEvent) -> bool:
        """Advances by a single step."""
        self._clock.step()
        return True

    @messages.handler
    def on_pause(self, event: messages.RequestPauseEvent) -> bool:
        """Pauses when the user opens Studio's history."""
        self._clock.is_paused = event.pause_state != _RUNS
        return True

    @messages.handler
    def on_reset(self, event: messages.ResetEvent) -> bool:
        """Resets the mirror to the start, not the data to zero as Studio does."""
        self._clock.reset()
        return True

    @messages.handler
    def on_history(self, event: sim_history.SimHistorySnapshot) -> None:
        """Handles the selection of a past state, which `SimHistory` writes to the data."""
        self._is_scrubbed = True

    @messages.handler
    def on_step(self, event: messages.StepEvent) -> None:
        """Advances the mirror to the current time."""
        now = time.monotonic()
        passed, self._last = now - self._last, now
        clock = self._clock
        with self.handle.send_if_changes(self.snapshot):
            if self._is_scrubbed and clock.is_live and not clock.is_paused:
                self._is_scrubbed = False
                clock.reset()  # the current state, not the one that the history has written
            if self._is_scrubbed and not clock.is_live:
                self._is_scrubbed = False
                clock.seek(event.data.time)
            clock.advance(0.0 if self.is_held else passed)
