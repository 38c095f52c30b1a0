"""Rigid frames: the math against MuJoCo's, and frames as written in files."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from conftest import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sero_mj.base import frames
from sero_mj.base.declaration import numbers
from sero_mj.base.errors import Problem, problems_of

ANGLES = st.floats(-2 * math.pi, 2 * math.pi)
THREE_ANGLES = st.tuples(ANGLES, ANGLES, ANGLES)
EYE = np.eye(4).tolist()


def rotation_by_mujoco(quat):
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float))
    return matrix.reshape(3, 3)


def quat_about(axis, angle):
    quat = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat, np.eye(3)[axis], angle)
    return quat


def read(value):
    return frames.frame_from(value, numbers)


def refusal(value) -> Problem:
    with pytest.raises(ValueError) as caught:
        read(value)
    (problem,) = problems_of(caught.value)
    return problem


@given(axis=st.sampled_from([0, 1, 2]), angle=ANGLES)
@settings(deadline=None)
def test_rotation_about_an_axis_follows_the_right_hand(axis, angle):
    np.testing.assert_allclose(
        frames.rotation_about(axis, angle), rotation_by_mujoco(quat_about(axis, angle)), atol=1e-15
    )


def test_rotations_about_an_axis_have_the_shape_of_the_angles():
    angles = np.linspace(-3, 3, 6).reshape(2, 3)
    stack = frames.rotation_about(1, angles)
    assert stack.shape == (2, 3, 3, 3)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_array_equal(stack[i, j], frames.rotation_about(1, angles[i, j]))


@given(THREE_ANGLES)
@settings(deadline=None)
def test_roll_pitch_yaw_rotate_about_fixed_axes_as_in_urdf(rpy):
    # Quaternions multiply from the left if each rotation is about a fixed axis.
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in enumerate(rpy):
        mujoco.mju_mulQuat(quat, quat_about(axis, angle), quat.copy())
    expected = rotation_by_mujoco(quat)
    np.testing.assert_allclose(frames.rotation_from_rpy(np.array(rpy)), expected, atol=2e-15)
    degrees = np.rad2deg(rpy).tolist()
    np.testing.assert_allclose(read({"rpy_deg": degrees})[:3, :3], expected, atol=1e-14)
    np.testing.assert_allclose(read({"rpy": list(rpy)})[:3, :3], expected, atol=2e-15)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.floats(1e-3, 1e3))
@settings(deadline=None)
def test_quaternion_of_any_length_gives_the_rotation_of_its_unit_quaternion(quat, length):
    quat = np.array(quat)
    if np.linalg.norm(quat) < 1e-3:
        quat[0] += 1.0
    unit = quat / np.linalg.norm(quat)
    np.testing.assert_allclose(
        read({"quat": (unit * length).tolist()})[:3, :3], rotation_by_mujoco(unit), atol=1e-14
    )


def test_frame_defaults_to_the_identity():
    np.testing.assert_array_equal(frames.frame(), np.eye(4))
    T = frames.frame(frames.rotation_about(2, math.pi / 2), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-15)


@given(THREE_ANGLES, st.tuples(*[st.floats(-10, 10)] * 3))
@settings(deadline=None)
def test_inverse_undoes_a_frame_and_a_stack_of_frames(rpy, position):
    T = frames.frame(frames.rotation_from_rpy(np.array(rpy)), np.array(position))
    np.testing.assert_allclose(frames.inverse(T), np.linalg.inv(T), atol=1e-13)
    stack = np.array([[T, np.eye(4)]])
    np.testing.assert_allclose(frames.inverse(stack) @ stack, np.eye(4) + 0 * stack, atol=1e-13)


@given(st.floats(0, math.pi), st.tuples(*[st.floats(-1, 1)] * 3))
@example(1e-9, (1.0, 0.0, 0.0))  # arccos of the trace would return 0 here
@example(math.pi - 1e-9, (0.0, 1.0, 0.0))  # and pi here
@example(math.pi, (0.0, 0.0, 1.0))
@settings(deadline=None)
def test_rotation_angle_is_exact_from_zero_to_pi(angle, axis):
    axis = np.array(axis)
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    quat = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat, axis / np.linalg.norm(axis), angle)
    assert frames.rotation_angle(rotation_by_mujoco(quat)) == pytest.approx(angle, abs=1e-14)


def test_frame_is_read_from_rows_sixteen_numbers_or_a_table():
    T = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    flat = [number for row in T for number in row]
    quarter = {"xyz": [1, 2, 3], "rpy_deg": [0, 0, 90]}
    np.testing.assert_array_equal(read(T), T)
    np.testing.assert_array_equal(read(flat), T)  # row by row: the position is at 3, 7 and 11
    np.testing.assert_allclose(read(quarter), T, atol=1e-15)
    np.testing.assert_array_equal(read({}), np.eye(4))
    np.testing.assert_array_equal(read({"xyz": [1, 2, 3]})[:3, 3], [1, 2, 3])


def test_reading_a_frame_does_not_change_its_argument():
    given_frame = np.eye(4)
    read(given_frame)[0, 3] = 5.0
    np.testing.assert_array_equal(given_frame, np.eye(4))


def test_rotation_typed_with_four_digits_becomes_the_nearest_exact_one():
    s = 0.7071
    T = read([[s, -s, 0, 0], [s, s, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], frames.rotation_about(2, math.pi / 4), atol=1e-15)


def test_exact_rotation_is_read_without_rounding():
    exact = frames.rotation_about(2, 0.3)
    np.testing.assert_array_equal(read(frames.frame(exact))[:3, :3], exact)


def test_inexact_last_row_is_rejected():
    # An accepted 1.000009 would scale everything the frame is applied to.
    problem = Problem(
        reason="last row is", found=[0.0, 0.0, 0.0, 1.000009], expected="[0, 0, 0, 1] (row-major)"
    )
    assert refusal([*EYE[:3], [0, 0, 0, 1.000009]]) == problem


def test_vector_in_the_wrong_shape_is_rejected_without_contradiction():
    assert refusal({"xyz": [[1, 2, 3]]}).found is None


NOT_A_ROTATION = Problem(
    reason="the upper left 3 x 3 part is not a rotation (orthonormal, determinant +1)"
)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ([1, 2], Problem(found=2, of="numbers", expected="4 x 4, or { xyz = [...], rpy = [...] }")),
        (3, Problem(found=1, of="numbers", expected="4 x 4, or { xyz = [...], rpy = [...] }")),
        ("abc", Problem(found="abc", expected="numbers")),
        ([[1, 0], [1]], Problem(reason="expected rows of equal length")),
        (
            [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]],
            Problem(
                reason="last row is",
                found=[1.0, 2.0, 3.0, 1.0],
                expected="[0, 0, 0, 1] (row-major)",
            ),
        ),
        (np.diag([1, 1, -1, 1]), NOT_A_ROTATION),  # a mirror image
        (np.diag([2, 2, 2, 1]), NOT_A_ROTATION),
        (np.diag([0, 0, 0, 1]), NOT_A_ROTATION),
        (np.eye(4) + 2e-3 * np.eye(4, k=1) * [1, 1, 1, 0], NOT_A_ROTATION),
        ({"xzy": [1, 2, 3]}, Problem(reason="unknown key", found="xzy", available=["xyz"])),
        (
            {"colour": 1},
            Problem(
                reason="unknown key", found="colour", available=["quat", "rpy", "rpy_deg", "xyz"]
            ),
        ),
        ({"xyz": [1, 2]}, Problem(reason="'xyz' has", found=2, of="numbers", expected=3)),
        ({"rpy": [1, 2, 3, 4]}, Problem(reason="'rpy' has", found=4, of="numbers", expected=3)),
        ({"rpy_deg": 90}, Problem(reason="'rpy_deg' has", found=1, of="numbers", expected=3)),
        ({"quat": [1, 0, 0]}, Problem(reason="'quat' has", found=3, of="numbers", expected=4)),
        (
            {"quat": [0, 0, 0, 0]},
            Problem(reason="'quat' is zero; expected a unit quaternion w, x, y, z"),
        ),
        (
            {"rpy": [0, 0, 1], "quat": [1, 0, 0, 0]},
            Problem(reason="found both 'rpy' and 'quat'; expected one rotation"),
        ),
        (
            {"rpy": [0, 0, 1], "rpy_deg": [0, 0, 1]},
            Problem(reason="found both 'rpy' and 'rpy_deg'; expected one rotation"),
        ),
        ({"rpy": ["a", 0, 0]}, Problem(found=["a", 0, 0], expected="numbers")),
        (
            {"xyz": [math.nan, 0, 0]},
            Problem(found=[math.nan, 0, 0], expected="finite numbers without NaN or inf"),
        ),
        (
            {"xyz": [0, math.inf, 0]},
            Problem(found=[0, math.inf, 0], expected="finite numbers without NaN or inf"),
        ),
        ({"xyz": [True, False, True]}, Problem(found=[True, False, True], expected="numbers")),
    ],
)
def test_invalid_frame_is_rejected_with_found_and_expected_values(value, problem):
    assert refusal(value) == problem


@given(
    st.lists(
        st.floats(allow_nan=True) | st.sampled_from([0.0, 1.0, -1.0, 1e200, -1e200, 1e308]),
        min_size=12,
        max_size=12,
    )
)
@example([1e200, 1e200, 0, 0, -1e200, 1e200, 0, 0, 0, 0, 1e200, 0])
@settings(deadline=None, max_examples=examples(60))
def test_any_sixteen_numbers_are_a_rigid_frame_or_rejected(twelve):
    try:
        T = read([*twelve, 0, 0, 0, 1])
    except ValueError:
        return
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) > 0
    # Sixteen numbers far from a rotation must not be repaired without a warning.
    np.testing.assert_allclose(T.ravel()[:12], twelve, atol=2e-3)


@given(st.lists(st.floats(), min_size=4, max_size=4))
@example([1e200, 0.0, 0.0, 0.0])
@settings(deadline=None, max_examples=examples(60))
def test_any_four_numbers_are_a_rotation_or_rejected(quat):
    try:
        T = read({"quat": quat})
    except ValueError:
        return
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
