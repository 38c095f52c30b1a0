"""The Cartesian impedance: wrench, energy, step response, null space, singularities."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from simulated import START, Loop, lwr_model

from sero_mj.base.frames import frame, rotation_angle
from sero_mj.simulate.control.cartesian_control import (
    CartesianImpedance,
    CartesianImpedanceController,
)
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.robot_model import RobotModel

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
MODEL = lwr_model()


def turned(vector: Array) -> Array:
    """Returns the rotation matrix of a rotation vector, computed by MuJoCo."""
    angle = float(np.linalg.norm(vector))
    quat, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, vector / max(angle, 1e-300), angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def flange_at(model: RobotModel, angles: Array) -> Array:
    model.update(angles, np.zeros(7))
    return model.flange()


def target_at(model: RobotModel, angles: Array) -> Target:
    target = Target(7)
    target.pose[:] = flange_at(model, angles)
    target.posture[:] = angles
    return target


def at_pose(pose: Array) -> Target:
    target = Target(7)
    target.pose[:] = pose
    return target


def spring_energy(control: CartesianImpedanceController, pose: Array) -> float:
    """Returns V in J: 1/2 e^T K e with position error and -2 times the quaternion vector."""
    R, T = control.model.flange_rotation, control.model.flange()
    way, turn = pose[:3, 3] - T[:3, 3], R @ pose[:3, :3].T
    if control._in_flange:
        way, turn = pose[:3, :3].T @ way, pose[:3, :3].T @ R
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    error = np.hstack([way, -2.0 * np.copysign(1.0, quaternion[0]) * quaternion[1:]])
    return float(0.5 * error @ control.stiffness @ error)


@settings(deadline=None, max_examples=examples(50))
@given(seeds, st.sampled_from(["world", "flange"]))
def test_wrench_is_the_negative_gradient_of_the_energy(seed: int, axes: str) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(6, 6))
    control = CartesianImpedance(stiffness=a @ a.T * 100, axes=axes).make(MODEL, 1e-3)
    q = rng.uniform(-2, 2, 7)
    pose = frame(turned(rng.normal(size=3)), rng.normal(size=3))
    MODEL.update(q, np.zeros(7))
    torques = MODEL.jacobian().T @ control.spring_wrench(at_pose(pose))
    step, slope = 1e-6, []
    for e in np.eye(7):
        energies = []
        for sign in (step, -step):
            MODEL.update(q + sign * e, np.zeros(7))
            energies.append(spring_energy(control, pose))
        slope.append((energies[0] - energies[1]) / (2 * step))
    np.testing.assert_allclose(torques, -np.array(slope), atol=1e-3, rtol=1e-5)


@settings(deadline=None, max_examples=examples(50))
@given(seeds, st.sampled_from(["world", "flange"]), st.booleans())
def test_torques_at_rest_equal_those_of_the_wrench(seed: int, axes: str, coupled: bool) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(6, 6))
    stiffness = a @ a.T * 100
    if not coupled:
        stiffness[:3, 3:] = stiffness[3:, :3] = 0.0
    control = CartesianImpedance(stiffness=stiffness, axes=axes, nullspace_stiffness=0.0).make(
        MODEL, 1e-3
    )
    sensed, target, torques = Sensed(7), Target(7), np.zeros(7)
    sensed.angles[:] = rng.uniform(-2, 2, 7)
    target.pose[:] = frame(turned(rng.normal(size=3) * 2), rng.normal(size=3))
    control.torques(sensed, target, torques)
    expected = MODEL.jacobian().T @ control.spring_wrench(target) + MODEL.gravity()
    np.testing.assert_allclose(torques, expected, rtol=1e-9, atol=1e-9)


def test_small_errors_act_like_springs_along_the_declared_axes() -> None:
    stiffness = [1000.0, 2000.0, 3000.0, 10.0, 20.0, 30.0]
    MODEL.update(START, np.zeros(7))
    here = MODEL.flange()
    moved = np.array([1e-3, -2e-3, 3e-3])
    spun = np.array([1e-4, 2e-4, -3e-4])
    in_world = CartesianImpedance(stiffness=stiffness).make(MODEL, 1e-3)
    pose = frame(turned(spun) @ here[:3, :3], here[:3, 3] + moved)
    expected = stiffness * np.hstack([moved, spun])
    np.testing.assert_allclose(in_world.spring_wrench(at_pose(pose)), expected, rtol=1e-3)
    in_flange = CartesianImpedance(stiffness=stiffness, axes="flange").make(MODEL, 1e-3)
    pose = here @ frame(turned(spun), moved)
    R = pose[:3, :3]
    wrench = in_flange.spring_wrench(at_pose(pose))
    np.testing.assert_allclose(wrench[:3] @ R, stiffness[:3] * moved, rtol=1e-3)
    np.testing.assert_allclose(wrench[3:] @ R, stiffness[3:] * spun, rtol=1e-3)


def total_energy(loop: Loop, control: CartesianImpedanceController, pose: Array) -> float:
    loop.robot.update(loop.sensed.angles, loop.sensed.velocities)
    dq = loop.sensed.velocities
    return float(0.5 * dq @ loop.robot.mass() @ dq) + spring_energy(control, pose)


@pytest.mark.thorough
@settings(deadline=None, max_examples=examples(6))
@given(seeds, st.floats(0, 1.5), st.sampled_from(["world", "flange"]))
def test_energy_never_grows_without_null_space_stiffness(
    seed: int, ratio: float, axes: str
) -> None:
    rng = np.random.default_rng(seed)
    loop = Loop(1e-4, rng.uniform(-1.5, 1.5, 7))
    loop.data.qvel[:] = rng.uniform(-1.5, 1.5, 7)
    loop.sense()
    control = CartesianImpedance(damping=ratio, nullspace_stiffness=0.0, axes=axes).make(
        loop.robot, 1e-4
    )
    target = target_at(loop.robot, rng.uniform(-1.5, 1.5, 7))
    first = last = total_energy(loop, control, target.pose)
    for _ in range(50):
        loop.run(0.006, lambda sensed, out: control.torques(sensed, target, out))
        now = total_energy(loop, control, target.pose)
        assert now <= last + 2e-3 * first
        last = now


@pytest.mark.parametrize(
    ("along", "amount"), [([1, 0, 0, 0, 0, 0], 5e-3), ([0, 0, 0, 0, 0, 1], 0.02)]
)
def test_step_overshoot_matches_the_damping_ratio(along: list[float], amount: float) -> None:
    # Stiffness proportional to the effective inertia: all directions have the same mode.
    loop = Loop(2.5e-4)
    loop.robot.update(START, np.zeros(7))
    J = loop.robot.jacobian()
    felt = np.linalg.inv(J @ np.linalg.solve(loop.robot.mass(), J.T))
    stiffness = 400.0 * (felt + felt.T) / 2
    control = CartesianImpedance(stiffness=stiffness).make(loop.robot, 2.5e-4)
    target = target_at(loop.robot, START)
    here = target.pose.copy()
    spun = amount * np.array(along)
    target.pose[:3, 3] += spun[:3]
    target.pose[:3, :3] = turned(spun[3:]) @ here[:3, :3]
    logged = loop.run(1.0, lambda sensed, out: control.torques(sensed, target, out))
    moved = []
    for q in logged[::10]:
        now = flange_at(loop.robot, q)
        turn = (now[:3, :3] @ here[:3, :3].T - here[:3, :3] @ now[:3, :3].T) / 2
        moved.append([*(now - here)[:3, 3], turn[2, 1], turn[0, 2], turn[1, 0]])
    part = np.array(moved) @ along / amount
    assert part.max() == pytest.approx(1.046, abs=0.008)
    assert part[-1] == pytest.approx(1.0, abs=2e-3)
    others = np.array(moved)[:, np.flatnonzero(np.array(along) == 0)]
    assert np.abs(others).max() < 0.1 * amount


def test_flange_force_displaces_by_force_over_stiffness() -> None:
    loop = Loop()
    control = CartesianImpedance(stiffness=[500, 1000, 2000, 50, 50, 50]).make(loop.robot, 1e-3)
    target = target_at(loop.robot, START)
    force = np.array([5.0, -10.0, 20.0])

    def act(sensed: Sensed, out: Array) -> None:
        control.torques(sensed, target, out)
        out += loop.robot.jacobian()[:3].T @ force

    loop.run(8.0, act)
    now = flange_at(loop.robot, loop.sensed.angles)
    np.testing.assert_allclose(now[:3, 3] - target.pose[:3, 3], [0.01, -0.01, 0.01], atol=1e-5)
    assert rotation_angle(now[:3, :3].T @ target.pose[:3, :3]) < 1e-4


def test_target_wrench_is_exerted() -> None:
    target, out, before = target_at(MODEL, START), np.zeros(7), np.zeros(7)
    sensed = Sensed(7)
    sensed.angles[:] = START
    control = CartesianImpedance().make(MODEL, 1e-3)
    control.torques(sensed, target, before)
    np.testing.assert_allclose(before, MODEL.gravity(), atol=1e-9)
    target.wrench[:] = 1, 2, 3, 4, 5, 6
    target.torques[:] = 7
    control.torques(sensed, target, out)
    expected = MODEL.jacobian().T @ target.wrench + 7
    np.testing.assert_allclose(out - before, expected, atol=1e-9)


def test_null_space_moves_the_elbow_but_not_the_flange() -> None:
    loop = Loop()
    control = CartesianImpedance(stiffness=[5000] * 3 + [300] * 3, nullspace_stiffness=30.0).make(
        loop.robot, 1e-3
    )
    target = target_at(loop.robot, START)
    target.posture[:] = START + np.array([0.8, 0, -0.8, 0, 0.5, 0, 0])
    logged = loop.run(6.0, lambda sensed, out: control.torques(sensed, target, out))
    assert np.abs(logged[-1] - START).max() > 0.3
    assert np.abs(logged[-1] - logged[-500]).max() < 1e-3  # it has arrived
    poses = [flange_at(loop.robot, q) for q in logged[::20]]
    moved = max(np.linalg.norm(pose[:3, 3] - target.pose[:3, 3]) for pose in poses)
    spun = max(rotation_angle(pose[:3, :3].T @ target.pose[:3, :3]) for pose in poses)
    assert moved < 2e-3
    assert spun < 5e-3


@settings(deadline=None, max_examples=examples(20))
@given(seeds)
def test_null_space_torques_do_not_accelerate_the_flange(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = START + rng.uniform(-0.3, 0.3, 7)
    target = target_at(MODEL, q)
    sensed = Sensed(7)
    sensed.angles[:] = q
    control = CartesianImpedance(nullspace_stiffness=100.0).make(MODEL, 1e-3)
    still, out = np.zeros(7), np.zeros(7)
    control.torques(sensed, target, still)
    away, elbow = rng.uniform(-1, 1, 7), np.linalg.svd(MODEL.jacobian())[2][-1]
    away += np.copysign(0.3, elbow @ away) * elbow  # otherwise the elbow gets no null-space torque
    target.posture[:] = q + away
    control.torques(sensed, target, out)
    accelerations = np.linalg.solve(MODEL.mass(), out - still)
    assert np.abs(accelerations).max() > 0.01
    assert np.abs(MODEL.jacobian() @ accelerations).max() < 1e-3 * np.abs(accelerations).max()


def test_null_space_torques_do_not_leak_away_from_singularities() -> None:
    rng, bound = np.random.default_rng(0), np.deg2rad([170, 120, 170, 120, 170, 120, 170])
    poses = rng.uniform(-bound, bound, (2000, 7))
    best, moved = 0.0, []
    for q in poses:
        MODEL.update(q, np.zeros(7))
        best = max(best, float(np.linalg.svd(MODEL.jacobian(), compute_uv=False).prod()))
    for q in poses[: examples(400)]:
        target, sensed, still, out = target_at(MODEL, q), Sensed(7), np.zeros(7), np.zeros(7)
        sensed.angles[:] = q
        control = CartesianImpedance().make(MODEL, 1e-3)
        control.torques(sensed, target, still)
        target.posture[:] = q + rng.uniform(-1, 1, 7)
        control.torques(sensed, target, out)
        J, back = MODEL.jacobian(), np.linalg.solve(MODEL.mass(), MODEL.jacobian().T)
        if np.linalg.svd(J, compute_uv=False).prod() > 0.01 * best:
            # The wrench of the springs that holds the flange against these torques.
            wrench = np.linalg.solve(J @ back, back.T @ (out - still))
            moved.append(np.linalg.solve(control.stiffness, wrench))
    assert len(moved) > 0.9 * examples(400)
    assert np.linalg.norm(np.array(moved)[:, :3], axis=1).max() < 1e-8  # m; 0.1 mm is the goal
    assert np.linalg.norm(np.array(moved)[:, 3:], axis=1).max() < 1e-8


def test_target_is_reached_at_rest_near_a_stretched_elbow() -> None:
    loop = Loop()
    goal = np.deg2rad([0, 30, 0, -37, 0, 60, 0])
    control = CartesianImpedance(nullspace_stiffness=30.0).make(loop.robot, 1e-3)
    target = target_at(loop.robot, goal)
    target.posture[:] = START
    logged = loop.run(8.0, lambda sensed, out: control.torques(sensed, target, out))
    assert np.abs(logged[-1] - logged[-500]).max() < 1e-5  # at rest
    pose = flange_at(loop.robot, logged[-1])
    assert np.linalg.norm(pose[:3, 3] - target.pose[:3, 3]) < 1e-4
    assert rotation_angle(pose[:3, :3].T @ target.pose[:3, :3]) < 1e-4


@pytest.mark.thorough
def test_arm_comes_to_rest_near_a_blocked_direction() -> None:
    goal = np.array([-1.7056, -0.3836, 2.1033, -0.3642, 0.9774, 0.0418, 0.1892])
    loop = Loop(angles=goal)  # 2 % of the best manipulability
    target = target_at(loop.robot, goal)
    target.posture[:] = goal + np.array([0.0, -0.36, 0.07, 0.29, 0.05, -0.22, -0.49])
    control = CartesianImpedance().make(loop.robot, 1e-3)
    loop.run(14.0, lambda sensed, out: control.torques(sensed, target, out))
    assert np.abs(loop.data.qvel).max() < 1e-3
    pose = flange_at(loop.robot, loop.data.qpos)
    assert np.linalg.norm(pose[:3, 3] - target.pose[:3, 3]) < 1e-4


def test_torques_are_continuous_through_a_singularity() -> None:
    def jump(step: float) -> float:
        control = CartesianImpedance().make(MODEL, 1e-3)
        torques = []
        for elbow in np.arange(-0.01, 0.01, step):
            q = np.array([0.3, 0.5, 0.2, elbow, 0.4, 0.6, 0.1])
            target, sensed, out = target_at(MODEL, q), Sensed(7), np.zeros(7)
            sensed.angles[:] = q
            target.posture[:] = q + 0.5
            control.torques(sensed, target, out)
            torques.append(out)
        return float(np.abs(np.diff(torques, axis=0)).max())

    assert jump(1e-5) < 0.2 * jump(1e-4) < 0.5


@pytest.mark.thorough
def test_arm_passes_a_singularity_with_bounded_torques_and_returns() -> None:
    loop = Loop()
    control = CartesianImpedance(stiffness=[1e3] * 3 + [10] * 3).make(loop.robot, 1e-3)
    target = target_at(loop.robot, START)
    reach = target.pose[:3, 3].copy()
    away = (reach - [0, 0, 0.31]) / np.linalg.norm(reach - [0, 0, 0.31])
    largest, least = [0.0], [np.inf]

    def act(sensed: Sensed, out: Array) -> None:
        # To half a meter beyond the arm's reach, and back.
        target.pose[:3, 3] = reach + 1.0 * away * np.sin(np.pi * sensed.time / 4.0) ** 2
        control.torques(sensed, target, out)
        largest[0] = max(largest[0], float(np.abs(out).max()))
        least[0] = min(least[0], np.linalg.svd(loop.robot.jacobian(), compute_uv=False).prod())

    loop.run(4.0, act)
    assert least[0] < 1e-4
    assert largest[0] < 100.0
    target.pose[:3, 3] = reach
    logged = loop.run(5.0, lambda sensed, out: control.torques(sensed, target, out))
    assert np.linalg.norm(flange_at(loop.robot, logged[-1])[:3, 3] - reach) < 1e-3


STIFFNESSES = "6 numbers (N/m, Nm/rad), or 6 x 6 numbers"


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"stiffness": [1, 2, 3]}, {"reason": f"found 3; expected {STIFFNESSES}"}),
        ({"stiffness": 5}, {"reason": f"found one number; expected {STIFFNESSES}"}),
        (
            {"stiffness": [1, 1, 1, 1, 1, -5]},
            {"reason": "found an eigenvalue of", "found": -5.0, "expected": "none below zero"},
        ),
        (
            {"stiffness": np.triu(np.ones((6, 6)))},
            {"reason": "found a matrix that is not symmetric; expected a symmetric matrix"},
        ),
        (
            {"axes": "flang"},
            {"found": "flang", "expected": "'world' or 'flange'", "near": "flange"},
        ),
        ({"damping": -1}, {"found": -1, "expected": "greater than or equal to 0"}),
        ({"nullspace_stifness": 3}, {"reason": "unknown key", "near": "nullspace_stiffness"}),
    ],
)
def test_invalid_gains_are_rejected(fields: dict[str, Any], expected: dict[str, Any]) -> None:
    (key,) = fields
    with raises_with(key=key, **expected):
        CartesianImpedance(**fields)
