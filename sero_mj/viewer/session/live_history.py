"""`LiveHistory`: the states of a live mirror in the last minute."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ...data.drive.place import follow

SPAN = 60.0  # s
_RATE = 30.0  # states per s
_MAX_BYTES = 64e6  # for all states; large worlds store fewer states per second
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class LiveHistory:
    """The newest state of a live mirror, and about 30 states per second of the last minute.

    While a past state is shown, call `put_back` before the mirror advances.
    """

    def __init__(self, mirror: LiveWorld, span: float = SPAN) -> None:
        self._model, self._data = mirror.world.model, mirror.data
        self._span = span
        size = mujoco.mj_stateSize(self._model, _STATE)
        count = int(min(span * _RATE, _MAX_BYTES / (8 * size)))
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
        """Restores the last state before a time, s, or the oldest state."""
        count = len(self._times)
        order = (self._row + 1 + np.arange(count)) % count  # the oldest first
        order = order[np.isfinite(self._times[order])]
        if not len(order):
            return
        place = int(np.searchsorted(self._times[order], time + 1e-9, "right")) - 1
        row = order[max(place, 0)]
        mujoco.mj_setState(self._model, self._data, self._states[row], _STATE)
        follow(self._model, self._data)
