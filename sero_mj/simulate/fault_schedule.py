"""`FaultSchedule`: the faults of a run, ordered by step, in one of the rows of a plant."""

from __future__ import annotations

from functools import partial

from ..base.frames import Array
from .disturbances import Fault
from .due_actions import DueActions
from .plant import Plant
from .scenario import Scenario


class FaultSchedule:
    """Lets the faults of a scenario begin and end.

    Args:
        scenario: with its faults.
        plant: in which they are.
        due: what they are put to.
        gains: (n,), factors of the commanded torques, after the limits: those of faulty drives;
            to be written.
    """

    def __init__(self, scenario: Scenario, plant: Plant, due: DueActions, gains: Array) -> None:
        self._scenario, self._plant, self._gains = scenario, plant, gains
        self._active: list[Fault] = []
        model, parts = plant.world.model, plant.world.robots
        self._friction = {
            name: (model.dof_damping[part.dofs].copy(), model.dof_frictionloss[part.dofs].copy())
            for name, part in parts.items()
        }
        for fault in scenario.faults.values():
            due.add(fault.begin, partial(self._begin, fault))
            if fault.end is not None:
                due.add(fault.end, partial(self._end, fault))

    def _begin(self, fault: Fault) -> None:
        self._active.append(fault)
        self._apply(fault)

    def _apply(self, fault: Fault) -> None:
        fault.apply(self._plant, fault.rows(self._scenario.scene.robots), self._gains)

    def _end(self, fault: Fault) -> None:
        """Ends a fault; others of the same part are applied again in their order."""
        self._active = [other for other in self._active if other is not fault]
        others = [other for other in self._active if other.part == fault.part]

        def apply_others() -> None:
            for other in others:
                self._apply(other)

        if fault.part == "sensors":
            self._plant.sensors.end_faults(apply_others)
            return
        if fault.part == "drives":
            self._gains[:] = 1.0
        else:
            for name, (viscous, coulomb) in self._friction.items():
                self._plant.set_friction(name, viscous, coulomb)
        apply_others()
