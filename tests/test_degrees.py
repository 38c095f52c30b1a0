"""Angles in degrees are detected where radians are expected."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.load import load_scene
from sero_mj.robots.declared.degrees import FAR_BEYOND, degrees_warning, look_like_degrees
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.runs.tables import find_tables
from sero_mj.simulate.scenario_file import read_scenario

POSE = [0, 80, 0, -90, 0, 60, 0]  # degrees
INF = np.inf


def arm(**fields: object) -> SerialRobot:
    """Returns a revolute joint with limits, a continuous and a prismatic one."""
    return SerialRobot(
        name="arm",
        dh_params=[[0, 0, 0, 0.2]] * 3,
        dh_convention="craig",
        joint_types=["revolute", "revolute", "prismatic"],
        position_limits=[[-1.0, 2.0], [-INF, INF], [-0.1, 0.1]],
        **fields,
    )


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ([2.0 + FAR_BEYOND - 0.01, 0, 0], [0, 0, 0]),
        ([2.0 + FAR_BEYOND + 0.01, 0, 0], [1, 0, 0]),
        ([-1.0 - FAR_BEYOND - 0.01, 0, 0], [1, 0, 0]),
        ([0, 90, 0], [0, 1, 0]),
        ([0, np.float32(-30.1), 0], [0, 1, 0]),
        ([0, 20.0, 0], [0, 0, 0]),  # three revolutions
        ([0, 90.03417, 0], [0, 0, 0]),  # a measured angle of a wheel
        ([0, 4000.0, 0], [0, 0, 0]),  # a wheel
        ([0, 0, 500.0], [0, 0, 0]),  # a length
        ([np.nan, np.nan, np.nan], [0, 0, 0]),
    ],
)
def test_unreachable_angles_look_like_degrees(angles: list[float], expected: list[int]) -> None:
    found = look_like_degrees(arm(), np.array(angles, float))
    assert found.tolist() == [bool(each) for each in expected]


def test_degrees_of_any_joint_are_detected_in_all_poses_within_the_limits() -> None:
    """Random poses: in rad none is detected, in degrees nearly all are."""
    (robot,) = load_scene("lwr").robots.values()
    poses = np.random.default_rng(0).uniform(*robot.display_ranges.T, (200, 7))
    assert not any(degrees_warning(robot, pose) for pose in poses)
    assert all(degrees_warning(robot, pose) for pose in np.rad2deg(poses))
    assert degrees_warning(robot, np.empty((0, 7))) == ""


def test_fk_warns_about_degrees_before_it_prints(capsys: pytest.CaptureFixture[str]) -> None:
    angles = ",".join(map(str, POSE))
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["check", "--fk", "lwr", "--joint-angles", angles])
    assert "lwr.A2: 80 rad is far beyond its limits of ±2.09 rad" in capsys.readouterr().err
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["check", "--fk", "lwr", "--deg", "--joint-angles", angles])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("key", "count"), [("joint_angles", 1), ("joint_angles_deg", 0)])
def test_declared_pose_in_degrees_is_reported_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, key: str, count: int
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(f'[robots.lwr]\nmodel = "lwr"\n{key} = {POSE}\n')
    with caplog.at_level(logging.WARNING):
        load_scene(file)
    assert [record.args[1].split(":")[0] for record in caplog.records] == ["lwr.A2"] * count


@pytest.mark.parametrize(
    ("table", "owner"),
    [
        (f'[doubles.ghost]\nof = "lwr"\njoint_angles = {POSE}\n', "double 'ghost': "),
        (f'[groups.all]\nrobots = ["lwr"]\njoint_angles = {POSE}\n', "group 'all': "),
    ],
)
def test_pose_in_degrees_of_a_double_or_group_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, table: str, owner: str
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(f'[robots.lwr]\nmodel = "lwr"\n{table}')
    with caplog.at_level(logging.WARNING):
        load_scene(file)
    (record,) = caplog.records
    assert record.args[0] == owner and record.args[1].startswith("lwr.A2: 80 rad")


@pytest.mark.parametrize(("amplitude", "asks"), [(40.0, True), (4.0, False)])
def test_targets_beyond_the_limits_hint_at_degrees(
    tmp_path: Path, amplitude: float, asks: bool
) -> None:
    file = tmp_path / "scenario.toml"
    file.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[controllers.lwr]\nkind = "joint_impedance"\n'
        f'stiffness = 200\n[targets.lwr]\nkind = "sine"\namplitude = {amplitude}\n'
        "frequency = 1\n[run]\nduration = 1\n"
    )
    from sero_mj.simulate.simulation import Simulation

    with pytest.raises(DeclarationError) as error:
        Simulation(read_scenario(str(file)))
    assert all(("degrees" in str(each)) == asks for each in error.value.problems)


@pytest.mark.extensions
def test_table_in_degrees_is_reported_once_and_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    columns = [f"lwr_joint_angles[{i}]" for i in range(7)]
    rows = [[0.01 * k, *POSE] for k in range(5)]
    table = tmp_path / "run.csv"
    lines = [["time", *columns], *rows]
    table.write_text("\n".join(",".join(map(str, line)) for line in lines) + "\n")
    with caplog.at_level(logging.WARNING):
        run = find_tables(table).read_run(table, load_scene("lwr"), None, {})
    assert run.of("lwr", "joint_angles")[0].tolist() == POSE
    (record,) = caplog.records
    assert record.args[0] == table and record.args[1].startswith("lwr.A2: 80 rad")


@pytest.mark.extensions
@pytest.mark.parametrize("degrees", [False, True])
def test_check_tests_a_whole_recording_for_degrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], degrees: bool
) -> None:
    table = tmp_path / "run.csv"
    moved = np.multiply(POSE, 1.0 if degrees else np.pi / 180)
    poses = np.linspace(np.zeros(7), moved, 50)  # it begins at zero
    lines = [",".join(["time", *(f"q{k}" for k in range(1, 8))])]
    lines += [",".join(map(str, [0.1 * k, *pose])) for k, pose in enumerate(poses)]
    table.write_text("\n".join(lines) + "\n")
    with pytest.raises(SystemExit) as ended:
        main(["check", "lwr", "--replay", str(table)])
    assert not ended.value.code
    assert ("note: lwr.A2: 19.59 rad" in capsys.readouterr().out) == degrees
