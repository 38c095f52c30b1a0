"""Outputs of a simulation's log: a recording, and the signals of sent packets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np

from .. import __version__
from ..base.frames import Array
from ..data.drive.record_sources import joint_names, joint_states_of
from ..data.record.recording_format import Signals, media_type
from ..data.record.recording_writer import RecordingWriter
from ..data.record.scene_files import attached_files
from .runs.run_log import MEASURED, PER_JOINT, event_of
from .scenario import Scenario
from .simulated_scene import SOURCE
from .simulation import Simulation

SIGNALS_RATE = 5.0  # decoded rows per simulated second, for programs that plot; 0 for none


class RunRecorder:
    """Writes rows of a simulation's log into a recording, as if they had just been received.

    A replay shows it like the simulation itself, and `sero-mj compare` reads it. Use it as a
    context manager.

    Args:
        path: where to, OUT.mcap.
        overwrite: write over a file that exists.
        signals_rate: of how many rows per simulated second the values are kept as JSON as well.

    Raises:
        RecordingError: the file exists already, or cannot be written.
    """

    def __init__(
        self,
        simulation: Simulation,
        path: Path,
        *,
        overwrite: bool = False,
        signals_rate: float = SIGNALS_RATE,
    ) -> None:
        scenario, layout = simulation.scenario, simulation.layout
        about = {"sero-mj": __version__, "scene": scenario.name, "seed": str(scenario.run.seed)}
        self._simulation = simulation
        self._writer = RecordingWriter(path, about=about, overwrite=overwrite)
        self._begin = self._writer.clock.monotonic_ns / 1e9
        self._writer.add_source(
            SOURCE,
            kind="udp",
            declared={"structure": layout.structure.text, "column_major": False},
            events={name: tuple(shape) for name, shape in layout.structure.events.items()},
            size=layout.structure.size,
            signals=_signals_of(simulation),
        )
        for name, file in attached_files(scenario.scene, files_of(scenario)).items():
            self._writer.attach(name, media_type(name), file.read_bytes())
        timestep = scenario.run.timestep
        self._every = max(round(1.0 / (signals_rate * timestep)), 1) if signals_rate > 0 else 0

    def write(self, first: int, stop: int) -> None:
        """Writes these rows of the log; raises RecordingError when the disk is full."""
        simulation, writer, begin = self._simulation, self._writer, self._begin
        rows = simulation.rows[first:stop]
        writer.write_rows(SOURCE, rows.view(np.uint8), begin + rows[:, 0])
        picked = range(-first % self._every, stop - first, self._every) if self._every else ()
        if picked:
            thin = rows[picked.start :: self._every]
            numbers = [first + k for k in picked]
            writer.write_signal_rows(SOURCE, thin, begin + thin[:, 0], numbers)
        writer.flush_if_old()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._writer.close()


def _signals_of(simulation: Simulation) -> Signals:
    events = simulation.layout.structure.events
    shapes = {name: tuple(shape) for name, shape in events.items()}
    names: dict[str, list[str]] = {}
    for name, robot in simulation.scenario.scene.robots.items():
        for signal in PER_JOINT:
            if (event := event_of(name, signal)) in shapes:
                names[event] = joint_names(name, robot, signal)
    origins = {
        each: f"{event}[{i}]" for event, found in names.items() for i, each in enumerate(found)
    }
    joints = joint_states_of(simulation.scenario.scene.robots, shapes, event_of)
    return Signals(shapes, names, origins, joints)


def files_of(scenario: Scenario) -> list[Path]:
    """The scenario's file, its scene's, and those of its models."""
    own = [] if scenario.file is None else [scenario.file.absolute()]
    return list(dict.fromkeys(file for file in [*own, *scenario.scene.files()] if file.is_file()))


class LogSignals:
    """The signals of one robot of a simulation at any time until now; stands in for a motion.

    Args:
        robot: whose signals.
    """

    def __init__(self, simulation: Simulation, robot: str) -> None:
        self._simulation = simulation
        self._robot = simulation.scenario.scene.robots[robot]
        columns = simulation.layout.columns
        self._columns = {
            signal: columns[event_of(robot, signal)]
            for signal in (*MEASURED, "commanded_torques", "target_angles", "external_torques")
            if event_of(robot, signal) in columns
        }

    def signals(self, t: float) -> Mapping[str, Array]:
        """What is measured at time t, s."""
        simulation, timestep = self._simulation, self._simulation.scenario.run.timestep
        row = min(round(t / timestep), simulation.step)
        found = {signal: simulation.rows[row, columns] for signal, columns in self._columns.items()}
        angles, velocities = found["joint_angles"], found["joint_velocities"]
        before = simulation.rows[max(row - 1, 0), self._columns["joint_velocities"]]
        return {
            **found,
            "commanded_angles": found.get("target_angles", angles),
            "joint_accelerations": (velocities - before) / timestep,
            "billboard_values": velocities,
            "flange_check": self._robot.fwd_kin_base_to_flange(angles),
            "further": found["external_torques"],
        }
