"""Tables in mm, robots a kilometer long, and files that are not scenes: the messages."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with

from sero_mj import Scene, SerialRobot, World, load_scene
from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.simulate.scenario_file import read_scenario

MM = [[0, 0, 0, 310], [1.5, 0, 0, 0], [-1.5, 0, 0, 400], [0, 300, 0, 400]]
ROBOT = f'dh_convention = "craig"\ndh_params = {MM}\n'


def in_mm(**fields: object) -> SerialRobot:
    return SerialRobot(dh_convention="craig", dh_params=MM, **fields)  # type: ignore[arg-type]


def write(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / "robot.toml").write_text(text)
    return folder


def test_table_in_mm_is_converted_to_m() -> None:
    robot = in_mm(length_unit="mm")
    expected = np.array(MM) * [1.0, 0.001, 1.0, 0.001]
    np.testing.assert_allclose(robot.dh_params, expected)
    assert robot.length_unit == "m"
    robot.show_axes = True  # every field is checked again, and nothing is converted twice
    np.testing.assert_allclose(robot.dh_params, expected)
    moved = SerialRobot(
        dh_convention="craig",
        dh_columns=["d", "alpha", "a", "theta"],
        dh_params=[[310, 1.5, 400, 0.5]],
        length_unit="mm",
    )
    np.testing.assert_allclose(moved.dh_params, [[0.31, 1.5, 0.4, 0.5]])
    degrees = SerialRobot(
        dh_convention="craig", dh_params_deg=[[90, 500, 0, 100]], length_unit="mm"
    )
    np.testing.assert_allclose(degrees.dh_params, [[np.pi / 2, 0.5, 0, 0.1]])
    with raises_with(key="length_unit", found="cm", expected="'m' or 'mm'"):
        in_mm(length_unit="cm")


def test_table_that_overrides_one_in_mm_is_in_m(tmp_path: Path) -> None:
    folder = write(tmp_path / "arm", f'{ROBOT}length_unit = "mm"\n')
    rows = np.array(MM) * [1.0, 0.001, 1.0, 0.001]
    np.testing.assert_allclose(SerialRobot.from_model(str(folder)).dh_params, rows)
    over = SerialRobot.from_model(str(folder), dh_params=rows.tolist())
    np.testing.assert_allclose(over.dh_params, rows)
    again = SerialRobot.from_model(str(folder), dh_params=MM, length_unit="mm")
    np.testing.assert_allclose(again.dh_params, rows)


def test_reach_is_that_of_the_stretched_arm(lwr: SerialRobot) -> None:
    assert lwr.reach == pytest.approx(0.31 + 0.4 + 0.39 + 0.078)
    rng = np.random.default_rng(1)
    poses = rng.uniform(-np.pi, np.pi, (2000, 7))
    far = np.linalg.norm(lwr.fwd_kin_base_to_flange(poses)[:, :3, 3], axis=1)
    assert 0.9 * lwr.reach < far.max() <= lwr.reach
    assert np.linalg.norm(lwr.fwd_kin_base_to_flange(np.zeros(7))[:3, 3]) == pytest.approx(
        lwr.reach
    )
    slide = SerialRobot(
        dh_convention="standard",
        dh_params=[[0, 0.3, 0, -0.4]],
        joint_types=["prismatic"],
        position_limits=[[-0.5, 0.2]],
        flange_frame={"xyz": [0.0, 0.0, 2.0]},
    )
    assert slide.reach == pytest.approx(np.hypot(0.3, 0.9) + 2.0)


def test_check_reports_the_reach_and_implausible_lengths(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    folder = write(tmp_path / "arm", ROBOT)
    said = (
        "robot 'arm' reaches 1210 m. Are lengths in mm? Set length_unit = \"mm\" for a DH table "
        "in mm"
    )
    for text, reach, told in ((ROBOT, "1210", [said]), (f'{ROBOT}length_unit="mm"', "1.21", [])):
        (folder / "robot.toml").write_text(text)
        caplog.clear()
        with pytest.raises(SystemExit) as ended:
            main(["check", str(folder)])
        assert ended.value.code == 0
        assert f"shapes generated from its DH table, reach {reach} m" in capsys.readouterr().out
        warned = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
        assert warned == told


def test_large_crane_is_not_reported(caplog: pytest.LogCaptureFixture) -> None:
    World(Scene(robots=[in_mm(length_unit="mm", flange_frame={"xyz": [0, 0, 18.0]})]))
    assert not caplog.records


def test_scene_prints_its_description(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.toml"
    file.write_text('description = "An arm alone"\n[robots.lwr]\nmodel = "lwr"\n')
    assert load_scene(file).description == "An arm alone"
    with pytest.raises(SystemExit) as ended:
        main(["check", str(file)])
    assert ended.value.code == 0
    assert "  about   An arm alone\n" in capsys.readouterr().out
    scenario = read_scenario("payload")
    assert scenario.scene.description == scenario.description != ""
    file.write_text('description = 3\n[robots.lwr]\nmodel = "lwr"\n')
    with pytest.raises(DeclarationError) as found:
        load_scene(file)
    assert str(found.value) == f"{file}:1: description: found 3; expected a text"


@pytest.mark.parametrize(
    ("contents", "expected"),
    [
        (b'<?xml version="1.0"?>\n<!-- a > b -->\n<robot name="x"/>', "a URDF file"),
        (b"\xef\xbb\xbf<mujoco/>", "an MJCF file"),
        (b"<sdf version='1.6'></sdf>", "an SDF file"),
        (b"#usda 1.0\n", "a USD file"),
        (b"PXR-USDC\0\0", "a USD file"),
        (b"PK\x03\x04" + bytes(26) + b"robot.usdc", "a USD file"),
        (b"#VRML V1.0 ascii\n", "a VRML 1.0 file"),
        (b"<html></html>", "XML <html>"),
    ],
)
def test_file_of_another_format_is_reported_with_its_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], contents: bytes, expected: str
) -> None:
    file = tmp_path / "robot.toml"
    file.write_bytes(contents)
    with pytest.raises(SystemExit) as ended:
        main(["view", str(file), "--web"])
    assert ended.value.code == 2
    said = f"sero-mj: {file} is {expected}; expected a TOML file: a robot is a Denavit-Hartenberg"
    err = capsys.readouterr().err
    assert err.startswith(said)
    assert "or URDF or MJCF in .urdf or .xml" in err


def test_recording_is_rejected_as_scene(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with raises_with(
        reason="is a recording; expected a TOML file. Use view, render or export to open it",
        file=f"{tmp_path}/x.mcap",
    ):
        load_scene(tmp_path / "x.mcap")
