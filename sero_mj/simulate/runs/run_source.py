"""`RunSource`: a source for a finished run, or for a run that is simulated while it is shown."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
from pydantic import Field, PrivateAttr

from ...base.errors import SimulationError
from ...base.frames import Array
from ...data.receive.source import Source
from ...data.receive.structure import Structure
from .monitor import Finding

log = logging.getLogger(__name__)

# Suffix of the events with ages of commands, and minimum age that is reported, s.
_AGE, _OLD = "_command_age", 0.02


class Run(Protocol):
    """The run that a `RunSource` shows: a `FinishedRun`, or a `Simulation`, which computes rows.

    Attributes:
        about: title for users.
        structure: packet structure of a row, whose first value is the time in seconds.
        rows: rows of the log in chronological order, shape (T, width), float64.
        times: times of the rows, shape (T,), s; also correct for rows that are not computed yet.
        step: index of the last computed row.
        drag_force: object that applies drag forces to links; None if that is not possible.
        live: object that changes targets and controllers; None if that is not possible.
    """

    @property
    def about(self) -> str: ...
    @property
    def structure(self) -> Structure: ...
    @property
    def rows(self) -> Array: ...
    @property
    def times(self) -> Array: ...
    @property
    def step(self) -> int: ...
    @property
    def drag_force(self) -> Any: ...
    @property
    def live(self) -> Any: ...

    def advance(self, to_step: int) -> None:
        """Computes the rows up to a step."""

    def findings(self) -> list[Finding]:
        """Returns the detected faults in the computed rows."""


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run whose rows are all computed.

    Attributes:
        about: title for users.
        structure: packet structure of a row, whose first value is the time in seconds.
        rows: rows of the log in chronological order, shape (T, width), float64.
    """

    about: str
    structure: Structure
    rows: Array
    drag_force: None = None
    live: None = None

    @cached_property
    def times(self) -> Array:
        return np.ascontiguousarray(self.rows[:, 0])

    @property
    def step(self) -> int:
        return len(self.rows) - 1

    def advance(self, to_step: int) -> None:
        """Does nothing, because all rows exist."""

    def findings(self) -> list[Finding]:
        """Returns no faults, because a run without its scenario cannot be monitored."""
        return []


class RunSource(Source):
    """A source that receives the rows of a run as packets when the clock reaches their times.

    It has no thread. The caller passes the time to `advance_to`, so a video does not depend on the
    speed of rendering. If a simulation cannot continue, it stops, and `error` has the reason.

    Attributes:
        run: run whose rows are received.
        error: error that stopped the run, or None.
        end: time of the last row, s.
        step: median time between two rows, s.
    """

    name: str = "simulation"
    structure: str = ""
    column_major: bool = False
    run: Any = Field(exclude=True)

    _structure_is: ClassVar[str] = "determined by the run"
    _shown: int = PrivateAttr(-1)
    _error: SimulationError | None = PrivateAttr(None)

    def __reduce__(self) -> Any:
        """Pickles the declaration. A finished run is pickled as a `FinishedRun`."""
        make, (kind, fields) = super().__reduce__()
        run = self.run
        if run.step >= len(run.rows) - 1:
            fields = {**fields, "run": FinishedRun(run.about, run.structure, run.rows)}
        return make, (kind, fields)

    @cached_property
    def layout(self) -> Structure:
        structure: Structure = self.run.structure
        return structure

    @property
    def error(self) -> SimulationError | None:
        return self._error

    @property
    def end(self) -> float | None:
        return float(self.run.rows[-1, 0])

    @property
    def step(self) -> float | None:
        times = self.run.times
        return float(np.median(np.diff(times))) if len(times) > 1 else None

    @property
    def drag_force(self) -> Any:
        return self.run.drag_force

    @property
    def live(self) -> Any:
        return self.run.live

    @property
    def about(self) -> str:
        return f"{self.run.about}, {self.end:g} s"

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Returns the maximum age of external controllers' commands in seconds, and 0.

        If there are no external controllers, both values are -1.
        """
        ages = [float(values[event][0]) for event in self.events if event.endswith(_AGE)]
        return (max(ages), 0.0) if ages else (-1.0, -1.0)

    def link_faults(self, state: float, quality: float) -> list[str]:
        return [f"no command for {state:.2f} s"] if state > _OLD else []

    @property
    def is_live(self) -> bool:
        return False

    def now(self) -> float:
        return float(self.run.rows[max(self._shown, 0), 0])

    def open(self) -> None:
        self.reset()
        self._shown = -1
        self.advance_to(0.0)

    def close(self) -> None:
        """Ends the programs that control robots. They restart if the run is shown again."""
        end = getattr(self.run, "close", None)
        if end is not None:
            end()

    def wait(self, timeout: float) -> bool:
        return True

    def _before(self, row: int) -> int:
        return -1

    def advance_to(self, time: float) -> None:
        """Receives all rows up to a time in seconds, and computes missing rows."""
        run = self.run
        times = run.times
        row = int(np.searchsorted(times, time + 1e-9, side="right")) - 1
        if row > run.step and self._error is None:
            try:
                run.advance(row)
            except SimulationError as error:
                self._error = error
                log.warning("source '%s': the run has ended: %s", self.name, error)
        row = min(row, run.step)
        if row < self._shown:  # the clock was set back, for example for a new video
            self.reset()
            self._shown = self._before(row)
        if row > self._shown:
            rows = np.ascontiguousarray(run.rows[self._shown + 1 : row + 1])
            packets = rows.view(np.uint8).reshape(len(rows), -1)
            self._accept(packets, np.full(len(rows), self.size), rows[:, 0])
            self._shown = row
