"""Faults of links, motors and clocks: effects from changed models, and what is named for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import sampled
from explain_runs import swing

from sero_mj.base.frames import Array
from sero_mj.extensions.explain.explain import explain
from sero_mj.extensions.explain.goodness import limited, unexplained_share
from sero_mj.extensions.explain.link_torques import (
    body_torques,
    link_torques,
    torques_by_gravity,
)
from sero_mj.extensions.explain.torque_residuals import TorqueResiduals, torque_residuals
from sero_mj.robots.assemble.robot_dynamics import GRAVITY, robot_dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.study.explanation import BASE, COMMANDS, Explanation


@pytest.fixture(scope="module")
def found() -> TorqueResiduals:
    return torque_residuals(swing(), "lwr")


def first_of(found: TorqueResiduals) -> Explanation:
    first, *_ = explain(found)
    assert first.confidence > 0.9, first
    return first


def with_links(found: TorqueResiduals, changed: SerialRobot, gravity: Array | None = None) -> Array:
    """Returns the link residuals of a robot whose links differ from the model."""
    true = link_torques(changed, *found.motion.links, gravity)
    return found.link + true - link_torques(found.robot, *found.motion.links)


@pytest.mark.parametrize("name", ["lwr", "stanford"])
def test_bodies_of_all_links_together_have_the_torques_of_the_robot(name: str) -> None:
    robot = SerialRobot.from_model(name, name="arm")
    q, v, a = np.random.default_rng(1).normal(0.0, 0.5, (3, 5, robot.n))
    dynamics, total = robot_dynamics(robot), np.zeros((5, robot.n))
    for link in range(robot.n):
        mass, center = dynamics.masses[link + 1], dynamics.centers[link + 1]
        about = dynamics.tensors[link + 1] + mass * (center @ center * np.eye(3))
        about = about - mass * np.outer(center, center)
        inertia = [*np.diag(about), about[0, 1], about[0, 2], about[1, 2]]
        total += body_torques(robot, q, v, a, link + 1) @ [mass, *(mass * center), *inertia]
    np.testing.assert_allclose(total, link_torques(robot, q, v, a), atol=1e-6)


def test_torques_are_linear_in_gravity() -> None:
    robot = SerialRobot.from_model("lwr")
    q, still = np.random.default_rng(1).normal(0.0, 0.5, (4, robot.n)), np.zeros((4, robot.n))
    by_gravity = torques_by_gravity(robot, q)
    expected = link_torques(robot, q, still, still)
    np.testing.assert_allclose(by_gravity @ [0.0, 0.0, -GRAVITY], expected, atol=1e-9)


def test_tilted_base_is_named_with_its_angle(found: TorqueResiduals) -> None:
    x, y = np.radians([3.0, -2.0])
    gravity = GRAVITY * np.array([np.sin(y), np.sin(x), -np.cos(np.hypot(x, y))])
    first = first_of(replace(found, link=with_links(found, found.robot, gravity)))
    assert (first.joint, first.kind, first.part) == (BASE, "tilt", "base")
    angle = np.degrees(np.arctan2(np.hypot(*gravity[:2]), -gravity[2]))
    assert first.size == pytest.approx(angle, abs=0.05)
    direction = [first.values[axis] for axis in "xyz"]
    np.testing.assert_allclose(direction, gravity / np.linalg.norm(gravity), atol=1e-3)


@pytest.mark.parametrize("link", sampled([3, 5], 1))
def test_wrong_mass_or_center_of_one_link_is_named(found: TorqueResiduals, link: int) -> None:
    robot = found.robot
    dynamics = robot.dynamics
    assert dynamics.masses is not None and dynamics.centers_of_mass is not None
    factor = np.where(np.arange(robot.n + 1) == link + 1, 1.3, 1.0)
    inertias = np.asarray(dynamics.inertias) * factor[:, None, None]
    heavy = dynamics.model_copy(update={"masses": dynamics.masses * factor, "inertias": inertias})
    first = first_of(
        replace(found, link=with_links(found, robot.model_copy(update={"dynamics": heavy})))
    )
    assert (first.joint, first.kind) == (robot.names[link], "link mass")
    assert first.size == pytest.approx(0.3 * robot_dynamics(robot).masses[link + 1], rel=0.02)
    centers = np.array(dynamics.centers_of_mass)
    centers[link + 1] += [0.02, 0.01, -0.03]
    moved = dynamics.model_copy(update={"centers_of_mass": centers})
    first = first_of(
        replace(found, link=with_links(found, robot.model_copy(update={"dynamics": moved})))
    )
    assert (first.joint, first.kind) == (robot.names[link], "link center")


def test_elastic_joint_is_named_with_its_stiffness(found: TorqueResiduals) -> None:
    angles, velocities, accelerations = found.motion.links
    softer, bends = angles.copy(), accelerations.copy()
    softer[:, 1] -= found.torques.measured[:, 1] / 3000.0
    bends[:, 1] -= found.torques.curvature[:, 1] / 3000.0
    more = link_torques(found.robot, softer, velocities, bends) - link_torques(
        found.robot, angles, velocities, accelerations
    )
    first = first_of(replace(found, link=found.link + more))
    assert (first.joint, first.kind) == ("A2", "elasticity")
    assert first.size == pytest.approx(3000.0, rel=0.05)


def on_motor(found: TorqueResiduals, joint: int, torque: Array) -> TorqueResiduals:
    motor = found.motor.copy()
    motor[:, joint] += torque
    return replace(found, motor=motor)


def test_motor_inertia_is_named_with_its_size(found: TorqueResiduals) -> None:
    first = first_of(on_motor(found, 1, 2.0 * found.motion.accelerations[:, 1]))
    assert (first.joint, first.kind, first.part) == ("A2", "motor inertia", "drive")
    assert first.size == pytest.approx(2.0, rel=0.02)


def test_friction_that_rises_during_the_run_is_named(found: TorqueResiduals) -> None:
    past = (found.times - found.times[0]) / (found.times[-1] - found.times[0])
    first = first_of(on_motor(found, 1, 4.0 * past * found.motion.signs[:, 1]))
    assert (first.joint, first.kind) == ("A2", "friction drift")
    assert first.size == pytest.approx(4.0, rel=0.05)


def test_friction_of_the_load_is_named(found: TorqueResiduals) -> None:
    load = np.abs(found.torques.model[:, 1])
    first = first_of(on_motor(found, 1, 0.08 * load * found.motion.signs[:, 1]))
    assert (first.joint, first.kind) == ("A2", "load friction")
    assert first.size == pytest.approx(8.0, rel=0.05)


def test_saturated_drive_is_named_with_its_limit(found: TorqueResiduals) -> None:
    commanded = found.torques.commanded[:, 1]
    limit = 0.73 * np.abs(commanded).max()
    first = first_of(on_motor(found, 1, commanded - np.clip(commanded, -limit, limit)))
    assert (first.joint, first.kind) == ("A2", "saturation")
    assert first.size == pytest.approx(limit, rel=0.02)


def test_spring_is_named(found: TorqueResiduals) -> None:
    angles = found.motion.links[0, :, 1]
    link = found.link.copy()
    link[:, 1] += 20.0 * (angles - angles.mean()) + 60.0 * (angles - angles.mean()) ** 2
    first = first_of(replace(found, link=link))
    assert (first.joint, first.kind) == ("A2", "spring")


def test_missing_gravity_compensation_of_all_drives_is_named(found: TorqueResiduals) -> None:
    gravity = found.by_gravity @ [0.0, 0.0, -GRAVITY]
    first = first_of(replace(found, motor=found.motor - gravity))
    assert (first.joint, first.kind) == (COMMANDS, "gravity compensation")
    assert first.size == pytest.approx(-100.0, abs=2.0)


def test_share_is_zero_for_the_right_effect_and_one_for_an_unrelated_one() -> None:
    rng, x = np.random.default_rng(3), np.linspace(0.0, 6.0, 300)
    right, other, priors = np.sin(x), np.cos(7.0 * x), np.ones(1)
    y = (50.0 * right + rng.normal(size=300))[None]
    assert unexplained_share(y, right[None, :, None], np.array([100.0])) < 0.02
    assert unexplained_share(y, other[None, :, None], np.array([100.0])) > 0.9
    assert unexplained_share(0.01 * y, other[None, :, None], priors) == 0.0


def test_confidence_is_limited_by_the_share() -> None:
    assert limited(0.99, 0.0) == 0.99
    assert limited(0.6, 0.0) == 0.6
    shares = np.linspace(0.0, 1.0, 30)
    limits = [limited(0.99, share) for share in shares]
    assert limits == sorted(limits, reverse=True)
    assert limits[-1] == 0.0
