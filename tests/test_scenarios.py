"""Scenarios: files, their errors, and their expectations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import DeclarationError, Problem, SimulationError, UnknownName
from sero_mj.base.paths import list_scenarios
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.disturbances import Force
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.sections import is_scenario
from sero_mj.simulate.simulation import Simulation

HOME = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]


def lwr(**fields: Any) -> SerialRobot:
    return SerialRobot.from_model("lwr", **{"joint_angles": HOME, **fields})


def scenario(**fields: Any) -> Scenario:
    robots = fields.pop("robots", None) or [lwr()]
    fields.setdefault("controllers", {"lwr": {"kind": "joint_impedance", "stiffness": 800.0}})
    return Scenario(Scene(robots=robots, objects=fields.pop("objects", [])), **fields)


def ran(declared: Scenario, **options: Any) -> Simulation:
    simulation = Simulation(declared, **options)
    for _ in simulation.run():
        pass
    return simulation


def problems(**fields: Any) -> list[str]:
    with pytest.raises(DeclarationError) as caught:
        Simulation(scenario(**fields))
    return [f"{problem.key}: {problem.message}" for problem in caught.value.problems]


# ---- what ships


@pytest.mark.parametrize("name", list_scenarios())
def test_all_expectations_of_a_shipped_scenario_hold(name: str) -> None:
    declared = read_scenario(name)
    assert declared.description and declared.expect
    outcomes = ran(declared).outcomes()
    assert [outcome.text for outcome in outcomes if not outcome.holds] == []


def test_required_scenarios_are_shipped() -> None:
    assert set(list_scenarios()) >= {
        "hand_guiding", "impedance_push", "drive_home", "table_contact", "sensor_fault",
        "controller_fault", "payload", "singularity_pass", "haptic_position", "haptic_torque",
    }  # fmt: skip


# ---- files


BASE = """
[robots.lwr]
model = "lwr"

[run]
duration = 0.1

[controllers.lwr]
kind = "joint_impedance"
stiffness = 500
"""


def read(tmp_path: Path, text: str, overrides: dict[str, Any] | None = None) -> Scenario:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return read_scenario(path, overrides)


def test_obsolete_run_jit_is_ignored_with_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for value in ("true", "false", "'yes'"):
        declared = read(tmp_path, BASE.replace("[run]", f"[run]\njit = {value}"), {"run.seed": 3})
        assert "jit" not in declared.run.model_dump() and declared.run.seed == 3
    read(tmp_path, BASE, {"run.jit": True})
    extending = tmp_path / "other.toml"
    extending.write_text('extends = "mine.toml"\n[set]\n"run.jit" = true\n[run]\njit = true\n')
    assert read_scenario(extending).run.duration == 0.1
    assert caplog.messages == ["run.jit no longer has any effect; remove it"]


def test_file_is_read_and_anything_can_be_overridden(tmp_path: Path) -> None:
    declared = read(tmp_path, BASE)
    assert (declared.name, declared.run.duration, declared.run.timestep) == ("mine", 0.1, 0.001)
    over = {"controllers.lwr.stiffness": 100, "run.seed": 7, "lwr.show_axes": True}
    changed = read(tmp_path, BASE, over)
    assert changed.controllers["lwr"].stiffness.tolist() == [100.0]  # type: ignore[union-attr]
    assert changed.run.seed == 7
    assert changed.scene.robots["lwr"].show_axes
    assert is_scenario(tmp_path / "mine.toml")
    (tmp_path / "scene.toml").write_text('[robots.lwr]\nmodel = "lwr"\n')
    assert not is_scenario(tmp_path / "scene.toml")


def test_scenario_can_use_the_scene_of_another_file(tmp_path: Path) -> None:
    (tmp_path / "arms.toml").write_text('[robots.arm]\nmodel = "lwr"\n')
    declared = read(tmp_path, 'scene = "arms.toml"\n[targets.arm]\nkind = "constant"\n')
    assert list(declared.scene.robots) == ["arm"]
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, 'scene = "armz"\n[run]\n')
    assert "mine.toml" in str(caught.value) and "no scene 'armz'" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[controlers.lwr]\n", Problem("controlers", "unknown section", available=["controllers"])),
        (
            "[targets.lwrr]\nkind='constant'\n",
            Problem("targets.lwrr", "no robot", found="lwrr", available=["lwr"]),
        ),
        (
            "[targets.lwr]\nkind='sinus'\n",
            Problem("targets.lwr.kind", "no kind", found="sinus", available=["sine"]),
        ),
        (
            "[disturbances.push]\nkind='force'\nat='lwr/flansch'\nforce=[0,0,1]\n",
            Problem(
                "disturbances.push.at", "no frame", found="lwr/flansch", available=["lwr/flange"]
            ),
        ),
        (
            "[disturbances.push]\nkind='force'\nat='lwr/flange'\n",
            Problem(
                "disturbances.push",
                "found neither force nor torque; expected a vector for one of them",
            ),
        ),
        (
            "[faults.x]\nkind='dead_sensor'\njoints=['A9']\n",
            Problem(
                "faults.x.joints",
                "lwr has no joint",
                found="A9",
                available=["A1", "A2", "A3", "A4", "A5", "A6", "E1"],
            ),
        ),
        (
            "[faults.x]\nkind='ded_sensor'\n",
            Problem("faults.x.kind", "no kind", found="ded_sensor", available=["dead_sensor"]),
        ),
        (
            "[expect.e]\nmeasure='position_eror'\nbelow=1\n",
            Problem(
                "expect.e.measure",
                "no measure",
                found="position_eror",
                available=["position_error"],
            ),
        ),
        (
            "[expect.e]\nmeasure='torque'\n",
            Problem("expect.e.below", "is required", expected="a bound below or above"),
        ),
        (
            "[expect.e]\nbelow=1\n",
            Problem("expect.e", "found none; expected one of `measure`, `finds`, `finds_nothing`"),
        ),
        (
            "[expect.e]\nfinds='torque_error'\ncause='psh'\n",
            Problem("expect.e.cause", "no disturbance or fault", found="psh", available=[]),
        ),
        (  # and no error about the missing push
            "[disturbances.push]\nkind='force'\nat='lwr/flange'\nforce=[0,0]\n"
            "[expect.e]\nfinds='torque_error'\ncause='push'\n",
            Problem("disturbances.push.force", "found 2; expected 3 numbers"),
        ),
        (
            "[expect.e]\nmeasure='torque'\nbelow=1\nafter=3\n",
            Problem(
                "expect.e.after", "found 3 s; expected a time before the end of the run at 0.1 s"
            ),
        ),
        (
            "[sensors.lwr]\ntorqes={noise=1}\n",
            Problem("sensors.lwr.torqes", "unknown key", available=["torques"]),
        ),
    ],
)
def test_invalid_entries_are_reported_with_their_key(
    tmp_path: Path, text: str, problem: Problem
) -> None:
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, BASE + text)
    (told,) = caught.value.problems
    assert replace(told, file=None, line=None) == problem
    assert str(told.file).endswith("mine.toml") and told.line


def test_unknown_scenario_is_rejected_with_a_suggestion() -> None:
    with raises_with(UnknownName, kind="scenario", name="hand_guidin", near="hand_guiding"):
        read_scenario("hand_guidin")


def test_overridden_keys_must_exist(tmp_path: Path) -> None:
    for key, expected in (
        ("controllers.lwrr.stiffness", {"reason": "no robot", "found": "lwrr", "near": "lwr"}),
        ("run.duratio", {"reason": "unknown key", "near": "duration"}),
        ("controllers.lwr.stifness", {"reason": "unknown key", "near": "stiffness"}),
    ):
        with raises_with(key=key, **expected):
            read(tmp_path, BASE, {key: 1})


# ---- errors that are detected after compiling


def test_infeasible_targets_and_controllers_are_rejected_before_the_first_step() -> None:
    far = {"kind": "constant", "angles_deg": [0, 130, 0, 0, 0, 0, 0]}
    assert problems(targets={"lwr": far}) == [
        "targets.lwr: the target of joint A2 is 130 deg at t = 0.000 s; expected -120 to 120 deg"
    ]
    (found,) = problems(
        controllers={"lwr": {"kind": "cartesian_impedance"}},
        targets={
            "lwr": {"kind": "cartesian_way_points", "relative_to": "start", "times": [1.0],
                    "poses": [{"xyz": [0.0, 0.0, 2.0]}]}
        },
    )  # fmt: skip
    assert found.startswith("targets.lwr: the flange cannot follow at t = 0.")
    (found,) = problems(
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": 5000}}, timestep=0.05
    )
    assert "controllers.lwr" in found and "joint A" in found
    (found,) = problems(
        controllers={"lwr": {"kind": "torque", "torque_limits": [1, 1, 0, 1, 1, 1, 1]}}
    )
    assert "joint E1 has 0" in found


def test_too_large_log_is_rejected() -> None:
    (found,) = problems(duration=1e5, timestep=1e-4)
    assert found.startswith("run.duration: found 1000000000 steps, a log of ")


# ---- parts


def test_force_follows_its_profile() -> None:
    times = np.array([0.0, 1.0, 1.5, 2.0, 2.5])
    force = {"at": "x", "force": [0, 0, 1.0], "begin": 1.0, "end": 2.0}
    assert Force(**force).share(times).tolist() == [0, 1, 1, 0, 0]
    assert Force(**force, profile="ramp").share(times).tolist() == [0, 0, 0.5, 1, 1]
    half_sine = Force(**force, profile="half_sine").share(times)
    assert half_sine == pytest.approx([0, 0, 1, 0, 0])
    with raises_with(key="end", found=1.0):
        Force(**{**force, "begin": 2.0, "end": 1.0})
    with raises_with(
        key="end", reason="is required", expected="the time in seconds at which the ramp ends"
    ):
        Force(at="x", force=[0, 0, 1.0], profile="ramp")


# ---- recorded motions


@pytest.mark.extensions
def test_recorded_motion_can_be_a_target(tmp_path: Path) -> None:
    swing = {"lwr": {"kind": "sine", "amplitude_deg": 10.0, "frequency": 0.5}}
    first = Simulation(scenario(targets=swing, duration=2.0))
    with RunRecorder(first, tmp_path / "run.mcap") as recorder:
        for rows in first.run():
            recorder.write(*rows)
    table = tmp_path / "run.csv"
    angles = first.log.of("lwr", "joint_angles")[::10]
    lines = [",".join(map(str, row)) for row in np.column_stack([first.log.times[::10], angles])]
    table.write_text("\n".join(["time,A1,A2,E1,A3,A4,A5,A6", *lines]))
    for file in ("run.mcap", "run.csv"):
        text = BASE.replace("0.1", "2.0") + f"[targets.lwr]\nkind='recorded'\nfile='{file}'\n"
        again = ran(read(tmp_path, text))
        assert again.log.of("lwr", "joint_angles")[0] == pytest.approx(angles[0], abs=2e-3)
        target = again.log.of("lwr", "target_angles")
        # Averages over 20 ms, centered on their time.
        assert np.abs(target[100:1900] - first.log.of("lwr", "joint_angles")[100:1900]).max() < 0.02


@pytest.mark.extensions
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file='none.mcap'", "targets.lwr.file: "),
        ("file='none.csv'", "none.csv cannot be read"),
        ("file='bad.csv'", "found 2 columns in addition to time"),
        ("file='bad.csv'\nof='x'", "targets.lwr.of is only for recordings"),
        ("file='bad.csv'\ntimes=[0,1]", "targets.lwr.times is read from the file; remove it or"),
        ("file=5", "targets.lwr.file: found 5; expected the name of a recording or a table"),
    ],
)
def test_missing_recorded_motion_is_reported(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.csv").write_text("time,a,b\n0,1,2\n1,2,3\n")
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, f"{BASE}[targets.lwr]\nkind='recorded'\n{text}\n")
    assert message in str(caught.value) and "mine.toml:" in str(caught.value)


# ---- mistakes of newcomers


class Returns:
    def torques(self, sensed: Any, target: Any, out: Any) -> Any:
        return out + 1.0


def test_ineffective_or_impossible_entries_are_rejected(tmp_path: Path) -> None:
    for text, problem in (
        (
            "[faults.x]\nkind='sensor'\nbegin=0\n",
            Problem(
                "faults.x", "has no effect; expected one of bias, gain, noise, resolution, delay_ms"
            ),
        ),
        (
            "[faults.x]\nkind='friction'\n",
            Problem("faults.x", "has no effect; expected viscous, coulomb or added_coulomb"),
        ),
        (
            "[faults.x]\nkind='dead_sensor'\nbegin=17\n",
            Problem(
                "faults.x.begin", "found 17 s; expected a time before the end of the run at 0.1 s"
            ),
        ),
        (
            "[targets.lwr]\nkind='constant'\nfile='x.csv'\n",
            Problem("targets.lwr.file", "unknown key", available=["angles", "angles_deg", "kind"]),
        ),
        (
            "[targets.lwr]\nkind='recorded'\n",
            Problem(
                "targets.lwr.file",
                "is required; expected RUN.mcap or TABLE.csv, or times and angles",
            ),
        ),
        (
            "[expect.e]\nfinds='any'\nbelow=1\n",
            Problem("expect.e", "`below` requires `measure`; found `finds`"),
        ),
        (
            "[expect.e]\nmeasure='torque'\nbelow=1\nabove=2\n",
            Problem("expect.e.above", found=2.0, expected="less than 1"),
        ),
    ):
        with pytest.raises(DeclarationError) as caught:
            read(tmp_path, BASE + text)
        assert [replace(told, file=None, line=None) for told in caught.value.problems] == [problem]
    later = "[disturbances.p]\nkind='force'\nat='lwr/flange'\nforce=[0,0,1]\nbegin=17\n"
    later += "[expect.e]\nmeasure='torque'\nbelow=1\nafter=18\n"
    wrong = BASE.replace("duration = 0.1", "duration = 20\nseed = -1")
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, wrong + later)
    assert [problem.key for problem in caught.value.problems] == ["run.seed"]
    with raises_with(key="robots.lwr.modl", reason="unknown key", near="model"):
        read(tmp_path, BASE.replace("model", "modl"))
    with pytest.raises(DeclarationError) as caught:
        read(tmp_path, BASE, {"robots.lwr.joint_angles": [3.0, 0, 0, 0, 0, 0, 0]})
    assert "joint A1 starts at 171.9 deg" in str(caught.value)


def test_contact_force_requires_something_to_touch() -> None:
    touch = {"expect": {"e": {"measure": "contact_force", "below": 1.0}}, "duration": 0.01}
    assert ran(scenario(**touch)).outcomes()[0].holds  # the floor is there
    with raises_with(
        key="expect.e.measure",
        reason="there are no contacts; add an object or another robot to the scene",
    ):
        Scenario(Scene(robots=[lwr()], floor=False), **touch)


def test_user_controllers_must_write_into_out() -> None:
    with raises_with(
        SimulationError,
        time=0.0,
        joint="lwr",
        reason="torques() returned a value; expected None, and torques written to `out`",
    ):
        ran(scenario(controllers={"lwr": Returns()}))
    (found,) = problems(controllers={"lwr": Returns})
    assert "found the class Returns; expected an instance: Returns()" in found


def test_constant_torques_are_added_to_gravity() -> None:
    pushed = {"kind": "torque", "torques": [5.0, 0, 0, 0, 0, 0, 0]}
    log = ran(scenario(controllers={"lwr": pushed}, duration=0.5)).log
    held = log.of("lwr", "commanded_torques")[1] - log.of("lwr", "torques")[0]
    assert held == pytest.approx([5.0, 0, 0, 0, 0, 0, 0], abs=1e-6)
    assert log.of("lwr", "joint_angles")[-1, 0] > 0.05


def test_too_fast_motion_is_reported_with_its_peak_and_ramp() -> None:
    (found,) = problems(
        targets={"lwr": {"kind": "sine", "amplitude_deg": [90, 0, 0, 0, 0, 0, 0],
                         "frequency": 0.19}}, duration=5.0,
    )  # fmt: skip
    assert "the target velocity of joint A1 is 1" in found and "expected up to 112.5 deg/s" in found
    assert found.endswith("; only the ramp of 1 s exceeds it. Try ramp = 2")


def test_early_end_of_a_run_fails_later_expectations() -> None:
    late = {"late": {"measure": "torque", "below": 100.0, "after": 0.4}}
    simulation = Simulation(scenario(expect=late, duration=0.5))
    simulation.advance(100)
    (outcome,) = simulation.outcomes()
    assert not outcome.holds
    assert (
        outcome.text
        == "torque: the run ended at 0.1 s, before the evaluated time; expected below 100"
    )
