"""Saves a run with drags as a recording, and as a scenario that repeats the pushes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import SeroError, UnknownName, UsageError
from ..base.paths import find_scenario
from ..robots.importers.toml_text import toml_text
from .drag_force import Pull
from .log_output import RunRecorder
from .scenario import Scenario
from .simulation import Simulation

_DIGITS = 9  # decimal places of times in seconds


def save_pushes(simulation: Simulation, folder: Path) -> Path:
    """Saves a run with drags as `NAME_pushed.toml` and `NAME_pushed.mcap`.

    Args:
        folder: output folder. If a file exists, a number is appended to the name.

    Returns:
        path of the scenario. It extends the original scenario, and repeats the run exactly with the
            drag forces as disturbances.

    Raises:
        UsageError: nothing was dragged, or the scenario was not read from a file.
        RecordingError: the recording cannot be written.
        SeroError: the scenario cannot be written.
    """
    scenario, drag = simulation.scenario, simulation.drag_force
    pulls = [] if drag is None else [pull for pull in drag.pulls if pull.forces]
    if not pulls:
        raise UsageError("there are no pushes to save. Hold Ctrl and drag a link")
    if scenario.file is None:
        raise UsageError("the scenario was made in Python; only a scenario file can be extended")
    path = _unused(folder, f"{scenario.name}_pushed")
    timestep = scenario.run.timestep
    names = (f"push{i}" for i in range(1, 10**6))
    free = (name for name in names if name not in scenario.disturbances)
    settings = {key: _plain(value) for key, value in scenario.settings.items()}
    if simulation.plant.sensors.seed != scenario.run.seed:
        settings["run.seed"] = simulation.plant.sensors.seed
    tables: dict[str, Any] = {
        "extends": _named(scenario, folder),
        "description": f"{scenario.name}, pushed by drag",
        **({"set": settings} if settings else {}),
        "disturbances": {
            name: _disturbance(pull, timestep) for name, pull in zip(free, pulls, strict=False)
        },
    }
    with RunRecorder(simulation, path.with_suffix(".mcap")) as recorder:
        recorder.write(0, simulation.step + 1)
    try:
        path.write_text(toml_text(tables), "utf-8")
    except OSError as error:
        raise SeroError(f"{path} cannot be written: {error.strerror}") from error
    return path


def save_run(simulation: Simulation, folder: Path) -> Path:
    """Saves the log of a run as `NAME.mcap`. If the file exists, a number is appended to the name.

    Raises:
        RecordingError: the file cannot be written.
    """
    path = _unused(folder, simulation.scenario.name).with_suffix(".mcap")
    with RunRecorder(simulation, path) as recorder:
        recorder.write(0, simulation.step + 1)
    return path


def _disturbance(pull: Pull, timestep: float) -> dict[str, Any]:
    forces = np.array(pull.forces)
    changes = np.append(True, (forces[1:] != forces[:-1]).any(axis=1)).nonzero()[0]
    samples = [
        [round(int(k) * timestep, _DIGITS), *(float(value) + 0.0 for value in forces[k])]
        for k in changes
    ]
    return {
        "kind": "force",
        "at": pull.at,
        "point": pull.point.tolist(),
        "begin": round(pull.first * timestep, _DIGITS),
        "end": round((pull.first + len(forces)) * timestep, _DIGITS),
        "samples": samples,
    }


def _named(scenario: Scenario, folder: Path) -> str:
    assert scenario.file is not None
    try:
        if find_scenario(scenario.file.stem).samefile(scenario.file):
            return scenario.file.stem
    except UnknownName:
        pass
    return Path(os.path.relpath(scenario.file, folder)).as_posix()


def _unused(folder: Path, stem: str) -> Path:
    path, count = folder / f"{stem}.toml", 2
    while path.exists() or path.with_suffix(".mcap").exists():
        path = folder / f"{stem}_{count}.toml"
        count += 1
    return path


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
