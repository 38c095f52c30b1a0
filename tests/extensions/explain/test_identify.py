from __future__ import annotations

import csv
import json
import re
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from runs import HOME, record_run, simulated

from sero_mj.base.errors import UsageError
from sero_mj.cli import main
from sero_mj.extensions.explain.identify import _brief, as_toml, identify, remarks
from sero_mj.extensions.explain.regression import Estimate, regression
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog, event_of
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

MASS, DURATION = 2.5, 6.0


def excited(
    seed: int,
    *,
    moved: tuple[int, ...] = tuple(range(7)),
    loop: bool = False,
    mass: float = MASS,
) -> tuple[Simulation, dict[str, list[float]]]:
    """Returns an LWR that moves by sums of sines, and its true parameters."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, DURATION, 121)
    phases = rng.uniform(0.0, 6.0, (3, 7))
    swing = sum(
        np.sin(2.0 * np.pi * f * t[:, None] + phase) - np.sin(phase)
        for f, phase in zip((0.2, 0.45, 0.8), phases, strict=True)
    )
    size = np.deg2rad(rng.uniform(5.0, 8.0, 7)) * np.isin(np.arange(7), moved)
    angles = HOME + size * swing * np.clip(t / 1.5, 0.0, 1.0)[:, None] ** 2
    center, bias = rng.uniform(-0.05, 0.1, 3), rng.uniform(-2.0, 2.0, 7)
    lwr = SerialRobot.from_model("lwr", joint_angles=HOME)
    scenario = Scenario(
        Scene(robots=[lwr], floor=False),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": 1500}},
        targets={"lwr": {"kind": "recorded", "times": t, "angles": angles}},
        sensors={"lwr": {"angles": {"resolution": 1e-5}, "torques": {"noise": 0.05, "bias": bias}}},
        disturbances={"load": {"kind": "payload", "robot": "lwr", "mass": mass,
                               "center_of_mass": center}} if mass else None,
        duration=DURATION, seed=seed, torque_control=loop, name="excited",
    )  # fmt: skip
    simulation = Simulation(scenario)
    for _ in simulation.run():
        pass
    known = robot_dynamics(lwr)
    true = {
        "coulomb_friction": known.coulomb_friction.tolist(),
        "viscous_friction": known.viscous_friction.tolist(),
        "motor_inertia": known.motor_inertias.tolist(),
        "torque_offset": bias.tolist(),
        "center": center.tolist(),
    }
    return simulation, true


@cache
def log_of(seed: int, moved: tuple[int, ...] = tuple(range(7)), loop: bool = False) -> RunLog:
    return excited(seed, moved=moved, loop=loop)[0].log


@pytest.mark.thorough
def test_parameters_of_a_simulated_robot_are_within_three_standard_errors() -> None:
    distances: list[float] = []
    for seed in range(4):
        simulation, true = excited(seed)
        found = identify(simulation.log, "lwr")
        pairs = [(found.mass, MASS), *zip(found.center, true.pop("center"), strict=True)]
        for key, values in true.items():
            pairs += [(getattr(each, key), value)
                      for each, value in zip(found.joints, values, strict=True)]  # fmt: skip
        assert len(pairs) == 4 + 4 * 7
        for estimate, value in pairs:
            assert estimate.value is not None
            assert estimate.error is not None
            distances.append((estimate.value - value) / estimate.error)
        assert found.mass.error is not None
        assert found.mass.error < 0.01
        assert all((each.coulomb_friction.error or 1.0) < 0.02 for each in found.joints)
    sizes = np.abs(distances)
    assert np.mean(sizes < 3.0) >= 0.97
    assert sizes.max() < 4.5
    assert 0.5 < np.sqrt(np.mean(sizes**2)) < 1.5  # the errors are neither too small nor too large


@pytest.mark.thorough
def test_parameters_not_excited_by_the_motion_are_not_reported() -> None:
    found = identify(log_of(1, (0, 3)), "lwr")
    told = {each.joint for each in found.joints if each.coulomb_friction.value is not None}
    assert {"A1", "A3"} <= told <= {"A1", "A2", "E1", "A3"}  # these joints are pushed by the others
    assert found.joints[6].coulomb_friction.reason == "the run moves A6 too little"
    assert not np.isfinite(found.joints[6].condition)
    assert found.joints[3].condition < 20.0
    assert "the run moves A6 too little" in " ".join(remarks(found))
    # Gravity is constant, but reported offsets are true nevertheless.
    simulation, true = excited(1, moved=(0,))
    about_itself = identify(simulation.log, "lwr")
    assert about_itself.mass.value is None
    assert "the run moves the flange too little (condition number" in str(about_itself.mass.reason)
    assert about_itself.joints[0].torque_offset.value is not None
    for each, value in zip(about_itself.joints, true["torque_offset"], strict=True):
        offset = each.torque_offset
        if offset.value is None or offset.error is None:
            assert offset.reason is not None
            assert f"moves {each.joint} too little to separate offset and load" in offset.reason
        else:
            assert abs(offset.value - value) < 4.0 * offset.error


def test_friction_is_not_reported_with_joint_torque_control() -> None:
    found = identify(log_of(2, loop=True), "lwr")
    reasons = {each.coulomb_friction.reason for each in found.joints}
    assert reasons == {"joint torque control compensates friction"}
    assert found.mass.value == pytest.approx(MASS, abs=0.03)


def test_links_are_identified_without_commands() -> None:
    log = log_of(0)
    signals = {key: value for key, value in log.signals.items() if "commanded" not in key}
    found = identify(RunLog(log.robots, signals, log.times, "mute"), "lwr")
    assert found.joints[0].viscous_friction.reason == "the run has no commanded torques"
    assert found.mass.value == pytest.approx(MASS, abs=0.03)


def test_missing_payload_is_reported_as_not_significant() -> None:
    found = identify(excited(5, mass=0.0)[0].log, "lwr")
    assert not found.has_payload
    assert found.mass.value == pytest.approx(0.0, abs=0.02)
    assert remarks(found)[0].startswith("payload: not significant (")
    assert "payload" not in as_toml(found).replace("sensors and payloads", "")


def test_offsets_of_coupled_joints_are_not_reported() -> None:
    log = log_of(0)
    arm = SerialRobot.from_model("lwr", couplings={"A6": {"to": "A5", "ratio": -1.0}})
    found, apart = identify(replace(log, robots={"lwr": arm}), "lwr"), identify(log, "lwr")
    for mine, other in zip(found.joints[:5], apart.joints[:5], strict=True):
        assert mine.torque_offset.value == pytest.approx(other.torque_offset.value, abs=0.1)
    assert [each.torque_offset.value for each in found.joints[5:]] == [None, None]
    assert found.mass.value == pytest.approx(MASS, abs=0.05)


def test_lifting_force_is_neither_payload_nor_offset() -> None:
    log = log_of(0)
    raised = dict(log.signals)
    key = event_of("lwr", "torques")
    raised[key] = raised[key] - 2.0 * (raised[key] - raised[key].mean(axis=0))
    found = identify(replace(log, signals=raised), "lwr")
    assert found.mass.value is None and "another force acts on the robot" in str(found.mass.reason)
    assert all(each.torque_offset.value is None for each in found.joints)


def test_negative_inertia_is_not_reported() -> None:
    log = log_of(0)
    wrong = dict(log.signals)
    key, other = event_of("lwr", "commanded_torques"), event_of("lwr", "torques")
    wrong[key] = wrong[key].copy()
    wrong[key][:, 1] = 2.0 * wrong[other][:, 1] - wrong[key][:, 1]
    found = identify(replace(log, signals=wrong), "lwr")
    a2 = found.joints[1].motor_inertia
    assert a2.value is None and re.search(
        r"A2 would have -[0-9.]+ ± [0-9.e-]+ kg m2", a2.reason or ""
    )


def test_output_lines_are_valid_in_a_robot_file() -> None:
    found = identify(log_of(1, (0, 3)), "lwr")
    text = as_toml(found)
    dynamics = tomllib.loads(text)["dynamics"]
    again = robot_dynamics(SerialRobot.from_model("lwr", dynamics=dynamics))
    before = robot_dynamics(SerialRobot.from_model("lwr"))
    np.testing.assert_allclose(again.coulomb_friction, before.coulomb_friction, atol=0.02)
    np.testing.assert_array_equal(again.viscous_friction[[5, 6]], before.viscous_friction[[5, 6]])
    assert "# not identifiable from the run, unchanged: " in text
    # The rest is for a scenario, once uncommented.
    text = as_toml(identify(log_of(0), "lwr"))
    rest = text[text.index("# [sensors") :].replace("# standard", "#standard").replace("# ", "")
    scenario = tomllib.loads(rest.replace("standard errors", "#").replace("##", "#"))
    assert len(scenario["sensors"]["lwr"]["torques"]["bias"]) == 7
    assert scenario["disturbances"]["payload"]["mass"] == pytest.approx(MASS, abs=0.05)


def test_autocorrelated_residuals_increase_the_errors() -> None:
    rng = np.random.default_rng(3)
    K = 1500
    x = np.cumsum(rng.normal(size=K)) / 30.0 + np.sin(np.arange(K) / 50.0)
    X = np.stack([x, np.ones(K)], axis=1)[:, None]
    values, spread = [], []
    for _ in range(60):
        noise = np.zeros(K)
        for k in range(1, K):  # AR(1)
            noise[k] = 0.8 * noise[k - 1] + rng.normal()
        found = regression(X, (X[:, 0] @ [2.0, -1.0] + noise)[:, None])
        values.append(found.values)
        spread.append(np.sqrt(np.diag(found.covariance)))
    assert np.mean(values, axis=0) == pytest.approx([2.0, -1.0], abs=0.15)
    ratio = np.mean(spread, axis=0) / np.std(values, axis=0)
    assert ((ratio > 0.7) & (ratio < 1.4)).all(), ratio


def test_estimates_show_only_significant_digits() -> None:
    assert str(Estimate(1.23456, 0.02)) == "1.235 ± 0.02"
    assert str(Estimate(-0.00001, 0.001)) == "-0.0000 ± 0.001"
    assert str(Estimate(None, None, "because")) == "-"


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["identify", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.mark.thorough
def test_identify_writes_lines_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = record_run(excited(0)[0], tmp_path / "run.mcap")
    picture, lines = tmp_path / "fit.svg", tmp_path / "found.toml"
    assert command(recording, "--robot", "lwr", "--plot", picture, "-o", lines) == 0
    out = capsys.readouterr().out
    assert "run: lwr, 0.000 s to 6.000 s" in out
    assert re.search(r"payload: 2\.(49|50)\d* ± 0\.\d+ kg at \(", out)
    assert len(tomllib.loads(lines.read_text(encoding="utf-8"))["dynamics"]) == 2
    text = picture.read_text(encoding="utf-8")
    assert "run: lwr identified" in text
    assert "residual rms" in text
    assert command(recording, "--from", 1, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["begin"] == pytest.approx(1.0)
    assert found["payload"]["mass"]["value"] == pytest.approx(MASS, abs=0.03)
    assert len(found["joints"]) == 7


def test_several_recordings_have_one_row_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [record_run(excited(seed)[0], tmp_path / f"run{seed}.mcap") for seed in (0, 1)]
    table = tmp_path / "found.csv"
    assert command(*runs, "--table", table, "--jobs", 1) == 0
    (line,) = [each for each in capsys.readouterr().out.splitlines() if "payload.mass" in each]
    words = line.split()
    assert words[:5] == ["payload.mass", "[kg]", "2", "of", "2"]
    median, lowest, highest = (float(words[k]) for k in (5, 6, 8))
    assert {words[7], words[9]} == {path.name for path in runs}
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == list(map(str, runs))
    masses = sorted(float(row["payload.mass"]) for row in rows)
    assert masses == pytest.approx([MASS, MASS], abs=0.03) and masses[0] < masses[1]
    assert (lowest, highest) == pytest.approx(masses, abs=1e-3)
    assert median == pytest.approx(sum(masses) / 2, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            ["--table", "x.csv", "--plot", "x.pdf"],
            "--plot needs a single recording without --table",
        ),
        (["--robot", "lwx"], "--robot: no robot 'lwx' in run; did you mean 'lwr'?"),
        (["--plot", "x.jpg"], "--plot: found 'x.jpg'; expected a name that ends in .png, .pdf"),
        (["-o", "x.txt"], "--output: found 'x.txt'; expected a name that ends in .toml"),
        (["--from", "3", "--to", "2"], "--to: found 2; expected more than 3 s"),
        (["--to", "0.2"], "run has 0.2 s of 'lwr'"),
    ],
)
def test_invalid_arguments_are_rejected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    recording = record_run(simulated(), tmp_path / "run.mcap")
    assert command(recording, *arguments) == 2
    assert expected in capsys.readouterr().err


def test_runs_without_torques_or_motion_are_rejected() -> None:
    log = log_of(0)
    angles = {"lwr_joint_angles": log.of("lwr", "joint_angles")}
    with raises_with(
        UsageError, key="silent", reason="has no measured torques of 'lwr'", expected="`torques`"
    ):
        identify(RunLog(log.robots, angles, log.times, "silent"), "lwr")
    still = {**log.signals, "lwr_joint_angles": np.tile(HOME, (len(log.times), 1))}
    expected = {"reason": "no joint of 'lwr' moves", "expected": "a run that moves the robot"}
    with raises_with(UsageError, key="still", **expected):
        identify(RunLog(log.robots, still, log.times, "still"), "lwr")


def test_zero_has_no_sign() -> None:
    assert [_brief(Estimate(value)) for value in (-0.0004, -0.0006)] == ["0.000", "-0.001"]
    assert _brief(Estimate(None)) == "unknown"
