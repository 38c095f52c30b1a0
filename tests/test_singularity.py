"""Distance from singularities, against finite differences and known singular poses."""

import mujoco
import numpy as np
import pytest

from sero_mj.data.drive.place import follow
from sero_mj.viewer.decor.quantities import FAR, inverse_condition, jacobian, towards_singularity


def condition_at(world, data, q) -> tuple[float, np.ndarray]:
    data.qpos[:] = q
    follow(world.model, data)
    return inverse_condition(jacobian(world, data, world.robots["lwr"]))


def test_jacobian_equals_that_of_the_dh_table(lwr_world) -> None:
    data = lwr_world.make_data()
    q = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
    data.qpos[:] = q
    mujoco.mj_forward(lwr_world.model, data)
    robot = lwr_world.robots["lwr"].robot
    J = robot.dh.jacobian(q, robot.base_frame, robot.flange_frame)
    J[:3] /= 0.31 + 0.40 + 0.39
    found = jacobian(lwr_world, data, lwr_world.robots["lwr"])
    assert found == pytest.approx(J, abs=1e-12)


def test_gradient_agrees_with_finite_differences(lwr_world) -> None:
    data = lwr_world.make_data()
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, 7)
        _, gradient = condition_at(lwr_world, data, q)
        numeric = [
            (
                condition_at(lwr_world, data, q + step)[0]
                - condition_at(lwr_world, data, q - step)[0]
            )
            / 2e-6
            for step in 1e-6 * np.eye(7)
        ]
        assert gradient == pytest.approx(numeric, abs=1e-5)


def test_stretched_arm_is_singular_and_a_bent_one_is_not(lwr_world) -> None:
    data = lwr_world.make_data()
    assert condition_at(lwr_world, data, np.zeros(7))[0] < 1e-9
    bent = np.deg2rad([0, 40, 0, -90, 0, 60, 0])
    assert condition_at(lwr_world, data, bent)[0] > 0.05


def test_arrows_point_towards_the_singularity(lwr_world) -> None:
    data = lwr_world.make_data()
    part = lwr_world.robots["lwr"]
    q = np.deg2rad([0, 40, 0, -8, 0, 60, 0])  # the elbow is nearly stretched
    c, _ = condition_at(lwr_world, data, q)
    shown = towards_singularity(lwr_world, data, part)
    assert np.abs(shown).max() == pytest.approx(1 - c / FAR)
    assert int(np.argmax(np.abs(shown))) == 3
    nearer, _ = condition_at(lwr_world, data, q + 0.01 * shown)
    assert nearer < c
    condition_at(lwr_world, data, np.deg2rad([0, 40, 0, -90, 0, 60, 0]))
