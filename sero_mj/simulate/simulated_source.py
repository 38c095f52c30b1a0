"""`SimulatedSource`: a simulation as a source, so that a mirror shows it like a robot."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from ..assemble.scene import Scene
from ..errors import SimulationError
from ..receive.receiver import Receiver
from ..receive.structure import Structure
from .simulation import Simulation
from .staging import add_paths, stage

Array = NDArray[np.float64]


class SimulatedSource(Receiver):
    """The rows of a simulation's log as packets, simulated when the clock reaches them.

    It has no thread: whoever drives it says what time it is, so a film is the same however long
    rendering takes. A simulation that cannot go on stays where it is: `error` says why.

    Attributes:
        simulation: what is shown.
        error: why it cannot go on; None while it can.
    """

    name: str = "simulation"
    structure: str = ""
    column_major: bool = False
    simulation: Simulation = Field(exclude=True)

    _shown: int = PrivateAttr(-1)
    _error: SimulationError | None = PrivateAttr(None)

    @field_validator("structure")
    @classmethod
    def _structure_parses(cls, text: str, info: ValidationInfo) -> str:
        if text:
            raise ValueError("is what the simulation logs; leave it out")
        return text

    @cached_property
    def layout(self) -> Structure:
        """The decoder."""
        return self.simulation.layout.structure

    @property
    def error(self) -> SimulationError | None:
        """Why it cannot go on."""
        return self._error

    @property
    def about(self) -> str:
        """Kind and what it is, for people."""
        scenario = self.simulation.scenario
        return f"simulation of {scenario.name}, {scenario.run.duration:g} s"

    @property
    def is_live(self) -> bool:
        """Packets come when they are wanted."""
        return False

    @property
    def end(self) -> float | None:
        """How long it is simulated, s."""
        return float(self.simulation.scenario.run.duration)

    @property
    def step(self) -> float | None:
        """The time step, s."""
        return float(self.simulation.scenario.run.timestep)

    def now(self) -> float:
        """The simulated time, s."""
        return float(self.simulation.rows[max(self._shown, 0), 0])

    def open(self) -> None:
        """Goes to the start."""
        self.reset()
        self._shown = -1
        self.advance_to(0.0)

    def close(self) -> None:
        """Nothing is to be freed."""

    def wait(self, timeout: float) -> bool:
        """Whether there are packets at all; nothing is to be waited for."""
        return True

    def advance_to(self, time: float) -> None:
        """Simulates until then, s since the start."""
        simulation = self.simulation
        row = min(int(time / simulation.scenario.run.timestep + 1e-6), simulation.steps)
        if row > simulation.step and self._error is None:
            try:
                simulation.advance(row)
            except SimulationError as error:
                self._error = error
                self._warn(str(error))
        row = min(row, simulation.step)
        if row < self._shown:  # the clock went back: it is a new film, say
            self.reset()
            self._shown = -1
        if row > self._shown:
            rows = simulation.rows[self._shown + 1 : row + 1]
            packets = rows.view(np.uint8).reshape(len(rows), -1)
            self._accept(packets, np.full(len(rows), self.size), rows[:, 0])
            self._shown = row


def staged(simulation: Simulation) -> Scene:
    """Returns the scene of a simulation, which is simulated while it is shown.

    Rows of doubles stand along the targets' paths where `[run]` asks for them.
    """
    scenario, layout = simulation.scenario, simulation.layout
    scene = stage(scenario, layout, SimulatedSource(simulation=simulation))
    if scenario.run.show_paths:
        add_paths(scene, scenario, layout, simulation.rows)
    return scene
