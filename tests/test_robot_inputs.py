"""`robot("lwr").torques = ...`: inputs as attributes of viewers and overlays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from foreign_models import arm

import sero_mj
from sero_mj import Double, Scene, SerialRobot, World
from sero_mj.base.errors import UnknownName
from sero_mj.viewer.decor.quantities import joint_values
from sero_mj.viewer.program.robot_inputs import RobotInputs


@dataclass
class Holder:
    """A viewer or an overlay, as far as its inputs are concerned."""

    world: World
    data: mujoco.MjData

    def set(self, target: str, values: Any) -> None:
        self.world.set_input(self.data, target, values)


@pytest.fixture(scope="module")
def world() -> World:
    robot = SerialRobot.from_model("lwr", inputs=["temperatures"])
    return World(Scene(robots=[robot], doubles=[Double(name="goal", of="lwr")]))


@pytest.fixture
def overlay() -> Any:
    model, data = arm()
    return sero_mj.overlay(model, data, doubles=[Double(name="goal", of="arm")])


@pytest.mark.parametrize("name", ["lwr", "goal"])
@pytest.mark.parametrize(
    "key",
    ["joint_angles", "torques", "commanded_torques", "joint_accelerations", "billboard_values"],
)
def test_attribute_sets_the_same_as_set_input_and_can_be_read(
    world: World, name: str, key: str
) -> None:
    by_attribute, by_name = world.make_data(), world.make_data()
    values = np.linspace(-0.7, 0.9, 7)
    robot = RobotInputs(Holder(world, by_attribute), name)
    setattr(robot, key, values.tolist())
    world.set_input(by_name, f"{name}.{key}", values)
    assert (by_attribute.userdata == by_name.userdata).all()
    assert (by_attribute.qpos == by_name.qpos).all()
    read = getattr(robot, key)
    assert read.tolist() == values.tolist()
    read[:] = 5.0  # a copy
    assert getattr(robot, key).tolist() == values.tolist()


def test_initial_inputs_are_no_torques_and_the_declared_angles(world: World) -> None:
    robot = RobotInputs(Holder(world, world.make_data()), "lwr")
    assert np.isnan(robot.torques).all()
    assert robot.joint_angles.tolist() == world.scene.robots["lwr"].home.tolist()


def test_other_inputs_of_a_robot_are_set_by_name_or_attribute(world: World) -> None:
    data = world.make_data()
    robot = RobotInputs(Holder(world, data), "lwr")
    robot.temperatures = np.arange(30.0, 37.0)  # type: ignore[attr-defined]
    assert joint_values(world, data)["temperatures"][:7].tolist() == [*range(30, 37)]
    robot.set("base_frame", np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert data.mocap_quat[world.robots["lwr"].mocap] == pytest.approx([0, 0, 0, 1])


def test_mistyped_names_are_rejected_with_the_nearest(world: World, overlay: Any) -> None:
    robot = RobotInputs(Holder(world, world.make_data()), "lwr")
    with raises_with(UnknownName, kind="input of lwr", name="torqes", near="torques"):
        robot.torqes = np.zeros(7)  # type: ignore[attr-defined]
    with raises_with(UnknownName, kind="robot", name="lrw", near="lwr"):
        RobotInputs(Holder(world, world.make_data()), "lrw")
    with raises_with(UnknownName, kind="robot", name="amr", near="arm"):
        overlay.robot("amr")
    with raises_with(key="lwr.torques", reason="found [1.0]", expected="7 finite numbers"):
        robot.torques = [1.0]


def test_overlay_robot_has_the_torques_of_the_model_until_they_are_set(overlay: Any) -> None:
    robot = overlay.robot("arm")
    overlay.data.ctrl[:] = 0.5
    mujoco.mj_step(overlay.model, overlay.data)
    mujoco.mj_forward(overlay.model, overlay.data)
    dofs = overlay.world.robots["arm"].dofs
    assert robot.torques.tolist() == overlay.data.qfrc_actuator[dofs].tolist()
    robot.torques = {"elbow": 12.0}
    assert robot.torques[2] == 12.0
    assert np.isnan(robot.torques[[0, 1, 3]]).all()
    overlay.robot("goal").joint_angles = [0.1, 0.2, 0.3, 0.01]
    assert overlay.robot("goal").joint_angles.tolist() == [0.1, 0.2, 0.3, 0.01]
    with pytest.raises(
        ValueError, match=r"the joint angles of arm come from your data. Set data.qpos instead"
    ):
        robot.joint_angles = np.zeros(4)
