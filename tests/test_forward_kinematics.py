"""MuJoCo's forward kinematics of a flange against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from sero_mj import ForwardKinematics, SerialRobot
from sero_mj.base import paths


@pytest.mark.parametrize("name", sorted(paths.list_models()))
def test_mujoco_and_numpy_kinematics_agree(name: str) -> None:
    """Tables in both conventions, with branches and prismatic and coupled joints."""
    robot = SerialRobot.from_model(name)
    flange = ForwardKinematics(robot)
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (4, 5, robot.n))
    expected = robot.fwd_kin_base_to_flange(q)
    np.testing.assert_allclose(flange(q), expected, atol=1e-12)
    np.testing.assert_allclose(flange(q[2, 1]), expected[2, 1], atol=1e-12)
    assert flange(q[:0]).shape == (0, 5, 4, 4)


def test_kinematics_of_mirrored_robots_and_robots_without_a_table_agree() -> None:
    frames = [{"xyz": [0.0, 0.0, 0.3]}, {"xyz": [0.2, 0.0, 0.1], "rpy_deg": [90, 20, 0]}]
    robots = [
        SerialRobot.from_model("lwr", mirrored=True),
        SerialRobot(name="bare", dh_convention="none", joint_frames=frames),
    ]
    for robot in robots:
        q = np.random.default_rng(5).uniform(-1.5, 1.5, (7, robot.n))
        expected = robot.fwd_kin_base_to_flange(q)
        np.testing.assert_allclose(ForwardKinematics(robot)(q), expected, atol=1e-12)


def test_independent_joints_suffice_and_wrong_numbers_are_rejected() -> None:
    couplings = {"J3": {"to": "J2", "ratio": -1.0, "offset": 0.2}}
    robot = SerialRobot(
        name="r", dh_convention="craig", couplings=couplings,
        dh_params=[[0, 0, 0, 0.3], [1.5, 0, 0, 0], [0, 0.4, 0, 0]],
    )  # fmt: skip
    flange = ForwardKinematics(robot)
    np.testing.assert_allclose(flange([0.3, 0.5]), flange([0.3, 0.5, -0.3]), atol=1e-15)
    with pytest.raises(ValueError, match=r"found shape \(4,\); expected a last axis of length 3"):
        flange(np.zeros(4))


def test_returned_arrays_are_not_overwritten() -> None:
    flange = ForwardKinematics(SerialRobot.from_model("scara"))
    first = flange(np.zeros(4))
    kept = first.copy()
    flange(np.full(4, 0.3))
    assert (first == kept).all()
