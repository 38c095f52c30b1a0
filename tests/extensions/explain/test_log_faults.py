"""Wrong columns of a recording are detected, and faults of the robot are not faults of the log."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
import pytest
from conftest import sampled

from sero_mj.base.errors import SimulationError
from sero_mj.base.frames import Array
from sero_mj.extensions.explain.explain import explain_run, explain_runs
from sero_mj.extensions.explain.log_faults import log_faults
from sero_mj.extensions.explain.torque_residuals import torque_residuals
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.explanation import ALL_JOINTS, LOGGED, Explanation

HOMES = {"lwr": [0, 30, 0, -90, 0, 60, 0], "fr3": [0, -20, 10, -110, 10, 100, 30]}
ANGLES, MEASURED, COMMANDED = ("joint_angles",), ("torques",), ("commanded_torques",)
TORQUES, ALL = MEASURED + COMMANDED, ANGLES + MEASURED + COMMANDED
DEGREES = 180.0 / np.pi


@cache
def moved(robot: str, seed: int = 0, fault: str = "{}", load: str = "{}") -> RunLog:
    """Returns a run with sines of other frequencies at each joint."""
    rng = np.random.default_rng(seed)
    angles = np.deg2rad(np.array(HOMES[robot]) + rng.uniform(-10.0, 10.0, 7))
    sine = {"kind": "sine", "amplitude_deg": rng.uniform(6.0, 14.0, 7).tolist(),
            "frequency": rng.uniform(0.3, 0.7, 7).tolist(),
            "phase": rng.uniform(0.0, 6.0, 7).tolist()}  # fmt: skip
    faults, loads = json.loads(fault), json.loads(load)
    scenario = Scenario(
        Scene(robots=[SerialRobot.from_model(robot, joint_angles=angles)], floor=False),
        controllers={robot: {"kind": "joint_impedance", "stiffness": 800}},
        targets={robot: sine},
        sensors={robot: {"angles": {"resolution": 1e-5}, "torques": {"noise": 0.03}}},
        faults={"it": faults} if faults else None,
        disturbances={"load": loads} if loads else None,
        duration=2.6, seed=seed, name="moved",
    )  # fmt: skip
    simulation = Simulation(scenario)
    with suppress(SimulationError):
        for _ in simulation.run():
            pass
    return simulation.log


def columns(
    log: RunLog, signals: tuple[str, ...], order: Any = None, factors: Any = None
) -> RunLog:
    """Returns the log with columns in another order, and multiplied by factors."""
    (name,) = log.robots
    order = list(range(7)) if order is None else list(order)
    changed = {f"{name}_{signal}": log.of(name, signal)[:, order] for signal in signals}
    if factors is not None:
        changed = {event: values * factors for event, values in changed.items()}
    return RunLog(log.robots, {**log.signals, **changed}, log.times, log.name)


def at(joints: list[int], factor: float) -> Array:
    factors = np.ones(7)
    factors[joints] = factor
    return factors


def exchanged(i: int, j: int) -> list[int]:
    order = list(range(7))
    order[i], order[j] = j, i
    return order


def found_in(log: RunLog) -> tuple[list[Explanation], RunLog]:
    (name,) = log.robots
    return log_faults(log, name, torque_residuals(log, name))


CASES = {
    "angle": ("sign", "angles", ANGLES, None, at([3], -1.0)),
    "two angles": ("sign", "angles", ANGLES, None, at([1, 3], -1.0)),
    "measured": ("sign", "measured torques", MEASURED, None, at([*range(7)], -1.0)),
    "commanded": ("sign", "commanded torques", COMMANDED, None, at([*range(7)], -1.0)),
    "both torques of a joint": ("sign", "torques", TORQUES, None, at([3], -1.0)),
    "angles exchanged": ("swap", "angles", ANGLES, exchanged(1, 3), None),
    "measured exchanged": ("swap", "measured torques", MEASURED, exchanged(1, 3), None),
    "commanded exchanged": ("swap", "commanded torques", COMMANDED, exchanged(1, 3), None),
    "all exchanged": ("swap", "signals", ALL, exchanged(1, 3), None),
    "angles in another order": ("order", "angles", ANGLES, np.roll(range(7), 1), None),
    "torques in another order": ("order", "torques", TORQUES, np.roll(range(7), 2), None),
    "degrees": ("scale", "angles", ANGLES, None, at([*range(7)], DEGREES)),
    "one joint in degrees": ("scale", "angles", ANGLES, None, at([1], DEGREES)),
    "motor angle": ("scale", "angles", ANGLES, None, at([1], -100.0)),
    "wrong ratio": ("scale", "angles", ANGLES, None, at([1], 0.8)),
    "mNm": ("scale", "measured torques", MEASURED, None, at([*range(7)], 1e3)),
    "motor torque": ("scale", "torques", TORQUES, None, at([*range(7)], 0.01)),
}


# One case of each kind and signal; the others are repetitions.
QUICK = ("angle", "commanded", "all exchanged", "angles in another order", "degrees", "motor angle")


@pytest.mark.parametrize(
    "case", sampled(sorted(CASES, key=lambda each: each not in QUICK), len(QUICK))
)
@pytest.mark.parametrize(("robot", "seed"), sampled([["lwr", 0], ["fr3", 1], ["lwr", 2]], 1))
def test_wrong_columns_are_named_and_corrected(case: str, robot: str, seed: int) -> None:
    kind, part, signals, order, factors = CASES[case]
    log = moved(robot, seed)
    wrong = columns(log, signals, order, factors)
    (fault,), corrected = found_in(wrong)
    assert (fault.kind, fault.part) == (kind, part), fault
    assert fault.confidence > 0.7
    changed = factors if order is None else np.array(order) - np.arange(7) + 1
    assert fault.joints == tuple(np.array(log.robots[robot].names)[changed != 1.0])
    assert (fault.joint == ALL_JOINTS) == (len(fault.joints) == 7)
    for signal in ALL:  # fitted factors have an error of up to 2 %
        expected = log.of(robot, signal)
        np.testing.assert_allclose(corrected.of(robot, signal), expected, rtol=0.02, atol=1e-3)
    if kind == "scale" and factors is not None:
        assert fault.size == pytest.approx(factors[1], rel=0.02)
    if kind in ("sign", "swap", "order") and order is not None:
        exact = torque_residuals(log, robot)
        corrected_link = torque_residuals(corrected, robot).link
        np.testing.assert_allclose(corrected_link, exact.link, atol=1e-9)


@pytest.mark.parametrize(
    "fault",
    sampled(
        [
            {},
            {"kind": "sensor", "gain": -1.0},
            {"kind": "controller", "gain": 1.3},
            {"kind": "encoder_offset", "offset_deg": 3.0},
            {"kind": "friction", "added_coulomb": 1000},
            {"kind": "sensor", "gain": 0.8},
            {"kind": "sensor", "bias": -4.0},
            {"kind": "sensor", "delay_ms": 40},
            {"kind": "sensor", "noise": 0.6},
            {"kind": "dead_sensor"},
            {"kind": "friction", "added_coulomb": 3.0},
        ],
        5,
    ),
)
@pytest.mark.parametrize(("robot", "seed"), sampled([["lwr", 0], ["fr3", 1]], 1))
def test_faults_of_the_robot_are_not_faults_of_the_log(
    fault: dict[str, Any], robot: str, seed: int
) -> None:
    joint = SerialRobot.from_model(robot).names[1]
    described = {**fault, "joints": [joint], "begin": 0.0} if fault else {}
    assert found_in(moved(robot, seed, json.dumps(described)))[0] == []


def test_wrong_columns_of_a_second_robot_are_named() -> None:
    log = moved("fr3", 1)
    for case in ("angle", "angles exchanged", "mNm"):
        kind, part, signals, order, factors = CASES[case]
        (fault,), _ = found_in(columns(log, signals, order, factors))
        assert (fault.kind, fault.part) == (kind, part)


@pytest.mark.parametrize("mass", sampled([4.0, 1.0], 1))
def test_payload_is_not_a_fault_of_the_log(mass: float) -> None:
    load = {"kind": "payload", "robot": "lwr", "mass": mass, "center_of_mass": [0.02, 0.0, 0.1]}
    assert found_in(moved("lwr", 0, load=json.dumps(load)))[0] == []


@pytest.mark.parametrize("angle", [15.0, 180.0])
def test_tilted_base_is_not_a_fault_of_the_log(angle: float) -> None:
    log, c, s = moved("lwr"), np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    base = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
    robots = {"lwr": log.robots["lwr"].model_copy(update={"base_frame": base})}
    assert found_in(RunLog(robots, log.signals, log.times, log.name))[0] == []


def test_wrong_sign_of_all_angles_or_all_torques_is_ambiguous_for_a_symmetric_robot() -> None:
    """The inverse dynamics of an LWR change their sign with all angles."""
    fault, *_ = found_in(columns(moved("lwr"), TORQUES, None, -np.ones(7)))[0]
    assert fault.confidence <= 0.5
    causes = " or ".join((fault.text, *fault.alternatives))
    assert "wrong sign of the angles" in causes
    assert "wrong sign of the torques" in causes


def test_search_continues_with_the_corrected_signals() -> None:
    bias = {"kind": "sensor", "bias": -4.0, "joints": ["A3"], "begin": 1.3}
    log = columns(moved("lwr", 0, json.dumps(bias)), ANGLES, exchanged(1, 3))
    fault, sensor = explain_run(log, "lwr")
    evidence = fault.evidence
    assert evidence is not None and evidence.joint in fault.joints
    assert (evidence.side, evidence.quantity) == ("link", "angle")
    assert fault.next == "move one joint after the other, and check its column"
    before, after = (np.nanmax(np.abs(each)) for each in (evidence.before, evidence.after))
    assert after < 0.2 * before
    assert (fault.kind, fault.joints) == ("swap", ("A2", "A3"))
    assert str(fault) == "swap: the angles of A2 and A3 are exchanged in the log, from the start"
    assert fault.short == "swap (angles)"
    assert (sensor.joint, sensor.kind) == ("A3", "bias")
    assert sensor.size == pytest.approx(-4.0, abs=0.1)


def test_wrong_log_of_the_second_run_is_reported_for_it() -> None:
    log = moved("lwr")
    (fault,) = explain_runs(log, columns(log, MEASURED, exchanged(1, 3)), ("lwr", "lwr"))
    assert (fault.kind, fault.part, fault.is_second) == ("swap", "measured torques", True)
    assert fault.part in LOGGED and fault.text.endswith("in the log, in B")
