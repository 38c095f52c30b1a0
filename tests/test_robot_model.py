"""The controller's model against finite differences, MuJoCo's whole pipeline, and NumPy."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from simulated import MOTORS, lwr_model, lwr_mujoco, lwr_robot

from sero_mj import SerialRobot
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.simulate.control.robot_model import RobotModel

Array = NDArray[np.float64]
MODEL = lwr_model()
seeds = st.integers(0, 2**32 - 1)


def state(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-2, 2, 7), rng.uniform(-2, 2, 7)


CACHE = lwr_mujoco()


@settings(deadline=None, max_examples=examples(30))
@given(seeds)
def test_bias_and_mass_equal_those_of_the_whole_pipeline(seed: int) -> None:
    q, dq = state(seed)
    model, *_ = CACHE
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, dq
    mujoco.mj_forward(model, data)
    MODEL.update(q, dq)
    np.testing.assert_allclose(MODEL.coriolis() + MODEL.gravity(), data.qfrc_bias, atol=1e-11)
    full = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, full)
    np.testing.assert_allclose(MODEL.mass(), full, atol=1e-13)
    momentum, slope = np.zeros((2, 7))
    MODEL.write_momentum(momentum, slope)
    np.testing.assert_allclose(momentum, (full - np.diag(MOTORS)) @ dq, atol=1e-12)
    data.qvel[:] = 0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(MODEL.gravity(), data.qfrc_bias, atol=1e-11)


def mass_at(q: Array) -> Array:
    MODEL.update(q, np.zeros(7))
    return MODEL.mass().copy()


@settings(deadline=None, max_examples=examples(20))
@given(seeds)
def test_coriolis_terms_equal_those_of_the_christoffel_symbols(seed: int) -> None:
    q, dq = state(seed)
    other = state(seed + 1)[1]
    step = 1e-5
    slopes = np.array(
        [(mass_at(q + step * e) - mass_at(q - step * e)) / (2 * step) for e in np.eye(7)]
    )  # [k, i, j] = dM_ij / dq_k
    # symbols[i, j, k]: 0.5 (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i)
    symbols = 0.5 * (
        np.einsum("kij->ijk", slopes)
        + np.einsum("jik->ijk", slopes)
        - np.einsum("ijk->ijk", slopes)
    )
    matrix = symbols @ dq
    MODEL.update(q, dq)
    np.testing.assert_allclose(MODEL.coriolis(), matrix @ dq, atol=1e-7)
    acceleration = state(seed + 2)[1]
    inverse = (MODEL.mass() - np.diag(MOTORS)) @ acceleration + matrix @ other + MODEL.gravity()
    found, less = np.zeros((2, 7))
    MODEL.write_inverse_dynamics(other, acceleration, found, less)
    np.testing.assert_allclose(found - less, inverse, atol=1e-7)
    momentum, slope = np.zeros((2, 7))
    MODEL.write_momentum(momentum, slope)
    np.testing.assert_allclose(slope, matrix.T @ dq - MODEL.gravity(), atol=1e-7)
    np.testing.assert_allclose(MODEL.coriolis(), matrix @ dq, atol=1e-7)  # in any order


@settings(deadline=None, max_examples=examples(20))
@given(seeds)
def test_jacobian_equals_finite_differences_of_the_flange(seed: int) -> None:
    q, dq = state(seed)
    dh = lwr_robot().dh
    flange = lwr_robot().flange_frame
    MODEL.update(q, dq)
    np.testing.assert_allclose(MODEL.flange(), dh.frames(q)[-1] @ flange, atol=1e-12)
    twist = MODEL.jacobian() @ dq
    step = 1e-6
    after, before = (dh.frames(q + s * dq)[-1] @ flange for s in (step, -step))
    np.testing.assert_allclose(twist[:3], (after - before)[:3, 3] / (2 * step), atol=1e-7)
    turn = (after - before)[:3, :3] @ MODEL.flange_rotation.T / (2 * step)
    np.testing.assert_allclose(twist[3:], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-7)


def test_declared_robot_has_a_model() -> None:
    robot = RobotModel.of(lwr_robot())
    assert (robot.n, robot.name) == (7, "lwr")
    assert robot.joint_names == lwr_robot().names
    robot.update(np.zeros(7), np.zeros(7))
    assert robot.flange_position[2] == pytest.approx(0.31 + 0.4 + 0.39 + 0.078)


def test_invalid_joints_and_flanges_are_rejected() -> None:
    model, joints, flange = CACHE
    with pytest.raises(ValueError, match=r"^found joints \[2, 1\]; expected the joints of one"):
        RobotModel(model, [2, 1], body=flange)
    with pytest.raises(ValueError, match=r"found joints \[\]"):
        RobotModel(model, [], body=flange)
    for both in ({}, {"site": 0, "body": 0}):
        with pytest.raises(ValueError, match=r"the flange is .*; expected a site or a body"):
            RobotModel(model, joints, **both)


def test_other_bodies_are_omitted_and_other_joints_are_rigid() -> None:
    xml = """<mujoco><worldbody>
      <body pos="3 0 0"><freejoint/><geom size=".1"/></body>
      <body><joint name="r/A" axis="0 1 0" armature=".5"/><geom size=".1" pos=".5 0 0" mass="2"/>
        <body pos="1 0 0"><joint name="r/B" axis="0 0 1"/><geom size=".1" pos=".2 0 0" mass="1"/>
          <body pos=".1 0 0"><joint name="gripper"/><geom size=".01" mass=".001"/></body>
          <site name="tip" pos=".4 0 0"/></body></body>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    robot = RobotModel(model, [1, 2], site=0, name="r")
    assert robot.joint_names == ["A", "B"]
    robot.update(np.zeros(2), np.array([0.3, 0.0]))
    np.testing.assert_allclose(robot.gravity(), [-9.81 * (2 * 0.5 + 1.2 + 0.0011), 0.0], atol=1e-12)
    np.testing.assert_allclose(robot.mass()[1, 1], 0.4 * 0.01 + 0.04 + 1e-5 + 4e-8, atol=1e-12)
    np.testing.assert_allclose(robot.jacobian()[:, 0], [0, 0, -1.4, 0, 1, 0], atol=1e-12)
    with pytest.raises(ValueError, match=r"^found joints \[0, 1\]"):
        RobotModel(model, [0, 1], site=0)


def test_base_is_the_declared_base_frame() -> None:
    stands = frame(rotation_from_rpy(np.array([0.2, 0.1, 0.3])), np.array([1.0, 2.0, 3.0]))
    robot = SerialRobot.from_model("fr3", base_frame=stands)
    model = RobotModel.of(robot)
    angles = np.array([0.1, 0.2, 0.3, -1.4, 0.5, 1.6, 0.7])
    model.update(angles, np.zeros(7))
    flange = model.base() @ robot.fwd_kin_base_to_flange(angles)
    np.testing.assert_allclose(flange, model.flange(), atol=1e-12)
