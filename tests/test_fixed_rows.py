"""Rows of DH tables without a joint: the frame to declare instead is in the message."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError
from sero_mj.robots.declared.robot import SerialRobot

# Kinova Gen3, 7 joints: User Guide, classical DH parameters; alpha, a, theta, d. The first row is
# "0 (from base)". Straight up its interface is 1.1873 m above the base.
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


def said(rows: object, types: list[str], **fields: object) -> str:
    with pytest.raises(DeclarationError) as caught:
        SerialRobot(dh_params=rows, joint_types=types, **fields)
    (problem,) = caught.value.problems
    assert problem.found == "fixed"
    assert problem.key == f"joint_types.{types.index('fixed')}"
    return str(problem.expected)


def declared_in(text: str) -> dict[str, object]:
    (line,) = re.findall(r"\w+ = \{.*\}$", text)
    return tomllib.loads(line)


def test_a_fixed_first_row_is_the_base_frame_that_the_message_has() -> None:
    types = ["revolute"] * 7
    frame = declared_in(said(GEN3, ["fixed", *types], dh_convention="standard"))
    robot = SerialRobot(dh_params=GEN3[1:], joint_types=types, dh_convention="standard", **frame)  # type: ignore[arg-type]
    flange = robot.fwd_kin_base_to_flange(np.zeros(7))
    assert flange[:3, 3] == pytest.approx([0.0, -0.0246, 1.1873], abs=1e-6)
    assert flange[:3, 2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)


def test_fixed_rows_at_the_end_are_the_flange_frame() -> None:
    rows = [[0, 0, 0, 300], [1.5, 200, 0, 0], [0, 100, 1.0, 50]]
    types = ["revolute", "revolute", "fixed"]
    text = said(rows, types, dh_convention="craig", length_unit="mm")
    assert text.startswith("'revolute' or 'prismatic'; remove this row and set flange_frame = ")
    frame = declared_in(text)["flange_frame"]
    assert frame == {"xyz": [0.1, 0, 0.05], "rpy_deg": [0, 0, pytest.approx(57.2958)]}


def test_elsewhere_other_frames_are_named() -> None:
    types = ["revolute", "fixed", "revolute"]
    text = said(np.zeros((3, 4)), types, dh_convention="craig")
    assert "declare the robot by joint_frames" in text
