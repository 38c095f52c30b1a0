"""Step responses, energy, drift, tracking, limits and messages of the joint controllers."""

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

from sero_mj.base.errors import DeclarationError, Problem, SimulationError
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.joint_control import (
    GravityCompensation,
    JointImpedance,
    JointPosition,
    Torque,
    design_damping,
    unstable_joint,
)
from sero_mj.simulate.control.make_controller import LimitedController
from sero_mj.simulate.control.robot_model import RobotModel

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
NAMES = ["A1", "A2", "E1", "A3", "A4", "A5", "A6"]


def target_at(angles: Array) -> Target:
    target = Target(len(angles))
    target.angles[:] = angles
    return target


@settings(deadline=None, max_examples=examples(50))
@given(seeds, st.integers(1, 9), st.floats(0.05, 1.5))
def test_every_mode_has_the_requested_damping_ratio(seed: int, n: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, n, n))
    mass, stiffness = a @ a.T + 0.1 * np.eye(n), b @ b.T + 0.1 * np.eye(n)
    damping = design_damping(mass, stiffness, ratio)
    np.testing.assert_allclose(damping, damping.T, atol=1e-9 * np.abs(damping).max())
    # The poles of M x'' + D x' + K x are those of modes with that ratio.
    inverse = np.linalg.inv(mass)
    poles = np.linalg.eigvals(
        np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    )
    squares = np.linalg.eigvals(inverse @ stiffness).real
    roots = np.concatenate([np.roots([1, 2 * ratio * np.sqrt(w), w]) for w in squares])
    for pole in poles:
        assert np.abs(roots - pole).min() < 1e-4 * max(1.0, abs(pole))


def test_different_damping_ratios_only_dissipate_energy() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        a = rng.normal(size=(7, 7))
        matrix = design_damping(
            a @ a.T + np.eye(7), np.diag(rng.uniform(0, 5000, 7)), rng.uniform(0, 2, 7)
        )
        assert np.linalg.eigvalsh(matrix).min() > -1e-9 * np.abs(matrix).max()
    diagonal = design_damping(np.diag([4.0, 1.0]), np.diag([100.0, 9.0]), np.array([0.5, 1.0]))
    np.testing.assert_allclose(diagonal, np.diag([2 * 0.5 * 20, 2 * 3]), atol=1e-12)


@given(st.floats(0.1, 100), st.floats(0.0, 1.9), st.floats(1e-4, 1e-2), st.floats(0.9, 1.1))
def test_longest_stable_time_step_equals_the_formula(
    mass: float, ratio: float, timestep: float, factor: float
) -> None:
    # w^2 t^2 + 4 z w t = 4, solved for w t.
    limit = -2 * ratio + np.sqrt(4 * ratio**2 + 4)
    w = factor * limit / timestep
    if abs(factor - 1) < 1e-3 or ratio < 1e-3:
        return
    found = unstable_joint(
        np.array([[mass]]),
        np.array([[mass * w**2]]),
        np.array([[2 * ratio * w * mass]]),
        timestep,
    )
    assert (found == 0) == (factor > 1)


def test_gains_unstable_at_the_time_step_are_rejected_with_the_joint() -> None:
    model = lwr_model()
    JointPosition().make(model, 1e-3).check(START)
    with raises_with(
        key="stiffness",
        reason="joint A5 is unstable at 1e+06 Nm/rad with a time step of",
        found=1.0,
        of="ms",
        expected="up to 2.67e+05 and 27 % of the other stiffnesses, or a shorter time step",
    ):
        JointPosition(stiffness=1e6).make(model, 1e-3).check(START)
    message = (
        r"unstable at 10000 Nm/rad with a time step of 20 ms; expected up to 667 and 6.7 % of "
    )
    with pytest.raises(DeclarationError, match=message):
        JointPosition().make(model, 0.02).check(START)
    JointPosition(stiffness=667.0).make(model, 0.02).check(START)
    with pytest.raises(DeclarationError):
        JointPosition(stiffness=700.0).make(model, 0.02).check(START)
    # The error is right: the simulation would be unstable.
    loop = Loop(0.02)
    loop.data.qvel[:] = 1e-3
    control, target = JointPosition().make(loop.robot, 0.02), target_at(START)
    angles = loop.run(1.0, lambda sensed, out: control.torques(sensed, target, out))
    assert not np.abs(angles[-1] - START).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize(("ratio", "overshoot"), [(0.7, 0.046), (0.4, 0.254), (1.0, 0.0)])
def test_small_step_overshoots_as_its_ratio_predicts(
    joint: int, ratio: float, overshoot: float
) -> None:
    loop = Loop(2.5e-4)
    control = JointImpedance(stiffness=1000.0, damping=ratio).make(loop.robot, 2.5e-4)
    target = target_at(START)
    # Along one mode, otherwise the others would contribute.
    loop.robot.update(START, np.zeros(7))
    mass = loop.robot.mass().copy()
    _, modes = np.linalg.eig(np.linalg.solve(mass, control.stiffness))
    mode = modes[:, joint].real
    target.angles += 0.01 * mode
    angles = loop.run(1.2, lambda sensed, out: control.torques(sensed, target, out))
    along = (angles - START) @ mass @ mode / (mode @ mass @ mode) / 0.01
    assert along.max() - 1 == pytest.approx(overshoot, abs=0.006)
    assert along[-1] == pytest.approx(1.0, abs=0.02)


def energies(loop: Loop, angles: Array, stiffness: Array) -> float:
    loop.robot.update(loop.sensed.angles, loop.sensed.velocities)
    dq, e = loop.sensed.velocities, angles - loop.sensed.angles
    return float(0.5 * dq @ loop.robot.mass() @ dq + 0.5 * e @ stiffness @ e)


@settings(deadline=None, max_examples=examples(6))
@given(seeds, st.floats(0, 1.5))
def test_impedance_never_adds_energy(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    step = 1e-4
    loop = Loop(step, rng.uniform(-1.5, 1.5, 7))
    loop.data.qvel[:] = rng.uniform(-2, 2, 7)
    loop.sense()
    control = JointImpedance(stiffness=rng.uniform(0, 2000, 7), damping=ratio).make(
        loop.robot, step
    )
    target = target_at(rng.uniform(-1.5, 1.5, 7))
    last = energies(loop, target.angles, control.stiffness)
    first = last
    for _ in range(50):
        loop.run(0.006, lambda sensed, out: control.torques(sensed, target, out))
        now = energies(loop, target.angles, control.stiffness)
        assert now <= last + 3e-3 * first  # integration error at this time step
        last = now
    if ratio > 0.3:
        assert last < first


@pytest.mark.slow
def test_gravity_compensation_does_not_drift_in_a_minute() -> None:
    loop = Loop()
    control, target = GravityCompensation().make(loop.robot, 1e-3), Target(7)
    angles = loop.run(60.0, lambda sensed, out: control.torques(sensed, target, out))
    assert np.abs(angles[-1] - START).max() < 1e-9


def test_motion_after_a_push_continues_without_damping_and_ends_with_it() -> None:
    for damping, moves in ((0.0, True), ([10.0] * 7, False)):
        loop = Loop()
        loop.data.qvel[:] = 0.1
        control, target = GravityCompensation(damping=damping).make(loop.robot, 1e-3), Target(7)
        loop.run(5.0, lambda sensed, out, c=control, t=target: c.torques(sensed, t, out))
        assert (np.abs(loop.data.qvel).max() > 0.05) == moves


@pytest.mark.parametrize("feed_forward", [True, False])
def test_moving_target_is_followed_with_feed_forward_torques(feed_forward: bool) -> None:
    loop = Loop()
    control = JointPosition(stiffness=2000.0, feed_forward=feed_forward).make(loop.robot, 1e-3)
    target, w, swing = target_at(START), 4.0, np.linspace(0.2, 0.5, 7)
    worst = [0.0]

    def act(sensed: Sensed, out: Array) -> None:
        t = sensed.time
        target.angles[:] = START + swing * (1 - np.cos(w * t)) / 2
        target.velocities[:] = swing * w * np.sin(w * t) / 2
        target.accelerations[:] = swing * w * w * np.cos(w * t) / 2
        control.torques(sensed, target, out)
        worst[0] = max(worst[0], float(np.abs(target.angles - sensed.angles).max()))

    loop.run(2.0, act)
    assert worst[0] < 3e-4 if feed_forward else worst[0] > 3e-3


def test_torque_control_adds_gravity_if_declared() -> None:
    loop = Loop()
    target, out = Target(7), np.zeros(7)
    target.torques[:] = np.arange(7)
    Torque(compensate_gravity=False).make(loop.robot, 1e-3).torques(loop.sensed, target, out)
    np.testing.assert_array_equal(out, np.arange(7))
    Torque().make(loop.robot, 1e-3).torques(loop.sensed, target, out)
    np.testing.assert_allclose(out - np.arange(7), loop.robot.gravity(), atol=1e-12)


@pytest.mark.parametrize("on_motor", [True, False])
def test_elastic_joint_is_held_by_its_motor_angle(on_motor: bool) -> None:
    xml = """<mujoco><option timestep=".0005"/><worldbody><body>
      <joint name="r/A" axis="0 1 0" armature=".4"/><inertial pos="0 0 0" mass=".01"
        diaginertia="1e-5 1e-5 1e-5"/>
      <body><joint name="r/bend" axis="0 1 0" stiffness="8000" damping="1"/>
        <geom size=".1" pos=".5 0 0" mass="4"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    robot = RobotModel(model, [0], body=2)
    control = JointImpedance(stiffness=2000.0).make(robot, 5e-4)
    motor = np.zeros(2)
    sensed = Sensed(1, motor_state=motor if on_motor else None)
    target, out = Target(1), np.zeros(1)
    data.qvel[0] = 0.1
    for _ in range(8000):
        motor[:] = data.qpos[0], data.qvel[0]
        sensed.state[:] = data.qpos.sum(), data.qvel.sum()
        control.torques(sensed, target, out)
        data.qfrc_applied[0] = np.clip(out[0], -200, 200)
        mujoco.mj_step(model, data)
    swings = np.abs(data.qvel).max()
    assert swings < 1e-3 if on_motor else swings > 0.1
    if on_motor:
        assert data.qpos.sum() == pytest.approx(9.81 * 4 * 0.5 / 8000, rel=0.02)


class Fixed:
    """A user-defined controller."""

    def __init__(self, *torques: float) -> None:
        self.wanted = np.array(torques)

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        out[:] = self.wanted


def limited(*torques: float, **more: Any) -> tuple[LimitedController, Fixed]:
    fixed = Fixed(*torques)
    fields: dict[str, Any] = {"robot": "lwr", "joint_names": ["A1", "A2"], **more}
    return LimitedController(fixed, np.array([100.0, 30.0]), 1e-3, **fields), fixed


def test_limits_hold_and_saturated_joints_are_marked() -> None:
    control, fixed = limited(120.0, -29.0)
    sensed, target, out = Sensed(2), Target(2), np.zeros(2)
    control.torques(sensed, target, out)
    assert (out.tolist(), control.saturated.tolist()) == ([100.0, -29.0], [True, False])
    assert control.requested.tolist() == [120.0, -29.0]
    fixed.wanted[:] = 100.0, -31.0
    control.torques(sensed, target, out)
    assert (out.tolist(), control.saturated.tolist()) == ([100.0, -30.0], [False, True])


def test_torque_rates_are_limited_after_the_first_torques() -> None:
    control, fixed = limited(50.0, -20.0, rates=np.array([1000.0, 5000.0]))
    sensed, target, out = Sensed(2), Target(2), np.zeros(2)
    control.torques(sensed, target, out)
    assert out.tolist() == [50.0, -20.0]
    fixed.wanted[:] = 45.0, 40.0
    seen = []
    for _ in range(12):
        control.torques(sensed, target, out)
        seen.append(out.tolist())
    np.testing.assert_allclose([row[0] for row in seen[:6]], [49, 48, 47, 46, 45, 45])
    np.testing.assert_allclose([row[1] for row in seen], [*range(-15, 31, 5), 30, 30])
    assert control.saturated.tolist() == [False, True]


@settings(deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 2), min_size=2, max_size=30))
def test_no_torque_ever_exceeds_a_limit(rows: list[tuple[float, float]]) -> None:
    rates = np.array([2e4, 4e4])
    control, fixed = limited(0.0, 0.0, rates=rates)
    sensed, target, out = Sensed(2), Target(2), np.zeros(2)
    last = None
    for row in rows:
        fixed.wanted[:] = row
        control.torques(sensed, target, out)
        assert (np.abs(out) <= [100, 30]).all()
        assert last is None or (np.abs(out - last) <= rates * 1e-3 + 1e-9).all()
        assert ((out != row) == control.saturated).all()
        last = out.copy()


@pytest.mark.parametrize(
    ("bad", "joint", "found"),
    [((1, np.nan), "A2", "nan"), ((np.inf, 1), "A1", "inf"), ((0, -np.inf), "A2", "-inf")],
)
def test_invalid_torque_stops_with_robot_joint_and_time(
    bad: tuple[float, float], joint: str, found: str
) -> None:
    control, _ = limited(*bad)
    sensed = Sensed(2)
    sensed.time = 1.2345
    with pytest.raises(SimulationError) as caught:
        control.torques(sensed, Target(2), np.zeros(2))
    assert (caught.value.joint, caught.value.time) == (f"lwr/{joint}", 1.2345)
    expected = f"the controller requested {found} Nm; expected a finite number"
    assert str(caught.value) == f"lwr/{joint} at 1.2345 s: {expected}"


def test_zero_limit_names_the_joint() -> None:
    with pytest.raises(DeclarationError) as error:
        LimitedController(
            Fixed(0, 0),
            np.array([100.0, 0.0]),
            1e-3,
            np.array([-1.0, np.nan]),
            joint_names=["A1", "A2"],
        )
    assert str(error.value).splitlines() == [
        "torque_limits: joint A2 has 0; expected a positive number of Nm",
        "torque_rate_limits: joint A1 has -1; expected a positive number of Nm/s",
        "torque_rate_limits: joint A2 has nan; expected a positive number of Nm/s",
    ]
    with raises_with(key="torque_limits", found=1, expected="2, one per joint"):
        LimitedController(Fixed(0, 0), np.ones(1), 1e-3, joint_names=["A1", "A2"])


STIFFNESSES = "0 to 5000 Nm/rad; kind = 'joint_position' can be stiffer"


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, Problem("stiffness", "is required")),
        ({"stiffness": -1}, Problem("stiffness", found=-1.0, expected=STIFFNESSES)),
        ({"stiffness": [1, 6000.0]}, Problem("stiffness", found=6000.0, expected=STIFFNESSES)),
        ({"stiffness": "much"}, Problem("stiffness", found="much", expected="numbers")),
        (
            {"stiffness": [[1, 2]]},
            Problem(
                "stiffness",
                "found an array with",
                found=2,
                of="dimensions",
                expected="one number, or one per joint",
            ),
        ),
        (
            {"stifness": 1, "stiffness": 1},
            Problem("stifness", "unknown key", available=["stiffness"]),
        ),
        (
            {"stiffness": 1, "damping": 7},
            Problem("damping", found=7.0, expected="0 to 2 (a ratio; 1 is critical damping)"),
        ),
    ],
)
def test_invalid_gains_are_rejected(fields: dict[str, Any], problem: Problem) -> None:
    with pytest.raises(DeclarationError) as caught:
        JointImpedance(**fields)
    assert caught.value.problems == [problem]


def test_gains_of_the_wrong_size_are_rejected() -> None:
    expected = "7 (one per joint) or 1 (for all)"
    with raises_with(key="stiffness", found=6, of="entries", expected=expected):
        JointImpedance(stiffness=[1.0] * 6).make(lwr_model(), 1e-3)
