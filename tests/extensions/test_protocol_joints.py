"""Robots whose number of joints does not fit the protocol of their controller."""

from __future__ import annotations

import pytest

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.scenario import Scenario


@pytest.mark.parametrize(("kind", "robot"), [("fri", "ur5e"), ("franka", "ur5e"), ("rtde", "lwr")])
def test_robot_with_another_number_of_joints_is_rejected(kind: str, robot: str) -> None:
    scene = Scene(robots=[SerialRobot.from_model(robot)])
    with pytest.raises(DeclarationError) as caught:
        Scenario(scene, controllers={robot: {"kind": kind}})
    assert [problem.key for problem in caught.value.problems] == [f"controllers.{robot}.kind"]
