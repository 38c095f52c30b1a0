"""Late or reversed angles are corrected before other faults are searched."""

from __future__ import annotations

import numpy as np
import pytest

from sero_mj.extensions.explain.corrected_angles import with_correct_angles
from sero_mj.extensions.explain.explain import explain_run
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.explanation import ALL_JOINTS, Explanation


@pytest.fixture(scope="module")
def log() -> RunLog:
    robot = SerialRobot.from_model("lwr", joint_angles_deg=[0, 30, 0, -90, 0, 60, 0])
    scenario = Scenario(
        Scene(robots=[robot], floor=False),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": 800}},
        targets={"lwr": {"kind": "sine", "amplitude_deg": 15, "phase": [0, 1, 2, 3, 4, 5, 6],
                         "frequency": [0.5, 0.6, 0.7, 0.8, 0.6, 0.7, 0.9]}},
        sensors={"lwr": {"torques": {"noise": 0.03}}},
        duration=3.2, name="moved",
    )  # fmt: skip
    simulation = Simulation(scenario)
    for _ in simulation.run():
        pass
    return simulation.log


def changed(log: RunLog, angles: np.ndarray) -> RunLog:
    return RunLog(log.robots, {**log.signals, "lwr_joint_angles": angles}, log.times, log.name)


def fault(joint: str, kind: str, part: str, size: float, unit: str) -> Explanation:
    joints = ("A1", "A2", "A3") if joint == ALL_JOINTS else (joint,)
    return Explanation(
        joint, kind, part, size, unit, 0.001, 0.9, 0.0, from_start=True, joints=joints
    )  # type: ignore[arg-type]


def test_delay_is_refined_and_removed(log: RunLog) -> None:
    delay, angles = 0.05, log.of("lwr", "joint_angles")
    late = np.stack([np.interp(log.times - delay, log.times, each) for each in angles.T], axis=1)
    approximate = fault(ALL_JOINTS, "delay", "angles", 0.04, "s")
    found = with_correct_angles(changed(log, late), "lwr", [approximate])
    assert found is not None
    explanation, correct = found
    assert explanation.size == pytest.approx(delay, abs=0.002)
    rows = len(correct.times)
    np.testing.assert_allclose(correct.of("lwr", "joint_angles"), angles[:rows], atol=2e-3)
    (verdict,) = [each for each in explain_run(changed(log, late), "lwr") if each.confidence > 0.7]
    assert (verdict.joint, verdict.kind, verdict.part) == (ALL_JOINTS, "delay", "angles")
    assert verdict.size == pytest.approx(delay, abs=0.002)


def test_reversed_angle_is_a_fault_of_the_log(log: RunLog) -> None:
    angles = log.of("lwr", "joint_angles") * [1, 1, 1, 1, 1, 1, -1]
    found = with_correct_angles(
        changed(log, angles), "lwr", [fault("A6", "encoder scale", "encoder", 195.0, "%")]
    )
    assert found is not None
    explanation, correct = found
    assert (explanation.kind, explanation.part) == ("sign", "angles")
    np.testing.assert_array_equal(correct.of("lwr", "joint_angles"), log.of("lwr", "joint_angles"))


@pytest.mark.parametrize("kind", ["encoder scale", "encoder", "friction"])
def test_other_faults_are_not_corrected(log: RunLog, kind: str) -> None:
    assert with_correct_angles(log, "lwr", [fault("A6", kind, "encoder", 3.0, "%")]) is None


def test_delays_of_drives_are_not_late_angles(log: RunLog) -> None:
    delays = [fault(joint, "delay", "drive", 0.02, "s") for joint in ("A1", "A2", "A3", "A4")]
    assert with_correct_angles(log, "lwr", delays) is None
