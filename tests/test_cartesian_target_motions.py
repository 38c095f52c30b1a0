"""Target motions of the flange, and whether the LWR can follow them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from simulated import START, lwr_model, lwr_robot

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.base.frames import frame, rotation_angle, rotation_from_rpy
from sero_mj.simulate.control.plan import follow_poses, target_motion_from, target_motion_kinds
from sero_mj.simulate.control.target_motions import CartesianConstant, CartesianTargetMotion
from sero_mj.simulate.control.way_points import CartesianWayPoints

Array = NDArray[np.float64]
MODEL = lwr_model()
TIMES = np.arange(0.0, 10.0, 1e-3)
angles = st.tuples(*[st.floats(-3, 3)] * 3)
places = st.tuples(*[st.floats(-1, 1)] * 3)


def start_pose() -> Array:
    MODEL.update(START, np.zeros(7))
    return MODEL.flange()


@settings(deadline=None, max_examples=examples(30))
@given(st.lists(st.tuples(places, angles), min_size=2, max_size=4))
def test_motion_reaches_each_pose_on_time_with_consistent_twists(
    rows: list[tuple[tuple[float, ...], tuple[float, ...]]],
) -> None:
    poses = [frame(rotation_from_rpy(np.array(rpy)), np.array(xyz)) for xyz, rpy in rows]
    arrivals = 3.0 * np.arange(1, len(poses) + 1)
    times = np.arange(0.0, arrivals[-1] + 0.5, 5e-3)
    start = frame()
    motion = CartesianWayPoints(poses=poses, times=arrivals).sample(times, start)
    for t, pose in zip(arrivals, poses, strict=True):
        np.testing.assert_allclose(motion.poses[np.argmin(np.abs(times - t))], pose, atol=1e-7)
    R = motion.poses[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9
    )
    middle = (motion.twists[1:] + motion.twists[:-1]) / 2
    slope = np.diff(motion.poses[:, :3, 3], axis=0) / 5e-3
    np.testing.assert_allclose(slope, middle[:, :3], atol=1e-3)
    turn = R[1:] @ R[:-1].transpose(0, 2, 1)
    turn = (turn - turn.transpose(0, 2, 1)) / 2
    spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) / 5e-3
    np.testing.assert_allclose(spin, middle[:, 3:], atol=1e-3)
    rate = np.diff(motion.twists, axis=0) / 5e-3
    half = (motion.accelerations[1:] + motion.accelerations[:-1]) / 2
    np.testing.assert_allclose(rate, half, atol=0.05)


@pytest.mark.parametrize("law", ["quintic", "trapezoidal"])
@pytest.mark.parametrize(("far", "spun"), [(0.5, 0.1), (0.01, 2.0)])
def test_speed_limits_hold_and_one_limit_is_reached(law: str, far: float, spun: float) -> None:
    pose = frame(rotation_from_rpy(np.array([0, 0, spun])), np.array([far, 0, 0]))
    declared = CartesianWayPoints(
        poses=[pose], speed=0.2, angular_speed=0.5, acceleration=3.0, time_law=law
    )
    motion = declared.sample(TIMES, frame())
    linear = np.linalg.norm(motion.twists[:, :3], axis=1).max() / 0.2
    angular = np.linalg.norm(motion.twists[:, 3:], axis=1).max() / 0.5
    assert max(linear, angular) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(motion.poses[-1], pose, atol=1e-12)


def test_poses_can_be_relative_to_the_start() -> None:
    start = start_pose()
    down = {"kind": "cartesian_way_points", "poses": [{"xyz": [0, 0, 0.1]}], "times": [2.0]}
    motion = target_motion_from({**down, "relative_to": "start"}).sample(TIMES, start)
    np.testing.assert_allclose(motion.poses[-1], start @ frame(None, np.array([0, 0, 0.1])))
    still = CartesianConstant().sample(TIMES[:3], start)
    np.testing.assert_array_equal(still.poses, np.tile(start, (3, 1, 1)))
    placed = CartesianConstant(pose={"xyz": [1, 2, 3]}).sample(TIMES[:3], start)
    np.testing.assert_array_equal(placed.poses[0][:3, 3], [1, 2, 3])
    zero = CartesianWayPoints(poses=[{"xyz": [1, 2, 3]}], times=[0.0]).sample(TIMES[:3], start)
    np.testing.assert_allclose(zero.poses[0][:3, 3], [1, 2, 3])
    kinds = {
        kind
        for kind, law in target_motion_kinds().items()
        if issubclass(law, CartesianTargetMotion)
    }
    assert kinds == {
        "cartesian_constant",
        "cartesian_way_points",
    }


def test_lwr_follows_reachable_poses() -> None:
    start = start_pose()
    turned = frame(rotation_from_rpy(np.array([0.2, 0.0, 0.3])), np.array([0.1, 0.1, -0.1]))
    motion = CartesianWayPoints(poses=[turned], relative_to="start", times=[3.0]).sample(
        TIMES[:4000], start
    )
    joints = follow_poses(motion, MODEL, lwr_robot(), START)
    assert joints.shape == (4000, 7)
    np.testing.assert_allclose(joints[0], START, atol=1e-5)
    limits = lwr_robot().position_limits
    assert limits is not None
    for row in range(0, 4000, 137):
        MODEL.update(joints[row], np.zeros(7))
        pose = motion.poses[row]
        assert np.linalg.norm(MODEL.flange_position - pose[:3, 3]) < 1e-3
        assert rotation_angle(MODEL.flange_rotation.T @ pose[:3, :3]) < 2e-3
        assert ((joints[row] >= limits[:, 0]) & (joints[row] <= limits[:, 1])).all()


@pytest.mark.parametrize(
    ("frame_table", "message"),
    [
        (
            {"xyz": [0, 0, 1.0]},
            r"^the flange cannot follow at t = \d\.\d+ s: its error is \d+\.\d mm and ",
        ),
        ({"rpy_deg": [0, 0, 179]}, r"at t = \d\.\d+ s: .*; joints? .*A6.* at the limit$"),
    ],
)
def test_unreachable_pose_is_reported_with_its_time(frame_table: Any, message: str) -> None:
    start = start_pose()
    bent = START.copy()
    bent[6] = np.deg2rad(100.0)
    if "rpy_deg" in frame_table:
        MODEL.update(bent, np.zeros(7))
        start = MODEL.flange()
    else:
        bent = START
    law = CartesianWayPoints(poses=[frame_table], relative_to="start", times=[4.0])
    with pytest.raises(DeclarationError, match=message):
        follow_poses(law.sample(TIMES, start), MODEL, lwr_robot(), bent)


@pytest.mark.parametrize(
    ("fields", "problems"),
    [
        ({"poses": []}, [Problem("poses", found=[], expected="1 entry or more")]),
        (
            {"poses": [{}], "times": [1, 2]},
            [Problem("times", found=2, of="entries", expected="1, one per pose")],
        ),
        (
            {"poses": [{}]},
            [Problem("", "found neither; expected exactly one of `times` and `speed`")],
        ),
        (
            {"poses": [{"xzy": 1}], "times": [1]},
            [Problem("poses.0", "unknown key", found="xzy", available=["xyz"])],
        ),
        (
            {"pose": [{}], "times": [1]},
            [Problem("poses", "is required"), Problem("pose", "unknown key", available=["poses"])],
        ),
    ],
)
def test_invalid_motions_are_rejected(fields: dict[str, Any], problems: list[Problem]) -> None:
    with pytest.raises(DeclarationError) as caught:
        target_motion_from({"kind": "cartesian_way_points", **fields}).sample(TIMES, np.eye(4))
    assert caught.value.problems == problems
