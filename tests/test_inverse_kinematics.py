"""Inverse kinematics against forward kinematics, with DH tables and the compiled model."""

from __future__ import annotations

import numpy as np
import pytest

import sero_mj
from sero_mj.base.frames import frame, rotation_angle
from sero_mj.data.drive.place import follow
from sero_mj.robots.declared.couplings import Coupling
from sero_mj.robots.declared.inverse_kinematics import (
    CLOSE,
    frame_place,
    independent_limits,
    reach,
)

BENT = np.array([0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1])


@pytest.fixture(scope="module")
def lwr() -> sero_mj.SerialRobot:
    return sero_mj.SerialRobot.from_model("lwr")


def flange_place(robot: sero_mj.SerialRobot):
    return frame_place(robot, robot.base_frame, robot.flange_link, robot.T_n_flange)


@pytest.mark.parametrize("name", ["lwr", "panda", "puma560", "scara", "stanford", "hit_finger"])
def test_jacobian_equals_finite_differences_of_the_compiled_model(name: str) -> None:
    robot = sero_mj.SerialRobot.from_model(name)
    world = sero_mj.World(sero_mj.Scene(robots=[robot]))
    data = world.make_data()
    part = world.robots[robot.name]
    rng = np.random.default_rng(3)
    free = robot.home[robot.coupled.independent]
    free = free + rng.uniform(0.1, 0.4, len(free))

    def flange(angles: np.ndarray) -> np.ndarray:
        data.qpos[part.qpos] = robot.coupled.positions(angles)
        follow(world.model, data)
        return world.frame(data, f"{robot.name}/flange")

    pose, jacobian = flange_place(robot)(free)
    assert pose == pytest.approx(flange(free), abs=1e-9)
    for k in range(len(free)):
        step = np.zeros(len(free))
        step[k] = 1e-6
        there, back = flange(free + step), flange(free - step)
        assert jacobian[:3, k] == pytest.approx((there - back)[:3, 3] / 2e-6, abs=1e-6)
        turn = (there[:3, :3] @ back[:3, :3].T - np.eye(3)) / 2e-6
        assert jacobian[3:, k] == pytest.approx([turn[2, 1], turn[0, 2], turn[1, 0]], abs=1e-5)


def test_random_poses_are_reached_within_the_limits(lwr: sero_mj.SerialRobot) -> None:
    place, limits = flange_place(lwr), lwr.position_limits
    rng = np.random.default_rng(5)
    for _ in range(30):
        angles = rng.uniform(0.8 * limits[:, 0], 0.8 * limits[:, 1])
        goal = lwr.base_frame @ lwr.fwd_kin_base_to_flange(angles)
        start = np.clip(angles + rng.uniform(-0.25, 0.25, 7), limits[:, 0], limits[:, 1])
        found = reach(place, goal, start, limits, posture=start)
        assert (found.angles >= limits[:, 0]).all() and (found.angles <= limits[:, 1]).all()
        if found.is_there:
            T = lwr.base_frame @ lwr.fwd_kin_base_to_flange(found.angles)
            assert np.linalg.norm(T[:3, 3] - goal[:3, 3]) < CLOSE
            assert rotation_angle(T[:3, :3] @ goal[:3, :3].T) < CLOSE
        else:
            assert found.at_limit.any()


def test_null_space_is_held_on_a_closed_path(lwr: sero_mj.SerialRobot) -> None:
    place = flange_place(lwr)
    start, _ = place(BENT)
    angles = BENT
    held, drifted = BENT, BENT
    for phase in np.linspace(0, 2 * np.pi, 60):
        goal = start @ frame(np.eye(3), 0.12 * np.array([np.sin(phase), np.cos(phase) - 1, 0.0]))
        held = reach(place, goal, held, lwr.position_limits, posture=BENT).angles
        drifted = reach(place, goal, drifted, lwr.position_limits).angles
        angles = np.vstack([angles, held])
    assert np.ptp(angles, axis=0).max() > 0.2
    assert held == pytest.approx(BENT, abs=2e-3)
    assert np.abs(drifted - BENT).max() > 5 * np.abs(held - BENT).max()


def test_unreachable_pose_is_approached_and_reported(lwr: sero_mj.SerialRobot) -> None:
    place = flange_place(lwr)
    far = frame(np.eye(3), [2.0, 0.0, 0.31])
    found = reach(place, far, BENT, lwr.position_limits, turns=False)
    assert not found.is_there
    assert found.angle == 0.0
    # Fully stretched from its shoulder, 0.31 m up, along the line to the goal.
    arm = 0.40 + 0.39 + 0.078
    assert found.distance == pytest.approx(2.0 - arm, abs=0.02)


def test_joint_at_its_limit_is_named(lwr: sero_mj.SerialRobot) -> None:
    place, limits = flange_place(lwr), lwr.position_limits.copy()
    limits[1] = -0.1, 0.65
    goal, _ = place(BENT + 0.4 * np.eye(7)[1])
    held = np.array([0.0, 1.0, 0, 0, 0, 0, 0])
    found = reach(place, goal, BENT, np.where(held[:, None], limits, BENT[:, None] + [0, 0]))
    assert found.at_limit[1] and found.angles[1] == 0.65 and not found.is_there


def test_coupled_joints_follow_within_their_limits(lwr: sero_mj.SerialRobot) -> None:
    robot = lwr.model_copy(update={"couplings": {"A3": Coupling(to="A2", ratio=-2.0, offset=0.1)}})
    limits = independent_limits(robot)
    low, high = (robot.position_limits[3] - 0.1) / -2.0
    assert limits[1].tolist() == pytest.approx([high, low])
    place = flange_place(robot)
    free = BENT[robot.coupled.independent]
    goal, _ = place(free + 0.1)
    found = reach(place, goal, free, limits)
    assert found.is_there and len(found.angles) == 6
