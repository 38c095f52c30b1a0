"""Motions against finite differences and limits; torques against energy and forward dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sero_mj.data.drive.place import follow
from sero_mj.data.send.motion import InverseDynamics, SineMotion
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

Array = NDArray[np.float64]
GRAVITY = 9.81  # m/s2, MuJoCo's default
times = st.floats(-1e5, 1e5)


@st.composite
def robots(draw: st.DrawFn) -> SerialRobot:
    """Robots with and without limits, with revolute and prismatic joints."""
    n = draw(st.integers(1, 9))
    low = draw(st.lists(st.floats(-3, 3), min_size=n, max_size=n))
    width = draw(st.lists(st.floats(1e-3, 6), min_size=n, max_size=n))
    speeds = draw(st.lists(st.floats(1e-3, 10), min_size=n, max_size=n))
    kinds = draw(st.lists(st.sampled_from(["revolute", "prismatic"]), min_size=n, max_size=n))
    limits = [[a, a + b] for a, b in zip(low, width, strict=True)]
    return SerialRobot(
        dh_convention="craig",
        dh_params=[[1.0, 0.1, 0.2, 0.3]] * n,
        joint_types=kinds,
        position_limits=limits if draw(st.booleans()) else None,
        velocity_limits=speeds if draw(st.booleans()) else None,
    )


def bent_arm(**fields: object) -> SerialRobot:
    """Returns a robot whose links hang, swing and slide under gravity."""
    table = {
        "dh_convention": "standard",
        "dh_params": [[1.2, 0.3, 0.1, 0.2], [-0.7, 0.2, 0.4, 0.1], [0.5, 0.4, -0.3, 0.3]],
        "joint_types": ["revolute", "prismatic", "revolute"],
        "base_frame": {"xyz": [0.1, 0.2, 0.3], "rpy": [0.8, -0.5, 0.3]},
    }
    return SerialRobot(**{**table, **fields})


def unconstrained(robot: SerialRobot) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = World(Scene(robots=[robot], floor=False)).model
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    return model, mujoco.MjData(model)


def potential_energy(model: mujoco.MjModel, data: mujoco.MjData, q: Array) -> float:
    """Returns the potential energy from the heights of the centers of mass alone."""
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return float(GRAVITY * (model.body_mass * data.xipos[:, 2]).sum())


@given(robots(), times, st.floats(0, 1))
def test_motion_stays_within_the_limits_at_all_times(
    robot: SerialRobot, t: float, amplitude: float
) -> None:
    position, velocity, _ = SineMotion(robot, amplitude).at(t)
    far = np.where(np.array(robot.joint_types) == "revolute", np.pi, 1.0)  # without limits
    limits = np.stack([-far, far], axis=1)
    if robot.position_limits is not None:
        limits = robot.position_limits
    assert (position >= limits[:, 0]).all()
    assert (position <= limits[:, 1]).all()
    if robot.velocity_limits is not None:
        assert (np.abs(velocity) <= robot.velocity_limits).all()


@pytest.mark.parametrize("amplitude", [0.3, 1.0])
def test_every_joint_moves_a_quarter_of_its_range_independently(
    lwr: SerialRobot, amplitude: float
) -> None:
    motion = SineMotion(lwr, amplitude)
    moment = [motion.at(t) for t in np.linspace(0, 60, 3000)]
    position = np.array([m[0] for m in moment])
    velocity = np.array([m[1] for m in moment])
    assert lwr.position_limits is not None
    assert lwr.velocity_limits is not None
    low, high = lwr.position_limits.T
    assert ((position > low) & (position < high)).all()
    assert (np.abs(velocity) < lwr.velocity_limits).all()
    swing = np.ptp(position, axis=0)
    assert (swing > 0.25 * amplitude * (high - low)).all()
    # Joints move linearly independently, so that they can be distinguished.
    assert np.linalg.matrix_rank(position - position.mean(axis=0)) == lwr.n


@settings(deadline=None)
@given(robots(), st.floats(-100, 100))
def test_velocities_and_accelerations_are_derivatives(robot: SerialRobot, t: float) -> None:
    motion = SineMotion(robot)
    h = 1e-4
    (before, slower, _), (after, faster, _) = motion.at(t - h), motion.at(t + h)
    _, velocity, acceleration = motion.at(t)
    # Off by h^2/6 of the third derivative and by rounding of the time.
    np.testing.assert_allclose((after - before) / (2 * h), velocity, rtol=0, atol=1e-7)
    np.testing.assert_allclose((faster - slower) / (2 * h), acceleration, rtol=0, atol=1e-7)


@given(robots(), times)
def test_amplitude_scales_the_motion_only(robot: SerialRobot, t: float) -> None:
    still, half, full = (SineMotion(robot, amplitude).at(t) for amplitude in (0.0, 0.5, 1.0))
    assert not still[1].any()
    assert not still[2].any()
    assert (still[0] == SineMotion(robot, 0.0).at(t + 1.0)[0]).all()
    for excess, bound in ((7.0, full), (-1.0, still)):
        for found, expected in zip(SineMotion(robot, excess).at(t), bound, strict=True):
            assert (found == expected).all()
    if robot.velocity_limits is None:  # these can limit the whole amplitude but not half of it
        np.testing.assert_allclose(half[0] - still[0], (full[0] - still[0]) / 2, atol=1e-9)


def test_robot_with_a_declared_pose_moves_about_it_within_its_limits() -> None:
    home = np.array([1.0, -0.5, 0.3, 2.0, 0.0, 0.9, -0.4])  # the fourth joint is close to its limit
    robot = SerialRobot.from_model("lwr", joint_angles=home)
    assert robot.position_limits is not None
    angles = np.array([SineMotion(robot).at(t)[0] for t in np.linspace(0, 600, 6000)])
    low, high = angles.min(axis=0), angles.max(axis=0)
    assert (low >= robot.position_limits[:, 0]).all() and (
        high <= robot.position_limits[:, 1]
    ).all()
    middle = (low + high) / 2
    assert np.delete(middle, 3) == pytest.approx(np.delete(home, 3), abs=0.01)
    assert ((low < home) & (home < high)).all()
    assert (high - low > 0.3).all()


def test_robot_without_limits_moves() -> None:
    motion = SineMotion(SerialRobot(dh_convention="craig", dh_params=[[0, 0, 0, 0.3]]))
    positions = [motion.at(t)[0][0] for t in np.linspace(0, 60, 600)]
    assert np.ptp(positions) > 0.5


@pytest.mark.parametrize("seed", range(5))
def test_torques_of_a_motion_reproduce_its_accelerations(lwr: SerialRobot, seed: int) -> None:
    for robot in (lwr, bent_arm()):
        model, data = unconstrained(robot)
        random = np.random.default_rng(seed)
        position, velocity, acceleration = random.uniform(-1.5, 1.5, (3, robot.n))
        torques = InverseDynamics(robot).torques(position, velocity, acceleration)
        assert torques.shape == (robot.n,)
        assert np.abs(torques).max() > 0.1
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = position, velocity, torques
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, acceleration, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("t", [0.0, 0.7, 3.1])
def test_power_of_the_torques_equals_the_energy_rate(lwr: SerialRobot, t: float) -> None:
    for robot in (lwr, bent_arm()):
        model, data = unconstrained(robot)
        motion, dynamics = SineMotion(robot), InverseDynamics(robot)

        def energy(
            t: float,
            motion: SineMotion = motion,
            model: mujoco.MjModel = model,
            data: mujoco.MjData = data,
        ) -> float:
            data.qpos[:], data.qvel[:], _ = motion.at(t)
            mujoco.mj_forward(model, data)
            return float(data.energy[1]) + potential_energy(model, data, motion.at(t)[0])

        h = 1e-4
        gain = (energy(t + h) - energy(t - h)) / (2 * h)
        position, velocity, acceleration = motion.at(t)
        power = float(dynamics.torques(position, velocity, acceleration) @ velocity)
        assert abs(power) > 1e-3
        assert power == pytest.approx(gain, rel=1e-6, abs=1e-6)


def test_torques_at_rest_hold_the_weight(lwr: SerialRobot) -> None:
    for robot in (lwr, bent_arm()):
        model, data = unconstrained(robot)
        q = np.linspace(0.4, 1.1, robot.n)
        h = 1e-6
        slopes = [
            (potential_energy(model, data, q + e) - potential_energy(model, data, q - e)) / (2 * h)
            for e in h * np.eye(robot.n)
        ]
        zero = np.zeros(robot.n)
        torques = InverseDynamics(robot).torques(q, zero, zero)
        assert np.abs(torques).max() > 1.0
        np.testing.assert_allclose(torques, slopes, atol=1e-6)


def test_joint_stops_do_not_push_back_beyond_the_limits() -> None:
    # A real robot can be beyond the declared limits: its torques are those of its motion.
    free, limited = bent_arm(), bent_arm(position_limits=[[-0.2, -0.1]] * 3)
    q, v, a = np.array([[1.0, 0.8, -1.0], [0.5, 0.5, 0.5], [1.0, 1.0, 1.0]])
    np.testing.assert_array_equal(
        InverseDynamics(limited).torques(q, v, a), InverseDynamics(free).torques(q, v, a)
    )


def test_torques_are_a_copy_and_independent_of_previous_calls() -> None:
    dynamics = InverseDynamics(bent_arm())
    first = dynamics.torques(*np.full((3, 3), 0.5))
    kept = first.copy()
    dynamics.torques(*np.full((3, 3), -0.7))
    assert (first == kept).all()
    assert (dynamics.torques(*np.full((3, 3), 0.5)) == kept).all()


def test_follow_moves_frames_without_advancing_time() -> None:
    robot = bent_arm()
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    q = np.array([0.5, -0.25, 1.5])
    data.qpos[:] = q
    follow(world.model, data)
    assert data.time == 0.0
    assert (data.qpos == q).all()
    flange = robot.dh.frames(q, robot.base_frame)[-1] @ robot.flange_frame
    assert np.abs(data.xpos[world.robots["robot"].flange_body] - flange[:3, 3]).max() < 1e-12


def test_follow_updates_everything_that_mujoco_draws() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body pos="0 0 1"><joint axis="0 1 0"/>
        <geom type="box" size=".1 .2 .3" pos=".4 0 0"/><site pos=".1 .2 .3"/>
        <camera pos="0 .3 .2"/><light pos=".2 0 .1" dir="1 0 0"/></body></worldbody></mujoco>"""
    )
    data, reference = mujoco.MjData(model), mujoco.MjData(model)
    for each, move in ((data, follow), (reference, mujoco.mj_forward)):
        each.qpos[:] = 0.7
        move(model, each)
    for field in ("geom_xpos", "site_xpos", "subtree_com", "cam_xpos", "cam_xmat", "light_xdir"):
        assert getattr(data, field).any(), field
        assert (getattr(data, field) == getattr(reference, field)).all(), field
