"""Denavit-Hartenberg kinematics: NumPy against scalar products, MuJoCo, and published poses."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import permutations
from math import cos, pi, sin

import mujoco
import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import MAX_JOINTS
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.kinematics.dh import COLUMNS, DhTable

CONVENTIONS = ("craig", "standard")
SPECIAL = [0.0, pi / 2, -pi / 2, pi, -pi]  # values that occur in real tables
ANGLES = st.sampled_from(SPECIAL) | st.floats(-2 * pi, 2 * pi)
LENGTHS = st.just(0.0) | st.floats(-2.0, 2.0)
ROWS = st.tuples(ANGLES, LENGTHS, ANGLES, LENGTHS)  # alpha, a, theta, d


def turn_z(angle):
    c, s = cos(angle), sin(angle)
    return [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def turn_x(angle):
    c, s = cos(angle), sin(angle)
    return [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]]


def shift(x, z):
    return [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, z], [0, 0, 0, 1]]


def product(*matrices):
    """Returns the product of 4x4 lists, element by element, without the code under test."""

    def times(A, B):
        return [[sum(A[i][k] * B[k][j] for k in range(4)) for j in range(4)] for i in range(4)]

    return reduce(times, matrices)


def scalar_frames(convention, rows, revolute, q):
    """Returns T_0_i for i = 0 to n as products of elementary matrices, as in ROBOTS.md 4.1."""
    frames = [shift(0, 0)]
    for (alpha, a, theta, d), turns, value in zip(rows, revolute, q, strict=True):
        screw_x = (turn_x(alpha), shift(a, 0))
        screw_z = (turn_z(theta + value * turns), shift(0, d + value * (not turns)))
        order = (*screw_x, *screw_z) if convention == "craig" else (*screw_z, *screw_x)
        frames.append(product(frames[-1], *order))
    return np.array(frames, float)


def angle_between(A, B):
    """Returns the largest angle (rad) between rotations (..., 3, 3), exact for small ones."""
    off = np.linalg.norm(A - B, axis=(-2, -1)) / np.sqrt(8.0)
    return float(2.0 * np.arcsin(np.clip(off, 0.0, 1.0)).max())


def assert_same_poses(A, B, tolerance=1e-12):
    assert np.abs(A[..., :3, 3] - B[..., :3, 3]).max() < tolerance
    assert angle_between(A[..., :3, :3], B[..., :3, :3]) < tolerance


def random_frame(rng):
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, :3] *= np.linalg.det(T[:3, :3])
    T[:3, 3] = rng.uniform(-1, 1, 3)
    return T


@st.composite
def robots(draw, max_joints=MAX_JOINTS):
    """Returns a robot with frames at both ends, and joint values, generated from a seed."""
    n = draw(st.integers(1, max_joints))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = rng.uniform(-0.4, 0.4, (n, 4))
    rows[:, [0, 2]] *= pi / 0.4
    special = rng.random((n, 2)) < 0.5
    rows[:, [0, 2]] = np.where(special, rng.choice(SPECIAL, (n, 2)), rows[:, [0, 2]])
    rows[:, [1, 3]] *= rng.random((n, 2)) < 0.7
    kinds = draw(st.sampled_from(["revolute", "prismatic", "both"]))
    types = rng.choice(["revolute", "prismatic"], n).tolist() if kinds == "both" else [kinds] * n
    robot = SerialRobot(
        dh_convention=draw(st.sampled_from(CONVENTIONS)),
        dh_params=rows,
        joint_types=types,
        base_frame=random_frame(rng),
        flange_frame=random_frame(rng),
    )
    return robot, rng.uniform(-1, 1, n) * np.where(robot.dh.revolute, pi, 0.5)


def compiled(robot, q):
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    world.set_input(data, f"{robot.name}.joint_angles", q)
    mujoco.mj_forward(world.model, data)
    return world, data


def body_poses(data, bodies):
    T = np.tile(np.eye(4), (len(bodies), 1, 1))
    T[:, :3, :3] = data.xmat[bodies].reshape(-1, 3, 3)
    T[:, :3, 3] = data.xpos[bodies]
    return T


@given(
    convention=st.sampled_from(CONVENTIONS),
    joints=st.lists(st.tuples(ROWS, st.booleans(), ANGLES), min_size=1, max_size=8),
)
@settings(max_examples=examples(80), deadline=None)
def test_numpy_frames_equal_products_of_elementary_matrices(convention, joints):
    rows, revolute, q = zip(*joints, strict=True)
    table = DhTable.from_rows(rows, convention, revolute=revolute)
    np.testing.assert_allclose(
        table.frames(q), scalar_frames(convention, rows, revolute, q), rtol=0, atol=1e-12
    )


@given(robots())
@settings(max_examples=examples(40), deadline=None)
def test_numpy_frames_equal_those_of_the_compiled_model(case):
    robot, q = case
    world, data = compiled(robot, q)
    part = world.robots["robot"]
    expected = robot.dh.frames(q, robot.base_frame)
    assert_same_poses(body_poses(data, part.bodies), expected)
    flange = body_poses(data, [part.flange_body])[0]
    assert_same_poses(flange, expected[-1] @ robot.flange_frame)
    assert_same_poses(world.fwd_kin_base_to_flange(data, "robot"), robot.fwd_kin_base_to_flange(q))


@given(robots(max_joints=12))
@settings(max_examples=examples(25), deadline=None)
def test_jacobian_and_joint_axes_equal_those_of_the_compiled_model(case):
    robot, q = case
    world, data = compiled(robot, q)
    model, part = world.model, world.robots["robot"]
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, linear, angular, part.flange_body)
    jacobian = robot.dh.jacobian(q, robot.base_frame, robot.flange_frame)
    np.testing.assert_allclose(jacobian, np.vstack([linear, angular]), rtol=0, atol=1e-11)
    axes, points = robot.dh.joint_axes(robot.dh.frames(q, robot.base_frame))
    np.testing.assert_allclose(axes, data.xaxis, rtol=0, atol=1e-12)
    # The anchor of a prismatic joint can be anywhere; that of a revolute joint is on its axis.
    hinges = robot.dh.revolute
    off = np.cross(data.xanchor - points, axes)[hinges]
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-12)


@given(robots(max_joints=10))
@settings(max_examples=examples(40), deadline=None)
def test_jacobian_equals_finite_differences(case):
    robot, q = case
    n, step = robot.n, 1e-6

    def flange(values):
        return robot.dh.frames(values, robot.base_frame)[..., -1, :, :] @ robot.flange_frame

    ahead, behind = flange(q + step * np.eye(n)), flange(q - step * np.eye(n))
    rate = (ahead - behind) / (2 * step)
    spin = rate[:, :3, :3] @ flange(q)[:3, :3].T
    expected = np.vstack([rate[:, :3, 3].T, spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    jacobian = robot.dh.jacobian(q, robot.base_frame, robot.flange_frame)
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=2e-8)


@given(
    joints=st.lists(st.tuples(ROWS, st.booleans(), ANGLES), min_size=1, max_size=6),
)
@settings(max_examples=examples(60), deadline=None)
def test_standard_table_equals_modified_table_shifted_by_one_link(joints):
    rows, revolute, q = zip(*joints, strict=True)
    standard = np.array(rows)
    modified = standard.copy()
    modified[1:, :2] = standard[:-1, :2]  # alpha and a belong to the row before
    modified[0, :2] = 0.0
    last = np.array(product(turn_x(standard[-1, 0]), shift(standard[-1, 1], 0)))
    np.testing.assert_allclose(
        DhTable.from_rows(modified, "craig", revolute=revolute).frames(q)[-1] @ last,
        DhTable.from_rows(standard, "standard", revolute=revolute).frames(q)[-1],
        rtol=0,
        atol=1e-12,
    )


# ROBOTS.md 4.2, rows 3 and 4: alpha (deg), a (m), theta, d (m).
PUMA_STANDARD = [
    (90, 0, 0, 0.67183),
    (0, 0.4318, 0, 0),
    (-90, 0.0203, 0, 0.15005),
    (90, 0, 0, 0.4318),
    (-90, 0, 0, 0),
    (0, 0, 0, 0),
]
PUMA_MODIFIED = [
    (0, 0, 0, 0.67183),
    (90, 0, 0, 0),
    (0, 0.4318, 0, 0.15005),
    (-90, 0.0203, 0, 0.4318),
    (90, 0, 0, 0),
    (-90, 0, 0, 0),
]
# Franka Emika, FCI documentation, "Denavit-Hartenberg parameters" (Craig's convention).
PANDA = [
    (0, 0, 0, 0.333),
    (-90, 0, 0, 0),
    (90, 0, 0, 0.316),
    (90, 0.0825, 0, 0),
    (-90, -0.0825, 0, 0.384),
    (90, 0, 0, 0),
    (90, 0.088, 0, 0),
]
PANDA_FLANGE = np.array(shift(0, 0.107))


def table_in_degrees(rows: Sequence, convention: str) -> DhTable:
    return DhTable.from_rows(np.array(rows) * (pi / 180, 1, 1, 1), convention)


def test_puma_560_pose_equals_the_one_of_the_robotics_toolbox():
    # Source: petercorke/robotics-toolbox-python, docs/notebooks/kinematics.ipynb, pose qn.
    pose = table_in_degrees(PUMA_STANDARD, "standard").frames([0, pi / 4, pi, 0, pi / 4, 0])[-1]
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-12)
    # Published with four digits; ROBOTS.md has the recomputed sixth.
    np.testing.assert_allclose(pose[:3, 3], [0.5963, -0.15005, 0.65748], atol=5e-6)
    np.testing.assert_allclose(pose[:3, 3], [0.596303, -0.150050, 0.657476], atol=5e-7)


def test_standard_and_modified_puma_560_agree_at_any_pose():
    q = np.random.default_rng(560).uniform(-pi, pi, (200, 6))
    standard = table_in_degrees(PUMA_STANDARD, "standard").frames(q)[:, -1]
    modified = table_in_degrees(PUMA_MODIFIED, "craig").frames(q)[:, -1]
    np.testing.assert_allclose(standard, modified, rtol=0, atol=1e-14)


def test_panda_flange_at_zero_equals_the_published_one():
    # Source: RTB-matlab issue 125 (z = 0.926), ROBOTS.md 4.2 row 6.
    pose = table_in_degrees(PANDA, "craig").frames(np.zeros(7))[-1] @ PANDA_FLANGE
    np.testing.assert_allclose(pose[:3, :3], np.diag([1, -1, -1]), atol=1e-15)
    np.testing.assert_allclose(pose[:3, 3], [0.088, 0, 0.926], atol=1e-15)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_mixed_chain_equals_the_robotics_toolbox_test(convention):
    # Source: RTB test_fkine: P, R, P (theta = 2), R at 1, 2, 3, 4 is Rz(8 rad), z = 4.
    rows = [(0, 0, 0, 0), (0, 0, 0, 0), (0, 0, 2, 0), (0, 0, 0, 0)]
    table = DhTable.from_rows(rows, convention, revolute=[False, True, False, True])
    pose = table.frames([1, 2, 3, 4])[-1]
    np.testing.assert_allclose(pose[0, :2], [-0.14550003, -0.98935825], atol=5e-9)
    np.testing.assert_allclose(pose[:3, 3], [0, 0, 4], atol=1e-15)


@pytest.mark.parametrize("columns", list(permutations(COLUMNS)))
def test_columns_can_be_in_any_order(columns):
    by_name = {"alpha": 0.1, "a": 0.2, "theta": 0.3, "d": 0.4}
    table = DhTable.from_rows([[by_name[name] for name in columns]], "craig", columns)
    assert {name: getattr(table, name).tolist() for name in by_name} == {
        name: [value] for name, value in by_name.items()
    }


def test_batched_poses_equal_single_ones():
    table = table_in_degrees(PUMA_STANDARD, "standard")
    base, flange = np.array(product(turn_x(0.3), shift(1, 2))), np.array(shift(0.1, 0.2))
    q = np.random.default_rng(1).uniform(-pi, pi, (2, 3, 6))
    frames, jacobians = table.frames(q, base), table.jacobian(q, base, flange)
    assert frames.shape == (2, 3, 7, 4, 4)
    assert table.link_transforms(q).shape == (2, 3, 6, 4, 4)
    assert jacobians.shape == (2, 3, 6, 6)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_allclose(frames[i, j], table.frames(q[i, j], base), atol=1e-15)
        np.testing.assert_allclose(
            jacobians[i, j], table.jacobian(q[i, j], base, flange), atol=1e-15
        )


def test_wrong_number_of_joint_angles_is_rejected():
    table = table_in_degrees(PUMA_STANDARD, "standard")
    with raises_with(
        key="joint_angles", reason="found shape (2, 5)", expected="a last axis of length 6"
    ):
        table.frames(np.zeros((2, 5)))
    with raises_with(
        key="joint_angles", reason="found shape ()", expected="a last axis of length 6"
    ):
        table.jacobian(0.5)
