"""Fixed rows of DH tables are rejected, and the message contains the frame to declare instead."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError
from sero_mj.base.frames import frame, rotation_about
from sero_mj.load import load_scene
from sero_mj.robots.declared.robot import SerialRobot

# Kinova Gen3, 7 joints: User Guide, classical DH parameters; alpha, a, theta, d. The first row is
# "0 (from base)".
HALF = np.pi / 2
GEN3 = [
    [np.pi, 0, 0, 0],
    [HALF, 0, 0, -(0.1564 + 0.1284)],
    [HALF, 0, np.pi, -(0.0054 + 0.0064)],
    [HALF, 0, np.pi, -(0.2104 + 0.2104)],
    [HALF, 0, np.pi, -(0.0064 + 0.0064)],
    [HALF, 0, np.pi, -(0.2084 + 0.1059)],
    [HALF, 0, np.pi, 0],
    [np.pi, 0, np.pi, -(0.1059 + 0.0615)],
]
# The same robot by Kinova's URDF, gen3_macro.xacro of ros_kortex, 7dof (commit 6cd75d4): origins of
# joint_1 to joint_7 and of end_effector, x, y, z and roll. All joints rotate about z.
GEN3_URDF = [
    [0, 0, 0.15643, 3.1416],
    [0, 0.005375, -0.12838, 1.5708],
    [0, -0.21038, -0.006375, -1.5708],
    [0, 0.006375, -0.21038, 1.5708],
    [0, -0.20843, -0.006375, -1.5708],
    [0, 0.00017505, -0.10593, 1.5708],
    [0, -0.10593, -0.00017505, -1.5708],
    [0, 0, -0.061525, 3.14159265358979],
]


def expected_of(rows: object, types: list[str], **fields: object) -> str:
    with pytest.raises(DeclarationError) as caught:
        SerialRobot(dh_params=rows, joint_types=types, **fields)
    (problem,) = caught.value.problems
    assert problem.found == "fixed"
    assert problem.key == f"joint_types.{types.index('fixed')}"
    return str(problem.expected)


def declared_in(text: str) -> dict[str, object]:
    (line,) = re.findall(r"\w+ = \{.*\}$", text)
    return tomllib.loads(line)


def test_error_for_a_fixed_first_row_contains_the_base_frame() -> None:
    types = ["revolute"] * 7
    base = declared_in(expected_of(GEN3, ["fixed", *types], dh_convention="standard"))
    robot = SerialRobot(dh_params=GEN3[1:], joint_types=types, dh_convention="standard", **base)  # type: ignore[arg-type]
    flange = robot.fwd_kin_base_to_flange(np.zeros(7))
    assert flange[:3, 3] == pytest.approx([0.0, -0.0246, 1.1873], abs=1e-6)
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 7)):
        expected = np.eye(4)
        for (*xyz, roll), angle in zip(GEN3_URDF, [*q, 0.0], strict=True):
            turned = rotation_about(0, roll) @ rotation_about(2, angle)
            expected = expected @ frame(turned, np.array(xyz))
        difference = robot.fwd_kin_base_to_flange(q) - expected
        # The table omits the 0.18 mm offsets that the URDF has between the wrist axes.
        assert np.linalg.norm(difference[:3, 3]) < 0.0006
        assert np.abs(difference[:3, :3]).max() < 1e-4


def test_table_in_degrees_is_a_robot_in_a_file_of_any_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('dh_convention = "standard"\ndh_params_deg = [[90, 0, 0, 0.2]]\n')
    assert [robot.n for robot in load_scene(file).robots.values()] == [1]


def test_error_for_fixed_last_rows_contains_the_flange_frame() -> None:
    rows = [[0, 0, 0, 300], [1.5, 200, 0, 0], [0, 100, 1.0, 50]]
    types = ["revolute", "revolute", "fixed"]
    text = expected_of(rows, types, dh_convention="craig", length_unit="mm")
    assert text.startswith("'revolute' or 'prismatic'; remove this row and set flange_frame = ")
    flange = declared_in(text)["flange_frame"]
    assert flange == {"xyz": [0.1, 0, 0.05], "rpy_deg": [0, 0, pytest.approx(57.2958)]}


def test_error_for_a_fixed_row_in_between_names_joint_frames() -> None:
    types = ["revolute", "fixed", "revolute"]
    text = expected_of(np.zeros((3, 4)), types, dh_convention="craig")
    assert "use joint_frames" in text
