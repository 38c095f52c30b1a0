from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.cli import main
from sero_mj.cli.arguments import read_scene
from sero_mj.extensions.explain.base_parameters import standard_torques
from sero_mj.extensions.explain.links.identify_links import (
    WholeRobot,
    identify_links,
    prediction_errors,
)
from sero_mj.extensions.explain.links.report import as_json
from sero_mj.extensions.explain.links.robot_files import write_identified
from sero_mj.extensions.explain.torque_residuals import torque_residuals
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.runs.run_log import RunLog

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks" / "verdicts"))

from plant import Log, Plant, load_robot

SHARES = (1.25, 0.8)  # true masses over declared masses of odd and even links


def heavier(spec: mujoco.MjSpec) -> None:
    for k, joint in enumerate(spec.joints):
        body = joint.parent
        body.mass *= SHARES[k % 2]
        body.inertia = np.array(body.inertia) * SHARES[k % 2]
        body.fullinertia = np.array(body.fullinertia) * SHARES[k % 2]


def plant(name: str, seed: int, duration: float = 6.0) -> Plant:
    made = Plant(load_robot(name), np.random.default_rng(seed), duration=duration)
    made.edits.append(heavier)
    return made


@cache
def logged(name: str, seed: int) -> Log:
    return plant(name, seed).run()


def run_of(name: str, seed: int, *, sensors: bool = True, log: Log | None = None) -> RunLog:
    log = logged(name, seed) if log is None else log
    robot = read_scene(load_robot(name).scene).robots[name]
    signals = {"joint_angles": log.angles, "commanded_torques": log.commands}
    signals |= {"torques": log.torques} if sensors else {}
    signals = {f"{name}_{key}": value for key, value in signals.items()}
    return RunLog({name: robot}, signals, log.times, f"run{seed}")


def true_links(whole: WholeRobot) -> np.ndarray:
    """Returns the base parameters of the true model, by inverse dynamics of MuJoCo."""
    made = plant(whole.robot.name, 1)
    model = made._true_model(made.edits)
    data, states = mujoco.MjData(model), np.random.default_rng(0).normal(size=(3, 60, model.nv))
    torques = np.empty(states.shape[1:])
    for q, v, a, torque in zip(*states, torques, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        torque[:] = data.qfrc_inverse - model.dof_armature * a
    X = whole.base.columns(standard_torques(whole.robot, *states)).reshape(torques.size, -1)
    return np.linalg.lstsq(X, torques.ravel(), rcond=None)[0]


@cache
def identified(name: str, sensors: bool = True) -> WholeRobot:
    return identify_links(run_of(name, 1, sensors=sensors), name)


@pytest.mark.parametrize("sensors", [True, False])
def test_links_are_identified_without_their_declared_masses(sensors: bool) -> None:
    whole = identified("g3", sensors)
    true = true_links(whole)
    estimates = whole.estimates[: len(true)]
    distances = np.array([(each.value - value) / each.error
                          for each, value in zip(estimates, true, strict=True)])  # fmt: skip
    if not sensors:  # the motor inertias of the first joints count as link inertia
        is_inertia = ["Izz" in each for each in whole.base.names]
        assert [each.partition(":")[0] for each in whole.reasons] == [
            "motor inertia of joint_1", "motor inertia of joint_2",
        ]  # fmt: skip
        distances = distances[~np.array(is_inertia)]
    assert np.mean(np.abs(distances) < 3.0) > 0.97
    heavy = next(k for k, each in enumerate(whole.base.names) if each.startswith("joint_2.hy"))
    assert estimates[heavy].error < 0.01
    assert whole.values[heavy] == pytest.approx(true[heavy], abs=0.01)
    known = robot_dynamics(whole.identified)
    assert (np.linalg.eigvalsh(known.tensors) > 0).all() and (known.masses > 0).all()
    plants = load_robot("g3")
    np.testing.assert_allclose(known.coulomb_friction, plants.coulomb, atol=0.02)
    np.testing.assert_allclose(known.viscous_friction, plants.viscous, atol=0.03)
    np.testing.assert_allclose(known.motor_inertias[2:], plants.motor_inertias[2:], atol=0.01)


@pytest.mark.parametrize("sensors", [True, False])
def test_torques_of_another_run_are_predicted(sensors: bool) -> None:
    rows = prediction_errors(identified("g3", sensors), run_of("g3", 2, sensors=sensors), "g3")
    assert [each.side for each in rows] == ["link"] * 7 * sensors + ["drive"] * 7
    for each in rows[:6]:
        assert each.after < 0.01
        assert each.after < 0.3 * each.before


@pytest.mark.parametrize("ending", [".toml", ".urdf", ".xml"])
def test_written_robots_can_be_read_and_explain_the_torques(tmp_path: Path, ending: str) -> None:
    whole, file = identified("g3"), tmp_path / f"found{ending}"
    write_identified(whole, file)
    assert "joint_7.Izz: 0.000" in file.read_text("utf-8")
    expected = robot_dynamics(whole.identified)
    if ending == ".xml":
        model = mujoco.MjModel.from_xml_path(str(file))
        links = [model.body(f"g3/link{i + 1}").mass[0] for i in range(7)]
        np.testing.assert_allclose(links, expected.masses[1:], rtol=1e-5)
        return
    robot = SerialRobot.from_model(str(file), name="g3")
    found = robot_dynamics(robot)
    np.testing.assert_allclose(found.masses, expected.masses, rtol=1e-5)
    np.testing.assert_allclose(found.tensors, expected.tensors, atol=1e-8)
    np.testing.assert_allclose(found.coulomb_friction, expected.coulomb_friction, rtol=1e-5)
    run = run_of("g3", 2)
    before = torque_residuals(run, "g3").link
    after = torque_residuals(replace(run, robots={"g3": robot}), "g3").link
    assert (np.sqrt(np.nanmean(after**2, axis=0)) < 0.02).all()
    assert np.nanmean(after**2) < 1e-3 * np.nanmean(before**2)


def test_urdf_needs_a_urdf_robot(tmp_path: Path) -> None:
    whole = replace(identified("g3"), robot=SerialRobot.from_model("lwr"))
    with pytest.raises(
        DeclarationError, match=r"is not from a URDF file; expected --scene robot\.urdf"
    ):
        write_identified(whole, tmp_path / "found.urdf")


def test_needed_parameters_are_added_and_others_are_not() -> None:
    optional = {"stribeck_friction", "load_friction", "angle_offset", "tilt"}
    assert not optional & {each.kind for each in identified("g3").parameters}
    made = plant("fr3", 3)
    offset = np.radians(1.5)
    made.encoders.append(lambda q: q + offset * (np.arange(7) == 3))
    made.friction.append(
        lambda s: 0.8 * np.tanh(s.v / 0.003) * np.exp(-((s.v / 0.1) ** 2)) * (np.arange(7) == 1)
    )
    made.friction.append(
        lambda s: 0.1 * np.tanh(s.v / 0.003) * np.abs(s.torques) * (np.arange(7) == 3)
    )
    whole = identify_links(run_of("fr3", 3, log=made.run()), "fr3")
    found = {name: each for name, (each, _) in whole.named().items()}
    assert found["fr3_joint4.angle_offset"].value == pytest.approx(-offset, abs=2e-3)
    assert found["fr3_joint2.stribeck_friction"].value == pytest.approx(0.8, abs=0.1)
    assert found["fr3_joint4.load_friction"].value == pytest.approx(0.1, abs=0.01)


@pytest.mark.thorough
def test_base_that_is_not_level_is_identified() -> None:
    made = plant("fr3", 4)
    made.edits.append(lambda spec: setattr(spec.option, "gravity", [0.3, 0.0, -9.805]))
    whole = identify_links(run_of("fr3", 4, log=made.run()), "fr3")
    tilt = whole.named()["base.tilt_y"][0]
    assert tilt.value == pytest.approx(np.arctan2(0.3, 9.805), abs=1e-3)


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["identify", *map(str, arguments)])
    return int(ended.value.code or 0)


def test_command_identifies_validates_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"run{seed}.csv" for seed in (1, 2)]
    for seed, file in enumerate(files, 1):
        logged("g3", seed).write(file)
    scene, found = load_robot("g3").scene, tmp_path / "found.toml"
    options = [files[0], "--scene", scene, "--links", "--validate", files[1]]
    assert command(*options, "-o", found) == 0
    out = capsys.readouterr().out
    assert "base parameter" in out and "joint_7.Izz" in out
    assert "run2: errors of predicted torques" in out
    assert len(tomllib.loads(found.read_text("utf-8"))["dynamics"]["masses"]) == 8
    table, options = tmp_path / "found.csv", [files[0], "--scene", scene, "--links"]
    assert command(*options, "--jobs", 1, "--table", table) == 0
    assert "joint_7.Izz [kg m2]" in capsys.readouterr().out


def test_results_are_json() -> None:
    errors = prediction_errors(identified("g3"), run_of("g3", 2), "g3")
    printed = json.loads(json.dumps(as_json(identified("g3"), errors)))
    assert len(printed["prediction_errors"]) == 14
    assert len(printed["parameters"]) == 43 + 5 * 7
    assert printed["parameters"][42]["name"] == "joint_7.Iyz"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--validate", "x.mcap"], "--validate needs --links"),
        (["-o", "x.urdf"], "--output: found 'x.urdf'; expected a name that ends in .toml"),
        (["--links", "--plot", "x.pdf"], "--plot is not available with --links"),
    ],
)
def test_options_of_other_modes_are_rejected(
    capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert command("run.mcap", *arguments) == 2
    assert expected in capsys.readouterr().err


def test_runs_that_do_not_suit_are_rejected() -> None:
    run = run_of("g3", 1)
    still = {
        **run.signals,
        "g3_joint_angles": np.tile(run.signals["g3_joint_angles"][0], (6000, 1)),
    }
    with raises_with(UsageError, key="run1", reason="no joint of 'g3' moves"):
        identify_links(replace(run, signals=still, derived={}), "g3")
    with pytest.raises(UsageError, match="run2 has no measured torques, in contrast to run1"):
        prediction_errors(identified("g3"), run_of("g3", 2, sensors=False), "g3")
