"""Writes a simulation's log to a recording, and provides its signals for sending."""

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

SIGNALS_RATE = 5.0  # default number of JSON rows per simulated second, for plotting programs


class RunRecorder:
    """Writes rows of a simulation's log to a recording, as if they had been received.

    A replay of the recording looks like the simulation, and `sero-mj compare` can read it. Use the
    recorder as a context manager.

    Args:
        path: output file (`.mcap`).
        overwrite: whether to replace an existing file.
        signals_rate: number of rows per simulated second that are also stored as JSON; 0 for none.

    Raises:
        RecordingError: the file exists, or cannot be written.
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
        """Writes the log rows `first` to `stop - 1`. Raises RecordingError if the disk is full."""
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
    """Returns the files of the scenario, its scene and its models."""
    own = [] if scenario.file is None else [scenario.file.absolute()]
    return list(dict.fromkeys(file for file in [*own, *scenario.scene.files()] if file.is_file()))


class LogSignals:
    """The logged signals of one simulated robot, in the form that `sero-mj send` requires."""

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
        """Returns the signals in the log row that is nearest to a time in seconds."""
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
