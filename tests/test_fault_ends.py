"""Faults that end: the faulty component recovers, and other faults remain."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import ACTUAL, MEASURED
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.sensors import SIGNALS
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.plot import spans_of

HOME = np.deg2rad([0.0, 30.0, 0.0, -90.0, 0.0, 60.0, 0.0])
A1, A2, A3, A4 = (0, 1, 3, 4)  # the third joint is E1
SWING = {"kind": "sine", "amplitude_deg": 10.0, "frequency": 1.0}
BIAS = {"kind": "sensor", "signal": "torques", "joints": ["A3"], "bias": 3.0}


def scenario(duration: float = 0.6, **fields: Any) -> Scenario:
    robot = SerialRobot.from_model("lwr", joint_angles=HOME)
    return Scenario(
        Scene(robots=[robot]),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": 1500.0}},
        targets={"lwr": SWING},
        duration=duration,
        **fields,
    )


def ran(**fields: Any) -> Simulation:
    simulation = Simulation(scenario(**fields))
    for _ in simulation.run():
        pass
    return simulation


def during(begin: float, end: float | None, **fault: Any) -> dict[str, Any]:
    return {**fault, "begin": begin, "end": end}


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "sensor", "signal": "torques", "bias": 2.0, "noise": 0.5, "delay_ms": 7.0},
        {"kind": "encoder_offset", "joints": ["A2"], "offset_deg": 1.0},
        {"kind": "dead_sensor", "signal": "velocities", "joints": ["A4"]},
        {"kind": "frozen_sensor", "signal": "torques"},
        {"kind": "frozen_sensor", "signal": "angles", "joints": ["A1"]},
    ],
)
def test_sensors_recover_after_a_fault(fault: dict[str, Any]) -> None:
    log = ran(faults={"it": during(0.2, 0.3, **fault)}).log
    for signal in SIGNALS:
        row = SIGNALS.index(signal)
        measured, actual = log.of("lwr", MEASURED[row]), log.of("lwr", ACTUAL[row])
        differs = (measured != actual).any(axis=1)
        assert not differs[:201].any() and not differs[301:].any()
        assert differs[201:301].any() == (signal == fault.get("signal", "angles"))


def test_drives_and_bearings_recover_after_a_fault() -> None:
    drive = {"kind": "controller", "joints": ["A2"], "gain": 0.0}
    dry = {"kind": "friction", "joints": ["A1"], "added_coulomb": 40.0, "viscous": 3.0}
    simulation = ran(duration=3.0, faults={"a": during(0.2, 0.3, **drive),
                                           "b": during(0.2, 0.4, **dry)})  # fmt: skip
    whole = ran(duration=3.0)
    for key in ("dof_frictionloss", "dof_damping"):
        np.testing.assert_array_equal(
            getattr(simulation.plant.model, key), getattr(whole.plant.model, key)
        )
    angles, expected = (each.log.of("lwr", "joint_angles") for each in (simulation, whole))
    assert np.abs(angles - expected)[200:400].max() > 0.02
    assert np.abs(angles - expected)[-1].max() < 1e-3


def test_noise_after_a_fault_is_the_same_as_without_it() -> None:
    noisy = {"sensors": {"lwr": {"torques": {"noise": 0.1, "resolution": 0.01, "delay": 3}}}}
    fault = {"it": during(0.2, 0.3, **BIAS)}
    once, never = (ran(**noisy, **each).log for each in ({"faults": fault}, {}))
    differs = (once.of("lwr", "torques") != never.of("lwr", "torques")).any(axis=0)
    assert np.flatnonzero(differs).tolist() == [A3]
    np.testing.assert_array_equal(once.of("lwr", "torques")[305:], never.of("lwr", "torques")[305:])


def test_other_faults_remain_when_one_ends() -> None:
    log = ran(
        faults={
            "dead": during(0.1, None, kind="dead_sensor", joints=["A2"]),
            "frozen": during(0.15, 0.5, kind="frozen_sensor", joints=["A4"]),
            "late": during(0.1, 0.45, kind="sensor", signal="angles", joints=["A1"], delay_ms=20),
            "later": during(0.2, 0.3, kind="sensor", signal="angles", joints=["A3"], delay_ms=40),
            "off": during(0.2, 0.3, **BIAS),
            "more": during(0.25, 0.4, **{**BIAS, "bias": 5.0}),
        }
    ).log
    measured, actual = log.of("lwr", "torques"), log.of("lwr", "actual_torques")
    assert not measured[101:, A2].any()
    assert np.ptp(measured[150:501, A4]) == 0.0 and np.ptp(measured[501:, A4]) > 0.0
    np.testing.assert_allclose((measured - actual)[201:251, A3], 3.0)
    np.testing.assert_allclose((measured - actual)[251:401, A3], 5.0)
    np.testing.assert_array_equal(measured[401:, A3], actual[401:, A3])
    angles, true = log.of("lwr", "joint_angles"), log.of("lwr", "actual_angles")
    np.testing.assert_array_equal(angles[130:451, A1], true[110:431, A1])
    np.testing.assert_array_equal(angles[451:, A1], true[451:, A1])
    np.testing.assert_array_equal(angles[245:301, A3], true[205:261, A3])
    np.testing.assert_array_equal(angles[301:, A3], true[301:, A3])


def test_overlapping_drive_faults_end_one_by_one() -> None:
    weak = {"kind": "controller", "joints": ["A2"], "gain": 0.9}
    weaker = {**weak, "joints": ["A2", "A3"], "gain": 0.8}
    simulation = Simulation(
        scenario(faults={"a": during(0.1, 0.3, **weak), "b": during(0.2, 0.4, **weaker)})
    )
    gains = simulation._schedule.gains
    for step, expected in ((150, [0.9, 1.0]), (250, [0.8, 0.8]), (350, [0.8, 0.8]), (450, [1, 1])):
        simulation.advance(step)
        assert gains[[A2, A3]].tolist() == expected
    assert (gains == 1.0).all()


def test_plot_shows_when_a_fault_ends() -> None:
    (span,) = spans_of(scenario(faults={"it": during(0.2, 0.3, **BIAS)}))
    assert (span.begin, span.end, span.is_fault) == (0.2, 0.3, True)


@pytest.mark.parametrize(
    ("end", "problem"),
    [
        ("0.02", Problem("faults.x.end", found=0.02, expected="a time after begin (0.05 s)")),
        ("0.05", Problem("faults.x.end", found=0.05, expected="a time after begin (0.05 s)")),
        ("'soon'", Problem("faults.x.end", found="soon", expected="number")),
        ("nan", Problem("faults.x.end", found=math.nan, expected="a finite number")),
        ("inf", Problem("faults.x.end", found=math.inf, expected="a finite number")),
    ],
)
def test_invalid_fault_ends_are_rejected(tmp_path: Path, end: str, problem: Problem) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        f"[robots.lwr]\nmodel = 'lwr'\n[run]\nduration = 0.1\n"
        f"[faults.x]\nkind = 'dead_sensor'\nbegin = 0.05\nend = {end}\n"
    )
    with pytest.raises(DeclarationError) as caught:
        read_scenario(file)
    assert caught.value.problems == [replace(problem, file=str(file), line=8)]
