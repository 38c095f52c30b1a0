"""Denavit-Hartenberg tables computed from chains of joint frames, checked by `kinematics.dh`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj import DhTable, SerialRobot
from sero_mj.base import paths
from sero_mj.base.frames import Array, Bools, frame, inverse, rotation_about, rotation_from_rpy
from sero_mj.robots.kinematics.dh_from_frames import DhChain, dh_from_frames

CONVENTIONS = ("craig", "standard")
SERIAL = [name for name in paths.list_models() if not SerialRobot.from_model(name).mirrored]


def walk(joint_frames: Array, revolute: Bools, q: Array) -> Array:
    """Returns the frames of the base and of every link, (n + 1, 4, 4), joint by joint."""
    found = [np.eye(4)]
    for T, turns, value in zip(joint_frames, revolute, q, strict=True):
        moved = frame(rotation_about(2, value)) if turns else frame(position=[0, 0, value])
        found.append(found[-1] @ T @ moved)
    return np.array(found)


def assert_same(chain: DhChain, joint_frames: Array, revolute: Bools, flange: Array) -> None:
    """Asserts that the table, read by `DhTable`, has the chain's links and flange."""
    table = DhTable.from_rows(chain.rows, chain.convention, revolute=revolute)
    random = np.random.default_rng(7)
    for q in random.uniform(-1, 1, (20, len(joint_frames))) * np.where(revolute, np.pi, 1.0):
        frames = table.frames(q, chain.base_frame)
        expected = walk(joint_frames, revolute, q)
        assert np.allclose(frames[1:] @ chain.link_frames, expected[1:], rtol=0, atol=2e-9)
        assert np.allclose(
            frames[-1] @ chain.flange_frame, expected[-1] @ flange, rtol=0, atol=2e-9
        )


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("name", SERIAL)
def test_table_of_a_robot_or_an_equivalent_one_is_found(name: str, convention: str) -> None:
    robot = SerialRobot.from_model(name)
    at_zero = robot.dh.frames(np.zeros(robot.n))
    axes, points = robot.dh.joint_axes(at_zero)
    # Link frames as in other software: anywhere on the axis, rotated about it.
    random = np.random.default_rng(1)
    links = [np.eye(4)]
    for z, point, angle, shift in zip(
        axes, points, *random.uniform(-1, 1, (2, robot.n)), strict=True
    ):
        x = np.cross(z, [0.3, 0.5, 0.8])
        x /= np.linalg.norm(x)
        turned = frame(np.column_stack([x, np.cross(z, x), z]), point)
        links.append(turned @ frame(rotation_about(2, angle), [0, 0, shift]))
    joint_frames = np.array([inverse(A) @ B for A, B in pairwise(links)])
    flange = inverse(links[-1]) @ at_zero[-1] @ robot.T_n_flange
    chain = dh_from_frames(joint_frames, robot.dh.revolute, flange, convention)
    assert chain is not None
    assert_same(chain, joint_frames, robot.dh.revolute, flange)
    assert np.abs(chain.rows[:, [1, 3]]).max() < 2 * robot.reach + 1.0


@pytest.mark.parametrize("name", ["lwr", "panda"])
def test_computed_tables_equal_the_published_ones(name: str) -> None:
    robot = SerialRobot.from_model(name)
    joint_frames = robot.dh.link_transforms(np.zeros(7))
    chain = dh_from_frames(joint_frames, robot.dh.revolute, robot.T_n_flange)
    assert chain is not None
    assert np.allclose(chain.rows, robot.dh_params, atol=1e-12)
    assert np.allclose(chain.base_frame, np.eye(4), atol=1e-12)
    assert np.allclose(chain.flange_frame, robot.T_n_flange, atol=1e-12)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_parallel_coincident_and_opposite_axes_have_a_table(convention: str) -> None:
    half = rotation_about(0, np.pi)
    joint_frames = np.array(
        [
            frame(position=[0.1, 0.2, 0.3]),
            frame(position=[0.0, 0.0, 0.4]),
            frame(half, [0.0, 0.0, 0.1]),
            frame(rotation_about(2, 1.0), [0.3, 0.4, 0.5]),
            frame(half, [-0.3, 0.1, 0.0]),
        ]
    )
    revolute = np.array([True, False, True, True, True])
    flange = frame(rotation_from_rpy(np.array([0.1, 0.2, 0.3])), [0.1, 0.2, 0.3])
    chain = dh_from_frames(joint_frames, revolute, flange, convention)
    assert chain is not None
    assert_same(chain, joint_frames, revolute, flange)
    assert np.abs(chain.rows[:, 1]).max() == pytest.approx(0.5)


def test_nearly_parallel_axes_have_an_exact_table_or_none() -> None:
    found = []
    for angle in (1e-12, 1e-8, 3.7e-6, 1e-3):
        second = frame(rotation_about(1, angle), [0.5, 0.2, 0.0])
        chain = dh_from_frames(np.array([np.eye(4), second, second]), np.ones(3, bool))
        if chain is not None:
            assert_same(chain, np.array([np.eye(4), second, second]), np.ones(3, bool), np.eye(4))
        found.append(None if chain is None else bool(np.abs(chain.rows[:, 3]).max() < 10.0))
    assert found[0] is True and found[-1] is False  # exact both; far feet in the last
    assert True not in found[1:]


angles = st.one_of(st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi]), st.floats(-3, 3))
lengths = st.one_of(st.sampled_from([0.0, 0.4]), st.floats(-1, 1))
poses = st.tuples(
    st.lists(angles, min_size=3, max_size=3), st.lists(lengths, min_size=3, max_size=3)
)


@given(
    st.lists(st.tuples(poses, st.booleans()), min_size=1, max_size=8),
    poses,
    st.sampled_from(CONVENTIONS),
)
def test_any_chain_has_an_exact_table_or_none(joints, flange, convention) -> None:
    joint_frames = np.array(
        [frame(rotation_from_rpy(np.array(rpy)), xyz) for (rpy, xyz), _ in joints]
    )
    revolute = np.array([turns for _, turns in joints])
    T_n_flange = frame(rotation_from_rpy(np.array(flange[0])), flange[1])
    chain = dh_from_frames(joint_frames, revolute, T_n_flange, convention)
    if chain is not None:
        assert_same(chain, joint_frames, revolute, T_n_flange)
        return
    # Only axes that are parallel up to rounding have none.
    sines = np.linalg.norm(np.cross([0, 0, 1], joint_frames[:, :3, 2]), axis=1)
    assert ((sines > 0) & (sines < 1e-4)).any() or T_n_flange[0, 2] ** 2 + T_n_flange[
        1, 2
    ] ** 2 < 1e-8
