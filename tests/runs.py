"""Synthetic and simulated runs for tests, and recordings of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recording_format import RecordingClock
from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

Array = NDArray[np.float64]

HOME = np.deg2rad([0.0, 30.0, 0.0, -90.0, 0.0, 60.0, 0.0])


def two_joints(name: str = "arm", **fields: object) -> SerialRobot:
    """Returns a robot with a revolute and a prismatic joint."""
    declared: dict[str, object] = {
        "dh_convention": "craig",
        "dh_params": [[0.0, 0.0, 0.0, 0.2], [0.0, 0.3, 0.0, 0.0]],
        "joint_types": ["revolute", "prismatic"],
        "joint_names": ["turn", "slide"],
        "torque_limits": [10.0, 100.0],
    }
    return SerialRobot(**{**declared, "name": name, **fields})


def sine_run(
    *,
    rate: float = 1000.0,
    duration: float = 4.0,
    delay: float = 0.0,
    start: float = 0.0,
    robot: SerialRobot | None = None,
    amplitude: float = 3.0,
    name: str = "run",
) -> RunLog:
    """Returns a motion that never repeats; torque errors are sines of `amplitude` Nm and 2 Hz."""
    robot = robot or two_joints()
    times = start + np.arange(round(duration * rate) + 1) / rate
    t = times - delay
    angles = np.stack([np.sin(1.3 * t) + 0.4 * np.sin(0.9 * (t + 5.0) ** 1.5), 0.1 * np.cos(t)], 1)
    measured = np.stack([4.0 * np.cos(t), 20.0 * np.sin(t)], axis=1)
    commanded = measured + amplitude * np.sin(4.0 * np.pi * t)[:, None]
    signals = {
        f"{robot.name}_joint_angles": angles,
        f"{robot.name}_torques": measured,
        f"{robot.name}_commanded_torques": commanded,
    }
    return RunLog({robot.name: robot}, signals, times, name)


@cache
def simulated(stiffness: float = 800.0, duration: float = 0.5) -> Simulation:
    """Returns a simulation of an LWR that swings under joint impedance."""
    lwr = SerialRobot.from_model("lwr", joint_angles=HOME)
    scenario = Scenario(
        Scene(robots=[lwr]),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": stiffness}},
        targets={"lwr": {"kind": "sine", "amplitude_deg": 5.0, "frequency": 2.0}},
        duration=duration,
        name="swing",
    )
    simulation = Simulation(scenario)
    for _ in simulation.run():
        pass
    return simulation


def in_old_words(text: str) -> str:
    """Returns a text in which measured angles and velocities have their former names."""
    return text.replace("_joint_angles", "_angles").replace("_joint_velocities", "_velocities")


def record_run(
    simulation: Simulation, path: Path, *, attach: bool = True, is_old: bool = False
) -> Path:
    """Records a simulation like `sero-mj simulate --record`."""
    structure = simulation.layout.structure
    if is_old:
        structure = Structure(in_old_words(structure.text), column_major=False)
    with RecordingWriter(path, about={"scene": "swing"}) as writer:
        writer.add_source(
            "simulation",
            kind="udp",
            declared={"structure": structure.text, "column_major": False},
            events=structure.events,
            size=structure.size,
        )
        for robot in simulation.log.robots.values() if attach else ():
            assert robot._model is not None
            writer.attach("lwr/robot.toml", "application/toml", robot._model.read_bytes())
        begin = writer.clock.monotonic_ns / 1e9
        for row in simulation.rows:
            writer.write_raw("simulation", row.tobytes(), begin + row[0])
    return path


def record_packets(
    path: Path,
    structure: str,
    rows: Mapping[str, Array],
    times: Array,
    files: Mapping[str, str],
    source: str = "udp",
    clock: RecordingClock | None = None,
) -> Path:
    """Records packets like `sero-mj record`: unchanged, with the files of the scene."""
    layout = Structure(structure)
    with RecordingWriter(path, about={"scene": "mine"}, clock=clock) as writer:
        writer.add_source(
            source,
            kind="udp",
            declared={"structure": structure},
            events=layout.events,
            size=layout.size,
        )
        for name, text in files.items():
            writer.attach(name, "application/toml", text.encode())
        begin = writer.clock.monotonic_ns / 1e9 + 2.0  # the first packet is delayed
        for i, time in enumerate(times):
            packet = layout.encode({event: values[i] for event, values in rows.items()})
            writer.write_raw(source, packet, begin + time)
    return path
