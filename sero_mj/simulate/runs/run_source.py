"""`RunSource`: a run as a source, finished or simulated while it is shown."""

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

_AGE, _OLD = "_command_age", 0.02  # s, of a command that is told


class Run(Protocol):
    """What a `RunSource` shows: a `FinishedRun`, or a `Simulation`, which computes rows.

    Attributes:
        about: what it is, for people.
        structure: of a row as a packet; its first number is the time, s.
        rows: (T, width), float64, in the order of their times.
        times: of the rows, (T,), s; those of later rows have to be right.
        step: the last row that is there.
        drag_force: pulls the robots by hand while they are simulated; None where nothing does.
        live: changes targets and controllers while they run; None where nothing does.
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
        """What a monitor finds in the rows until now."""


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A complete run.

    Attributes:
        about: what it is, for people.
        structure: of a row as a packet; its first number is the time, s.
        rows: (T, width), float64, in the order of their times.
    """

    about: str
    structure: Structure
    rows: Array
    drag_force: None = None
    live: None = None

    @cached_property
    def times(self) -> Array:
        """Times of the rows, (T,), s."""
        return np.ascontiguousarray(self.rows[:, 0])

    @property
    def step(self) -> int:
        """The last row."""
        return len(self.rows) - 1

    def advance(self, to_step: int) -> None:
        """Does nothing: all rows exist."""

    def findings(self) -> list[Finding]:
        """None: its rows alone do not say what they are."""
        return []


class RunSource(Source):
    """The rows of a run as packets, passed on when the clock reaches their times.

    It has no thread: whoever drives it says what time it is, so a film is the same however long
    rendering takes. A simulation that cannot go on stays where it is: `error` says why.

    Attributes:
        run: what is shown.
        error: why it cannot go on; None while it can.
        end: time of the last row, s.
        step: median time between two rows, s.
    """

    name: str = "simulation"
    structure: str = ""
    column_major: bool = False
    run: Any = Field(exclude=True)

    _structure_is: ClassVar[str] = "that of the run"
    _shown: int = PrivateAttr(-1)
    _error: SimulationError | None = PrivateAttr(None)

    def __reduce__(self) -> Any:
        """Pickles what is declared; of a run that is over its rows."""
        make, (kind, fields) = super().__reduce__()
        run = self.run
        if run.step >= len(run.rows) - 1:
            fields = {**fields, "run": FinishedRun(run.about, run.structure, run.rows)}
        return make, (kind, fields)

    @cached_property
    def layout(self) -> Structure:
        """The decoder."""
        structure: Structure = self.run.structure
        return structure

    @property
    def error(self) -> SimulationError | None:
        """Why it cannot go on."""
        return self._error

    @property
    def end(self) -> float | None:
        """Time of the last row, s."""
        return float(self.run.rows[-1, 0])

    @property
    def step(self) -> float | None:
        """Median time between two rows, s."""
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
        """Kind and what it is, for people."""
        return f"{self.run.about}, {self.end:g} s"

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Age of the oldest command of a program that holds a robot, s, and 0; -1 without one."""
        ages = [float(values[event][0]) for event in self.events if event.endswith(_AGE)]
        return (max(ages), 0.0) if ages else (-1.0, -1.0)

    def link_faults(self, state: float, quality: float) -> list[str]:
        """Which commands do not come."""
        return [f"no command for {state:.2f} s"] if state > _OLD else []

    @property
    def is_live(self) -> bool:
        """False: packets follow `advance_to`."""
        return False

    def now(self) -> float:
        """The time of the row that is shown, s."""
        return float(self.run.rows[max(self._shown, 0), 0])

    def open(self) -> None:
        """Goes to the start."""
        self.reset()
        self._shown = -1
        self.advance_to(0.0)

    def close(self) -> None:
        """Ends the programs that control the robots; a run that is shown again starts them anew."""
        end = getattr(self.run, "close", None)
        if end is not None:
            end()

    def wait(self, timeout: float) -> bool:
        """Whether there are packets at all; nothing is to be waited for."""
        return True

    def _before(self, row: int) -> int:
        return -1

    def advance_to(self, time: float) -> None:
        """Passes on all rows up to a time, s; computes missing ones."""
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
        if row < self._shown:  # the clock went back: it is a new film, say
            self.reset()
            self._shown = self._before(row)
        if row > self._shown:
            rows = np.ascontiguousarray(run.rows[self._shown + 1 : row + 1])
            packets = rows.view(np.uint8).reshape(len(rows), -1)
            self._accept(packets, np.full(len(rows), self.size), rows[:, 0])
            self._shown = row
